"""The experiment of the thesis, table 5.1: its numbers, data, training, scores and words."""
