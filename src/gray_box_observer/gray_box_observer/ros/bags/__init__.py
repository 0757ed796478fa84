"""The recorder and the player. Read `recorder_node.py` and `player_node.py` first."""
