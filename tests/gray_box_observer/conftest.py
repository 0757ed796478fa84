"""Tests of the cores share this: simulated motors, their samples, and small bags of them."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from dc_motor_sim.plant import PlantParameters
from dc_motor_sim.simulation import Recording, Simulation
from gray_box_observer.bag.joint_state import TYPE_NAME, encode_joint_state
from gray_box_observer.bag.schemas import built_in_lookup, schema_text
from gray_box_observer.bag.writer import BagWriter
from gray_box_observer.samples import Sample
from gray_box_observer.white_box import MotorWhiteBox

sys.path.insert(0, str(Path(__file__).parent))

Message = tuple[str, int, bytes]
"""Topic, time in the bag in ns, and content."""


@cache
def _record(
    excitation: str, duration_s: float, seed: int, motors: tuple[str, ...], **options: Any
) -> Recording:
    plants = {
        name: PlantParameters(**{'resistance': 1.0 + 0.5 * k}) for k, name in enumerate(motors)
    }
    return Simulation(plants, excitation, seed=seed, **options).record(duration_s)


@pytest.fixture(scope='session')
def record() -> Callable[..., Recording]:
    """Record simulated motors: the first is the thesis's, each further one has 0.5 ohm more."""

    def make(
        excitation: str = 'R[5,15]D[1,20]',
        duration_s: float = 60.0,
        seed: int = 1,
        motors: tuple[str, ...] = ('motor',),
        **options: Any,
    ) -> Recording:
        return _record(excitation, duration_s, seed, motors, **options)

    return make


@pytest.fixture(scope='session')
def samples_of() -> Callable[..., list[Sample]]:
    """Turn a recording into samples of all its motors at once, as pairing would make them."""

    def make(recording: Recording, speed: bool = False) -> list[Sample]:
        count = recording.stamp_ns.size
        motors = len(recording.motors)
        blank = np.full(motors, np.nan)
        return [
            Sample(
                int(recording.stamp_ns[k]),
                np.full(
                    motors,
                    0.0 if k == 0 else (recording.stamp_ns[k] - recording.stamp_ns[k - 1]) / 1e9,
                ),
                recording.voltage_v[:, max(k - 1, 0)].copy(),
                recording.torque_nm[:, k].copy(),
                recording.speed_rad_s[:, k].copy() if speed else blank.copy(),
            )
            for k in range(count)
        ]

    return make


@pytest.fixture
def thesis_box() -> MotorWhiteBox:
    """White box of the thesis: L, R and K_HS unknown, Kt and Kb known, w = Kt i."""
    return MotorWhiteBox(
        ('inductance', 'resistance', 'hysteresis'), 0.01, {'back_emf_constant': 0.01}
    )


@pytest.fixture(scope='session')
def messages_of() -> Callable[..., list[Message]]:
    """Turn a recording into the messages of a bag: per stamp voltage, then torque."""

    def make(
        recording: Recording, speed: bool = False, start_ns: int = 1_000_000_000
    ) -> list[Message]:
        messages: list[Message] = []
        for k, stamp in enumerate(recording.stamp_ns):
            at = int(stamp) + start_ns
            voltage = encode_joint_state(at, recording.motors, effort=recording.voltage_v[:, k])
            velocity = recording.speed_rad_s[:, k] if speed else ()
            torque = encode_joint_state(
                at, recording.motors, velocity=velocity, effort=recording.torque_nm[:, k]
            )
            messages += [('/motor/voltage', at, voltage), ('/motor/torque', at, torque)]
        return messages

    return make


@pytest.fixture(scope='session')
def write_bag() -> Callable[..., Path]:
    """Write JointState messages into a rosbag2 folder."""

    def make(
        folder: Path,
        messages: Iterable[Message],
        topics: tuple[str, ...] = ('/motor/voltage', '/motor/torque'),
    ) -> Path:
        schema = schema_text(TYPE_NAME, built_in_lookup)
        with BagWriter(folder) as bag:
            for topic in topics:
                bag.add_topic(topic, TYPE_NAME, schema)
            for topic, at, data in messages:
                bag.write(topic, data, at, at)
        return folder

    return make


@pytest.fixture(scope='session')
def torch_name() -> str:
    """Device on which torch is tried: a GPU where it sees one, else the processor."""
    return 'cuda' if torch.cuda.is_available() else 'cpu'
