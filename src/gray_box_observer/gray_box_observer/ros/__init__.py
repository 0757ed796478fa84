"""Nodes and what they share; they only wire. Read `running.py` and `topics.py` first."""
