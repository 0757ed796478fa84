"""The HTML report of a run: one file, no network."""

from gray_box_observer.report.errors import ReportError
from gray_box_observer.report.history import MotorHistory, ParameterHistory, RunHistory
from gray_box_observer.report.page import render, require_plotly, write_report

__all__ = ['MotorHistory', 'ParameterHistory', 'ReportError', 'RunHistory', 'render', 'require_plotly', 'write_report']
