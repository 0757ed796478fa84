"""Coarse search of a delay: the integrated equation's residual at every whole interval.

Over a window of samples the change of the current is linear in the integrals of voltage and basis
functions (METHOD 4, :mod:`gray_box_observer.context_nodes.recursive.linear_start`); a delay shifts
the integral of the voltage and nothing else. On an even grid the sums of products for all shifts
are cross-correlations, which the Fourier transform gives at the price of a few.
"""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gray_box_observer.samples.raw_history import RawSignals
from gray_box_observer.white_box.interface import Array, WhiteBox

WINDOW = 12
"""Samples between the two ends of a difference."""

OUTLIERS = 5
"""So many of the largest currents may be outliers; nothing counts as larger than twice the next."""


@dataclass(frozen=True, eq=False)
class Profile:
    """Residual against delay.

    Attributes:
        delay_s: shape (shift,): ascending, one sample interval apart.
        misfit: shape (shift,): sum of squared residuals of the best parameters; L is kept positive.
        rows: number of residuals.
    """

    delay_s: Array
    misfit: Array
    rows: int

    def best(self) -> float:
        """Return the delay of least misfit in s, by a parabola through the three nearest."""
        at, slope, bend = self._parabola()
        shift = -slope / bend if bend > 0.0 else 0.0
        return float(self.delay_s[at] + shift * (self.delay_s[1] - self.delay_s[0]))

    def evidence(self, delay_s: float) -> float:
        """Log-likelihood gain of the best delay over a given one, for independent residuals."""
        at, slope, bend = self._parabola()
        logs = np.log(self.misfit)
        away = float((delay_s - self.delay_s[at]) / (self.delay_s[1] - self.delay_s[0]))
        here = slope * away + 0.5 * bend * away**2
        if abs(away) > 1.0:
            here = float(np.interp(delay_s, self.delay_s, logs) - logs[at])
        lowest = -0.5 * slope**2 / bend if bend > 0.0 else 0.0
        return 0.5 * self.rows * (here - lowest)

    def _parabola(self) -> tuple[int, float, float]:
        """Place of the least misfit, with slope and bend of its logarithm per interval."""
        at = int(np.argmin(self.misfit))
        if not 0 < at < self.misfit.size - 1:
            return at, 0.0, 0.0
        left, middle, right = np.log(self.misfit[at - 1 : at + 2])
        return at, float(0.5 * (right - left)), float(left - 2.0 * middle + right)


def profile(
    white_box: WhiteBox,
    signals: RawSignals,
    restart: NDArray[np.bool_],
    interval_s: float,
    reach_s: tuple[float, float],
) -> Generator[None, None, Profile | None]:
    """Work out the profile over a range of delays, a piece of work at a time.

    Args:
        white_box: the physics.
        signals: voltage and torque; the voltage is known all over the range of delays.
        restart: shape (n - 1,): whether the signal history starts anew at torque 1 ... n - 1.
        interval_s: step of the delays: the usual time between torques.
        reach_s: smallest and largest delay.

    Returns:
        The profile; None where the signals are too short for it.
    """
    grid = _grid(signals.time_s, interval_s)
    low, high = round(reach_s[0] / interval_s), round(reach_s[1] / interval_s)
    if grid.size < 4 * WINDOW or high <= low:
        return None
    current = credible(white_box.state(signals.torque_nm))
    state = np.interp(grid, signals.time_s, current)
    speed = white_box.speed(state, np.interp(grid, signals.time_s, signals.speed_rad_s))
    yield
    restarts = np.concatenate([[0], np.cumsum(restart)])
    before = restarts[np.searchsorted(signals.time_s, grid, side='right') - 1]
    after = restarts[
        np.minimum(np.searchsorted(signals.time_s, grid, side='left'), restarts.size - 1)
    ]
    whole = (after[WINDOW:] == before[:-WINDOW]).astype(float)
    yield
    change = (state[WINDOW:] - state[:-WINDOW]) * whole
    known_drop = -_windowed(white_box.drive(np.zeros_like(state), state, speed), interval_s) * whole
    basis = [
        _windowed(phi, interval_s) * whole
        for phi in white_box.basis(np.zeros_like(state), state, speed)
    ]
    yield
    first, last = grid[0] - high * interval_s, grid[-1] - low * interval_s
    wide = first + interval_s * np.arange(round((last - first) / interval_s) + 1)
    integral = signals.voltage_integral(wide)
    volt = (
        integral[WINDOW:] - integral[:-WINDOW]
    )  # of the window that ends at each instant of the wide grid
    yield
    misfit = yield from _misfits(change, basis, known_drop, whole, volt)
    delays: Array = interval_s * np.arange(low, high + 1, dtype=np.float64)
    return Profile(delays, misfit[::-1], int(whole.sum()))  # a later window is a smaller delay


