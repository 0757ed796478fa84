"""Simulated DC motors: the plant whose parameters an observer has to find."""
