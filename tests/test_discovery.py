"""Everything started by this repository stays on this host, unless the user decides."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from dc_motor_sim.ros import discovery as of_simulator
from gray_box_observer.ros import discovery

ROOT = Path(__file__).resolve().parent.parent
RANGE = 'ROS_AUTOMATIC_DISCOVERY_RANGE'

START = """
import importlib, os, sys
import rclpy

def stop(*_, **__):
    print(os.environ.get('ROS_AUTOMATIC_DISCOVERY_RANGE', 'not set'))
    raise SystemExit(0)

rclpy.init = stop
module = importlib.import_module(sys.argv[1])
module.main(['name', *sys.argv[2:]] if 'gray_box' in sys.argv[1] else sys.argv[2:])
"""

NODES = {
    'dc_motor_sim.ros.motor_sim': (),
    'gray_box_observer.ros.observer.observer_node': (),
    'gray_box_observer.ros.bags.recorder_node': (),
    'gray_box_observer.ros.bags.player_node': ('some_bag',),
}


def range_of(module: str, arguments: tuple[str, ...], **variables: str) -> str:
    """The range that is in force when an executable hands over to the middleware."""
    environment = {name: value for name, value in os.environ.items() if name not in discovery.SAYS}
    done = subprocess.run(
        [sys.executable, '-c', START, module, *arguments],
        env={**environment, **variables},
        capture_output=True,
        text=True,
        timeout=100,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


@pytest.mark.parametrize(('module', 'arguments'), NODES.items(), ids=NODES)
def test_an_executable_stays_on_this_host_unless_told_otherwise(
    module: str, arguments: tuple[str, ...]
):
    assert range_of(module, arguments) == 'LOCALHOST'
    assert range_of(module, arguments, **{RANGE: 'SUBNET'}) == 'SUBNET'


@pytest.mark.parametrize('name', discovery.SAYS)
def test_whatever_a_user_says_of_discovery_stands(name: str):
    assert discovery.default_range({name: '1'}) == {}
    assert discovery.default_range({name: ''}) == {RANGE: 'LOCALHOST'}


def test_simulator_and_observer_follow_the_same_rule():
    for name in ('RANGE', 'SAYS', 'OPENED_BY'):
        assert getattr(of_simulator, name) == getattr(discovery, name)
    for environment in ({}, {RANGE: 'SUBNET'}, {'ROS_STATIC_PEERS': 'robot'}, {'HOME': '/'}):
        assert of_simulator.default_range(environment) == discovery.default_range(environment)


def test_scripts_that_start_nodes_keep_them_on_this_host():
    """Demo, benchmarks and tests set the range for the processes they start themselves."""
    for path in ('ros_ws/demo.py', 'benchmarks/common/live/processes.py', 'tests/conftest.py'):
        text = (ROOT / path).read_text(encoding='utf-8')
        assert f"'{RANGE}'" in text and "'LOCALHOST'" in text, path
