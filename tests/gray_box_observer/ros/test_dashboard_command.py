"""The command line of ``dashboard``, and what an observer tells the one that it starts."""

from __future__ import annotations

import io
import json
import subprocess
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from gray_box_observer.errors import InputError
from gray_box_observer.ros.observer import dashboard_process
from gray_box_observer.ros.observer.dashboard_process import DashboardProcess
from gray_box_observer.ros.watching import dashboard_command
from gray_box_observer.settings.configuration import Configuration


def test_an_address_may_stand_in_one_word_with_its_option() -> None:
    options = dashboard_command.make_parser().parse_args(['--address=0.0.0.0', '--port=8080'])
    assert (options.address, options.port) == ('0.0.0.0', 8080)


def test_an_address_that_begins_with_a_dash_is_no_option_of_the_page(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The page refuses it as an address, in a sentence."""
    commands: list[list[str]] = []

    class Process:
        stdin = io.BytesIO()
        stdout = io.BytesIO()

        def __init__(self, command: list[str], **_: Any) -> None:
            commands.append(command)

        def wait(self, _timeout_s: float | None = None) -> int:
            return 0

    monkeypatch.setattr(subprocess, 'Popen', Process)
    node = SimpleNamespace(
        get_fully_qualified_name=lambda: '/r1/gray_box_observer', resolve_topic_name=lambda t: t
    )
    values = {'dashboard.port': 8080, 'dashboard.address': '--port'}
    DashboardProcess(node, Configuration.from_flat(values), print, print).close()
    (command,) = commands
    words = command[command.index(dashboard_process.MODULE) + 1 :]
    options = dashboard_command.make_parser().parse_args(words)
    assert (options.address, options.port) == ('--port', 8080)
    assert options.observer == ['/r1/gray_box_observer'] and options.of_observer


@pytest.mark.parametrize(
    'line', [b'', b'\n', b'[]', b'{}', b'{"parameters": 1}', b'\xff', b'[' * 5000]
)
def test_an_observer_that_says_nothing_of_use_is_an_error_in_a_sentence(
    line: bytes, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(dashboard_command, '_first_line', lambda _: line)
    assert dashboard_command.main(['dashboard', '--of-observer']) == 2
    out, said = capsys.readouterr()
    assert out == ''
    assert said.startswith('dashboard: error: the observer ') and said.count('\n') == 1


def test_a_mistyped_parameter_of_the_file_is_refused_in_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    params = tmp_path / 'p.yaml'
    params.write_text('/**: {ros__parameters: {gap: 1.0}}')
    assert dashboard_command.main(['dashboard', '--params', str(params)]) == 2
    out, said = capsys.readouterr()
    assert out == ''
    assert 'gap (did you mean gap_s?)' in said and said.count('\n') == 1


@pytest.mark.parametrize('words', [('-p', 'nosuch:=1'), ('--params-file', 'x.yaml')])
def test_parameters_are_refused_for_nobody_would_read_them(
    words: tuple[str, str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert dashboard_command.main(['dashboard', '--ros-args', *words]) == 2
    said = capsys.readouterr().err
    assert said.startswith(f'dashboard: error: {" ".join(words)}: this node has no parameters')
    assert said.count('\n') == 1


def test_what_an_observer_says_is_taken() -> None:
    data = {
        'parameters': {'motors': ['left']},
        'topic_names': {'motor/voltage': '/r1/motor/voltage'},
    }
    assert dashboard_command._read_signals(json.dumps(data).encode()) == data
    with pytest.raises(InputError):
        dashboard_command._read_signals(b'null')
