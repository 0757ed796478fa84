"""A robot of two wheels whose signals are wired rightly, or wrongly in one of twelve ways."""
