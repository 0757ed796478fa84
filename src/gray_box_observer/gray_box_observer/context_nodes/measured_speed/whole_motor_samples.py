"""A window's samples with the speed of the whole motor in place of the measured one."""

from __future__ import annotations

from gray_box_observer.context_nodes.measured_speed.output_fit import OutputFit
from gray_box_observer.samples.replay_buffer import SPEED, ReplayBuffer
from gray_box_observer.white_box.declaration import State
from gray_box_observer.white_box.interface import Array


def with_motor_speed(samples: Array, fit: OutputFit) -> Array:
    """Return samples with the speed that their fit gives, free of noise and lag.

    Args:
        samples: shape (signal, n): those of the fit.
        fit: of current and speed.

    Returns:
        Shape (signal, n); a history too short to be fitted keeps its measured speed.
    """
    result = samples.copy()
    for history, path in zip(fit.window.histories, fit.fit.runs.runs, strict=True):
        speed = path.states[:, State.SPEED]
        result[SPEED, history.place : history.place + speed.size] = speed
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
