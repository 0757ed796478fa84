"""The free run of one motor at given values, and what further effects would add to it.

The free run goes from voltage (and measured speed) alone; no measured current corrects it on the
way. Where it begins anew, its first state is known by one noisy reading. The samples that follow
correct it, ever less, as a Kalman filter of the state alone would; single outliers do not.

Every effect that the white box leaves out is a small voltage of a known shape or a small change of
the reading. Its influence on the free run follows from the same linearised intervals as that of the
context nodes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gray_box_observer.context_nodes.pieces import Pieces, completed
from gray_box_observer.context_nodes.recursive.normal_equations import robust_std
from gray_box_observer.context_nodes.recursive.trajectory import (
    Linearised,
    SampleWindow,
    Trajectory,
    find_kicks,
    follow,
    follow_moves,
    input_reach,
    linearise,
    recurrence,
    restart_variance,
    taken_over,
)
from gray_box_observer.context_nodes.rotor.noise_memory import without_memory
from gray_box_observer.context_nodes.rotor.voltage_noise import NO_NOISE, VoltageNoise
from gray_box_observer.context_nodes.rotor.voltage_response import Winding
from gray_box_observer.fit_test.speed_memory import SpeedMemory
from gray_box_observer.white_box.interface import Array, WhiteBox

PASSES = 3
"""Linearisations at most, each about the run of the one before: the free run of a nonlinear motor
is then its own."""

NEAR = 0.05
"""Residual, as a share of the current's spread, up to which the run that is linearised about the
readings will do."""

MAX_KICKS = 0.05
"""Share of the samples at which the state may jump before the jumps are the model's fault."""

CREDIBLE = 20.0
"""Times the largest reading: nothing is linearised about a state beyond."""

OUTLIER = 6.0
"""Standard deviations beyond which a reading corrects no state after a restart."""


@dataclass(frozen=True, eq=False)
class FreeRun:
    """Free run of one motor over k + 1 samples.

    Attributes:
        stretch: the samples, with a motor axis of one; restarted where the state was kicked.
        inductance_h: L of the run.
        current_a: shape (k + 1,): the run.
        residual_a: shape (k + 1,): measured less predicted current.
        jacobian: shape (k + 1, 1 + coordinate): derivative by the first state and by the
            coordinates' logarithms.
        decay: shape (k,): what every interval leaves of a deviation, and corrections after a
            restart.
        reach_s: shape (k,): time over which a voltage acts in every interval, its decay taken into
            account.
        weight: shape (k + 1,): what a sample counts; less than one after a restart.
        further: shape (k + 1,) each: derivatives by whatever else is free.
        noise: of the voltage, which the current does not answer, where the values know of it.
        noise_power_a2: mean square of what that adds to the residual.
        noise_memory: of the current. Residual and derivatives are without what its noise remembers,
            and so is what answers.
        speed_memory: what noise of a measured speed makes the residual remember, where it shows.
    """

    stretch: SampleWindow
    inductance_h: float
    current_a: Array
    residual_a: Array
    jacobian: Array
    decay: Array
    reach_s: Array
    weight: Array
    further: tuple[Array, ...] = ()
    noise: VoltageNoise = NO_NOISE
    noise_power_a2: float = 0.0
    noise_memory: float = 0.0
    speed_memory: SpeedMemory | None = None

    @property
    def is_whole(self) -> NDArray[np.bool_]:
        """Whether an interval lasts, and the run goes on through it, shape (k,)."""
        return np.asarray(~self.stretch.restart[0] & (self.stretch.interval_s[0] > 0.0))

    @property
    def gain(self) -> Array:
        """Current in A that one volt over an interval brings to its end, shape (k,)."""
        return np.where(self.stretch.restart[0], 0.0, self.reach_s / self.inductance_h)

    @property
    def added_a(self) -> Array:
        """What an interval adds to the residual, in A, shape (k,)."""
        return np.asarray(self.residual_a[1:] - self.decay * self.residual_a[:-1])

    @property
    def lasting_weight(self) -> Array:
        """What the squares of a push at the end of every interval come to, shape (k,).

        At the samples that follow it is ever smaller, until the run begins anew.
        """
        later = np.concatenate([self.decay[1:], [0.0]]) ** 2
        weight = self.weight[None, None, :0:-1]
        backward = recurrence(later[None, ::-1], weight, np.zeros((1, 1)))
        return np.asarray(backward[0, 0, :0:-1])

    @property
    def has_input_noise(self) -> bool:
        """Whether noise of voltage or speed gives the residual a memory."""
        return self.noise is not NO_NOISE or self.speed_memory is not None

    def beyond_memory(self, signals_a: Array) -> Array:
        """Return signals of the current as the residual is: without what noise remembers.

        Args:
            signals_a: shape (..., k + 1).
        """
        begins = np.concatenate([[True], self.stretch.restart[0]])
        return np.asarray(without_memory(signals_a.T, self.noise_memory, begins).T)

    def innovation_of(self, residual_a: Array) -> Array:
        """Return what a residual has beyond the memory that noise of voltage or speed gives it.

        Args:
            residual_a: shape (k + 1,).
        """
        if self.noise is not NO_NOISE:
            winding = Winding(self.decay, self.gain)
            return self.noise.innovation(residual_a, winding, self.is_whole, self.noise_power_a2)
        if self.speed_memory is not None:
            return self.speed_memory.innovation(residual_a, self.decay, self.is_whole)
        return residual_a

    def response(self, voltages_v: Array) -> Array:
        """Return how the run answers small further voltages.

        Args:
            voltages_v: shape (voltage, k): mean over every interval.

        Returns:
            Shape (voltage, k + 1), in A.
        """
        inputs = (voltages_v * self.gain)[:, None]
        rows: Array = recurrence(self.decay[None], inputs, np.zeros(inputs.shape[:2]))[:, 0]
        return rows

    def pulse_response(self, pulses_vs: Array) -> Array:
        """Return how the run answers small pulses of voltage at the start of its intervals.

        Args:
            pulses_vs: shape (pulse, k): in V s, a row of them an answer.

        Returns:
            Shape (pulse, k + 1), in A.
        """
        left = np.where(self.stretch.restart[0], 0.0, self.decay / self.inductance_h)
        inputs = (pulses_vs * left)[:, None]
        rows: Array = recurrence(self.decay[None], inputs, np.zeros(inputs.shape[:2]))[:, 0]
        return rows

    def explain(self, response_a: Array, columns: Array) -> tuple[Array, Array]:
        """Explain a response by columns, and by where the run begins, as well as they can.

        Args:
            response_a: shape (k + 1,): of the current.
            columns: shape (k + 1, column).

        Returns:
            How much of each column, shape (column,), and what is left over, shape (k + 1,). That
            has the root of the samples' weight.
        """
        root = np.sqrt(self.weight)
        both = np.column_stack([columns, self.jacobian[:, 0], *self.further]) * root[:, None]
        target = response_a * root
        scale = np.linalg.norm(both, axis=0) + 1e-300
        amounts = np.linalg.lstsq(both / scale, target, rcond=1e-9)[0] / scale
        return amounts[: columns.shape[1]], target - both @ amounts


