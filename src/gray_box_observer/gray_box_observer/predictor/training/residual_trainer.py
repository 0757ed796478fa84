"""Learning the residual from recorded samples, and finding out how much of it is real.

The linear part is learnt at once, in closed form; the network, round by round, what it leaves. The
samples fall into blocks in time; every fourth block teaches nothing and judges. The correction is
used as far as it makes these blocks better, and not at all unless it makes them better by more than
chance would.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from gray_box_observer.predictor import lag_features
from gray_box_observer.predictor.linear_part import LinearPart, features
from gray_box_observer.predictor.network import Memory, Weights, step
from gray_box_observer.predictor.residual_model import BINS, INPUTS, WARM, ResidualModel, cells
from gray_box_observer.predictor.significance import PARTS, is_significant
from gray_box_observer.predictor.training import random_state
from gray_box_observer.predictor.training.histories import History
from gray_box_observer.predictor.training.physics_batches import free_run, steady_currents
from gray_box_observer.settings.device import CPU
from gray_box_observer.white_box.interface import Array

if TYPE_CHECKING:  # torch is imported when there is something to learn, not before
    from gray_box_observer.predictor.training.trainable_residual import TrainableResidual

HIDDEN = 8
LIMIT = 1.0
"""Largest correction, as a fraction of the size of the measured current: of the predicted one it
could not be, for what the physics lacks most (a rotor that runs up, where no speed is measured) is
what it predicts least of. Where the physics misses by more than all there is, of the size of what
it misses."""

OWN_LIMIT = 5.0
"""And as a multiple of the residual's own root mean square: the network's answers are of order one.
"""

OUTGROWN = 1.5
"""Growth of any size after which the network is taught anew in units of the new ones."""

FEWEST = 400
"""Samples below which nothing is learnt."""

SMALL = 1e-3
"""Residuals below this fraction of the current's spread are left to themselves."""

SHORTEST = 24
"""Samples of a signal history, at least, that tell anything."""

LAGS = 16
STRUCTURE = 64.0
"""Portmanteau statistic (Ljung and Box 1978) of LAGS lags that white noise passes once in ten
million times."""

BLOCK = 64
"""Samples of a block in time."""

EVERY = 4
"""One block in so many judges."""

STEPS = 150
"""Training steps of a round."""


@dataclass(frozen=True, slots=True, eq=False)
class _Run:
    """Signal histories in a row with what the physics says of them; arrays of (motor, time).

    ``number``, ``anew``, ``is_cut`` and ``is_warm`` have shape (time,): which sample it is, counted
    since the beginning, where a history begins, where it goes on from samples that are lost, and
    whether what is said of it counts: it does not while the memory fills that streams full.
    """

    number: NDArray[np.int64]
    anew: NDArray[np.bool_]
    is_cut: NDArray[np.bool_]
    is_warm: NDArray[np.bool_]
    interval_s: Array
    voltage_v: Array
    speed_rad_s: Array
    current_a: Array
    predicted_a: Array
    steady_a: Array
    residual_a: Array


@dataclass(frozen=True, slots=True, eq=False)
class PhysicsRun:
    """What the physics says along one signal history; arrays of (motor, time).

    Attributes:
        predicted_a: current at the end of every interval, run freely.
        steady_a: current that the voltage leads to.
        speed_rad_s: speed held over the interval; zero where none is known.
    """

    predicted_a: Array
    steady_a: Array
    speed_rad_s: Array


