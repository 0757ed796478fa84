"""The observer: one sample at a time, from messages to estimates. Read `observer.py` first, then
`motor_observer.py`.
"""

from gray_box_observer.observer.observer import Observer

__all__ = ['Observer']
