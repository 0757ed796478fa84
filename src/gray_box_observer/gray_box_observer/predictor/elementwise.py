"""The few functions that relaxation and alarm need, for plain floats; numpy and torch offer the same names for arrays.

A single motor streams in plain floats: an array of one costs ten times as much an operation.
"""

from __future__ import annotations

import math
import operator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gray_box_observer.white_box.base import Array


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
    """The motor axis inside the predictor: one motor becomes plain floats, several stay arrays.

    Args:
        motors: number of motors.

    Attributes:
        motors: as given.
        single: whether it is one.
        ops: the functions to use, :class:`Floats` or numpy.
    """

    def __init__(self, motors: int) -> None:
        self.motors = motors
        self.single = motors == 1
        self.ops: Any = Floats if self.single else np

    def take(self, signal: NDArray[Any]) -> Any:
        """Turn shape (motor,) into what is computed with."""
        return signal[0].item() if self.single else signal

    def give(self, value: Any) -> NDArray[Any]:
        """Turn it back into shape (motor,)."""
        return np.array([value]) if self.single else value

    def columns(self, theta: Array) -> list[Any]:
        """Turn shape (motor, parameter) into one entry a parameter."""
        return theta[0].tolist() if self.single else list(theta.T)

    def same(self, a: Any, b: Any) -> bool:
        """Tell whether two signals, or lists of them, are equal throughout."""
        return bool(a == b) if self.single else np.array_equal(a, b)
