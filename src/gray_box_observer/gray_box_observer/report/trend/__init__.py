"""The report of motors over many runs. Read `trend_page.py` first."""
