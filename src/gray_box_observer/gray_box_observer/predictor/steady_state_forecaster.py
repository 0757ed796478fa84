"""Variant ``physics`` in streaming: the network leads a current towards its steady state."""

from __future__ import annotations

from typing import Any

import numpy as np

from gray_box_observer.errors import ConfigurationError
from gray_box_observer.predictor.elementwise import Axis
from gray_box_observer.predictor.forecaster import ForecastRequest
from gray_box_observer.predictor.network import (
    Mask,
    Memory,
    Weights,
    advance,
    check_weights,
    has_weights,
    step,
)
from gray_box_observer.predictor.steady_state import INPUTS, Course, after, relaxation
from gray_box_observer.white_box.interface import Array, WhiteBox


class RelaxingForecaster:
    """See `forecaster.Forecaster`. Useful from the second sample of a history on.

    Args:
        white_box: the physics.
        motors: number of motors.
        weights: the network to begin with.
        device: torch's, on which it runs; None: by numpy.
    """

    def __init__(
        self, white_box: WhiteBox, motors: int, weights: Weights, device: str | None = None
    ) -> None:
        self._axis = Axis(motors, device)
        self._white_box = self._axis.white_box(white_box)
        self._run(weights)
        self._memory = self._blank()
        self._current = self._axis.to_operand(np.full(motors, np.nan))

    def forecast(self, request: ForecastRequest) -> tuple[Array, Memory | None]:
        """Let the current relax over the interval, in one step however long it is."""
        axis = self._axis
        ops = self._axis.ops
        current, memory = self._origin(request)
        start = ops.where(request.usable, current, 0.0)
        interval_s = ops.where(request.usable, axis.to_operand(request.interval_s), 0.0)
        interval = relaxation(ops, self._white_box, request.way, start, interval_s)
        columns = interval.inputs(ops)
        inputs = np.array([columns]) if axis.single else ops.stack(columns).T
        readout, memory = advance(axis.arrays, self._matrices, memory, inputs)
        end = after(ops, interval, axis.to_operand(readout))
        torque_nm = self._white_box.output(ops.where(request.usable, end, np.nan))
        return axis.to_array(torque_nm), memory

    def path(self, request: ForecastRequest, instants_s: Array) -> Array:
        """Forecast torques along a held voltage, each in one step from the motor's state.

        Args:
            request: what is held; the length of its interval is left aside.
            instants_s: shape (instant,): time since the start.

        Returns:
            Shape (motor, instant), in N m; NaN where the request cannot be answered.
        """
        current, memory = self._origin(request)
        motors = memory.hidden.shape[0]
        count = instants_s.size
        usable = np.reshape(request.usable, (motors, 1))
        way = request.way
        if not self._axis.single:
            theta = [column[:, None] for column in way.theta]
            way = Course(theta, *(signal[:, None] for signal in way.signals))
        start = np.broadcast_to(
            np.where(usable, np.reshape(current, (motors, 1)), 0.0), (motors, count)
        )
        interval = relaxation(np, self._white_box, way, start, instants_s)
        inputs = np.stack(interval.inputs(np), axis=-1).reshape(motors * count, INPUTS)
        repeated_memory = Memory(
            np.repeat(memory.hidden, count, axis=0), np.repeat(memory.cell, count, axis=0)
        )
        readout, _ = step(self._weights, repeated_memory, inputs)
        end = after(np, interval, readout.reshape(motors, count))
        return self._white_box.output(np.where(usable, end, np.nan))

    def _origin(self, request: ForecastRequest) -> tuple[Any, Memory]:
        """Current and memory at the start of the interval."""
        if request.origin is None:
            return self._current, self._memory
        torque_nm, memory = request.origin
        return self._white_box.state(self._axis.to_operand(torque_nm)), memory

    def remember(
        self,
        torque_nm: Array,
        measured_nm: Array,
        anew: Mask,
        memory: Memory | None,
        present: Mask | None = None,
    ) -> None:
        """Go on from the forecast; from the measured torque where a history begins."""
        axis = self._axis
        begins = anew | ~np.isfinite(torque_nm)
        before = self._memory, self._current
        self._memory = self._memory if memory is None else memory
        if begins.any():
            torque_nm = np.where(begins, measured_nm, torque_nm)
            self._memory = self._memory.cleared(axis.array(begins), axis.arrays)
        self._current = self._white_box.state(axis.to_operand(torque_nm))
        if present is not None:
            present = axis.array(present)
            self._memory = self._memory.where(present, before[0], axis.arrays)
            self._current = axis.arrays.where(present, self._current, before[1])

    def adopt(self, result: dict[str, Any]) -> None:
        """Let a better network run from here on."""
        self._run(Weights.from_arrays(result))

    def _run(self, weights: Weights) -> None:
        self._weights = weights
        self._matrices = [self._axis.array(matrix) for matrix in weights.matrices]

    def _blank(self) -> Memory:
        blank = Memory.blank(self._axis.motors, self._weights.hidden)
        return Memory(self._axis.array(blank.hidden), self._axis.array(blank.cell))

    def state(self) -> dict[str, Array]:
        """The network."""
        return self._weights.arrays()

    def restore(self, arrays: dict[str, Array]) -> None:
        """Take back the network, if there was one."""
        if any(name.startswith('range_') for name in arrays):
            raise ConfigurationError(
                'the checkpoint holds a network of the thesis, expected variant physics: see '
                'variant'
            )
        if not has_weights(arrays):
            return
        check_weights(arrays)
        self._run(Weights.from_arrays(arrays, self._weights.hidden, INPUTS))
        self._memory = self._blank()

    def start(self) -> dict[str, Any]:
        """The network, for a job."""
        return {f'start_{name}': array for name, array in self._weights.arrays().items()}
