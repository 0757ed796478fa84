"""Learns a motor whose speed is hidden. Read `rotor_estimator.py`, then `window_learner.py`."""
