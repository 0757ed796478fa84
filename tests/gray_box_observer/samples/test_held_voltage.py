from __future__ import annotations

import math
from itertools import pairwise

import numpy as np

from gray_box_observer.samples.held_voltage import HeldVoltage
from gray_box_observer.samples.rhythm import REGULAR, Rhythm

MS = 1_000_000


def regular(count: int = REGULAR + 100) -> tuple[HeldVoltage, list[int]]:
    """A voltage that has come every 10 ms for long, torque with it, and its stamps."""
    held = HeldVoltage(math.nan)
    stamps = [k * 10 * MS for k in range(count)]
    for stamp_ns in stamps:
        held.update(stamp_ns, 1.0)
        held.step_to(stamp_ns, is_lost=False)
    return held, stamps


def expected(stamps: list[int], limits_s: list[float], held_ns: int, end_ns: int) -> int | None:
    """When voltage is known again after the last pause before ``end_ns``, told by stamps.

    A limit a stamp is the longest habit when it came; one more is that of the voltage which is
    still to come.
    """
    known_ns = None
    for (earlier, later), limit_s in zip(
        pairwise([*stamps, end_ns + 1]), limits_s[1:], strict=True
    ):
        if held_ns <= earlier < end_ns and (min(later, end_ns) - earlier) / 1e9 > limit_s:
            known_ns = later
    return known_ns


def test_where_voltage_is_unknown_is_what_its_stamps_say_one_by_one() -> None:
    random = np.random.default_rng(1)
    unknown_until = []
    torque = Rhythm()
    for _ in range(100):
        torque.update(0.001)  # against its habit it was silent, too
    for _ in range(300):
        held, stamps = regular()
        held_ns = stamps[-2]  # the newest is not in force before the stamp that begins with it
        limits_s = [held._rhythm.silence_s] * len(stamps)
        for gap_ms in random.choice(
            [1, 10, 30, 150, 190, 230, 500], size=int(random.integers(0, 6))
        ).tolist():
            stamps.append(stamps[-1] + gap_ms * MS)
            limits_s.append(held._rhythm.silence_s)
            held.update(stamps[-1], 2.0)
        limits_s.append(held._rhythm.silence_s)
        end_ns = held_ns + int(random.integers(25, 1000)) * MS
        unknown_until.append(held.unknown_until_ns(held_ns, end_ns, torque))
        assert unknown_until[-1] == expected(stamps, limits_s, held_ns, end_ns)
    assert 100 < sum(stamp is not None for stamp in unknown_until) < 290


def test_what_was_never_regular_and_pauses_no_more_than_torque_does_is_known() -> None:
    held = HeldVoltage(math.nan)
    for stamp_ns in (0, 10 * MS, 5_000 * MS):
        held.update(stamp_ns, 1.0)
    assert held.unknown_until_ns(0, 6_000 * MS, Rhythm()) is None
