"""What a session says of motors that have stopped."""

from __future__ import annotations

from unittest.mock import Mock

from gray_box_observer.observer.incident import Incident
from gray_box_observer.ros.observer.session import Session


def test_what_a_defect_quotes_is_shown_in_the_log_and_not_obeyed():
    session = Mock()
    incident = Incident(('motor',), 'KeyError: \x1b[2J', 'Traceback:\n  KeyError: \x1b[31m\r')
    session.observer.incidents = {'motor': incident}
    session._incident_names = set()
    Session.report_incidents(session)
    (text,) = session._log.error.call_args.args
    lines = text.split('\n')
    assert all(line.isprintable() for line in lines)
    assert lines[1:] == ['Traceback:', r'  KeyError: \x1b[31m\r']
    _, tell = session._keeper.report.call_args.args
    tell('in \x1b[31m')
    session._log.warning.assert_called_once_with(r'in \x1b[31m')
