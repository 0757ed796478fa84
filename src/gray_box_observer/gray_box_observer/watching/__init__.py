"""What people see of observers: a table in a terminal, a page in a browser.

Nothing here knows ROS. Read `observer_state.py` first: what table and page are made from.
"""
