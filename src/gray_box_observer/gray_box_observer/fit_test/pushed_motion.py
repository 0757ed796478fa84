"""What readings that are pushed do to the intervals of a free run."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gray_box_observer.context_nodes.native import interval_motion
from gray_box_observer.fit_test.free_run import FreeRun
from gray_box_observer.fit_test.rotor_free_run import RotorFreeRun
from gray_box_observer.white_box.declaration import State
from gray_box_observer.white_box.flow import flow
from gray_box_observer.white_box.interface import Array
from gray_box_observer.white_box.motion import Linear
from gray_box_observer.white_box.motor import MotorWhiteBox


@dataclass(frozen=True, eq=False)
class Push:
    """What noise of one standard deviation does to the end of an interval.

    Attributes:
        current_a: shape (k,).
        slopes_a: shape (coordinate, k): of the current's derivatives by the coordinates'
            logarithms.
    """

    current_a: Array
    slopes_a: Array

    @property
    def products(self) -> Array:
        """Products of the current with its slopes, shape (coordinate, k)."""
        return self.current_a * self.slopes_a

    def after(self, end: Push, decay: Array) -> Push:
        """Return what noise does that has pushed the end of the interval before, too.

        Args:
            end: what it does there.
            decay: shape (k,): what every interval leaves of that.
        """
        current_a = self.current_a.copy()
        slopes_a = self.slopes_a.copy()
        current_a[1:] += decay[1:] * end.current_a[:-1]
        slopes_a[:, 1:] += decay[1:] * end.slopes_a[:, :-1]
        return Push(current_a, slopes_a)


class PushedMotion:
    """The intervals of a free run from the readings, and from readings that are pushed.

    Args:
        white_box: of one motor.
        p: shape (1, coordinate): its present values.
        run: its free run at these.
    """

    def __init__(self, white_box: MotorWhiteBox, p: Array, run: FreeRun) -> None:
        self._white_box = white_box
        self._p = p
        self._run = run
        self._ends = self._moved(0.0, 0.0, 0.0)

    def push(
        self, *, voltage_v: float = 0.0, start_rad_s: float = 0.0, end_rad_s: float = 0.0
    ) -> Push:
        """Return what other readings do; of an interval that is not whole, nothing."""
        ends = self._moved(voltage_v, start_rad_s, end_rad_s)
        current_a, slopes_a = (
            np.where(self._run.is_whole, np.nan_to_num(end - rest), 0.0)
            for end, rest in zip(ends, self._ends, strict=True)
        )
        return Push(current_a, slopes_a * self._p[0][:, None])

    def _moved(self, voltage_v: float, start_rad_s: float, end_rad_s: float) -> tuple[Array, Array]:
        """Return the current in A at the ends, shape (k,), and its derivatives (coordinate, k)."""
        stretch = self._run.stretch
        start = stretch.state[:, :-1]
        signals = (
            stretch.voltage_v + voltage_v,
            stretch.speed_rad_s[:, :-1] + start_rad_s,
            stretch.speed_rad_s[:, 1:] + end_rad_s,
            stretch.interval_s,
        )
        motion: Linear
        if isinstance(self._run, RotorFreeRun):
            rotor = self._run.speed_rad_s[None, :-1]
            motion = flow(self._white_box, self._p, [start, rotor], *signals)
        else:
            motion = interval_motion.move(self._white_box, self._p, start, *signals)
        end, _, by_coordinate = motion.of_state(State.CURRENT)
        return end[0], by_coordinate[:, 0]
