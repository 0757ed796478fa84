"""Small bags that tests write themselves."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from gray_box_observer.bag.joint_state import TYPE_NAME, encode_joint_state
from gray_box_observer.bag.schemas import JOINT_STATE_HASH, built_in_lookup, schema_text
from gray_box_observer.bag.writer import BagOptions, BagWriter

VOLTAGE = '/motor/voltage'
TORQUE = '/motor/torque'
START_NS = 1_000_000_000
STEP_NS = 10_000_000

MakeBag = Callable[..., Path]


@pytest.fixture
def make_bag(tmp_path: Path) -> MakeBag:
    """Writes a bag of ``count`` steps of 10 ms, one voltage and torque each; returns its folder."""

    def make(count: int = 100, name: str = 'run', options: BagOptions | None = None) -> Path:
        folder = tmp_path / name
        text = schema_text(TYPE_NAME, built_in_lookup)
        with BagWriter(folder, options or BagOptions(chunk_bytes=2000)) as writer:
            for topic in (VOLTAGE, TORQUE):
                writer.add_topic(topic, TYPE_NAME, text, [], JOINT_STATE_HASH)
            for index in range(count):
                stamp_ns = START_NS + index * STEP_NS
                for topic, value in ((VOLTAGE, 5.0 + index), (TORQUE, 0.01 * index)):
                    data = encode_joint_state(stamp_ns, ['motor'], effort=[value])
                    writer.write(topic, data, stamp_ns, stamp_ns - 7)
        return folder

    return make
