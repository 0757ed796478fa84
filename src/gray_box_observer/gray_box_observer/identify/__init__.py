"""The observer over recorded bags (`offline_run.py`), and the `identify` command around it."""
