"""Residual analysis: does the white box explain the data? Read `assessment.py` first."""

from gray_box_observer.fit_test.assessment import FitAssessment, FitVerdict, Suspect

__all__ = ['FitAssessment', 'FitVerdict', 'Suspect']
