"""Archives: many bags, each identified by itself. Read `bag_work.py` first."""
