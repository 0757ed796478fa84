"""The rule that learns block by block, with its batch fits and tests for a change. Read
`estimator.py` first.
"""
