"""Every parameter, declared once, and their checked values. Read `parameters.py` first."""

from gray_box_observer.settings.configuration import Configuration

__all__ = ['Configuration']
