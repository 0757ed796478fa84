"""The four variants of the thesis and what only they need. Read `window_forecaster.py` first."""
