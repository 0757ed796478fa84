"""Finds motors whose signals are mixed up: the current or the voltage of one bears another's name.

Asked where the white box does not explain a motor. Its voltage balance is fitted by least squares,
over sums of a few samples, once with its own signals and once with those of each other motor. Where
only another motor's voltage, or current, closes the balance, the names are mixed up.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass

import numpy as np

from gray_box_observer.fit_test import FitAssessment, FitVerdict
from gray_box_observer.fit_test.effects import leaky_mean
from gray_box_observer.samples.replay_buffer import INTERVAL, SPEED, TORQUE, VOLTAGE
from gray_box_observer.white_box.interface import Array

FEWEST = 256
"""Samples by which it is told."""

MOST_COMPARED = 64
"""Motors of an observer from which on names are not compared: that would cost too much."""

COMPARED = 2048
"""Newest samples that are compared, at most."""

SUM = 4
"""Samples that are summed to a row."""

CLOSED, CLOSED_UNMEASURED = 0.1, 0.2
"""Share of the squared voltage that a balance may leave where it closes, with a measured speed and
without."""

TIMES = 5.0
"""How many times less it must leave than a motor's own signals do."""

PACE = (16.0, 64.0, 256.0, 1024.0, 4096.0, 65536.0)
"""Time constants in samples of the leaky integrals that stand for the speed of a rotor."""

MOST_MOTORS = 16
"""Other motors that are tried, at most: of those that do not fit either."""


@dataclass(frozen=True, slots=True)
class MixUp:
    """Two motors whose names are mixed up in one signal.

    Attributes:
        motor: whose balance does not close.
        other: whose signal closes it.
        signal: which signal: ``voltage`` or ``current``.
        share: share of the squared voltage that is left with it.
        own_share: the same with the motor's own signal.
    """

    motor: str
    other: str
    signal: str
    share: float
    own_share: float

    @property
    def sentence(self) -> str:
        """Say it in one line, with the remedy."""
        return (
            f'the {self.signal} named {self.other} closes the voltage balance of {self.motor} '
            f'({100.0 * self.share:.2g} % of the squared voltage left, '
            f'{100.0 * self.own_share:.2g} '
            f'% with its own): are {self.motor} and {self.other} swapped? Swap their names, or set '
            f'{self.motor}.joint: {self.other} and {self.other}.joint: {self.motor}'
        )


def mix_up(motor: str, samples: Mapping[str, Array]) -> MixUp | None:
    """Return the motor that one is mixed up with; None where none is, or it cannot be told.

    Args:
        motor: its name.
        samples: of it and of others, shape (signal, n) each, the newest last. Only those with the
            same intervals can be compared.
    """
    own = samples[motor]
    if own.shape[1] < FEWEST:
        return None
    own_share = _share_left(own[VOLTAGE], own[TORQUE], own)
    limit = CLOSED if np.isfinite(own[SPEED]).all() else CLOSED_UNMEASURED
    best: MixUp | None = None
    others = [name for name in samples if name != motor][:MOST_MOTORS]
    for name in others:
        other = samples[name]
        if not np.array_equal(other[INTERVAL, 1:], own[INTERVAL, 1:]):
            continue
        for signal, share in (
            ('voltage', _share_left(other[VOLTAGE], own[TORQUE], own)),
            ('current', _share_left(own[VOLTAGE], other[TORQUE], own)),
        ):
            closes = share < limit and TIMES * share < own_share
            if closes and (best is None or share < best.share) and _is_mutual(own, other, signal):
                best = MixUp(motor, name, signal, share, own_share)
    return best


def _is_mutual(own: Array, other: Array, signal: str) -> bool:
    """Tell whether the other motor closes with this one's signal, and not with its own.

    Motors that are driven alike close with each other's voltage. One of them with a broken sensor
    is not mixed up with the other.
    """
    limit = CLOSED if np.isfinite(other[SPEED]).all() else CLOSED_UNMEASURED
    voltage_v = own[VOLTAGE] if signal == 'voltage' else other[VOLTAGE]
    torque_nm = other[TORQUE] if signal == 'voltage' else own[TORQUE]
    share = _share_left(voltage_v, torque_nm, other)
    return share < limit and TIMES * share < _share_left(other[VOLTAGE], other[TORQUE], other)


def _share_left(voltage_v: Array, torque_nm: Array, own: Array) -> float:
    """Return the share of a squared voltage that the best balance leaves.

    Args:
        voltage_v: shape (n,): mean over each interval.
        torque_nm: shape (n,).
        own: shape (signal, n): intervals, and the speed where it is measured.
    """
    means = 0.5 * (torque_nm[1:] + torque_nm[:-1])
    interval_s = own[INTERVAL, 1:]
    speed = own[SPEED]
    columns = [np.diff(torque_nm), means * interval_s]
    if np.isfinite(speed).all() and np.ptp(speed) > 0.0:
        columns.append(0.5 * (speed[1:] + speed[:-1]) * interval_s)
    else:  # the speed is near a sum of leaky integrals of the current
        columns += [interval_s, *(leaky_mean(means, PACE) * interval_s)]
    target = voltage_v[1:] * interval_s
    rows = np.stack([*columns, target], axis=1)
    rows = np.where((interval_s > 0.0)[:, None], rows, 0.0)
    sums = rows[: rows.shape[0] // SUM * SUM].reshape(-1, SUM, rows.shape[1]).sum(axis=1)
    scale = np.linalg.norm(sums, axis=0)
    if not (np.isfinite(scale).all() and (scale > 0.0).all()):
        return 1.0
    sums = sums / scale
    weights = np.linalg.lstsq(sums[:, :-1], sums[:, -1], rcond=1e-9)[0]
    rest = sums[:, -1] - sums[:, :-1] @ weights
    return float(rest @ rest)


class MixUpSearch:
    """Searches for mixed up names among the motors of an observer, once after every test."""

    def __init__(self) -> None:
        self._answers: dict[str, tuple[FitAssessment, MixUp | None]] = {}

    def find(
        self,
        motor: str,
        names: Collection[str],
        fit_of: Callable[[str], FitAssessment],
        newest_of: Callable[[str], Array | None],
    ) -> MixUp | None:
        """Return the motor that one which does not fit is mixed up with; None where none is.

        Args:
            motor: its name.
            names: of all that have been seen.
            fit_of: gives how well the white box explains the data of one.
            newest_of: gives the newest COMPARED samples of one, shape (signal, n); None where they
                cannot be had.
        """
        if motor not in names or not 2 <= len(names) <= MOST_COMPARED:
            return None
        fit = fit_of(motor)
        if fit.verdict is not FitVerdict.MISFIT:
            return None
        last_fit, answer = self._answers.get(motor, (None, None))
        if last_fit != fit:  # asked again where a test has found something else
            misfits = [n for n in [*names] if fit_of(n).verdict is FitVerdict.MISFIT]
            newest = {n: newest_of(n) for n in (motor, *misfits)}
            samples = {n: array for n, array in newest.items() if array is not None}
            answer = mix_up(motor, samples) if motor in samples else None
            self._answers[motor] = fit, answer
        return answer
