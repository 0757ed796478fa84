from __future__ import annotations

import math
from itertools import pairwise

import numpy as np

from gray_box_observer.samples.held_voltage import HeldVoltage
from gray_box_observer.samples.rhythm import REGULAR, Rhythm

MS = 1_000_000


def regular(count: int = REGULAR + 100) -> tuple[HeldVoltage, list[int]]:
    """A voltage that has come every 10 ms for long, torque with it, and its stamps."""
    held, stamps = HeldVoltage(math.nan), [k * 10 * MS for k in range(count)]
    for stamp_ns in stamps:
        held.take(stamp_ns, 1.0)
        held.step_to(stamp_ns, lost=False)
    return held, stamps


def expected(stamps: list[int], held_ns: int, end_ns: int, silence_s: float) -> int | None:
    """When the voltage is known again after the last silence before ``end_ns``, told stamp by stamp."""
    seen = [stamp for stamp in stamps if stamp >= held_ns]
    before = [stamp for stamp in seen if stamp < end_ns]
    until = [*before, *[stamp for stamp in seen if stamp >= end_ns][:1]]
    known_ns = None
    for earlier, later in pairwise(until):
        if (later - earlier) / 1e9 > silence_s:
            known_ns = later
    if until[-1] < end_ns and (end_ns - until[-1]) / 1e9 > silence_s:
        return end_ns + 1
    return known_ns


def test_where_voltage_is_unknown_is_what_its_stamps_say_one_by_one() -> None:
    random, found, torque = np.random.default_rng(1), [], Rhythm()
    for _ in range(100):
        torque.take(0.001)  # against its habit it was silent, too
    for _ in range(300):
        held, stamps = regular()
        held_ns = stamps[-2]  # the newest is not in force before the stamp that begins with it
        for gap_ms in random.choice([1, 10, 30, 150, 190, 230, 500], size=int(random.integers(0, 6))).tolist():
            stamps.append(stamps[-1] + gap_ms * MS)
            held.take(stamps[-1], 2.0)
        end_ns = held_ns + int(random.integers(25, 1000)) * MS
        found.append(held.unknown_until_ns(held_ns, end_ns, torque))
        assert found[-1] == expected(stamps, held_ns, end_ns, held._rhythm.silence_s)
    assert 100 < sum(stamp is not None for stamp in found) < 290


def test_what_was_never_regular_and_pauses_no_more_than_torque_does_is_known() -> None:
    held = HeldVoltage(math.nan)
    for stamp_ns in (0, 10 * MS, 5_000 * MS):
        held.take(stamp_ns, 1.0)
    assert held.unknown_until_ns(0, 6_000 * MS, Rhythm()) is None
