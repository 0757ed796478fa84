"""Noise of a measured speed, which the current of the motor does not answer.

That of the model does: a speed runs straight from reading to reading, so noise of one pushes the
end of one interval and the start of the next. The residual has a memory then. How much noise there
is, its products with the residual tell.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from gray_box_observer.context_nodes.recursive.normal_equations import difference_noise
from gray_box_observer.context_nodes.recursive.trajectory import recurrence
from gray_box_observer.context_nodes.rotor.voltage_noise import (
    FEWEST,
    SURE,
    unanswered_variance,
)
from gray_box_observer.fit_test.free_run import FreeRun
from gray_box_observer.fit_test.projection import Amount
from gray_box_observer.fit_test.pushed_motion import Push, PushedMotion
from gray_box_observer.fit_test.speed_memory import SpeedMemory
from gray_box_observer.samples.noise_floor import STEP_TO_STD, quantisation_step
from gray_box_observer.samples.order_statistics import median
from gray_box_observer.white_box.interface import Array, WhiteBox
from gray_box_observer.white_box.motor import MotorWhiteBox

HELD_DECAY = 1e-3
"""Share of a deviation that an interval leaves at most where brushes hold the current."""

LEAST_RAD_S = 1e-9
"""Noise of a speed that is none: what rounding leaves."""


@dataclass(frozen=True, eq=False)
class SpeedNoise:
    """Noise of the readings of one motor's speed, and what it does to a free run.

    Attributes:
        std_rad_s: standard deviation, as second differences of the readings have it.
        variance: the same in rad2/s2, as far as the current does not answer it.
        start: what one standard deviation at the start of an interval does.
        end: what one does at its end.
    """

    std_rad_s: float
    variance: Amount
    start: Push
    end: Push

    @classmethod
    def from_run(cls, white_box: WhiteBox, p: Array, run: FreeRun) -> SpeedNoise | None:
        """Return the noise of a speed; None where its readings have none.

        Args:
            white_box: of one motor, its speed measured.
            p: shape (1, coordinate): its present values.
            run: the free run at these.
        """
        speed_rad_s = run.stretch.speed_rad_s
        step_rad_s = float(quantisation_step(speed_rad_s)[0])
        std_rad_s = max(difference_noise(speed_rad_s[0]), step_rad_s * STEP_TO_STD)
        if not std_rad_s > LEAST_RAD_S:
            return None
        assert isinstance(white_box, MotorWhiteBox)
        motion = PushedMotion(white_box, p, run)
        start, end = motion.push(start_rad_s=std_rad_s), motion.push(end_rad_s=std_rad_s)
        gain = 0.5 * (start.current_a[1:] + end.current_a[:-1]) / std_rad_s
        both_a = run.added_a[1:] + run.added_a[:-1]
        difference_rad_s = -0.5 * np.diff(speed_rad_s[0], 2)
        is_sound = run.is_whole[1:] & run.is_whole[:-1]
        pair = unanswered_variance(difference_rad_s, both_a, gain, is_sound)
        return cls(std_rad_s, Amount.from_pair(pair), start, end)

    @property
    def most_share(self) -> float:
        """Share of the variance that the current lets be noise, 0 to 1.

        A shaft that really runs so restlessly is no noise, and neither is a speed that is sampled
        too slowly to be smooth: the current answers it.
        """
        most = max(0.0, self.variance.mean + SURE * self.variance.std)
        return min(1.0, most / (self.std_rad_s * self.std_rad_s))

    @property
    def shown_share(self) -> float:
        """Share of the variance that the current shows to be noise, 0 to 1."""
        if not self.variance.exceeds(SURE):
            return 0.0
        return min(1.0, self.variance.mean / (self.std_rad_s * self.std_rad_s))

    def scores(self, run: FreeRun) -> Array:
        """Return the mean products of slopes and residual that all of it makes, (coordinate,)."""
        products = self.end.products * run.weight[1:]
        products += self.start.after(self.end, run.decay).products * run.lasting_weight
        return np.asarray(-products.sum(axis=1))

    def answers_a(self, run: FreeRun, noises: Array) -> Array:
        """Return how a run answers noise of the readings.

        Args:
            run: it.
            noises: shape (draw, k + 1): in standard deviations of all of it.

        Returns:
            Shape (draw, k + 1), in A.
        """
        pushes_a = self.start.current_a * noises[:, :-1] + self.end.current_a * noises[:, 1:]
        begins = np.zeros((len(noises), 1))
        return np.asarray(recurrence(run.decay[None], pushes_a[:, None], begins)[:, 0])

    def shown_in(self, run: FreeRun) -> FreeRun:
        """Return a run that knows the noise that shows; where none does, the run itself.

        Intervals in which brushes hold the current do not tell what others remember.
        """
        is_driven = run.is_whole & (run.decay > HELD_DECAY)
        if self.shown_share == 0.0 or np.count_nonzero(is_driven) < FEWEST:
            return run
        decay, start_a, end_a = (
            float(median(one[is_driven]))
            for one in (run.decay, self.start.current_a, self.end.current_a)
        )
        share = math.sqrt(self.shown_share)
        return replace(run, speed_memory=SpeedMemory(decay, share * start_a, share * end_a))
