"""What data tell of the parameters beside a lost voltage and an offset that the form leaves out.

The free run of every part of the data is linearised by the parameters' logarithms, by the loss and
by the offset. Its rows go into a square-root information matrix (Bierman 1977), so that data are
looked at once and nothing is lost by rounding. A prior stands for what loss and offset may be. So
data say by how much the parameters may move with them.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gray_box_observer.context_nodes.recursive.normal_equations import difference_noise
from gray_box_observer.context_nodes.recursive.trajectory import SampleWindow
from gray_box_observer.fit_test.effects import KNEE, interval_means
from gray_box_observer.fit_test.free_run import FreeRun, free_run
from gray_box_observer.fit_test.policy import RATIO_DOUBT
from gray_box_observer.fit_test.twin_effects import LOST_VOLTAGE, OFFSET
from gray_box_observer.safe_io.saved_state import ArrayRule, numbers, whole
from gray_box_observer.samples.order_statistics import MAD_TO_STD, median
from gray_box_observer.white_box import MotorWhiteBox, forms
from gray_box_observer.white_box.flow import swapped_logarithms, to_coordinates
from gray_box_observer.white_box.interface import Array

OPEN_STD = 4.0
"""Standard deviation of a parameter's logarithm of which the data tell nothing."""

CREDIBLE = 6.0
"""Standard deviations beyond which a residual counts for no more."""

FLOWING = 2.0
"""Standard deviations of the noise from which a current flows."""

MATERIAL_V = 0.2
"""Root mean square voltage from which loss and offset count as found. On healthy robots, which are
not so exact, up to 0.14 V seem to be lost or won."""

SMALLEST_NOISE = 1e-6
"""Noise that is believed at least, as a share of the largest current."""


