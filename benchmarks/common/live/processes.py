"""Nodes as processes of their own: starting, ending, and what they use of the machine."""

from __future__ import annotations

import os
import random
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import psutil

BENCHMARKS = Path(__file__).resolve().parents[2]
END_S = 10.0
PRIORITY = 10


def own_domain() -> None:
    """Put this process and its children into a ROS domain of their own that ends at this host."""
    os.environ.setdefault('ROS_DOMAIN_ID', str(random.SystemRandom().randint(1, 100)))
    os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'


@contextmanager
def running(
    module: str, *arguments: str, realtime: bool = False, **parameters: object
) -> Iterator[subprocess.Popen[str]]:
    """Run a module as a process, end it and wait for its end.

    Args:
        module: what ``python -m`` is given; one of ``common`` does too. ``module:function`` calls a
            function instead.
        arguments: of the command line.
        realtime: before every other program of the machine; needs the right to.
        parameters: of the node, ``sample_rate_hz=100.0``.
    """
    name, _, function = module.partition(':')
    call = (
        ['-c', f'from {name} import {function}; raise SystemExit({function}())']
        if function
        else ['-m', name]
    )
    command = [sys.executable, *call, *arguments]
    if parameters:
        command += [
            '--ros-args',
            *(word for name, value in parameters.items() for word in ('-p', f'{name}:={value}')),
        ]
    path = os.pathsep.join([str(BENCHMARKS), *filter(None, [os.environ.get('PYTHONPATH')])])
    environment = {**os.environ, 'PYTHONPATH': path}
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, env=environment, text=True)
    if realtime:  # its threads are yet to come and inherit it
        os.sched_setscheduler(process.pid, os.SCHED_RR, os.sched_param(PRIORITY))
    try:
        yield process
    finally:
        process.terminate()
        try:
            process.wait(timeout=END_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


def family(process: psutil.Process) -> list[psutil.Process]:
    """A process and its children, such as the observer and its training process."""
    return [process, *process.children(recursive=True)]


def cpu_s(processes: list[psutil.Process]) -> float:
    """CPU time that processes have used until now, in s."""
    return sum(sum(process.cpu_times()[:2]) for process in processes)
