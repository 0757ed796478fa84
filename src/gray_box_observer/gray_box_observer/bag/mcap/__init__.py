"""Records of MCAP files that are cut, damaged or still being written. Read `mcap_layout.py` first."""
