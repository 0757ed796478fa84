"""How far the estimates of one motor are believed after the test of its fit."""

from __future__ import annotations

import math
from collections.abc import Collection
from functools import partial

from gray_box_observer.context_nodes.estimate import (
    COUNTS_AS_KNOWN,
    Verdict,
    misfit,
    unsettled,
)
from gray_box_observer.context_nodes.native.widened_estimate import WidenedEstimate
from gray_box_observer.context_nodes.update_rule import ContextUpdate
from gray_box_observer.fit_test.assessment import FitVerdict
from gray_box_observer.fit_test.fit_result import FitResult
from gray_box_observer.fit_test.policy import Judgement
from gray_box_observer.white_box.interface import Array, Parameter

Verdicts = tuple[Verdict, ...]


class EstimateLimit:
    """Limits the estimates of one motor.

    Args:
        parameters: of the motor.
        result: of its newest test; None: it was never tested, and nothing of it is identified.
        open_parameters: which are not to be identified, though all fits.
        without_test: what follows without a test, of samples that no test can be made of.

    Attributes:
        widens: whether covariances grow.
        is_open: whether all is believed as the rule gives it.
    """

    def __init__(
        self,
        parameters: tuple[Parameter, ...],
        result: FitResult | None,
        *,
        open_parameters: Collection[str] = (),
        without_test: Judgement | None = None,
    ) -> None:
        self._parameters = parameters
        names = [parameter.name for parameter in parameters]
        self._is_open = [result is None or name in open_parameters for name in names]
        self._is_misfit = result is not None and result.assessment.verdict is FitVerdict.MISFIT
        self._judgement: Judgement | None = None
        judgement = without_test if result is None else result.judgement
        if judgement is not None and judgement.widens:
            self._judgement = judgement
            self._native = WidenedEstimate(
                parameters,
                judgement.factor,
                judgement.factors,
                judgement.spread,
                judgement.furthest,
            )
        self.widens = self._judgement is not None
        self.is_open = not (any(self._is_open) or self._is_misfit or self.widens)
        self._last: tuple[tuple[Verdicts, Verdicts], Verdicts] = ((), ()), ()

    def apply(
        self, nodes: ContextUpdate, motor: int, value: Array, covariance: Array, verdicts: Verdicts
    ) -> Verdicts:
        """Widen a covariance in place; return what is left of the verdicts.

        Args:
            nodes: the rule that has learnt the motor.
            motor: its place on the motor axis.
            value: shape (parameter,): its estimate.
            covariance: shape (parameter, parameter): as the rule gives it.
            verdicts: likewise.
        """
        if self._judgement is not None:
            if self._native.is_compiled:
                rules = nodes.verdict_rules
                shares = partial(nodes.voltage_shares, motor)
                judged_verdicts = self._native.widen(value, covariance, rules, shares)
            else:
                judged_verdicts = self._widen(self._judgement, nodes, motor, value, covariance)
            if Verdict.FROZEN not in verdicts:
                verdicts = self._no_better(judged_verdicts, verdicts)
        if self._is_misfit:
            return tuple(map(misfit, verdicts))
        pairs = zip(verdicts, self._is_open, strict=True)
        return tuple(unsettled(verdict) if is_open else verdict for verdict, is_open in pairs)

    def _widen(
        self, judgement: Judgement, nodes: ContextUpdate, motor: int, value: Array,
        covariance: Array,
    ) -> Verdicts:  # fmt: skip
        """Widen a covariance in place; return the verdicts on the values, in plain numbers."""
        values = value.tolist()
        rows = judgement.widened(values, covariance.tolist())
        variances = [row[place] for place, row in enumerate(rows)]
        stds = [math.sqrt(x) if x >= 0.0 else math.nan for x in variances]
        share, reach = nodes.voltage_shares(motor)
        most = judgement.largest_shares(values, share.tolist(), reach.tolist())
        covariance[:] = rows
        return nodes.verdict_rules.judge_motor(self._parameters, values, stds, most)

    def _no_better(self, judged_verdicts: Verdicts, verdicts: Verdicts) -> Verdicts:
        """Return verdicts that wider deviations have left, where the rule knows as much.

        They are mostly those of the estimate before.
        """
        both, remainder = self._last
        if both != (judged_verdicts, verdicts):
            remainder = tuple(
                verdict if of_the_rule in COUNTS_AS_KNOWN else unsettled(verdict)
                for verdict, of_the_rule in zip(judged_verdicts, verdicts, strict=True)
            )
            self._last = (judged_verdicts, verdicts), remainder
        return remainder