class LossInformation:
    """Gathers what the data of one motor tell of its parameters, a loss and an offset.

    Args:
        white_box: its physics; the effects that it has already are no question.
        lost_v: standard deviation in V of what may be lost, and of an offset.
    """

    def __init__(self, white_box: MotorWhiteBox, lost_v: float) -> None:
        self._white_box = white_box
        names = [parameter.name for parameter in white_box.parameters]
        self._effects = [
            name
            for name in (LOST_VOLTAGE, OFFSET)
            if name not in names and name not in white_box.known
        ]
        self._count = len(names)
        self._unknowns = self._count + len(self._effects)
        self._prior = np.diag(1.0 / np.repeat([OPEN_STD, lost_v], [len(names), len(self._effects)]))
        self._about = np.zeros(self._count)
        self._root = np.zeros((self._unknowns, self._unknowns + 1))
        self._power = np.zeros((len(self._effects), len(self._effects)))
        self._interval_count = 0

    def add(self, theta: Array, content: Array) -> bool:
        """Take in a part of the data.

        Args:
            theta: shape (1, parameter): present values, about which the free run is linearised.
            content: shape (signal, 1, n): samples, the first of them where the part before ended.

        Returns:
            Whether the values explain the part nearly: about others a linearisation tells little.
        """
        window = SampleWindow.of_content(self._white_box, np.ascontiguousarray(content))
        window = window.restarted(_crossings(window.state))
        run = free_run(self._white_box, to_coordinates(theta), window)
        logarithm = np.log(theta[0])
        if self._interval_count == 0:
            self._about = logarithm
        floor_a = difference_noise(run.residual_a)
        limit_a = CREDIBLE * max(MAD_TO_STD * float(median(np.abs(run.residual_a))), floor_a)
        residual_a = np.clip(run.residual_a, -limit_a, limit_a)
        least_a = SMALLEST_NOISE * float(np.max(np.abs(run.stretch.state))) + 1e-12
        noise_a = max(float(np.sqrt(np.mean(residual_a**2))), floor_a, least_a)
        by_logarithm = swapped_logarithms(run.jacobian[:, 1:])
        nuisances = [run.jacobian[:, :1], *(column[:, None] for column in run.further)]
        shapes = self._shapes(run, noise_a)
        target_a = residual_a + by_logarithm @ (logarithm - self._about)
        columns = [*nuisances, by_logarithm, run.response(-shapes).T, target_a[:, None]]
        rows = np.column_stack(columns) * (np.sqrt(run.weight) / noise_a)[:, None]
        if not np.isfinite(rows).all():  # absurd samples tell nothing
            return False
        part = np.asarray(np.linalg.qr(rows, mode='r'))[len(nuisances) :, len(nuisances) :]
        root = np.asarray(np.linalg.qr(np.vstack([self._root, part]), mode='r'))
        self._root = root[: self._unknowns]
        self._power += shapes @ shapes.T
        self._interval_count += shapes.shape[1]
        return noise_a < RATIO_DOUBT * max(floor_a, least_a)

    def _shapes(self, run: FreeRun, noise_a: float) -> Array:
        """Return the voltages that 1 V of every effect in question takes, shape (effect, k).

        Of a current that is hardly there nothing is told of a loss: its sign would follow the loss.
        """
        current_a = interval_means(run.current_a)
        flows = np.abs(current_a) > max(
            FLOWING * noise_a, KNEE * float(np.max(np.abs(run.stretch.state)))
        )
        shapes = np.ones((len(self._effects), current_a.size))
        for row, name in enumerate(self._effects):
            if name == LOST_VOLTAGE:
                drop = np.asarray(forms.EFFECTS[name].value(current_a, 0.0, 0.0, 0.0))
                shapes[row] = np.where(flows, drop, 0.0)
        return shapes

    def spread(self) -> Array:
        """Return what loss and offset add to the covariance of the parameters' logarithms.

        It is what the data leave open of them, and what the data say of them, where that is
        material: a second moment about what is estimated without them.

        Returns:
            Shape (parameter, parameter).
        """
        count = self._count
        if self._unknowns == count or self._interval_count == 0:
            return np.zeros((count, count))
        rows = np.vstack([self._root[:, :-1], self._prior])
        target = np.concatenate([self._root[:, -1], np.zeros(self._unknowns)])
        q, r = np.linalg.qr(rows)
        inverse = np.linalg.solve(r, np.column_stack([np.eye(self._unknowns), q.T @ target]))
        covariance = inverse[:, :-1] @ inverse[:, :-1].T
        amount_v = inverse[count:, -1]
        of_effects = covariance[count:, count:]
        slope = np.linalg.solve(of_effects, covariance[count:, :count])
        mean_power = float(amount_v @ self._power @ amount_v) / self._interval_count
        moment = of_effects
        if mean_power > MATERIAL_V**2:
            moment = of_effects + np.outer(amount_v, amount_v)
        spread: Array = slope.T @ moment @ slope
        return spread

    def state(self) -> dict[str, Any]:
        """Everything, as plain values for a checkpoint."""
        return {
            'about': self._about.tolist(),
            'root': self._root.tolist(),
            'power': self._power.tolist(),
            'intervals': self._interval_count,
        }

    def restore(self, plain: Mapping[str, Any]) -> None:
        """Take back what :meth:`state` gave.

        Raises:
            CheckpointError: it is no state that there could have been.
        """
        about = numbers(plain, 'about', ArrayRule(self._about.shape))
        root = numbers(plain, 'root', ArrayRule(self._root.shape))
        power = numbers(plain, 'power', ArrayRule(self._power.shape))
        self._interval_count = whole(plain, 'intervals')
        self._about = about
        self._root = root
        self._power = power


def _crossings(current_a: Array) -> NDArray[np.bool_]:
    """Return the intervals in which a current changes its sign, shape (1, k) of (1, k + 1).

    When within them it does, and what a loss is at small currents, no form tells exactly.
    """
    changes = np.sign(current_a[:, 1:]) != np.sign(current_a[:, :-1])
    larger_a = np.maximum(np.abs(current_a[:, 1:]), np.abs(current_a[:, :-1]))
    crossings: NDArray[np.bool_] = changes & (larger_a > KNEE * float(np.max(np.abs(current_a))))
    return crossings
