"""Events of voltage and torque, in ms, and the samples that a pairing makes of them."""

from __future__ import annotations

from collections.abc import Iterable

from gray_box_observer.samples import Pairing, Sample

MS = 1_000_000
Event = tuple[str, int, float]


def feed(pairing: Pairing, events: Iterable[Event]) -> list[Sample]:
    samples: list[Sample] = []
    for kind, at_ms, value in events:
        samples += (pairing.voltage if kind == 'v' else pairing.torque)(round(at_ms * MS), value)
    return samples


def content(samples: list[Sample]) -> list[tuple[int, float, float, float]]:
    return [
        (s.stamp_ns, float(s.interval_s[0]), float(s.voltage_v[0]), float(s.torque_nm[0]))
        for s in samples
    ]


def steady(count: int, period_ms: int = 10) -> tuple[list[Event], list[Event]]:
    voltages: list[Event] = [('v', k * period_ms, 1.0 + k % 7) for k in range(count)]
    torques: list[Event] = [('t', k * period_ms, 0.1 * k) for k in range(count)]
    return voltages, torques
