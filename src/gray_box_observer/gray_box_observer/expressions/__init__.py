"""Arithmetic on named quantities, for live topics, bags and logs; read `formula.py` first."""
