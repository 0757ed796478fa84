"""Functions that steady state and alarm need for floats; numpy and torch share the names.

A single motor streams in plain floats: an array of one costs ten times as much an operation.
"""

from __future__ import annotations

import math
import operator
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gray_box_observer.white_box.interface import Array, WhiteBox
from gray_box_observer.white_box.motor import MotorWhiteBox


class Floats:
    """Functions of one number, under numpy's names."""

    exp = staticmethod(math.exp)
    expm1 = staticmethod(math.expm1)
    log = staticmethod(math.log)
    log1p = staticmethod(math.log1p)
    sqrt = staticmethod(math.sqrt)
    tanh = staticmethod(math.tanh)
    isfinite = staticmethod(math.isfinite)
    maximum = staticmethod(max)
    minimum = staticmethod(min)
    max = staticmethod(float)
    all = staticmethod(bool)
    any = staticmethod(bool)
    logical_not = staticmethod(operator.not_)

    @staticmethod
    def where(condition: bool, then: Any, otherwise: Any) -> Any:
        """Choose; both were worked out, as with arrays."""
        return then if condition else otherwise

    @staticmethod
    def clip(value: float, low: float, high: float) -> float:
        """Bound."""
        return low if value < low else min(value, high)


class Axis:
    """The motor axis inside the predictor: one motor is plain floats, several are arrays.

    Args:
        motors: number of motors.
        device: torch's, on which several are computed; None: by numpy.

    Attributes:
        motors: as given.
        single: whether it is one.
        arrays: the functions to use of whole arrays: numpy, or
            :class:`~gray_box_observer.white_box.torch_ops.TorchOps`.
        ops: those to use of signals: the same, or :class:`Floats`.
    """

    def __init__(self, motors: int, device: str | None = None) -> None:
        self.motors = motors
        self.single = motors == 1
        self.arrays: Any = np
        self._on_device = device is not None and not self.single
        if self._on_device:
            from gray_box_observer.white_box.torch_ops import TorchOps

            self.arrays = TorchOps(str(device))
        self.ops: Any = Floats if self.single else self.arrays

    def to_operand(self, signal: NDArray[Any]) -> Any:
        """Turn shape (motor,) into what is computed with."""
        return signal[0].item() if self.single else self.array(signal)

    def array(self, values: Any) -> Any:
        """Turn an array of any shape into one that :attr:`arrays` knows."""
        return self.arrays.taken(values) if self._on_device else values

    def white_box(self, white_box: WhiteBox) -> WhiteBox:
        """Return the physics with constants that are computed with alike."""
        if not self._on_device or not isinstance(white_box, MotorWhiteBox):
            return white_box
        constants = white_box.torque_constant, *white_box.known.values()
        torque_constant, *known_values = (
            self.array(np.broadcast_to(constant, self.motors)) for constant in constants
        )
        return replace(
            white_box,
            torque_constant=torque_constant,
            known=dict(zip(white_box.known, known_values, strict=True)),
        )

    def to_array(self, value: Any) -> NDArray[Any]:
        """Turn it back into shape (motor,)."""
        if self._on_device:
            array: NDArray[Any] = value.cpu().numpy()
            return array
        return np.array([value]) if self.single else value

    def columns(self, theta: Array) -> list[Any]:
        """Turn shape (motor, parameter) into one entry a parameter."""
        return theta[0].tolist() if self.single else list(self.array(theta).T)

    def same(self, a: Any, b: Any) -> bool:
        """Tell whether two signals, or lists of them, are equal throughout."""
        return bool(a == b) if self.single else bool(self.arrays.array_equal(a, b))
