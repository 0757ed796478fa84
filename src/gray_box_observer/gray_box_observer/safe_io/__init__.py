"""Text, files and names from outside, read within bounds and written whole or not at all. Read
`atomic_write.py` first.
"""
