"""Records of MCAP files that are cut, damaged or in progress. Read `mcap_layout.py` first."""
