"""Bounded reading and atomic writing of foreign text and files. Read `atomic_write.py` first."""
