"""Regular estimates by compiled code, `regular_estimate.c`; fallback: :mod:`estimate`.

An estimate is regular where no parameter is known so vaguely that the spread of its logarithm is
not that of its value. After the first seconds all are, and controllers wait for them.
"""

from __future__ import annotations

import ctypes

import numpy as np
from numpy.typing import NDArray

from gray_box_observer.context_nodes.estimate import (
    LOG_NORMAL,
    Verdict,
    VerdictSettings,
    verdicts_of,
)
from gray_box_observer.context_nodes.native import compiled
from gray_box_observer.context_nodes.native.compiled import address
from gray_box_observer.context_nodes.native.verdict_rules import VerdictRules
from gray_box_observer.context_nodes.recursive.belief import Belief
from gray_box_observer.white_box.interface import Array, Parameter

MOST_PARAMETERS = 5
"""Room in `regular_estimate.c`."""

_COUNT = ctypes.c_int64
_POINTER = ctypes.c_void_p


class _Believed(ctypes.Structure):
    """``Believed`` of `regular_estimate.c`."""

    _fields_ = (
        ('parameters', _COUNT),
        ('rules', VerdictRules),
        ('log_normal', ctypes.c_double),
        *((name, _POINTER) for name in ('p', 'covariance', 'noise', 'share', 'reach')),
    )


class RegularEstimates:
    """Works out values, covariance and verdicts.

    Args:
        parameters: of every motor.
        motors: how many.
    """

    def __init__(self, parameters: tuple[Parameter, ...], motors: int) -> None:
        n = len(parameters)
        # it keeps the interpreter lock, which takes longer to get back than this takes
        self._library = (
            None
            if n > MOST_PARAMETERS
            else compiled.library('believed_size', _Believed, ctypes.PyDLL)
        )
        if self._library is None:
            return
        self._library.tell_estimates.argtypes = (_POINTER, _POINTER, _COUNT, *3 * (_POINTER,))
        self._library.tell_estimates.restype = _COUNT
        rules = VerdictRules.between_bounds(parameters)
        self._belief_pointers = _Believed(n, rules, LOG_NORMAL)
        self._about = ctypes.byref(self._belief_pointers)
        self._places = np.empty(motors, dtype=np.int64)
        self._results = (
            np.empty((motors, n)),
            np.empty((motors, n, n)),
            np.empty((motors, n), dtype=np.uint8),
        )
        self._at = address(self._places), tuple(address(array) for array in self._results)
        self._belief: Belief | None = None
        self._rules: VerdictSettings | None = None
        self._shares: tuple[Array | None, Array | None] = (None, None)

    def estimate(
        self,
        belief: Belief,
        motors: NDArray[np.int64] | None,
        rules: VerdictSettings,
        share: Array | None = None,
        reach: Array | None = None,
    ) -> tuple[Array, Array, tuple[tuple[Verdict, ...], ...]] | None:  # fmt: skip
        """Return values, shape (place, parameter), covariances and verdicts of some motors.

        None where one of them is not regular, or where there is no compiled code.

        Args:
            belief: of all motors.
            motors: places of those that are meant; None: all.
            rules: when a parameter counts as identified.
            share: shape (motor, parameter), of all motors: of the voltage, that one unit takes;
                None: nobody knows.
            reach: likewise, what may come on top of that.
        """
        if (
            self._library is None
            or not self._point(belief, rules)
            or not self._point_shares(share, reach)
        ):
            return None
        places, results = self._at
        if motors is None:
            count = self._places.size
            where = None
        else:
            count = motors.size
            where = places
            self._places[:count] = motors
        if not self._library.tell_estimates(self._about, where, count, *results):
            return None
        value, covariance, codes = self._results
        if motors is not None:
            value = value[:count]
            covariance = covariance[:count]
            codes = codes[:count]
        return value.copy(), covariance.copy(), verdicts_of(codes)

    def _point_shares(self, share: Array | None, reach: Array | None) -> bool:
        """Let the compiled code read these; tell whether it can."""
        if share is self._shares[0] and reach is self._shares[1]:
            return True
        if share is None or reach is None:
            self._belief_pointers.share = self._belief_pointers.reach = None
        elif share.flags.c_contiguous and reach.flags.c_contiguous:
            self._belief_pointers.share = address(share)
            self._belief_pointers.reach = address(reach)
        else:
            return False
        self._shares = share, reach
        return True

    def _point(self, belief: Belief, rules: VerdictSettings) -> bool:
        """Let the compiled code read this belief; tell whether it can."""
        if rules is not self._rules:
            self._belief_pointers.rules.follow(rules)
            self._rules = rules
        if belief is not self._belief:
            arrays = belief.p, belief.covariance, belief.noise
            if not all(array.flags.c_contiguous for array in arrays):
                return False
            (
                self._belief_pointers.p,
                self._belief_pointers.covariance,
                self._belief_pointers.noise,
            ) = (address(a) for a in arrays)
            self._belief = belief
        return True
