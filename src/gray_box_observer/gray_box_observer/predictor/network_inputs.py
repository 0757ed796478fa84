"""Inputs of the network at every step: voltage, measured speed if any, and context nodes."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import Any

import numpy as np

from gray_box_observer.predictor.normalisation import Normalisation
from gray_box_observer.white_box.interface import Array


class Variant(str, Enum):
    """Stage 2: what the LSTM is trained on: the thesis's four (5.1) and their descendants.

    ``physics`` takes the idea of ``main``, that measured torque is not needed, to its end: the
    network says how the identified motor relaxes (:mod:`steady_state`), and is taught on drawn
    sequences of whole families of motors.
    """

    PHYSICS = 'physics'
    MAIN = 'main'
    SEES_DATA = 'sees_data'
    SUPERVISED_WITH_PARAMETERS = 'supervised_with_parameters'
    SUPERVISED = 'supervised'

    @property
    def sees_theta(self) -> bool:
        """Whether the context nodes are inputs of the network."""
        return self is not Variant.SUPERVISED


@dataclass(frozen=True, slots=True, eq=False)
class InputLayout:
    """Columns of the network's input: voltage, speed where measured, then theta.

    Attributes:
        theta_reference: shape (parameter,): theta enters as ``log(theta / reference)``, so it is
            dimensionless.
        sees_theta: whether theta enters at all.
        sees_speed: whether measured speed enters.
    """

    theta_reference: Array
    sees_theta: bool
    sees_speed: bool

    @property
    def width(self) -> int:
        """Number of columns."""
        return 1 + int(self.sees_speed) + (self.theta_reference.size if self.sees_theta else 0)

    def columns(
        self, normalisation: Normalisation, voltage_v: Any, speed_rad_s: Any, theta: Array
    ) -> list[Any]:
        """Return the columns, each of the shape of the voltage or broadcastable to it.

        Args:
            normalisation: ranges.
            voltage_v: shape (motor,) or (motor, time).
            speed_rad_s: same shape; ignored where speed is not seen.
            theta: shape (motor, parameter).
        """
        columns = [normalisation.voltage.normalise(voltage_v)]
        if self.sees_speed and normalisation.speed is not None:
            columns.append(normalisation.speed.normalise(speed_rad_s))
        if self.sees_theta:
            ratio = np.log(theta / self.theta_reference)
            columns += [ratio[:, j] for j in range(self.theta_reference.size)]
        return columns
