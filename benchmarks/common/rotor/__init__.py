"""Records of hidden rotors, their Cramer-Rao bound, and the runs over them."""
