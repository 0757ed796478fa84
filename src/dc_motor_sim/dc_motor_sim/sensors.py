"""Torque and speed sensors: noise, quantisation and range between truth and publication."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from dc_motor_sim.errors import SensorError
from dc_motor_sim.quantity import about, check_fields
from dc_motor_sim.random_streams import Purpose, WhiteNoise
from dc_motor_sim.solver import FloatArray


@dataclass(frozen=True, slots=True, kw_only=True)
class SensorParameters:
    """Imperfections of the sensors, the same for all motors; every default means a perfect sensor.

    Raises:
        SensorError: A value is not a finite number or out of its bounds.
    """

    torque_noise_std: float = field(
        default=0.0, metadata=about('standard deviation of the white torque noise', 'N m', 0.0, 1e6)
    )
    torque_offset: float = field(
        default=0.0, metadata=about('what the torque sensor reads too high', 'N m', -1e6, 1e6)
    )
    torque_quantisation: float = field(
        default=0.0, metadata=about('resolution of the torque sensor; 0 for none', 'N m', 0.0, 1e6)
    )
    torque_limit: float = field(
        default=0.0,
        metadata=about(
            'the torque sensor saturates at plus and minus this; 0 for never', 'N m', 0.0, 1e6
        ),
    )
    speed_noise_std: float = field(
        default=0.0,
        metadata=about('standard deviation of the white speed noise', 'rad/s', 0.0, 1e6),
    )
    speed_quantisation: float = field(
        default=0.0, metadata=about('resolution of the speed sensor; 0 for none', 'rad/s', 0.0, 1e6)
    )

    def __post_init__(self) -> None:
        check_fields(self, SensorError)


class Sensors:
    """Measures one sample after the other; each motor has noise streams of its own.

    Args:
        parameters: What is imperfect.
        torque_noise_std: Standard deviation of the torque noise of each motor in N m, in place of
            the one in `parameters`; shape (motor,).
        seed: Seed of the simulation.
    """

    def __init__(
        self, parameters: SensorParameters, torque_noise_std: FloatArray, seed: int
    ) -> None:
        self._parameters = parameters
        speed_noise_std = np.full(len(torque_noise_std), parameters.speed_noise_std)
        self._torque_noise = WhiteNoise(seed, Purpose.TORQUE_NOISE, torque_noise_std)
        self._speed_noise = WhiteNoise(seed, Purpose.SPEED_NOISE, speed_noise_std)

    def measure(
        self, torque_nm: FloatArray, speed_rad_s: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return measured torque in N m and speed in rad/s of the next sample, shape (motor,) each.

        Offset and noise come first, then the resolution, then the range, as in a real converter.
        """
        analogue_nm = torque_nm + self._parameters.torque_offset + self._torque_noise.next()
        torque = _round(analogue_nm, self._parameters.torque_quantisation)
        if self._parameters.torque_limit > 0.0:
            torque = np.clip(torque, -self._parameters.torque_limit, self._parameters.torque_limit)
        speed = _round(speed_rad_s + self._speed_noise.next(), self._parameters.speed_quantisation)
        return torque, speed


def _round(values: FloatArray, quantum: float) -> FloatArray:
    return np.round(values / quantum) * quantum if quantum > 0.0 else values
