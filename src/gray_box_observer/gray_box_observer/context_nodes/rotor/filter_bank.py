"""Filters of the speed of many motors, side by side, as compiled code reads them."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from gray_box_observer.context_nodes.native import compiled, filtered_speed
from gray_box_observer.context_nodes.native.whole_motor import pointer
from gray_box_observer.context_nodes.rotor.rotor_trajectory import LARGEST_STEP, MOST_STEPS, STATES
from gray_box_observer.white_box.declaration import TERMS
from gray_box_observer.white_box.interface import Array

WALKS = np.array([1e-10, 1e-6, 1e-4, 1e-2, 1.0])
"""Variances that the load gains within a mechanical time constant, over the square of the stall
torque; a filter each."""

MEMORY = 0.99
"""Share of its log-likelihood that a filter keeps from sample to sample."""

COARSENESS = 0.03
"""Standard deviation of what the model misses in the current, within a sample, over the noise."""

SLIP = 1e-3
"""The same of the speed within a mechanical time constant, over the no-load speed: friction that
holds a rotor lets it go a little earlier or later."""

FURTHEST = 5.0
"""Standard deviations of an innovation that count at most: an outlier moves the speed little."""

LEAST_V = 1e-3
"""Voltage by which the no-load speed is reckoned at least."""

LOADED = STATES + 1
"""States of a filter: those of the motor, and the load over the inertia."""

NO_LOAD_SPEED = 2
"""Place of the no-load speed among the constants of a motor."""

_COVARIANCE = LOADED + LOADED**2


class FilterBank:
    """What the filters of some motors have come to.

    Args:
        motors: how many.
        is_compiled: whether compiled code is used where there is any.

    Attributes:
        states: shape (motor, filter, state).
        covariance: shape (motor, filter, state, state).
        log_likelihood: shape (motor, filter).
        p: shape (motor, coordinate): coordinates of every motor's motion.
        constants: shape (motor, 4): Kt in N m/A, noise in A, no-load speed in rad/s and mechanical
            time constant in s.
        samples: shape (motor, 3): interval in s, voltage in V and measured current in A.
        mixture: shape (motor, 2): speed that the filters agree on, and its variance.
        largest_v: shape (motor,): largest voltage so far, in V.
        is_running: shape (motor,): whether the newest sample could be followed.
        can_step: whether there is compiled code.
    """

    def __init__(self, motors: int, *, is_compiled: bool = True) -> None:
        filters = np.zeros((motors, WALKS.size, filtered_speed.FILTER_SIZE))
        self.states: Array = filters[:, :, :LOADED]
        self.covariance: Array = filters[:, :, LOADED:_COVARIANCE].reshape(
            motors, WALKS.size, LOADED, LOADED
        )
        self.log_likelihood: Array = filters[:, :, _COVARIANCE]
        self.p: Array = np.zeros((motors, len(TERMS)))
        self.constants: Array = np.zeros((motors, 4))
        self.samples: Array = np.zeros((motors, 3))
        self.mixture: Array = np.full((motors, 2), np.nan)
        self.largest_v: Array = np.full(motors, LEAST_V)
        self.is_running: NDArray[np.bool_] = np.zeros(motors, dtype=bool)
        self._library = filtered_speed.library() if is_compiled else None
        self.can_step = self._library is not None
        if self._library is None:
            return
        self._settings = filtered_speed.FilterSettings(
            coarseness=COARSENESS, slip=SLIP, furthest=FURTHEST, memory=MEMORY,
            largest_step=LARGEST_STEP, most_steps=MOST_STEPS,
        )  # fmt: skip
        self._ladders = np.zeros((motors, self._library.filtered_speed_ladder_size()))
        self._filters = filters
        self._arguments = (
            self._settings, pointer(WALKS), WALKS.size, pointer(self.p), pointer(self.constants),
            pointer(self._ladders), pointer(self.samples), pointer(filters), pointer(self.mixture),
        )  # fmt: skip

    def renew(self, motor: int, p: Array) -> None:
        """Take other coordinates of a motor's motion, shape (coordinate,)."""
        self.p[motor] = p
        if self.can_step:
            self._ladders[motor] = 0.0

    def step(self, motors: NDArray[np.int64]) -> None:
        """Go on by the newest sample of some motors; the mixture is NaN where that cannot be.

        Args:
            motors: their places, shape (n,).
        """
        self.step_at(motors.size, compiled.address(motors))

    def step_at(self, count: int, places: Any) -> None:
        """Do what :meth:`step` does, for so many motors whose places stand at an address."""
        assert self._library is not None
        self._library.filtered_speed_steps(count, places, *self._arguments)
