"""Measurement logs (CSV, or columns between blanks) turned into bags. Read `log_conversion.py`
first.
"""
