"""Residual analysis: does the white box explain the data? Start with `assessment.py`."""

from gray_box_observer.fit_test.assessment import FitAssessment, FitVerdict, Suspect

__all__ = ['FitAssessment', 'FitVerdict', 'Suspect']
