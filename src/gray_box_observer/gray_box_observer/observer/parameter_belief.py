"""What is believed of motors' parameters: what their rule has learnt, as far as the fit allows.

What is published says more, and nothing leans on it: the parameters of a measured rotor, what is
not known of the scales, and parts that were known.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from gray_box_observer.context_nodes import (
    ContextUpdate,
    Estimate,
    MeasuredSpeedUpdate,
    published_known_parts,
)
from gray_box_observer.context_nodes.estimate import COUNTS_AS_KNOWN, Verdict
from gray_box_observer.context_nodes.pieces import Pieces
from gray_box_observer.delay import DelayEstimate
from gray_box_observer.errors import CheckpointError
from gray_box_observer.fit_test import FitVerdict
from gray_box_observer.fit_test.evidence import WINDOW
from gray_box_observer.fit_test.fit_result import FitResult
from gray_box_observer.observer.level_doubt import LevelDoubt
from gray_box_observer.observer.motor_forms.motor_form import MotorForm
from gray_box_observer.observer.speed_doubt import SpeedDoubt
from gray_box_observer.white_box.interface import Array


class ParameterBelief:
    """Holds what is believed of motors that are sampled together.

    ``theta``, ``covariance`` and ``is_identified`` are replaced, never written to: what was
    believed before may still be needed.

    Args:
        form: what the motors are observed by.

    Attributes:
        context_nodes: the rule; another one where samples are learnt anew.
        theta: shape (motor, parameter): values believed.
        covariance: shape (motor, parameter, parameter): of these.
        is_identified: shape (motor,): whether all of theta was identified, before a freeze.
        known_flags: shape (motor, published parameter): the same of every published parameter.
        mechanics: names of the published parameters of a measured rotor.
        level: doubts a voltage that has never moved; None of many motors, or without speed.
    """

    def __init__(self, form: MotorForm) -> None:
        nodes = form.context_nodes
        motors = nodes.theta.shape[0]
        parameters = (
            nodes.published_mechanics.parameters
            if isinstance(nodes, MeasuredSpeedUpdate)
            else form.white_box.parameters
        )
        electrical = len(form.white_box.parameters)
        self.context_nodes: ContextUpdate = nodes
        self.mechanics = tuple(p.name for p in parameters[electrical:])
        self.is_identified = np.zeros(motors, dtype=bool)
        self.known_flags = np.zeros((motors, len(parameters)), dtype=bool)
        self.theta: Array = nodes.theta
        self.covariance: Array = np.zeros((motors, electrical, electrical))
        self._speed = SpeedDoubt(form.white_box)
        self._fit = form.fit
        self._scales = form.scales
        self.level: LevelDoubt | None = None
        if motors == 1 and form.white_box.speed_measured:
            is_exact = bool(form.fit.configuration(0).values['stamps_exact'])
            self.level = LevelDoubt(form.white_box, stamps_exact=is_exact)
        self._known_parts = published_known_parts(nodes, form.white_box)
        self._has_known_parts = bool(self._known_parts.any())
        self._places = np.arange(motors)
        self._kept_verdicts: Any = None  # of every motor, that the flags stand for; None: not known

    def present(self, motors: Any = slice(None)) -> Estimate:
        """Return the present values of some motors, believed as far as the fit allows."""
        return self._judged(self.context_nodes.estimate(motors), motors)

    def _judged(self, estimate: Estimate, motors: Any) -> Estimate:
        return self._fit.judged(self.context_nodes, estimate, self._places[motors])

    def published(self, estimate: Estimate, motors: Any = slice(None)) -> Estimate:
        """Add a measured rotor's parameters, what is not known of the scales, and known parts.

        Args:
            estimate: what is believed of some motors.
            motors: index of these on the motor axis.
        """
        nodes = self.context_nodes
        if self.mechanics:
            assert isinstance(nodes, MeasuredSpeedUpdate)
            is_believed = self._fit.assessment(0).verdict is not FitVerdict.MISFIT
            estimate = nodes.with_mechanics(estimate, is_believed=is_believed)
        if self._scales is not None:
            rules = nodes.verdict_rules
            estimate = self._scales.widened(nodes, estimate, self._places[motors], rules)
        if self.level is not None:
            estimate = self.level.widened(estimate, nodes.verdict_rules)
        if isinstance(nodes, MeasuredSpeedUpdate) and not (
            nodes.is_noisy or self._fit.doubts_speed(0)
        ):
            estimate = self._speed.widened(nodes, estimate)
        if not self._has_known_parts:
            return estimate
        return self._signed(estimate.with_known_parts(self._known_parts), motors)

    def _signed(self, estimate: Estimate, motors: Any) -> Estimate:
        """Judge parameters of either sign by themselves, not by their distance from a bound."""
        places = np.flatnonzero(self._known_parts).tolist()
        std = estimate.std
        verdicts = [list(row) for row in estimate.verdicts]
        for row, motor in enumerate(self._places[motors].tolist()):
            electrical = self.context_nodes.voltage_shares(motor)[0]
            shares = np.pad(electrical, (0, len(estimate.parameters) - electrical.size))
            for place in places:
                if verdicts[row][place] is Verdict.IDENTIFIED:
                    verdicts[row][place] = self.context_nodes.verdict_rules.judge_signed(
                        float(estimate.value[row, place]),
                        float(std[row, place]),
                        float(shares[place]),
                    )
        return replace(estimate, verdicts=tuple(tuple(row) for row in verdicts))

    def keep(
        self, estimate: Estimate, motors: Any, *, is_frozen: bool, follows_level: bool = True
    ) -> Estimate:
        """Keep the beliefs of some motors, and whether all is identified; freezing keeps that.

        Args:
            estimate: what is believed of these.
            motors: index of these on the motor axis.
            is_frozen: whether learning is stopped.
            follows_level: whether to look if the voltage has moved; else that was restored.

        Returns:
            What is published of these.
        """
        if not is_frozen and self.level is not None and follows_level:
            is_misfit = self._fit.assessment(0).verdict is FitVerdict.MISFIT
            self.level.follow(self.context_nodes, is_misfit=is_misfit)
        public_estimate = self.published(estimate, motors)
        is_everyone = estimate.value.shape[0] == self._places.size
        verdicts = estimate.verdicts, public_estimate.verdicts
        if not (is_frozen or (is_everyone and verdicts == self._kept_verdicts)):
            flags = _known_flags(estimate)
            self._keep_flags(
                motors,
                [all(row) for row in flags],
                flags if public_estimate is estimate else _known_flags(public_estimate),
            )
            self._kept_verdicts = verdicts if is_everyone else None
        if is_everyone:
            self.theta = estimate.value
            self.covariance = estimate.covariance
        else:
            self.theta = self.theta.copy()
            self.covariance = self.covariance.copy()
            self.theta[motors] = estimate.value
            self.covariance[motors] = estimate.covariance
        return public_estimate

    def _keep_flags(self, motors: Any, is_identified: Any, known_flags: Any) -> None:
        self.is_identified = self.is_identified.copy()
        self.is_identified[motors] = is_identified
        self.known_flags[motors] = known_flags

    def test(
        self,
        motor: int,
        delay: DelayEstimate,
        *,
        is_recent: bool,
        estimate: Estimate | None = None,
    ) -> tuple[Estimate, bool]:
        """Test the fit of one motor at once.

        Args:
            motor: its place on the motor axis.
            delay: what is known of its delay.
            is_recent: whether its newest samples alone are tested.
            estimate: of this motor alone, as the rule gives it now; None: the rule is asked.

        Returns:
            What is believed of it then, and whether that has changed.
        """
        if estimate is None:
            estimate = self.context_nodes.estimate(slice(motor, motor + 1))
        test = self._fit.test_newest if is_recent else self._fit.test
        return self._compared(
            motor, estimate, partial(test, self.context_nodes, estimate, motor, delay)
        )

    def withhold(self, motor: int) -> None:
        """Believe nothing of one motor until its next test."""
        self._fit.withhold(motor)

    def leaves_noise_alone(self, motor: int) -> bool:
        """Look at the newest samples of a rotor that has passed; False: a test is to tell."""
        return self._fit.leaves_noise_alone(self.context_nodes, motor)

    def tested_count(self, motor: int) -> int:
        """Return how many samples a test of one motor takes at most."""
        return int(min(self.context_nodes.replay.remembered(slice(motor, motor + 1))[0], WINDOW))

    def begin_test(self, motor: int, delay: DelayEstimate) -> Pieces[FitResult] | None:
        """Begin to test the fit of one motor by all samples that count; None: too few."""
        estimate = self.context_nodes.estimate(slice(motor, motor + 1))
        return self._fit.begin(self.context_nodes, estimate, motor, delay)

    def follow(self, motor: int, result: FitResult) -> tuple[Estimate, bool]:
        """Believe of one motor what a test of its fit has left; returns what :meth:`test` does."""
        estimate = self.context_nodes.estimate(slice(motor, motor + 1))
        return self._compared(motor, estimate, partial(self._fit.follow, motor, result))

    def _compared(
        self, motor: int, estimate: Estimate, act: Callable[[], None]
    ) -> tuple[Estimate, bool]:
        """Do what may change the belief in one motor; return that, and whether it has."""
        one = slice(motor, motor + 1)
        before = self._judged(estimate, one)
        act()
        after = self._judged(estimate, one)
        has_changed = before.verdicts != after.verdicts or not np.array_equal(
            before.covariance, after.covariance
        )
        return after, has_changed

    def check_flags(self, flags: Any) -> None:
        """Refuse saved flags that are not one a published parameter.

        Raises:
            CheckpointError: they are not.
        """
        count = self.known_flags.shape[1]
        if not isinstance(flags, list) or [type(one) for one in flags] != [bool] * count:
            raise CheckpointError('identified_parameters is no list of yes and no, one a parameter')

    def restore_flags(self, motor: int, is_identified: bool, flags: Sequence[bool]) -> None:
        """Take back what was identified of one motor, where learning is stopped."""
        self._keep_flags(slice(motor, motor + 1), is_identified, flags)
        self._kept_verdicts = None


def _known_flags(estimate: Estimate) -> list[list[bool]]:
    """Tell of every motor, and of every parameter of it, whether it counts as known."""
    return [[verdict in COUNTS_AS_KNOWN for verdict in row] for row in estimate.verdicts]
