"""The observer: from messages to estimates. Read `observer.py`, then `motor_observer.py`."""

from gray_box_observer.observer.observer import Observer

__all__ = ['Observer']
