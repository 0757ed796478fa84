"""What noise of a measured voltage or speed does to the tests of a residual.

Whatever is made of the readings, such as the response to a delay, holds their noise.
So does the residual, and their products have a mean that is not zero: a delay seems to be there. It
is found by drawing such noise anew, and laying it over the readings.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from gray_box_observer.context_nodes.rotor.noise_filter import DRAWS, SEED
from gray_box_observer.context_nodes.rotor.voltage_noise import NO_NOISE
from gray_box_observer.fit_test.free_run import FreeRun
from gray_box_observer.fit_test.projection import Projection
from gray_box_observer.fit_test.speed_noise import SpeedNoise
from gray_box_observer.samples.order_statistics import usual_interval
from gray_box_observer.white_box.flow import swapped_logarithms
from gray_box_observer.white_box.interface import Array
from gray_box_observer.white_box.motor import MotorWhiteBox


@dataclass(frozen=True, eq=False)
class InputNoiseBias:
    """Mean products of responses with a residual that hold the same noise of voltage or speed.

    Attributes:
        run: free run of one motor.
        projection: of its residual on the parameters.
        scores: shape (1 + coordinate,): mean products of the residual with the columns of first
            state and coordinates.
        noisy_runs: the same with noise laid over its readings, once a draw.
        remainders_a: shape (draw, k + 1): what the columns leave of what it adds to the residual.
    """

    run: FreeRun
    projection: Projection
    scores: Array
    noisy_runs: tuple[FreeRun, ...]
    remainders_a: Array

    @classmethod
    def of_run(
        cls,
        white_box: MotorWhiteBox,
        theta: Array,
        run: FreeRun,
        projection: Projection,
        speed_noise: SpeedNoise | None,
    ) -> InputNoiseBias | None:
        """Draw noise as large as that of a free run; None where it has none.

        Args:
            white_box: of one motor.
            theta: shape (parameter,): its present values.
            run: its free run at these.
            projection: of its residual on the parameters.
            speed_noise: of the readings of its speed; None: they have none.
        """
        rng = np.random.default_rng(SEED)
        stretch = run.stretch
        if run.noise is not NO_NOISE:
            interval_s = stretch.interval_s[0]
            of_residual, _ = run.noise.products(white_box, np.log(theta), interval_s)
            scores = run.residual_a.size * swapped_logarithms(of_residual[None])[0]
            stds_v = run.noise.stds_v(interval_s, usual_interval(interval_s))
            stds_v = np.where(run.is_whole, stds_v, 0.0)
            noises_v = stds_v * rng.normal(size=(DRAWS, stds_v.size))
            answers_a = run.response(noises_v)
            stretches = [
                replace(stretch, voltage_v=stretch.voltage_v + noise_v) for noise_v in noises_v
            ]
        elif run.speed_memory is not None and speed_noise is not None:
            share = speed_noise.shown_share
            scores = share * speed_noise.scores(run)
            noises = math.sqrt(share) * rng.normal(size=(DRAWS, run.residual_a.size))
            answers_a = speed_noise.answers_a(run, noises)
            noises_rad_s = speed_noise.std_rad_s * noises
            stretches = [
                replace(stretch, speed_rad_s=stretch.speed_rad_s + noise_rad_s)
                for noise_rad_s in noises_rad_s
            ]
        else:
            return None
        return cls(
            run,
            projection,
            np.concatenate([[0.0], scores]),
            tuple(replace(run, stretch=one) for one in stretches),
            projection.without(projection.with_weight(-answers_a)),
        )

    def of_responses(
        self, responses_a: Array, respond: Callable[[FreeRun], Array]
    ) -> tuple[Array, Array]:
        """Return mean products with the residual, and the variances of their errors, (response,).

        Args:
            responses_a: shape (response, k + 1): those of the run, with weight.
            respond: makes responses of a run, of the same shape, without weight.
        """
        products = []
        for noisy_run, remainder_a in zip(self.noisy_runs, self.remainders_a, strict=True):
            moves_a = self.projection.with_weight(respond(noisy_run)) - responses_a
            products.append(moves_a @ remainder_a)
        means = np.mean(products, axis=0)
        variances = np.var(products, axis=0, ddof=1) / DRAWS
        return means - self.projection.explained(responses_a, self.scores), variances
