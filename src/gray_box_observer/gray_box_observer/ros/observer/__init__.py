"""The observer as a node: topics in, topics out, diagnostics. Read `observer_node.py` first."""
