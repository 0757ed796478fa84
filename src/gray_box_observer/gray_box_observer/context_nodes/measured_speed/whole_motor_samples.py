"""A window's samples as the whole motor has them: its speed, and its current free of a lag."""

from __future__ import annotations

from gray_box_observer.context_nodes.measured_speed.output_fit import OutputFit
from gray_box_observer.samples.replay_buffer import SPEED, TORQUE, ReplayBuffer
from gray_box_observer.white_box.declaration import State
from gray_box_observer.white_box.interface import Array


def as_of_motor(samples: Array, fit: OutputFit) -> Array:
    """Return samples with the speed that their fit gives, and a current that does not lag.

    The current keeps, of its noise, what is new at every sample: what the filter's memory brings is
    taken off. A history too short to be fitted keeps both readings.

    Args:
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
    for history, path in zip(fit.window.histories, runs.runs, strict=True):
        places = slice(history.place, history.place + history.current_a.size)
        result[SPEED, places] = path.states[:, State.SPEED]
        if is_lagging:
            noise_a = residual_a[begin : begin + history.current_a.size]
            result[TORQUE, places] = runs.torque_constant * (
                path.states[:, State.CURRENT] + noise_a
            )
        begin += history.current_a.size
    return result


def remembering(samples: Array, place: int, begin: int) -> ReplayBuffer:
    """Return a buffer that remembers samples of one motor, the last of them at a place.

    Args:
        samples: shape (signal, n).
        place: of the last one in the motor's stream.
        begin: place before the oldest sample that counts.
    """
    count = samples.shape[1]
    buffer = ReplayBuffer(1, count)
    buffer.refill(samples[:, None], dropped_count=place - count, begin=max(begin, place - count))
    return buffer