def free_run(white_box: WhiteBox, p: Array, stretch: SampleWindow) -> FreeRun:
    """Run the white box freely through a stretch, at once; see :func:`free_run_in_pieces`."""
    return completed(free_run_in_pieces(white_box, p, stretch))


def free_run_in_pieces(white_box: WhiteBox, p: Array, stretch: SampleWindow) -> Pieces[FreeRun]:
    """Run the white box freely through a stretch.

    Args:
        white_box: of one motor.
        p: shape (1, coordinate): where to linearise and to run.
        stretch: the samples, with a motor axis of one.
    """
    limit = CREDIBLE * np.abs(stretch.state).max() + 1e-9
    about = stretch.state
    start = stretch.state[:, 0]
    without_correction = np.zeros_like(stretch.state)
    for attempt in range(PASSES):
        maps = linearise(white_box, p, stretch, np.clip(about, -limit, limit))
        yield 0
        path = follow(maps, stretch, start, without_correction)
        residual = stretch.state - path.state
        kicks = _kicks(path, residual, stretch) if attempt == 0 else None
        if kicks is not None:
            stretch = stretch.restarted(kicks)
        power = float((path.by_start[0] ** 2).sum())
        shift = float((path.by_start[0] * residual[0]).sum()) / power
        start = start + shift
        about = path.state + shift * path.by_start
        is_near = float(np.std(stretch.state - about)) <= NEAR * float(np.std(stretch.state))
        if kicks is None and is_near:
            break
        yield 0
    yield 0
    residual = stretch.state - about
    loose = restart_variance(maps.decay, stretch.restart)
    if stretch.restart.any():
        path = _corrected(maps, stretch, start, taken_over(loose), residual)
        residual = stretch.state - path.state
        about = path.state
    jacobian = np.column_stack([path.by_start[0], (path.by_coordinate[:, 0] * p[0][:, None]).T])
    weight = 1.0 / (1.0 + loose[0])
    return FreeRun(
        stretch,
        1.0 / float(p[0, 0]),
        about[0],
        residual[0],
        jacobian,
        path.factor[0],
        input_reach(stretch.interval_s[0], maps.decay[0]),
        weight,
    )


def _corrected(
    maps: Linearised, stretch: SampleWindow, start: Array, gain: Array, residual: Array
) -> Trajectory:
    """Run on where readings correct the state after restarts.

    Either all do, or all but those that lie far from the run without corrections. The first is
    right where a run begins at an odd reading: every later one is then far from it. The second is
    right where an odd reading follows. What leaves the smaller residuals, outliers cut, is taken.

    Args:
        maps: the linearised intervals.
        stretch: the samples.
        start: shape (motor,): first state.
        gain: shape (motor, k + 1): share of a reading's error that the state takes over.
        residual: shape (motor, k + 1): measured less predicted state without corrections.
    """
    limit_a = OUTLIER * robust_std(residual, np.isfinite(residual))[:, None]
    by_all = follow(maps, stretch, start, gain)
    is_near = np.abs(residual) <= limit_a
    if is_near.all():
        return by_all
    by_near = follow(maps, stretch, start, np.where(is_near, gain, 0.0))
    sizes = [
        float((np.clip(stretch.state - path.state, -limit_a, limit_a) ** 2).sum())
        for path in (by_all, by_near)
    ]
    return by_all if sizes[0] <= sizes[1] else by_near


def _kicks(path: Trajectory, residual: Array, stretch: SampleWindow) -> NDArray[np.bool_] | None:
    """Jumps of the state against the model, shape (1, k); None if these are the model's fault.

    They are where there are too many of them. They are too where the state jumps at most moves of
    the voltage. A run that begins anew behind every move would test the held levels alone, and
    these tell nothing of the inductance.
    """
    change = residual[:, 1:] - path.factor * residual[:, :-1]
    sharp = np.minimum(
        robust_std(residual, stretch.valid), robust_std(change, ~stretch.restart) / np.sqrt(2.0)
    )
    kicks = find_kicks(path, residual, ~stretch.restart, np.maximum(sharp, 1e-12))
    count = int(kicks.sum())
    if not 0 < count <= MAX_KICKS * kicks.size:
        return None
    return None if follow_moves(kicks, stretch.moves)[0] else kicks
