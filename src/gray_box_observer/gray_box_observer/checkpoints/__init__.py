"""Saves and restores learnt state. Read `checkpoint.py` first, then `checkpoint_manager.py`."""
