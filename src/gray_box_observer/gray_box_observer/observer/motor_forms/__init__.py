"""Which form of the physics a motor takes, chosen by evidence. Read `form_choice.py` first."""
