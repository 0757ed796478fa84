"""Compiled code for regular blocks and estimates, and its loading. Read `regular_block.py` first."""
