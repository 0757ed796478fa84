"""The observer over recorded bags, and its command. Read `offline_run.py`, then `command.py`."""
