"""What can go wrong with a report."""

from __future__ import annotations

from gray_box_observer.errors import GrayBoxError


class ReportError(GrayBoxError):
    """A report cannot be drawn or written."""
