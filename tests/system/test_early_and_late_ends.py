"""An executable that is asked to end does so quietly: while it loads, and once it is done."""

from __future__ import annotations

import os
import signal
import subprocess
import sys

import pytest
from tests.conftest import free_domain

pytestmark = pytest.mark.system

TIMEOUT_S = 120.0

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)

LOADING = """
import importlib, importlib.abc, sys, time

executable, slow_module = sys.argv[1:]
del sys.argv[1:]

class Slow(importlib.abc.MetaPathFinder):
    def find_spec(self, name, *_):
        if name == slow_module:
            print('loading', flush=True)
            for _ in range(1000):  # a signal just before one sleep does not end it
                time.sleep(0.1)

sys.meta_path.insert(0, Slow())
package, _, name = executable.partition(':')
raise SystemExit(getattr(importlib.import_module(f'{package}.executables'), name)())
"""

DONE = """
import importlib, os, signal, sys

class Late:
    '''Lives until modules are taken apart, when Python has restored what signals do by default.'''

    def __init__(self):
        self.kill, self.id = os.kill, os.getpid()
        self.numbers = [signal.Signals[name] for name in sys.argv[2].split('+')]

    def __del__(self):
        for number in self.numbers:
            self.kill(self.id, number)

late = Late()
package, _, name = sys.argv[1].partition(':')
arguments = sys.argv[3:] if package == 'dc_motor_sim' else [name, *sys.argv[3:]]
raise SystemExit(getattr(importlib.import_module(f'{package}.executables'), name)(arguments))
"""

LOADED = {
    'dc_motor_sim:motor_sim': 'dc_motor_sim.ros.motor_sim',
    'gray_box_observer:observer': 'gray_box_observer.ros.observer.observer_node',
    'gray_box_observer:recorder': 'gray_box_observer.ros.bags.recorder_node',
    'gray_box_observer:player': 'gray_box_observer.ros.bags.player_node',
    'gray_box_observer:watch': 'gray_box_observer.ros.watching.watch_command',
    'gray_box_observer:dashboard': 'gray_box_observer.ros.watching.dashboard_command',
}
"""What each node loads."""

LOADED_LATER = [
    ('gray_box_observer:watch', 'gray_box_observer.ros.watching.watch_node'),
    ('gray_box_observer:dashboard', 'gray_box_observer.ros.watching.dashboard_node'),
]
"""What those load that read their command line first."""

REFUSED = {
    'dc_motor_sim:motor_sim': ('--ros-args', '-p', 'sample_rate_hz:=fast'),
    'gray_box_observer:observer': ('--ros-args', '-p', 'gap_s:=-1.0'),
    'gray_box_observer:recorder': ('--ros-args', '-p', 'duration_s:=-1.0'),
    'gray_box_observer:player': ('nowhere',),
    'gray_box_observer:watch': ('nowhere',),
    'gray_box_observer:dashboard': ('--address', '203.0.113.1'),
    'gray_box_observer:identify': ('nowhere',),
}
"""Arguments that each ends with once it has begun."""


def start(script: str, *arguments: str) -> subprocess.Popen[str]:
    """Start a script in a domain of its own, where nothing begins while it ends.

    What the signals do is not inherited from whoever runs the tests.
    """

    def forget_inherited() -> None:
        for number in SIGNALS:
            signal.signal(number, signal.SIG_DFL)

    return subprocess.Popen(
        [sys.executable, '-c', script, *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, 'ROS_DOMAIN_ID': str(free_domain())},
        preexec_fn=forget_inherited,
    )


@pytest.mark.parametrize(('name', 'module'), [*LOADED.items(), *LOADED_LATER])
def test_a_signal_while_modules_are_loaded_ends_a_node_without_a_word(
    name: str, module: str
) -> None:
    processes = {number: start(LOADING, name, module) for number in SIGNALS}
    for number, process in processes.items():
        assert process.stdout.readline() == 'loading\n'
        process.send_signal(number)
    for process in processes.values():
        out, err = process.communicate(timeout=TIMEOUT_S)
        assert (process.returncode, out, err) == (0, '', '')


def test_ctrl_c_while_modules_are_loaded_ends_the_command_in_one_line() -> None:
    process = start(LOADING, 'gray_box_observer:identify', 'gray_box_observer.identify.command')
    assert process.stdout.readline() == 'loading\n'
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=TIMEOUT_S)
    assert (process.returncode, out, err) == (
        130,
        '',
        'identify: interrupted; nothing was written\n',
    )


@pytest.mark.parametrize('name', REFUSED)
def test_a_second_signal_once_it_is_done_does_not_change_its_exit_code(name: str) -> None:
    """Terminal and launch both send one; the second must not kill what has just ended.

    Each comes in turn: the first that is not ignored ends the process, by its number.
    """
    numbers = SIGNALS if name in LOADED else SIGNALS[:1]
    process = start(DONE, name, '+'.join(number.name for number in numbers), *REFUSED[name])
    _, err = process.communicate(timeout=TIMEOUT_S)
    assert process.returncode == 2, err
    assert 'Traceback' not in err
