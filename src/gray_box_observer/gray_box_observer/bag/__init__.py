"""Reading, writing and describing bags. Read `reader.py` and `writer.py` first."""
