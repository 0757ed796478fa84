"""The rule that learns block by block, with batch fits and change tests. Read `estimator.py`."""
