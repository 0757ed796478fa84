"""The thesis's network in streaming: torque from voltages and context nodes (thesis 4.3)."""

from __future__ import annotations

from typing import Any

import numpy as np

from gray_box_observer.errors import ConfigurationError
from gray_box_observer.predictor.forecaster import ForecastRequest
from gray_box_observer.predictor.network import (
    Mask,
    Memory,
    Weights,
    check_weights,
    has_weights,
    step,
)
from gray_box_observer.predictor.network_inputs import InputLayout
from gray_box_observer.predictor.normalisation import Normalisation, saved_ranges
from gray_box_observer.predictor.predictor_settings import TrainingSettings
from gray_box_observer.white_box.interface import Array


class WindowForecaster:
    """See `forecaster.Forecaster`. Silent until trained and warm.

    Args:
        motors: number of motors.
        layout: what the network is shown.
        rules: settings.
    """

    def __init__(self, motors: int, layout: InputLayout, rules: TrainingSettings) -> None:
        self._motors = motors
        self._layout = layout
        self._rules = rules
        self._weights: Weights | None = None
        self._normalisation: Normalisation | None = None
        self._memory: Memory | None = None
        self._warm = np.zeros(motors, dtype=int)

    def forecast(self, request: ForecastRequest) -> tuple[Array, Memory | None]:
        """Run the network one sample on."""
        if self._weights is None or self._normalisation is None or self._memory is None:
            return np.full(self._motors, np.nan), None
        columns = self._layout.columns(
            self._normalisation, request.voltage_v, request.speed_rad_s, request.theta
        )
        output, memory = step(self._weights, self._memory, np.stack(columns, axis=-1))
        torque = self._normalisation.torque.denormalise(output)
        return np.where(self._warm >= self._rules.context, torque, np.nan), memory

    def remember(
        self,
        torque_nm: Array,
        measured_nm: Array,
        anew: Mask,
        memory: Memory | None,
        present: Mask | None = None,
    ) -> None:
        """Keep the memory, or warm up again; this network's motors are sampled together."""
        if memory is not None:
            self._memory = memory.cleared(anew)
        elif self._memory is not None:
            self._memory = self._memory.cleared(anew)
        self._warm = np.where(anew, 0, self._warm + 1)

    def adopt(self, result: dict[str, Any]) -> None:
        """Let a trained network run, with the ranges it was trained by."""
        self._weights = Weights.from_arrays(result)
        self._normalisation = Normalisation.from_dict(result['ranges'])
        if self._memory is None:
            self._begin(self._weights)

    def state(self) -> dict[str, Array]:
        """The network and its ranges."""
        if self._weights is None or self._normalisation is None:
            return {}
        ranges = {
            f'range_{name}': np.array(bounds)
            for name, bounds in self._normalisation.to_dict().items()
        }
        return {**self._weights.arrays(), **ranges}

    def restore(self, arrays: dict[str, Array]) -> None:
        """Take back the network and its ranges, if there were any."""
        has_ranges = any(name.startswith('range_') for name in arrays)
        if not has_weights(arrays) and not has_ranges:
            return
        if not has_ranges:
            raise ConfigurationError(
                'the checkpoint holds a network without its ranges, expected one of the thesis: it '
                'is damaged, or of variant physics (see variant)'
            )
        check_weights(arrays)
        weights = Weights.from_arrays(arrays, self._rules.hidden, self._layout.width)
        ranges = saved_ranges(arrays, 'range_', speed=self._layout.sees_speed)
        self._weights = weights
        self._normalisation = Normalisation.from_dict(ranges)
        self._begin(self._weights)

    def start(self) -> dict[str, Any]:
        """The network and its ranges, for a job."""
        if self._weights is None or self._normalisation is None:
            return {}
        arrays = {f'start_{name}': array for name, array in self._weights.arrays().items()}
        return {**arrays, 'start_ranges': self._normalisation.to_dict()}

    def _begin(self, weights: Weights) -> None:
        self._memory = Memory.blank(self._motors, weights.hidden)
        self._warm = np.zeros(self._motors, dtype=int)
