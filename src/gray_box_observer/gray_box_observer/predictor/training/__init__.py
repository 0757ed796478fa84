"""What the predictor is taught, when, and in which process. Read `online_training.py` first."""
