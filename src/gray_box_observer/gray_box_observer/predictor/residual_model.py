"""What the physics does not know: a bounded correction of the torque, learnt from data.

Cogging, brushes, friction and a rotor that follows leave a residual that no choice of the
parameters explains. A linear part learns it from voltage, speed, their traces and the current that
the physics predicts; a second small LSTM learns what that leaves. The correction is bounded, it
fades where no samples were seen, and as much of it is used as samples that did not teach it have
borne out: with perfect physics none.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from gray_box_observer.predictor import lag_features
from gray_box_observer.predictor.elementwise import Axis
from gray_box_observer.predictor.forecaster import ForecastRequest
from gray_box_observer.predictor.linear_part import BENDS, FEATURES, LinearPart, features
from gray_box_observer.predictor.network import Mask, Memory, Weights, check_weights, step
from gray_box_observer.safe_io.saved_state import ArrayRule, check_arrays, positive
from gray_box_observer.samples.replay_buffer import LONGEST_INTERVAL_S
from gray_box_observer.white_box.interface import Array, WhiteBox

INPUTS = 4
"""Of the network: voltage, predicted current, the current where it is going, speed; each in units
of its size."""

_SIZE_OF = [0, 1, 1, 2]

BINS = 12
"""Cells a side of the map of where samples were seen."""

REACH = 1.5
"""Edge of that map, in units of the signals' sizes."""

FEW = 5.0
"""Samples in a cell at which half of what the network says is used there."""

WARM = 64
"""Samples that fill the network's memory, whatever it held before: what it says counts behind them.
"""

ASKED = 32
"""Times, at most, that it is asked on the way to a forecast: there is time for it at a thousand
samples a second."""

SIZE_MEMORY = 500.0
"""Samples over which the size of what is said is followed, for diagnostics."""

PREFIX = 'residual_'

SHORTEST_S = 1e-12
"""Time between two samples that a correction was learnt at: stamps are whole nanoseconds."""


@dataclass(frozen=True, slots=True, eq=False)
class ResidualModel:
    """A learnt correction.

    Attributes:
        weights: the network.
        linear: the linear part.
        size: shape (3,): sizes of voltage in V, current in A and speed in rad/s.
        limit_a: largest correction, as a current in A.
        share: how much of it is used, 0 to 1.
        support: shape (BINS, BINS): samples seen, by predicted current and voltage.
        interval_s: from sample to sample where it was learnt, in s: the pace at which its memory
            moves.
    """

    weights: Weights
    linear: LinearPart
    size: Array
    limit_a: float
    share: float
    support: Array
    interval_s: float

    def inputs(
        self, voltage_v: Array, current_a: Array, steady_a: Array, speed_rad_s: Array
    ) -> Array:
        """The network's input: the current's shape with a last axis INPUTS; bounded."""
        columns = np.empty((*current_a.shape, INPUTS))
        for k, column in enumerate((voltage_v, current_a, steady_a, speed_rad_s)):
            columns[..., k] = column
        columns /= self.size[_SIZE_OF]
        inputs: Array = np.minimum(
            np.maximum(columns, -3.0), 3.0
        )  # np.clip takes four times as long for one motor
        return inputs

    def current(self, readout: Array, inputs: Array) -> Array:
        """Return the correction in A: bounded, and faded where few samples were seen.

        Args:
            readout: of the network.
            inputs: what it was said of, see
                :func:`~gray_box_observer.predictor.linear_part.features`.
        """
        at = cells(inputs[..., :2] / self.size[:2])
        samples = self.support[at[..., 1], at[..., 0]]
        output = self.linear.say(inputs) + np.tanh(readout) * samples / (samples + FEW)
        correction: Array = self.share * self.limit_a * np.minimum(np.maximum(output, -1.0), 1.0)
        return correction

    @property
    def weight_count(self) -> int:
        """How many numbers were learnt: weights of the network and of the linear part."""
        return sum(
            array.size
            for array in (*self.weights.arrays().values(), self.linear.weight, self.linear.bent)
        )

    def arrays(self) -> dict[str, Array]:
        """Everything as arrays, for a message or a checkpoint."""
        own = {
            name: getattr(self, name)
            for name in ('size', 'limit_a', 'share', 'support', 'interval_s')
        }
        linear = {
            f'linear_{name}': getattr(self.linear, name) for name in LinearPart.__dataclass_fields__
        }
        arrays = {**self.weights.arrays(), **linear, **own}
        return {f'{PREFIX}{name}': np.asarray(value, dtype=float) for name, value in arrays.items()}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, Any]) -> ResidualModel | None:
        """Take the correction out of others; None where there is none."""
        if f'{PREFIX}share' not in arrays:
            return None
        own = {
            name.removeprefix(PREFIX): value
            for name, value in arrays.items()
            if name.startswith(PREFIX)
        }
        limit_a, share, interval_s = (
            float(own[name]) for name in ('limit_a', 'share', 'interval_s')
        )
        linear = LinearPart(
            **{name[7:]: array for name, array in own.items() if name.startswith('linear_')}
        )
        return cls(
            Weights.from_arrays(own),
            linear,
            own['size'],
            limit_a,
            share,
            own['support'],
            interval_s,
        )

    def instants_s(self, horizon_s: float) -> Array:
        """Return when to ask it in a horizon: at its own pace, ASKED times at most, at the end.

        What it says follows from the last samples, so of a longer way the beginning is left out.
        """
        covered_s = min(horizon_s, ASKED * self.interval_s)
        count = max(1, round(covered_s / self.interval_s))
        before_end: Array = np.arange(count, dtype=float)[::-1]
        return horizon_s - covered_s / count * before_end


