"""Can ``identified`` be believed: a simulator of its own, scenarios, judge (``scenarios.py``)."""
