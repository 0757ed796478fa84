"""The experiment of the thesis, table 5.1: its numbers, its data, its training, our training,
scores and words.
"""
