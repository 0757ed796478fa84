"""HTML reports of a run and of archives: one file each, no network. Read `run/page.py` first."""

from gray_box_observer.report.report_errors import ReportError
from gray_box_observer.report.run.history import MotorHistory, ParameterHistory, RunHistory
from gray_box_observer.report.run.page import render, require_plotly, write_report
from gray_box_observer.report.trend.trend import ArchiveHistory, MotorTrend, ParameterTrend
from gray_box_observer.report.trend.trend_page import render_trends, write_trend_report

__all__ = [
    'ArchiveHistory',
    'MotorHistory',
    'MotorTrend',
    'ParameterHistory',
    'ParameterTrend',
    'ReportError',
    'RunHistory',
    'render',
    'render_trends',
    'require_plotly',
    'write_report',
    'write_trend_report',
]
