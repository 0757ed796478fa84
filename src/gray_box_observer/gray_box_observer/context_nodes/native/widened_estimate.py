"""Widened estimates by compiled code, `widened_estimate.c`.

Fallback: :mod:`~gray_box_observer.fit_test.estimate_limit`. A motor that was tested has its
deviations widened with every estimate, and controllers wait for that.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from functools import cache

import numpy as np

from gray_box_observer.context_nodes.estimate import Verdict, VerdictSettings, verdicts_of
from gray_box_observer.context_nodes.native import compiled
from gray_box_observer.context_nodes.native.verdict_rules import MOST_JUDGED, VerdictRules
from gray_box_observer.white_box.interface import Array, Parameter

_NUMBERS = ctypes.c_double * MOST_JUDGED
_SQUARE = ctypes.c_double * MOST_JUDGED**2
_IDENTIFIED = tuple(Verdict).index(Verdict.IDENTIFIED)


class _Widening(ctypes.Structure):
    """``Widening`` of `widened_estimate.c`."""

    _fields_ = (
        ('parameters', ctypes.c_int64),
        ('rules', VerdictRules),
        ('factors', _SQUARE),
        ('spread', _SQUARE),
        ('factor', _NUMBERS),
        *((name, _NUMBERS) for name in ('furthest', 'value', 'share', 'reach')),
        ('covariance', _SQUARE),
        ('verdicts', ctypes.c_uint8 * MOST_JUDGED),
    )


@cache
def library() -> ctypes.CDLL | None:
    """Load the compiled code, once, for every test asks for it; None if absent."""
    # it keeps the interpreter lock, which takes longer to get back than this takes
    handle = compiled.library('widening_size', _Widening, ctypes.PyDLL)
    if handle is None:
        return None
    for function in (handle.widen_estimate, handle.judge_widened):
        function.argtypes = (ctypes.c_void_p,)
        function.restype = None
    return handle


class WidenedEstimate:
    """Widens estimates of one motor by what a test of its fit has left.

    Args:
        parameters: of the motor.
        factor: shape (parameter,): by which standard deviations grow.
        factors: shape (parameter, parameter): by which covariances grow, by that alone.
        spread: shape (parameter, parameter): covariance of the logarithms that comes on top.
        furthest: shape (parameter,): times its value that a parameter may be, by that alone.
    """

    def __init__(
        self,
        parameters: tuple[Parameter, ...],
        factor: Array,
        factors: Array,
        spread: Array,
        furthest: Array,
    ) -> None:
        n = len(parameters)
        handle = library() if n <= MOST_JUDGED else None
        self.is_compiled = handle is not None
        if handle is None:
            return
        self._widen = handle.widen_estimate
        self._judge = handle.judge_widened
        structure = self._structure = _Widening(
            n,
            VerdictRules.between_bounds(parameters),
            tuple(factors.ravel().tolist()),
            tuple(spread.ravel().tolist()),
            tuple(factor.tolist()),
            tuple(furthest.tolist()),
        )
        self._about = ctypes.byref(structure)
        names = ('value', 'share', 'reach')
        self._value, self._share, self._reach = (
            np.ctypeslib.as_array(getattr(structure, name))[:n] for name in names
        )
        covariance = np.ctypeslib.as_array(structure.covariance)
        self._covariance = covariance[: n * n].reshape(n, n)
        self._codes = np.ctypeslib.as_array(structure.verdicts)[None, :n]
        self._all_identified = bytes([_IDENTIFIED] * n)
        self._last: tuple[bytes, tuple[Verdict, ...]] = b'', ()
        self._rules: VerdictSettings | None = None

    def widen(
        self,
        value: Array,
        covariance: Array,
        rules: VerdictSettings,
        shares: Callable[[], tuple[Array, Array]],
    ) -> tuple[Verdict, ...]:
        """Widen a covariance in place; return the verdicts on the values.

        Args:
            value: shape (parameter,).
            covariance: shape (parameter, parameter).
            rules: when a parameter counts as identified.
            shares: returns what is asked only where some parameter is not identified: shape
                (parameter,) each, of the voltage, that one unit takes, and what may come on top.
        """
        if rules is not self._rules:
            self._structure.rules.follow(rules)
            self._rules = rules
        self._value[:] = value
        self._covariance[:] = covariance
        self._widen(self._about)
        covariance[:] = self._covariance
        codes = self._codes.tobytes()
        if codes != self._all_identified:
            self._share[:], self._reach[:] = shares()
            self._judge(self._about)
            codes = self._codes.tobytes()
        if codes != self._last[0]:
            self._last = codes, verdicts_of(self._codes)[0]
        return self._last[1]
