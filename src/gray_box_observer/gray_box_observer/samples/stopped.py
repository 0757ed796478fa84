"""Replaces the pairing of stopped motors: pairs nothing, counts everything as refused."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gray_box_observer.samples.counts import PairingCounts
from gray_box_observer.samples.rejection import Rejection
from gray_box_observer.samples.sample import Sample


class StoppedPairing:
    """Counts what comes for motors that have stopped; makes no sample.

    What waited then, and what was under way, counts as refused too, so that the books balance.

    Args:
        counts: what had become of every motor's messages.

    Attributes:
        newest_voltage, newest_sample_ns, needs_speed: nothing is known, and nothing asked for.
        received_voltage, received_torque: of the motor that had most.
        take: what takes a signal, by its name.
    """

    newest_voltage = None
    newest_sample_ns = None
    needs_speed = False

    def __init__(self, counts: Sequence[PairingCounts]) -> None:
        self._counts = [_close_counts(one) for one in counts]
        self._came = {
            signal: np.zeros(len(counts), dtype=int) for signal in ('voltage', 'torque', 'speed')
        }
        self.received_voltage = max(one.received_voltage for one in counts)
        self.received_torque = max(one.received_torque for one in counts)
        self.ingest_signal: dict[str, Callable[..., list[Sample]]] = {
            'voltage': self.voltage,
            'torque': self.torque,
            'speed': self.speed,
        }

    def voltage(
        self, stamp_ns: int, voltage_v: Any, absent: NDArray[np.bool_] | None = None
    ) -> list[Sample]:
        """Count a voltage."""
        self.received_voltage += 1
        return self._refuse('voltage', absent)

    def torque(
        self,
        stamp_ns: int,
        torque_nm: Any,
        speed_rad_s: Any = None,
        absent: NDArray[np.bool_] | None = None,
    ) -> list[Sample]:
        """Count a torque."""
        self.received_torque += 1
        return self._refuse('torque', absent)

    def speed(self, stamp_ns: int, speed_rad_s: float) -> list[Sample]:
        """Count a speed."""
        return self._refuse('speed', None)

    def _refuse(self, signal: str, absent: NDArray[np.bool_] | None) -> list[Sample]:
        self._came[signal] += 1 if absent is None else ~absent
        return []

    def counts_for(self, motor: int) -> PairingCounts:
        """Return what became of one motor's messages."""
        counts = self._counts[motor]
        refusal_counts = {
            signal: counter.copy() for signal, counter in counts.refusal_counts.items()
        }
        came = {signal: int(count[motor]) for signal, count in self._came.items()}
        for signal, count in came.items():
            if count:
                refusal_counts[signal][Rejection.STOPPED] += count
        return replace(
            counts,
            refusal_counts=refusal_counts,
            received_voltage=counts.received_voltage + came['voltage'],
            received_torque=counts.received_torque + came['torque'],
        )

    def ahead(self, stamp_ns: int) -> None:
        """Nothing is known ahead."""

    def flush(self) -> list[Sample]:
        """Nothing waits."""
        return []

    def reconfigure(self, rules: object) -> None:
        """There is nothing to be patient for."""


def _close_counts(counts: PairingCounts) -> PairingCounts:
    """Return the counts with what is not accounted for, and what waits, as refused."""
    refusal_counts = {signal: counter.copy() for signal, counter in counts.refusal_counts.items()}
    open_torques = counts.received_torque - counts.used_count - refusal_counts['torque'].total()
    open_voltages = (
        counts.received_voltage - counts.taken_voltage - refusal_counts['voltage'].total()
    )
    for signal, count in (('torque', open_torques), ('voltage', open_voltages)):
        if count > 0:
            refusal_counts[signal][Rejection.STOPPED] += count
    return replace(counts, refusal_counts=refusal_counts, waiting_count=0)
