"""The physics as a teacher: the white box along the network's prediction (thesis 4.2.4).

Measured torque has no part in it.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from gray_box_observer.predictor.network import Memory, Weights, step
from gray_box_observer.predictor.steady_state import (
    Course,
    Relaxation,
    after,
    course,
    flow,
    relaxation,
)
from gray_box_observer.predictor.training.synthetic_sequences import Sequences
from gray_box_observer.white_box.interface import Array

EXACT = 0.1
"""Step of the flow that is taught, see :data:`relaxation.FLOW_STEP`."""


@dataclass(frozen=True, slots=True, eq=False)
class TrainingBatch:
    """Intervals along the network's own prediction, each with where the white box would have gone.

    Attributes:
        inputs: shape (sequence, time, input).
        intervals: fields of shape (sequence, time), the distance in units of the sequence's spread.
        targets: shape (sequence, time): exact change of the current, in units of the sequence's
            spread.
    """

    inputs: Array
    intervals: Relaxation
    targets: Array

    @classmethod
    def concatenate(cls, parts: list[TrainingBatch]) -> TrainingBatch:
        """Return the sequences of several lessons of equal length as one."""
        intervals = Relaxation(
            **{
                f.name: np.concatenate([getattr(p.intervals, f.name) for p in parts])
                for f in fields(Relaxation)
            }
        )
        inputs, targets = (
            np.concatenate([getattr(p, name) for p in parts]) for name in ('inputs', 'targets')
        )
        return cls(inputs, intervals, targets)


def free_run(weights: Weights, sequences: Sequences) -> tuple[Array, list[Relaxation]]:
    """Let the network predict every sequence from its voltages alone, by the code that streams.

    Returns:
        Predicted currents at the ends, shape (sequence, time), and each interval's dimensionless
        form.
    """
    way = _courses(sequences)
    state = sequences.start_a
    memory = Memory.blank(sequences.start_a.size, weights.hidden)
    predicted_a = np.empty_like(sequences.voltage_v)
    intervals = []
    for k in range(predicted_a.shape[1]):
        interval = relaxation(
            np, sequences.white_box, _at(way, k), state, sequences.interval_s[:, k]
        )
        readout, memory = step(weights, memory, np.stack(interval.inputs(np), axis=-1))
        state = predicted_a[:, k] = after(np, interval, readout)
        intervals.append(interval)
    return predicted_a, intervals


def exact_run(sequences: Sequences) -> Array:
    """Currents of the white box itself at the ends of the intervals, shape (sequence, time)."""
    way = _courses(sequences)
    state = sequences.start_a
    exact = np.empty_like(sequences.voltage_v)
    for k in range(exact.shape[1]):
        at = _at(way, k)
        state = exact[:, k] = flow(
            np, sequences.white_box, at, state, sequences.interval_s[:, k], EXACT
        )
    return exact


def spread(sequences: Sequences, current_a: Array) -> Array:
    """Spread of the current that the voltages ask for, in A, (sequence,): the scale of errors."""
    levels = np.concatenate(
        [sequences.start_a[:, None], current_a, _courses(sequences).steady_a], axis=1
    )
    size: Array = levels.std(axis=1) + 1e-3 * np.abs(levels).mean(axis=1) + 1e-30
    return size


def free_run_error(weights: Weights, sequences: Sequences, exact_a: Array) -> float:
    """Mean error of the free run in units of each sequence's spread."""
    error = np.abs(free_run(weights, sequences)[0] - exact_a).mean(axis=1)
    return float(np.mean(error / spread(sequences, exact_a)))


def training_batch(weights: Weights, sequences: Sequences) -> TrainingBatch:
    """Run the network freely; ask the white box where each interval should have ended."""
    predicted_a, parts = free_run(weights, sequences)
    size = spread(sequences, predicted_a)[:, None]
    intervals = Relaxation(
        **{f.name: np.stack([getattr(p, f.name) for p in parts], 1) for f in fields(Relaxation)}
    )
    end = flow(
        np, sequences.white_box, _courses(sequences), intervals.state, sequences.interval_s, EXACT
    )
    targets = (end - intervals.state) / size
    inputs = np.stack(intervals.inputs(np), axis=-1)
    scaled_intervals = Relaxation(
        **{
            f.name: getattr(intervals, f.name) / (size if f.name in ('state', 'distance') else 1.0)
            for f in fields(Relaxation)
        }
    )
    return TrainingBatch(inputs, scaled_intervals, targets)


def steady_currents(sequences: Sequences) -> Array:
    """Currents in A at which the voltage balances, shape (sequence, time)."""
    steady: Array = _courses(sequences).steady_a
    return steady


def _courses(sequences: Sequences) -> Course:
    """Where every interval leads; fields are (sequence, time), parameters (sequence, 1)."""
    theta = [column[:, None] for column in sequences.columns]
    guess = np.zeros_like(sequences.voltage_v)
    return course(np, sequences.white_box, theta, sequences.voltage_v, sequences.speed_rad_s, guess)


def _at(way: Course, k: int) -> Course:
    theta = [column[:, 0] for column in way.theta]
    return Course(theta, *(signal[:, k] for signal in way.signals))
