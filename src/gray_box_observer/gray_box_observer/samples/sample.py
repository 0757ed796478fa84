"""One sample of a group of motors that are measured together."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gray_box_observer.white_box.interface import Array

NANOSECONDS_PER_SECOND = 1_000_000_000

ABSURD_MAGNITUDE = 1e9
"""No armature voltage, torque or speed in SI units comes near; beyond it squares would soon
overflow."""

_INTERVAL = slice(0, 1)
_VOLTAGE = slice(1, 2)
_TORQUE = slice(2, 3)
_SPEED = slice(3, 4)
_HELD = slice(4, 5)
_MOMENT = slice(5, 6)


def seconds(duration_ns: int) -> float:
    """Turn integer nanoseconds into float seconds: the one place where time changes its type."""
    return duration_ns / NANOSECONDS_PER_SECOND


def nanoseconds(duration_s: float) -> int:
    """Turn float seconds of a setting into integer nanoseconds, to be added to stamps."""
    return round(duration_s * NANOSECONDS_PER_SECOND)


def passed_seconds(before_ns: int, sample: Sample) -> float:
    """Return the time since a group's last sample in s; 0 where every motor begins anew.

    Args:
        before_ns: stamp of that sample.
        sample: the newest.
    """
    longest_s = float(sample.interval_s.max())
    return min(max(seconds(sample.stamp_ns - before_ns), 0.0), longest_s)


class Sample(NamedTuple):
    """Torque at one instant, and the voltage that led to it.

    Attributes:
        stamp_ns: instant of the torque measurement.
        interval_s: shape (motor,): time since the motor's previous sample; 0 where the signal
            history starts anew (first sample, gap, clock that jumped back), and then the sample
            teaches nothing but where the motor stands.
        voltage_v: shape (motor,): mean voltage over that interval; the held value where it did not
            change in between.
        torque_nm: shape (motor,): torque at the stamp.
        speed_rad_s: shape (motor,): measured speed at the stamp; NaN where none is measured.
        present: shape (motor,): which motors were sampled at this stamp; None: all. What the arrays
            hold of the others is not to be used.
        held_v: shape (motor,): voltage in force just before the stamp; None: it is not told, as of
            motors without a rotor that are computed together.
        moment_v: shape (motor,): first moment of the voltage about the middle of the interval, in V
            (:meth:`HeldVoltage.moment`); None: it is not told.
    """

    stamp_ns: int
    interval_s: Array
    voltage_v: Array
    torque_nm: Array
    speed_rad_s: Array
    present: NDArray[np.bool_] | None = None
    held_v: Array | None = None
    moment_v: Array | None = None

    def beginning(self, motors: NDArray[np.bool_] | None = None) -> Sample:
        """Return the sample as the first of a history, of some motors or all: interval none."""
        begins = np.ones(self.interval_s.shape, dtype=bool) if motors is None else motors
        return self._replace(interval_s=np.where(begins, 0.0, self.interval_s))

    def resuming(self, is_waiting: NDArray[np.bool_]) -> tuple[Sample, NDArray[np.bool_] | None]:
        """Return the sample as first for all who wait for one, and who still does; or None."""
        still = None if self.present is None else is_waiting & ~self.present
        return self.beginning(is_waiting), None if still is None or not np.any(still) else still

    def select(self, index: NDArray[np.intp]) -> Sample:
        """Return the sample of the chosen motors."""
        voltage_v, torque_nm, speed_rad_s = (
            x[index] for x in (self.voltage_v, self.torque_nm, self.speed_rad_s)
        )
        present = None if self.present is None else self.present[index]
        held_v, moment_v = (None if x is None else x[index] for x in (self.held_v, self.moment_v))
        return Sample(
            self.stamp_ns, self.interval_s[index], voltage_v, torque_nm, speed_rad_s, present,
            held_v, moment_v,
        )  # fmt: skip

    @classmethod
    def of_one_motor(
        cls,
        stamp_ns: int,
        interval_s: float,
        voltage_v: float,
        torque_nm: float,
        speed_rad_s: float = np.nan,
        held_v: float | None = None,
        moment_v: float = 0.0,
    ) -> Sample:
        """Build the sample of a single motor from plain numbers."""
        end_v = voltage_v if held_v is None else held_v
        signals = (interval_s, voltage_v, torque_nm, speed_rad_s, end_v, moment_v)
        values = np.array(signals, dtype=float)
        # As cls(...) does, without the call that every sample would pay for.
        return tuple.__new__(
            cls,
            (
                stamp_ns, values[_INTERVAL], values[_VOLTAGE], values[_TORQUE], values[_SPEED],
                None, values[_HELD], values[_MOMENT],
            ),
        )  # fmt: skip
