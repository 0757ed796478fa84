"""Motors from a wheel's to a servo's, and the ways in which they are driven."""
