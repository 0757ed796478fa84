"""Compiled code for regular blocks and estimates. Read `regular_block.py` first."""