def credible(current: Array) -> Array:
    """Bound currents by twice the largest that is not alone, against absurd samples."""
    if current.size <= OUTLIERS:
        return current
    limit = 2.0 * np.partition(np.abs(current), -OUTLIERS - 1)[-OUTLIERS - 1]
    near: Array = np.clip(current, -limit, limit)
    return near


def _grid(time_s: Array, interval_s: float) -> Array:
    """An even grid that ends with the last sample, no longer than twice the number of samples."""
    count = min(int((time_s[-1] - time_s[0]) / interval_s) + 1, 2 * time_s.size)
    grid: Array = time_s[-1] - interval_s * np.arange(count - 1, -1, -1, dtype=np.float64)
    return grid


def _windowed(values: Array, interval_s: float) -> Array:
    """Integrals over every window, by the trapezoidal rule."""
    total = np.concatenate([[0.0], np.cumsum(0.5 * interval_s * (values[1:] + values[:-1]))])
    whole: Array = total[WINDOW:] - total[:-WINDOW]
    return whole


def _misfits(
    change: Array, basis: list[Array], known_drop: Array, whole: Array, volt: Array
) -> Generator[None, None, Array]:
    """Sums of squares of the balance for every place of the voltage's windows.

    The balance is ``change = p_0 (volt - known) - sum_j p_j basis_j``.

    What the basis explains is projected out once; ``p_0`` follows for each place, and is not
    negative.
    """
    if basis:
        unit_basis = np.stack([b / max(float(np.linalg.norm(b)), 1e-300) for b in basis], axis=1)
        directions, size, _ = np.linalg.svd(unit_basis, full_matrices=False)
        directions = directions[:, size > 1e-6 * size[0]] if size[0] > 0.0 else directions[:, :0]
    else:
        directions = np.zeros((change.size, 0))
    rest = change - directions @ (directions.T @ change)
    about = volt - np.mean(volt)  # sums of squares cancel less about the mean
    known_drop = (known_drop - np.mean(volt)) * whole
    yield
    along = _Correlation(about, change.size)
    by_rest = along(rest) - rest @ known_drop
    yield
    square = (
        _Correlation(about**2, change.size)(whole)
        - 2.0 * along(known_drop)
        + known_drop @ known_drop
    )
    for column in directions.T:
        yield
        square = square - (along(column) - column @ known_drop) ** 2
    total = float(rest @ rest)
    square_reduction = np.where(
        square > 1e-9 * np.max(square, initial=0.0), by_rest * np.maximum(by_rest, 0.0), 0.0
    )
    square_reduction = square_reduction / np.maximum(square, 1e-300)
    misfit: Array = np.maximum(total - square_reduction, 1e-12 * total) + 1e-300
    return misfit


class _Correlation:
    """Sums of products of short signals, so many samples each, with every stretch of a long one."""

    def __init__(self, long: Array, short: int) -> None:
        self._places = long.size - short + 1
        self._size = 1 << (long.size - 1).bit_length()
        self._long = np.fft.rfft(long, self._size)

    def __call__(self, short: Array) -> Array:
        product = self._long * np.conj(np.fft.rfft(short, self._size))
        result: Array = np.fft.irfft(product, self._size)[: self._places]
        return result
