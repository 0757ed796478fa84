"""Saving and restoring what was learnt. Read `checkpoint.py` first, then `checkpoint_manager.py`."""
