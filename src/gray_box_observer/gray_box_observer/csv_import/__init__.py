"""Turns measurement logs (CSV or columns) into bags. Read `log_conversion.py` first."""
