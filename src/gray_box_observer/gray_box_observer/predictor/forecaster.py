"""The contract of the two kinds of network behind the predictor."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

from gray_box_observer.predictor.network import Mask, Memory
from gray_box_observer.predictor.steady_state import Course
from gray_box_observer.white_box.interface import Array


@dataclass(frozen=True, slots=True, eq=False)
class ForecastRequest:
    """One interval whose end is asked for.

    Attributes:
        interval_s, voltage_v, speed_rad_s: shape (motor,): its length, and what is held over it.
        theta: shape (motor, parameter).
        way: where it leads, in the form that :class:`~gray_box_observer.predictor.elementwise.Axis`
            gives signals.
        usable: whether the interval goes on from a known start, in the same form.
        origin: forecast torque, shape (motor,), and memory to go on from; None: those of the last
            sample. Only variant ``physics`` looks so far ahead.
    """

    interval_s: Array
    voltage_v: Array
    speed_rad_s: Array
    theta: Array
    way: Course
    usable: Any
    origin: tuple[Array, Memory] | None = None


class RunningNetwork(Protocol):
    """A network that runs and may be replaced by a better one."""

    def adopt(self, result: dict[str, Any]) -> None:
        """Let a trained network run."""

    def state(self) -> dict[str, Array]:
        """The network as arrays, for a checkpoint or a trainer; empty before there is one."""

    def restore(self, arrays: dict[str, Array]) -> None:
        """Take back what :meth:`state` gave.

        Raises:
            ConfigurationError: a network of another kind or size.
        """

    def start(self) -> dict[str, Any]:
        """What a trainer's job carries where training shall go on from this network."""


class Forecaster(RunningNetwork, Protocol):
    """Streams one network over the samples of a group of motors."""

    def forecast(self, request: ForecastRequest) -> tuple[Array, Memory | None]:
        """Return the torque at the end of an interval, (motor,), NaN: unknown; changes nothing.

        The memory is what :meth:`remember` takes if the sample comes.
        """

    def remember(
        self,
        torque_nm: Array,
        measured_nm: Array,
        anew: Mask,
        memory: Memory | None,
        present: Mask | None = None,
    ) -> None:
        """Go on to the next sample.

        Args:
            torque_nm: shape (motor,): what was forecast of this one.
            measured_nm: shape (motor,): what it was.
            anew: shape (motor,): whether the signal history starts with it.
            memory: what came with the forecast.
            present: shape (motor,): who was sampled; the others stay where they are. None: all.
        """
