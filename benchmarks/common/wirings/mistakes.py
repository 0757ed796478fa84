"""The wirings of the robot: the right one, and what goes wrong on robots, each with its words."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from common.wirings.robot import WHEELS, Battery, Log, Published, Wheel, messages

Parameters = dict[str, Any]
Stream = Iterator[Published]

NOMINAL = Battery(open_v=12.0, resistance=0.0)
SAGGING = Battery(open_v=12.0, resistance=0.15)


def right_parameters(wheels: Sequence[Wheel]) -> Parameters:
    """Return what a careful user states: Kt and Kb exactly, R from the data sheet to 20 %."""
    parameters: Parameters = {
        'motors': list(WHEELS),
        'voltage.expression': 'duty * battery',
        'duty.topic': '/duty',
        'duty.field': 'effort',
        'battery.topic': '/battery_state',
        'battery.type': 'sensor_msgs/msg/BatteryState',
        'battery.field': 'voltage',
        'battery.stale_s': 5.0,
        'torque.topic': '/joint_states',
        'torque.field': 'effort',
        'torque.quantity': 'current',
    }
    for name, wheel in zip(WHEELS, wheels, strict=True):
        parameters |= {
            f'{name}.torque_constant': wheel.torque_constant,
            f'{name}.back_emf_constant': wheel.torque_constant,
            f'{name}.initial.resistance': 1.1 * wheel.resistance,
            f'{name}.initial_relative_std.resistance': 0.2,
        }
    return parameters


@dataclass(frozen=True)
class Mistake:
    """One wiring gone wrong.

    Attributes:
        name: what it is.
        words: by which an operator understands it, as a regular expression.
        parameters: what is stated instead.
        log: what is logged instead.
        stream: what comes instead.
        battery: behind the motors.
        motors: that are wired wrongly, by the names that are configured.
    """

    name: str
    words: str
    parameters: Parameters | None = None
    log: Callable[[Log], Log] | None = None
    stream: Callable[[Stream], Stream] | None = None
    battery: Battery = NOMINAL
    motors: tuple[str, ...] = WHEELS

    def wired(self, wheels: Sequence[Wheel]) -> Parameters:
        """Return the parameters of the robot with this mistake."""
        return right_parameters(wheels) | (self.parameters or {})

    def published(self, log: Log) -> Stream:
        """Return what the robot publishes with this mistake."""
        stream = messages(log if self.log is None else self.log(log))
        return stream if self.stream is None else self.stream(stream)

    def is_named(self, text: str) -> bool:
        """Tell whether a text names it."""
        return re.search(self.words, text) is not None


def _without_battery(stream: Stream) -> Stream:
    """Let the battery fall silent after two seconds."""
    start_ns: int | None = None
    for one in stream:
        start_ns = one.stamp_ns if start_ns is None else start_ns
        if one.topic != '/battery_state' or one.stamp_ns - start_ns < 2_000_000_000:
            yield one


MISTAKES = (
    Mistake(
        'sign of the voltage', r'voltage\.scale: -1', {'voltage.expression': '-duty * battery'}
    ),
    Mistake('duty for volt', 'duty cycle', {'voltage.expression': 'duty * 1'}),
    Mistake('current for torque', 'quantity: current', {'torque.quantity': 'torque'}),
    Mistake('mA', r'\bmA\b', log=lambda log: replace(log, current_a=1e3 * log.current_a)),
    Mistake(
        'degrees', r'deg/s', log=lambda log: replace(log, speed_rad_s=np.degrees(log.speed_rad_s))
    ),
    Mistake('ms', r'\bms\b', log=lambda log: replace(log, time_s=1e3 * log.time_s)),
    Mistake(
        'swapped names', 'swapped', log=lambda log: replace(log, current_a=log.current_a[::-1])
    ),
    Mistake(
        'gain 0.9', r'voltage\.scale|Kb differs', {'voltage.expression': '0.9 * duty * battery'}
    ),
    Mistake('sag', 'sags', {'voltage.expression': '12 * duty'}, battery=SAGGING),
    Mistake(
        'wrong joint',
        'names there: .*left',
        {'motors': ['wheel', 'right'], 'wheel.joint': 'left_whel'},
        motors=('wheel',),
    ),
    Mistake('stale battery', '/battery_state is', stream=_without_battery),
)
"""The twelfth, a publisher by best effort, is a matter of live topics: the subscription adapts
(``tests/gray_box_observer/ros/test_observer_inputs.py``)."""
