"""The observer as a node: topics in, topics out. Read `observer_node.py`, then `session.py`."""