def check_correction(arrays: Mapping[str, Any], prefix: str = '') -> None:
    """Refuse saved arrays that are no correction; it need not be there.

    Args:
        arrays: its arrays among others.
        prefix: that their names begin with, before PREFIX.

    Raises:
        CheckpointError: it is none.
    """
    own = f'{prefix}{PREFIX}'
    if not any(name.startswith(own) for name in arrays):
        return
    check_weights(arrays, INPUTS, own)
    magnitude = ArrayRule((FEATURES,), 0.0, endless=True)
    rules = {
        'linear_weight': ArrayRule((FEATURES,)),
        'linear_reach': magnitude,
        'linear_bent': ArrayRule((BENDS.size,)),
        'linear_bend_v': ArrayRule((BENDS.size,), 0.0),
        'size': positive(3),
        'limit_a': ArrayRule((), 0.0),
        'share': ArrayRule((), 0.0, 1.0),
        'support': ArrayRule((BINS, BINS), 0.0),
        'interval_s': ArrayRule((), SHORTEST_S, LONGEST_INTERVAL_S),
    }
    check_arrays(arrays, rules, own)


def cells(signal: Array) -> Any:
    """Cells of the map that signals in units of their size fall into."""
    return np.minimum(np.maximum((signal + REACH) * (BINS / (2.0 * REACH)), 0), BINS - 1).astype(
        int
    )


@dataclass(frozen=True, slots=True, eq=False)
class Recollection:
    """What a correction remembers: the network's memory, and the traces of the signals."""

    network: Memory
    traces: Array

    @classmethod
    def blank(cls, motors: int, hidden: int) -> Recollection:
        """Return that of motors at rest."""
        return cls(Memory.blank(motors, hidden), lag_features.blank(motors))

    def cleared(self, motors: Mask) -> Recollection:
        """Return it, blank for the motors that a mask of shape (motor,) marks."""
        return Recollection(self.network.cleared(motors), lag_features.cleared(self.traces, motors))