class ResidualTrainer:
    """Holds the correction under training.

    Args:
        seed: of everything random.
        device: torch's, on which the network is taught.
    """

    def __init__(self, seed: int, device: str = CPU) -> None:
        self._random = np.random.default_rng([seed, 5])
        self._seed = seed
        self._device = device
        self._trainable: TrainableResidual | None = None
        self._sizes: tuple[Array, float] | None = None
        self._best: list[ResidualModel] = []

    def learn(
        self, weights: Weights, histories: Sequence[History], steps: int = STEPS
    ) -> dict[str, Any]:
        """Run one round beside the network that knows the physics; see :meth:`learn_beside`.

        Args:
            weights: of that network.
            histories: of the motor.
            steps: training steps.
        """
        return self.learn_beside(partial(_network_run, weights), histories, steps)

    def learn_beside(
        self,
        physics: Callable[[History], PhysicsRun | None],
        histories: Sequence[History],
        steps: int = STEPS,
    ) -> dict[str, Any]:
        """Run one round.

        Args:
            physics: runs freely through a history; None: it cannot.
            histories: signal histories; the numbers of their samples settle for good which of them
                judge.
            steps: training steps.

        Returns:
            The correction's arrays; empty where there is too little to tell.

        Raises:
            ImportError: there is something to learn, and no torch to learn it with.
        """
        long_histories = [history for history in histories if history.number.size >= SHORTEST]
        if sum(history.number.size for history in long_histories) < FEWEST:
            return {}
        run = _against_physics(physics, long_histories)
        if run is None:
            return {}
        if self._trainable is None and not worth_learning(
            run.residual_a[:, run.is_warm], run.predicted_a[:, run.is_warm]
        ):
            return {}
        taught_model = self._teach(run, steps)
        weights = taught_model.weights
        silent = replace(
            weights,
            output=np.zeros_like(weights.output),
            output_bias=np.zeros_like(weights.output_bias),
        )
        linear_alone = replace(taught_model, weights=silent)
        judgements = [
            _judge(candidate, run) for candidate in (linear_alone, taught_model, *self._best)
        ]
        self._best = [min(judgements, key=lambda pair: pair[1])[0]]
        return self._best[0].arrays()

    def state(self) -> dict[str, Array]:
        """Everything that the next round depends on, as arrays."""
        state: dict[str, Array] = {'random': random_state.pack(self._random)}
        if self._trainable is not None and self._sizes is not None:
            state |= {'size': self._sizes[0], 'limit_a': np.array(self._sizes[1])}
            state |= {f'pupil_{name}': array for name, array in self._trainable.state().items()}
        for best in self._best:
            state |= {f'best_{name}': array for name, array in best.arrays().items()}
        return state

    def restore(self, arrays: dict[str, Array]) -> None:
        """Take back what :meth:`state` gave."""
        self._random = random_state.unpack(arrays['random'])
        if 'size' in arrays:
            from gray_box_observer.predictor.training.trainable_residual import TrainableResidual

            self._sizes = arrays['size'].copy(), float(arrays['limit_a'])
            self._trainable = TrainableResidual(INPUTS, HIDDEN, self._seed, self._device)
            self._trainable.restore(
                {name[6:]: array for name, array in arrays.items() if name.startswith('pupil_')}
            )
        best = ResidualModel.from_arrays(
            {name[5:]: array for name, array in arrays.items() if name.startswith('best_')}
        )
        self._best = [] if best is None else [best]

    def _teach(self, run: _Run, steps: int) -> ResidualModel:
        """Teach on all blocks but the judging ones."""
        from gray_box_observer.predictor.training.trainable_residual import TrainableResidual

        now = _sizes(run)
        if self._trainable is None or self._sizes is None or _outgrown(self._sizes, now):
            self._trainable = TrainableResidual(INPUTS, HIDDEN, self._seed, self._device)
            self._sizes = now
        size, limit_a = self._sizes
        pace_s = float(np.median(run.interval_s))
        support = np.zeros((BINS, BINS))
        blank = ResidualModel(
            self._trainable.weights, LinearPart.silent(), size, limit_a, 1.0, support, pace_s
        )
        is_training = ~judging(run.number) & run.is_warm
        at = (
            cells(run.predicted_a / size[1])[:, is_training],
            cells(run.voltage_v / size[0])[:, is_training],
        )
        np.add.at(support, at, 1.0)
        columns = _features(run, pace_s)
        targets = run.residual_a / limit_a
        linear = LinearPart.learn(columns[:, is_training], targets[:, is_training])
        inputs = blank.inputs(run.voltage_v, run.predicted_a, run.steady_a, run.speed_rad_s)
        self._trainable.learn(
            self._random, inputs, targets - linear.say(columns), is_training, run.anew, steps
        )
        return replace(blank, weights=self._trainable.weights, linear=linear)


def _sizes(run: _Run) -> tuple[Array, float]:
    """Sizes of voltage, current and speed, and the largest correction in A."""
    signals = run.voltage_v, run.predicted_a, run.speed_rad_s, run.current_a, run.residual_a
    volt, ampere, speed, measured_a, missed_a = (
        max(float(np.quantile(np.abs(signal), 0.95)), 1e-9) for signal in signals
    )
    limit_a = min(
        LIMIT * max(measured_a, missed_a), OWN_LIMIT * float(np.sqrt(np.mean(run.residual_a**2)))
    )
    return np.array([volt, ampere, speed]), max(limit_a, 1e-9)


def _outgrown(old: tuple[Array, float], new: tuple[Array, float]) -> bool:
    """Whether samples since are of another size, as after a first step after a long rest."""
    return bool(np.any(new[0] > OUTGROWN * old[0]) or new[1] > OUTGROWN * old[1])


