"""The cores know no ROS and no observer."""

from __future__ import annotations

import pkgutil
import subprocess
import sys

import dc_motor_sim

BLOCKED_IMPORT = """
import importlib, sys

class Block:
    def find_spec(self, name, path=None, target=None):
        foreign = {'rclpy', 'rcl_interfaces', 'sensor_msgs', 'rosgraph_msgs', 'gray_box_observer'}
        if name.split('.')[0] in foreign:
            raise ImportError(f'a core imported {name}')

sys.meta_path.insert(0, Block())
for name in sys.argv[1:]:
    importlib.import_module(name)
"""


def test_every_module_outside_ros_imports_without_ros_and_without_the_observer():
    names = [
        f'dc_motor_sim.{module.name}'
        for module in pkgutil.iter_modules(dc_motor_sim.__path__)
        if module.name != 'ros'
    ]
    assert len(names) >= 8
    done = subprocess.run(
        [sys.executable, '-c', BLOCKED_IMPORT, *names], capture_output=True, text=True, timeout=60
    )
    assert done.returncode == 0, done.stderr
