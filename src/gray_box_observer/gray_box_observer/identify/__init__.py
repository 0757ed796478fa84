"""The observer over recorded bags, and the `identify` command around it. Read `offline_run.py`
first, then `command.py`.
"""
