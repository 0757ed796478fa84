"""The report of one run. Read `page.py` first."""
