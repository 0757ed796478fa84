"""How executables end: signals, errors, exit codes."""

from __future__ import annotations

import itertools
import os
import signal
import subprocess
import sys
import textwrap
import time
from contextlib import redirect_stderr
from importlib import import_module
from io import StringIO
from unittest.mock import Mock

import pytest
from rclpy.node import Node
from tests.conftest import free_domain

from gray_box_observer.ros import running

pytestmark = pytest.mark.system

TIMEOUT_S = 120.0
SCRIPT = """
    import itertools
    import sys
    from rclpy.executors import SingleThreadedExecutor
    from rclpy.node import Node
    from gray_box_observer.errors import BagError
    from gray_box_observer.ros import running
    from gray_box_observer.ros.running import make_executor, run_node

    how, executor = sys.argv[1:3]

    class Example(Node):
        def __init__(self, stop):
            super().__init__('example')
            self.stop = stop
            self.declare_parameter('rate', 1.0)
            if how == 'refuses to start':
                raise BagError('no such\\nbag')
            if how == 'ends before it spins':
                stop()
            self.create_timer(0.05, self.tick)
            print('up', flush=True)
            if how == 'fails while it starts':
                stop(BagError('disk full'))
            while how in ('takes long to start', 'fails while it starts'):
                stop.require_going_on(self)

        def tick(self):
            if how == 'raises':
                raise BagError('went wrong')
            if how == 'has a defect':
                raise ValueError('a defect')
            if how == 'ends':
                self.stop()
            if how == 'ends with an error':
                self.stop(BagError('disk full'))
                self.stop(BagError('only a consequence'))
            if how in ('cannot close', 'is not let go'):
                self.stop()

        def destroy_node(self):
            if how == 'is not let go':
                sum(itertools.repeat(0))  # as deaf as the middleware
            super().destroy_node()

        def close(self):
            print('closed', flush=True)
            if how == 'cannot close':
                raise BagError('cannot close')

    if how == 'is not let go':
        running._GIVE_UP_S = 0.5
    factory = make_executor if executor == 'default' else SingleThreadedExecutor
    raise SystemExit(run_node(Example, sys.argv, name='example', executor_factory=factory))
"""


def start(how: str, executor: str = 'default', *args: str) -> subprocess.Popen:
    environment = {
        **os.environ,
        'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST',
        'ROS_DOMAIN_ID': str(free_domain()),
    }
    command = [sys.executable, '-c', textwrap.dedent(SCRIPT), how, executor, *args]
    return subprocess.Popen(
        command,
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=lambda: signal.signal(
            signal.SIGHUP, signal.SIG_DFL
        ),  # nohup hands on that it is ignored
    )


def finish(process: subprocess.Popen) -> tuple[int, str, list[str]]:
    try:
        out, err = process.communicate(timeout=TIMEOUT_S)
    finally:
        process.kill()
    return (
        process.returncode,
        out,
        [line for line in err.splitlines() if 'error:' in line or 'Traceback' in line],
    )


def wait_until_up(process: subprocess.Popen) -> None:
    """Wait until a script is up; before it the middleware may speak.

    It does where a process that was killed has left its shared memory locked.
    """
    before = list(itertools.takewhile(lambda line: line != 'up\n', process.stdout))
    if process.poll() is not None or not all('RTPS_TRANSPORT_SHM' in line for line in before):
        process.kill()
        raise AssertionError(f'it is not up: {before}')


@pytest.mark.parametrize('executor', ['default', 'single'])
@pytest.mark.parametrize(
    ('how', 'code', 'lines'),
    [
        ('ends', 0, []),
        ('ends before it spins', 0, []),
        ('ends with an error', 2, ['example: error: disk full']),
        ('raises', 2, ['example: error: went wrong']),
        ('cannot close', 2, ['example: error: cannot close']),
        ('refuses to start', 2, ['example: error: no such bag']),
    ],
)
def test_a_node_ends_with_its_code_and_at_most_one_line(how, code, lines, executor):
    returned, out, errors = finish(start(how, executor))
    assert (returned, errors) == (code, lines)
    assert ('closed' in out) == (how != 'refuses to start')


@pytest.mark.parametrize('executor', ['default', 'single'])
@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_ends_an_idle_node_at_once_and_lets_it_close(number, executor):
    process = start('waits', executor)
    wait_until_up(process)
    process.send_signal(number)
    returned, out, errors = finish(process)
    assert (returned, out, errors) == (0, 'closed\n', [])


def test_a_node_that_the_middleware_does_not_let_go_ends_after_a_while_and_says_where():
    process = start('is not let go')
    out, err = process.communicate(timeout=TIMEOUT_S)
    assert process.returncode == 1
    assert 'closed' in out
    assert 'Timeout' in err and 'destroy_node' in err


def test_a_defect_shows_its_traceback():
    returned, out, errors = finish(start('has a defect'))
    assert returned == 1 and 'closed' in out
    assert any('Traceback' in line for line in errors)


@pytest.mark.parametrize('arguments', [('-p', 'rate:=fast'), ('--nonsense',)])
def test_what_ros_refuses_is_one_line_too(arguments):
    returned, _, errors = finish(start('waits', 'default', '--ros-args', *arguments))
    assert returned == 2
    assert len(errors) == 1 and errors[0].startswith('example: error: ')


@pytest.mark.parametrize('arguments', [('-p', 'rate'), ('--params-file', '/nowhere.yaml')])
def test_so_is_what_it_refuses_in_the_process_of_the_test(end_here, arguments):
    def main() -> int:
        return running.run_node(lambda stop: Node('example'), name='example')

    returned, _, said = end_here(main, '--ros-args', *arguments)
    errors = [line for line in said.splitlines() if 'error:' in line or 'Traceback' in line]
    assert returned == 2
    assert len(errors) == 1 and errors[0].startswith('example: error: ')


@pytest.mark.parametrize('module', ['observer.observer_node', 'bags.recorder_node'])
@pytest.mark.parametrize('section', ['/**', 'some_node', '/robot/some_node'])
def test_a_parameter_with_and_without_a_dot_is_refused_by_file_and_name(module, section, tmp_path):
    path = tmp_path / 'twice.yaml'
    path.write_text(f'{section}:\n  ros__parameters: {{voltage: {{topic: a}}, voltage.topic: b}}\n')
    main = import_module(f'gray_box_observer.ros.{module}').main
    words = ['node', '--ros-args', '--params-file', str(path)]
    with pytest.raises(SystemExit) as end, redirect_stderr(StringIO()) as said:
        main(words)
    assert end.value.code == 2
    (line,) = said.getvalue().splitlines()
    assert f"error: parameter file {path}: parameter 'voltage.topic' stands twice" in line


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_ends_a_start_that_takes_long(number):
    process = start('takes long to start')
    wait_until_up(process)
    process.send_signal(number)
    assert finish(process) == (0, '', [])


def test_what_a_thread_reports_during_a_start_that_takes_long_is_not_lost():
    code, _, lines = finish(start('fails while it starts'))
    assert (code, lines) == (2, ['example: error: disk full'])


def test_a_node_of_very_many_topics_is_not_taken_down_one_by_one(monkeypatch):
    monkeypatch.setattr(running, '_TAKE_DOWN_S', 0.2)
    node = Mock()
    node.publishers = range(100_000)
    node.destroy_publisher = Mock(side_effect=lambda _: time.sleep(0.001))
    assert not running._take_down(node)
    assert 0 < node.destroy_publisher.call_count < 1000
    node.destroy_node.assert_not_called()
    node.publishers = range(3)
    assert running._take_down(node)
    node.destroy_node.assert_called_once()
