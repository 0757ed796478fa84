"""Learns a motor whose rotor turns while nobody measures its speed: the speed is a hidden state.

Read ``estimator.py`` first, then ``window_fit.py``.
"""