def _judge(correction: ResidualModel, run: _Run) -> tuple[ResidualModel, float]:
    """Return the correction with the share that judging blocks support, and its error."""
    output = _outputs(replace(correction, share=1.0), run)
    judges = judging(run.number) & run.is_warm
    residual = run.residual_a[:, judges]
    output = output[:, judges]
    share = float(
        np.clip(np.sum(residual * output) / max(float(np.sum(output**2)), 1e-300), 0.0, 1.0)
    )
    before, after = np.abs(residual), np.abs(residual - share * output)
    had, gains = (
        np.array([p.mean() for p in np.array_split(a, PARTS, axis=1)])
        for a in (before, before - after)
    )
    real = is_significant(had, gains)
    return replace(correction, share=share if real else 0.0), float(
        (after if real else before).mean()
    )


def worth_learning(residual: Array, predicted_a: Array) -> bool:
    """Whether residuals are large and correlated in time, as voltage and motion cause them.

    Args:
        residual: shape (motor, time).
        predicted_a: shape (motor, time): what they are small against.
    """
    if np.all(residual.std(axis=1) < SMALL * predicted_a.std(axis=1)):
        return False
    deviation = residual - residual.mean(axis=1, keepdims=True)
    n = residual.shape[1]
    power = np.sum(deviation**2, axis=1)
    statistic = np.zeros(residual.shape[0])
    for lag in range(1, LAGS + 1):
        correlation = np.sum(deviation[:, lag:] * deviation[:, :-lag], axis=1) / np.maximum(
            power, 1e-300
        )
        statistic += n * (n + 2.0) * correlation**2 / (n - lag)
    return bool(np.any(statistic > STRUCTURE))


def judging(number: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Which samples judge, shape (time,), by their number; none ever judges and teaches."""
    judges: NDArray[np.bool_] = (number // BLOCK) % EVERY == EVERY - 1
    return judges


def _network_run(weights: Weights, history: History) -> PhysicsRun:
    """Let the network that knows the physics run freely through a history."""
    sequences = history.sequences
    predicted_a, _ = free_run(weights, sequences)
    speed = np.nan_to_num(sequences.speed_rad_s)
    return PhysicsRun(predicted_a, steady_currents(sequences), speed)


def _against_physics(
    physics: Callable[[History], PhysicsRun | None], histories: Sequence[History]
) -> _Run | None:
    """Put histories in a row, with what the physics says of them; None where it says nothing."""
    parts = []
    for history in histories:
        physics_run = physics(history)
        if physics_run is None:
            continue
        sequences = history.sequences
        current_a = history.current_a
        number = history.number
        anew = number == number[0]
        is_cut = anew & history.is_cut
        is_warm = (number >= number[0] + WARM) if history.is_cut else np.ones_like(anew)
        signals = (
            sequences.interval_s,
            sequences.voltage_v,
            physics_run.speed_rad_s,
            current_a,
            physics_run.predicted_a,
            physics_run.steady_a,
            current_a - physics_run.predicted_a,
        )
        parts.append((number, anew, is_cut, is_warm, *signals))
    if not parts:
        return None
    return _Run(*(np.concatenate(signal, axis=-1) for signal in zip(*parts, strict=True)))


def _features(run: _Run, pace_s: float) -> Array:
    """What the linear part sees along the histories, shape (motor, time, FEATURES)."""
    first = np.flatnonzero(run.anew)
    parts = []
    for begin, end in pairwise([*first.tolist(), run.anew.size]):
        voltage_v, speed, interval_s = (
            x[:, begin:end] for x in (run.voltage_v, run.speed_rad_s, run.interval_s)
        )
        start = (
            lag_features.presumed(voltage_v, speed)
            if run.is_cut[begin]
            else lag_features.blank(voltage_v.shape[0])
        )
        parts.append(lag_features.along(voltage_v, speed, interval_s / pace_s, start))
    traces = np.concatenate(parts, axis=1)
    return features(run.voltage_v, run.predicted_a, run.steady_a, run.speed_rad_s, traces)


def _outputs(correction: ResidualModel, run: _Run) -> Array:
    """What a correction says along the histories, by the code that streams, shape (motor, time)."""
    inputs = correction.inputs(run.voltage_v, run.predicted_a, run.steady_a, run.speed_rad_s)
    memory = Memory.blank(inputs.shape[0], correction.weights.hidden)
    readout = np.empty_like(run.voltage_v)
    for k in range(inputs.shape[1]):
        memory = memory.cleared(np.full(inputs.shape[0], run.anew[k]))
        readout[:, k], memory = step(correction.weights, memory, inputs[:, k])
    return correction.current(readout, _features(run, correction.interval_s))