class ResidualForecaster:
    """Streams the correction over the samples of a group of motors.

    Args:
        white_box: the physics.
        motors: number of motors.
    """

    def __init__(self, white_box: WhiteBox, motors: int) -> None:
        self._white_box = white_box
        self._motors = motors
        self._axis = Axis(motors)
        self._memory: Recollection | None = None
        self.correction: ResidualModel | None = None
        self._square_nm2 = np.zeros(motors)

    @property
    def is_active(self) -> bool:
        """Whether anything was learnt that helps."""
        return self.correction is not None and self.correction.share > 0.0

    def correct(
        self, request: ForecastRequest, torque_nm: Array
    ) -> tuple[Array | None, Recollection | None]:
        """Return the correction of a forecast in N m, shape (motor,), and the memory it leaves.

        None where nothing was learnt, or nothing that helps.
        """
        model = self.correction
        memory = self._memory
        if model is None or not self.is_active or memory is None:
            return None, None
        is_known = np.isfinite(torque_nm)
        current: Array = self._white_box.state(np.where(is_known, torque_nm, 0.0))
        steady = self._axis.to_array(request.way.steady_a)
        signals = request.voltage_v, current, steady, request.speed_rad_s
        readout, network = step(model.weights, memory.network, model.inputs(*signals))
        traces = self._traces_at_end(request, memory, model)
        correction = self._white_box.output(model.current(readout, features(*signals, traces)))
        return np.where(is_known, correction, 0.0), Recollection(network, traces)

    def along(self, request: ForecastRequest, path_nm: Array, memory: Recollection | None) -> Array:
        """Return the correction after a held voltage in N m, shape (motor,); changes nothing.

        Args:
            request: what is held, and how long.
            path_nm: shape (motor, instant): what the physics forecasts at
                :meth:`Correction.instants_s`.
            memory: what was remembered before; None: after the last sample.
        """
        model = self.correction
        memory = memory or self._memory
        if model is None or memory is None:
            return np.zeros(self._motors)
        current = self._white_box.state(np.nan_to_num(path_nm))
        steady = self._axis.to_array(request.way.steady_a)
        signals = (
            np.asarray(signal)[:, None]
            for signal in (request.voltage_v, steady, request.speed_rad_s)
        )
        voltage_v, steady_a, speed_rad_s = signals
        inputs = model.inputs(voltage_v, current, steady_a, speed_rad_s)
        network = memory.network
        for k in range(inputs.shape[1]):
            readout, network = step(model.weights, network, inputs[:, k])
        end = request.voltage_v, current[:, -1], steady, request.speed_rad_s
        columns = features(*end, self._traces_at_end(request, memory, model))
        return self._white_box.output(model.current(readout, columns))

    def _traces_at_end(
        self, request: ForecastRequest, memory: Recollection, model: ResidualModel
    ) -> Array:
        """Traces at the end of an interval."""
        intervals = request.interval_s / model.interval_s
        return lag_features.advance(
            memory.traces, request.voltage_v, request.speed_rad_s, intervals
        )

    def remember(
        self, correction_nm: Array | None, anew: Mask, memory: Recollection | None
    ) -> None:
        """Go on to the next sample, blank at the start of a history; None: nothing was added."""
        memory = self._memory if memory is None else memory  # a history begins without a forecast
        if memory is not None:
            self._memory = memory.cleared(anew)
        if correction_nm is None and not self._square_nm2.any():
            return
        correction = (
            np.zeros(self._motors) if correction_nm is None else np.nan_to_num(correction_nm)
        )
        self._square_nm2 += (correction * correction - self._square_nm2) / SIZE_MEMORY

    @property
    def size_nm(self) -> Array:
        """RMS of the correction over about the last SIZE_MEMORY samples in N m, (motor,)."""
        size: Array = np.sqrt(self._square_nm2)
        return size

    def adopt(self, arrays: Mapping[str, Any], newest: Mapping[str, Array] | None = None) -> None:
        """Let a newly learnt correction run, where there is one.

        Args:
            arrays: the correction among others.
            newest: samples of the signal history that goes on, see
                :func:`~gray_box_observer.predictor.training.residual_schedule.newest`: while
                nothing was said, nothing was traced, and what the network remembered is long past.
                None: a history begins.
        """
        model = ResidualModel.from_arrays(arrays)
        if model is None:
            return
        blank = Recollection.blank(self._motors, model.weights.hidden)
        before = self._memory if self.is_active and self._memory is not None else blank
        traces = blank.traces if newest is None else _traced(newest, model.interval_s)
        self.correction = model
        self._memory = Recollection(before.network, traces)


def _traced(newest: Mapping[str, Array], pace_s: float) -> Array:
    """Return the traces after samples, since the newest of them that begins a history."""
    interval_s = newest['interval_s']
    speed = np.nan_to_num(newest['speed_rad_s'])
    begins = np.flatnonzero(np.any(interval_s <= 0.0, axis=0))
    first = (
        int(begins[-1]) if begins.size else 0
    )  # no interval that is known leads to it, but its speed is held next
    voltage_v = newest['voltage_v'][:, first + 1 :]
    intervals = interval_s[:, first + 1 :] / pace_s
    return lag_features.ending(voltage_v, speed[:, first:-1], intervals)
