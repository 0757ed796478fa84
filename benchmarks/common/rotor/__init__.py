"""What the benchmark of hidden rotors is made of: its records, their bound, and the runs over them."""
