"""A window's samples as the whole motor has them: its speed, and its current free of a lag."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gray_box_observer.context_nodes.measured_speed.output_fit import OutputFit
from gray_box_observer.context_nodes.recursive.trajectory import (
    SampleWindow,
    input_reach,
    linearise,
)
from gray_box_observer.context_nodes.rotor.window import History
from gray_box_observer.samples.replay_buffer import SPEED, TORQUE, VOLTAGE, ReplayBuffer
from gray_box_observer.white_box.declaration import State
from gray_box_observer.white_box.flow import to_coordinates
from gray_box_observer.white_box.interface import Array
from gray_box_observer.white_box.motor import MotorWhiteBox

NOTICEABLE = 0.3
"""Share of the current's noise from which it counts that a speed bends between two samples."""


def as_of_motor(white_box: MotorWhiteBox, samples: Array, fit: OutputFit) -> Array:
    """Return samples with the speed that their fit gives, and a current that does not lag.

    The current keeps, of its noise, what is new at every sample: what the filter's memory brings is
    taken off. The speed is free of what noise of the voltage does to the run. It is straight
    between two samples for who reads them, and bends in the fit.
    A voltage that moves between them counts as its mean. So the voltage contains what takes the
    current the same way. A history too short to be fitted keeps its readings.

    Args:
        white_box: physics whose speed is a signal.
        samples: shape (signal, n): those of the fit.
        fit: of current and speed.

    Returns:
        Shape (signal, n).
    """
    result = samples.copy()
    runs = fit.fit.runs
    begin = 0
    residual_a = runs.of_output(State.CURRENT)
    is_lagging = fit.window.unknowns.current_sensor is not None
    for row, (history, path) in enumerate(zip(fit.window.histories, runs.runs, strict=True)):
        places = slice(history.place, history.place + history.current_a.size)
        result[SPEED, places] = path.states[:, State.SPEED]
        intervals = slice(places.start + 1, places.stop)
        most_v = _largest_bend(white_box, history, path.states)
        bend_v = _bend_v(white_box, result[:, places], path.states, fit)
        result[VOLTAGE, intervals] += np.clip(bend_v, -most_v, most_v)
        result[SPEED, places] = runs.probable_speed(row)
        if is_lagging:
            noise_a = residual_a[begin : begin + history.current_a.size]
            result[TORQUE, places] = runs.torque_constant * (
                path.states[:, State.CURRENT] + noise_a
            )
        begin += history.current_a.size
    return result


def _bend_v(white_box: MotorWhiteBox, samples: Array, states: Array, fit: OutputFit) -> Array:
    """Return what to add to the voltage so that its mean and a straight speed do as the run does.

    Args:
        white_box: physics whose speed is a signal.
        samples: shape (signal, k + 1): a history, with the speed of the whole motor.
        states: shape (k + 1, state): how that runs.
        fit: which gives the values.

    Returns:
        Shape (k,), in V; nothing where it would move the current by less than a part of its noise.
    """
    current_a = states[None, :, State.CURRENT]
    theta = fit.fit.theta[None, : len(white_box.context_nodes)]
    stretch = replace(SampleWindow.of_content(white_box, samples[:, None]), state=current_a)
    maps = linearise(white_box, to_coordinates(theta), stretch, current_a)
    missed_a = current_a[:, 1:] - maps.offset - maps.decay * current_a[:, :-1]
    if not np.abs(missed_a).max(initial=0.0) > NOTICEABLE * fit.fit.noise_a:
        return np.zeros(missed_a.size)
    with np.errstate(all='ignore'):
        bend_v = missed_a * theta[0, 0] / input_reach(stretch.interval_s, maps.decay)
    return np.asarray(np.nan_to_num(bend_v[0]))


def _largest_bend(white_box: MotorWhiteBox, history: History, states: Array) -> Array:
    """Return the most that may be added to the voltage of an interval, shape (k,), in V.

    No speed bends by more than it changes, and no voltage differs from its mean by more than it
    moves.
    """
    most_v = float(white_box.known['back_emf_constant']) * np.abs(np.diff(states[:, State.SPEED]))
    if history.parts is None:
        return np.asarray(most_v)
    return np.asarray(most_v + history.parts.range_v)


def remembering(samples: Array, place: int, begin: int) -> ReplayBuffer:
    """Return a buffer that remembers samples of one motor, the last of them at a place.

    Args:
        samples: shape (signal, n).
        place: of the last one in the motor's stream.
        begin: place before the oldest sample that counts.
    """
    count = samples.shape[1]
    buffer = ReplayBuffer(1, count, with_moves=True)
    buffer.refill(samples[:, None], dropped_count=place - count, begin=max(begin, place - count))
    return buffer
