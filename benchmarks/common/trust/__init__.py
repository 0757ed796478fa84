"""Whether ``identified`` can be believed: a simulator of its own, scenarios, and the judge; see
``scenarios.py``.
"""
