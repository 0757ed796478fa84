"""What the physics does not know: a correction of the predicted torque, learnt from data and kept on a short lead.

Cogging, brushes, friction and a rotor that follows leave a residual that no choice of the parameters explains. A second
small LSTM learns it from voltage, speed and the current that the physics predicts. It is bounded, it fades where no
samples were seen, and as much of it is used as samples that did not teach it have borne out: with perfect physics none.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from gray_box_observer.predictor.forecaster import Question
from gray_box_observer.predictor.network import Mask, Memory, Weights, step
from gray_box_observer.white_box.base import Array, WhiteBox

INPUTS = 4
"""Voltage, predicted current, the current where it is going, speed; each in units of its size."""

BINS = 12
"""Cells a side of the map of where samples were seen."""

REACH = 1.5
"""Edge of that map, in units of the signals' sizes."""

FEW = 5.0
"""Samples in a cell at which half of the correction is used there."""

WARM = 64
"""Samples that fill the network's memory, whatever it held before: what it says counts behind them."""

ASKED = 32
"""Times, at most, that it is asked on the way to a forecast: there is time for it at a thousand samples a second."""

PREFIX = 'residual_'


@dataclass(frozen=True, slots=True)
class Correction:
    """A learnt correction.

    Attributes:
        weights: the network.
        size: shape (3,): sizes of voltage in V, current in A and speed in rad/s.
        limit_a: largest correction, as a current in A.
        share: how much of it is used, 0 to 1.
        support: shape (BINS, BINS): samples seen, by predicted current and voltage.
        interval_s: from sample to sample where it was learnt, in s: the pace at which its memory moves.
    """

    weights: Weights
    size: Array
    limit_a: float
    share: float
    support: Array
    interval_s: float

    def inputs(self, voltage_v: Array, current_a: Array, steady_a: Array, speed_rad_s: Array) -> Array:
        """Columns of the network's input, of the shape of the signals with an axis of INPUTS behind; bounded."""
        volt, ampere, speed = self.size
        columns = [voltage_v / volt, current_a / ampere, steady_a / ampere, speed_rad_s / speed]
        inputs: Array = np.clip(np.stack(np.broadcast_arrays(*columns), axis=-1), -3.0, 3.0)
        return inputs

    def current(self, readout: Array, current_a: Array, voltage_v: Array) -> Array:
        """Return the correction in A: bounded, and faded where few samples were seen."""
        seen = self.support[cells(current_a / self.size[1]), cells(voltage_v / self.size[0])]
        correction: Array = self.share * self.limit_a * np.tanh(readout) * seen / (seen + FEW)
        return correction

    def arrays(self) -> dict[str, Array]:
        """Everything as arrays, for a message or a checkpoint."""
        own = {name: getattr(self, name) for name in ('size', 'limit_a', 'share', 'support', 'interval_s')}
        named = {**self.weights.arrays(), **own}
        return {f'{PREFIX}{name}': np.asarray(value, dtype=float) for name, value in named.items()}

    @classmethod
    def of(cls, arrays: Mapping[str, Any]) -> Correction | None:
        """Take the correction out of others; None where there is none."""
        if f'{PREFIX}share' not in arrays:
            return None
        own = {name.removeprefix(PREFIX): value for name, value in arrays.items() if name.startswith(PREFIX)}
        limit_a, share, interval_s = (float(own[name]) for name in ('limit_a', 'share', 'interval_s'))
        return cls(Weights.of(own), own['size'], limit_a, share, own['support'], interval_s)

    def instants_s(self, horizon_s: float) -> Array:
        """Return when it is asked on the way through a horizon: at its own pace, at most ASKED times, and at the end.

        What it says follows from the last samples, so of a longer way the beginning is left out.
        """
        covered_s = min(horizon_s, ASKED * self.interval_s)
        count = max(1, round(covered_s / self.interval_s))
        before_end: Array = np.arange(count, dtype=float)[::-1]
        return horizon_s - covered_s / count * before_end


def cells(signal: Array) -> Any:
    """Cells of the map that signals in units of their size fall into."""
    return np.clip((signal + REACH) * (BINS / (2.0 * REACH)), 0, BINS - 1).astype(int)


class ResidualForecaster:
    """Streams the correction over the samples of a group of motors.

    Args:
        white_box: the physics.
        motors: number of motors.
    """

    def __init__(self, white_box: WhiteBox, motors: int) -> None:
        self._white_box = white_box
        self._motors = motors
        self._memory: Memory | None = None
        self.correction: Correction | None = None
        self._square_nm2 = np.zeros(motors)

    @property
    def speaks(self) -> bool:
        """Whether anything was learnt that helps."""
        return self.correction is not None and self.correction.share > 0.0

    def correct(self, question: Question, torque_nm: Array) -> tuple[Array | None, Memory | None]:
        """Return the correction of a forecast torque in N m, shape (motor,), and what has to be remembered with it.

        None where nothing was learnt, or nothing that helps.
        """
        learnt = self.correction
        if learnt is None or not self.speaks or self._memory is None:
            return None, None
        known = np.isfinite(torque_nm)
        current: Array = self._white_box.state(np.where(known, torque_nm, 0.0))
        steady = np.broadcast_to(question.way.steady_a, current.shape)
        inputs = learnt.inputs(question.voltage_v, current, steady, question.speed_rad_s)
        readout, memory = step(learnt.weights, self._memory, inputs)
        correction = self._white_box.output(learnt.current(readout, current, question.voltage_v))
        return np.where(known, correction, 0.0), memory

    def along(self, question: Question, path_nm: Array, memory: Memory | None) -> Array:
        """Return the correction at the end of a way through a held voltage in N m, shape (motor,); changes nothing.

        Args:
            question: what is held.
            path_nm: shape (motor, instant): what the physics forecasts at :meth:`Correction.instants_s`.
            memory: what was remembered before; None: after the last sample.
        """
        learnt, memory = self.correction, memory or self._memory
        if learnt is None or memory is None:
            return np.zeros(self._motors)
        current = self._white_box.state(np.nan_to_num(path_nm))
        steady = np.broadcast_to(question.way.steady_a, self._motors)
        held = (np.asarray(signal)[:, None] for signal in (question.voltage_v, steady, question.speed_rad_s))
        voltage_v, steady_a, speed_rad_s = held
        inputs = learnt.inputs(voltage_v, current, steady_a, speed_rad_s)
        for k in range(inputs.shape[1]):
            readout, memory = step(learnt.weights, memory, inputs[:, k])
        return self._white_box.output(learnt.current(readout, current[:, -1], question.voltage_v))

    def remember(self, correction_nm: Array, anew: Mask, memory: Memory | None) -> None:
        """Go on to the next sample, with a blank memory where the signal history starts."""
        memory = self._memory if memory is None else memory  # a history begins without a forecast
        if memory is not None:
            self._memory = memory.cleared(anew)
        added = np.nan_to_num(correction_nm)
        self._square_nm2 += 0.002 * (added * added - self._square_nm2)

    @property
    def size_nm(self) -> Array:
        """Root mean square of the correction over the last few hundred samples in N m, shape (motor,)."""
        size: Array = np.sqrt(self._square_nm2)
        return size

    def adopt(self, arrays: Mapping[str, Any]) -> None:
        """Let a newly learnt correction run, where there is one."""
        found = Correction.of(arrays)
        if found is not None:
            self.correction = found
            self._memory = self._memory or Memory.blank(self._motors, found.weights.hidden)
