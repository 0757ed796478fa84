"""Learns a motor whose speed is a hidden state. Read `rotor_estimator.py`, then `window_fit.py`."""
