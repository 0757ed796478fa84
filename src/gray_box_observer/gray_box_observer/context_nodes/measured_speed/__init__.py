"""A measured speed that is noisy or late is an output. Read `measured_speed_update.py` first."""
