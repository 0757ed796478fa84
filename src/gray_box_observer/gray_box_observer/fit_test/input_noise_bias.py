"""What noise of a measured voltage or speed does to the tests of a residual.

Whatever is made of the readings, such as the response to a delay, holds their noise.
So does the residual, and their products have a mean that is not zero: a delay seems to be there. It
is found by drawing such noise anew, and laying it over the readings.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from gray_box_observer.context_nodes.rotor.noise_filter import DRAWS, SEED
from gray_box_observer.context_nodes.rotor.voltage_noise import NO_NOISE
from gray_box_observer.fit_test.free_run import FreeRun
from gray_box_observer.fit_test.projection import Projection
from gray_box_observer.fit_test.speed_noise import SpeedNoise
from gray_box_observer.samples.order_statistics import usual_interval
from gray_box_observer.white_box.flow import swapped_logarithms, to_coordinates
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
        cls, white_box: MotorWhiteBox, theta: Array, run: FreeRun, projection: Projection
    ) -> InputNoiseBias | None:
        """Draw noise as large as that of a free run; None where it has none.

        Args:
            white_box: of one motor.
            theta: shape (parameter,): its present values.
            run: its free run at these.
            projection: of its residual on the parameters.
        """
        if run.noise is not NO_NOISE:
            return cls._of_voltage(white_box, theta, run, projection)
        if run.speed_memory is not None:
            return cls._of_speed(white_box, theta, run, projection)
        return None

    @classmethod
    def _of_voltage(
        cls, white_box: MotorWhiteBox, theta: Array, run: FreeRun, projection: Projection
    ) -> InputNoiseBias:
        interval_s = run.stretch.interval_s[0]
        of_residual, _ = run.noise.products(white_box, np.log(theta), interval_s)
        scores = np.concatenate([[0.0], swapped_logarithms(of_residual[None])[0]])
        scores *= run.residual_a.size
        usual_s = usual_interval(interval_s)
        rng = np.random.default_rng(SEED)
        is_whole = run.is_whole
        stds_v = np.where(is_whole, run.noise.stds_v(interval_s, usual_s), 0.0)
        noises_v = stds_v * rng.normal(size=(DRAWS, is_whole.size))
        remainders_a = projection.without(projection.with_weight(-run.response(noises_v)))
        stretch = run.stretch
        noisy_runs = tuple(
            replace(run, stretch=replace(stretch, voltage_v=stretch.voltage_v + noise_v))
            for noise_v in noises_v
        )
        return cls(run, projection, scores, noisy_runs, remainders_a)

    @classmethod
    def _of_speed(
        cls, white_box: MotorWhiteBox, theta: Array, run: FreeRun, projection: Projection
    ) -> InputNoiseBias | None:
        noise = SpeedNoise.from_run(white_box, to_coordinates(theta[None]), run)
        if noise is None:
            return None
        stretch = run.stretch
        rng = np.random.default_rng(SEED)
        noises = np.sqrt(noise.shown_share) * rng.normal(size=(DRAWS, run.residual_a.size))
        answers_a = noise.answers_a(run, noises)
        speeds_rad_s = stretch.speed_rad_s + noise.std_rad_s * noises[:, None]
        noisy_runs = tuple(
            replace(run, stretch=replace(stretch, speed_rad_s=speed_rad_s))
            for speed_rad_s in speeds_rad_s
        )
        scores = np.concatenate([[0.0], noise.shown_share * noise.scores(run)])
        remainders_a = projection.without(projection.with_weight(-answers_a))
        return cls(run, projection, scores, noisy_runs, remainders_a)

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
