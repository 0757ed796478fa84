"""The nodes of those who watch an observer. Read `observer_listener.py` first: what they hear."""
