"""Follows the fit of every motor of a group, and limits its estimates by that fit.

`fit_schedule.py` says when a motor is tested, `window_test.py` tests it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gray_box_observer.context_nodes import RotorGroup, RotorUpdate
from gray_box_observer.context_nodes.estimate import Estimate, Verdict
from gray_box_observer.context_nodes.pieces import Pieces, completed
from gray_box_observer.context_nodes.update_rule import ContextUpdate
from gray_box_observer.delay import DelayEstimate
from gray_box_observer.fit_test.assessment import FitAssessment, FitVerdict
from gray_box_observer.fit_test.estimate_limit import EstimateLimit
from gray_box_observer.fit_test.fit_result import FitResult
from gray_box_observer.fit_test.fit_schedule import SHORTEST_WAIT, FitSchedule
from gray_box_observer.fit_test.motor_under_test import MotorUnderTest
from gray_box_observer.fit_test.noise_alone import leaves_noise_alone
from gray_box_observer.fit_test.policy import Judgement
from gray_box_observer.fit_test.saved_test import check_saved_result, check_saved_test
from gray_box_observer.fit_test.speed_basis import SpeedBasis
from gray_box_observer.fit_test.window_test import RECENT, WindowTest
from gray_box_observer.safe_io.saved_state import group
from gray_box_observer.samples.replay_buffer import VOLTAGE
from gray_box_observer.samples.voltage_level import is_held
from gray_box_observer.settings.motor_configuration import MotorConfiguration
from gray_box_observer.white_box import MotorWhiteBox

_UNTESTED = FitAssessment()


class FitMonitor:
    """Follows the fit of a group of motors.

    Args:
        motors: their configurations, in the order of the motor axis.
        white_boxes: physics of each.
        quantity: what the torque signal is taken for: ``torque`` or ``current``.

    Attributes:
        schedule: says when each motor is tested.
    """

    def __init__(
        self,
        motors: Sequence[MotorConfiguration],
        white_boxes: Sequence[MotorWhiteBox],
        quantity: str = 'torque',
    ) -> None:
        self._tests = [
            WindowTest(motor, white_box, quantity)
            for motor, white_box in zip(motors, white_boxes, strict=True)
        ]
        self._results: list[FitResult | None] = [None] * len(motors)
        self._without_tests: list[Judgement | None] = [None] * len(motors)
        self._assessments = [_UNTESTED] * len(motors)
        self._limits: dict[int, EstimateLimit] = {}
        self._withheld_motors: set[int] = set()  # changed since they passed; not tested yet
        self._basis = SpeedBasis.from_form(white_boxes[0], len(motors))
        fewest = np.array([test.fewest for test in self._tests])
        # of rotors few have a new estimate at a sample, and the next one is far
        most = len(motors) if white_boxes[0].has_rotor else None
        self.schedule = FitSchedule(fewest, len(white_boxes[0].parameters), most)
        self.forget()

    def configuration(self, motor: int) -> MotorConfiguration:
        """Return the configuration of one motor."""
        return self._tests[motor].configuration

    def assessment(self, motor: int) -> FitAssessment:
        """Return what is known of the fit of one motor."""
        return self._assessments[motor]

    def doubts_speed(self, motor: int) -> bool:
        """Tell whether the newest test of one motor has doubted a speed that is taken for exact."""
        result = self._results[motor]
        return result is not None and result.doubts_speed

    def test(
        self, nodes: ContextUpdate, estimate: Estimate, motor: int, delay: DelayEstimate
    ) -> None:
        """Test one motor at once, and note what follows; arguments are those of :meth:`begin`."""
        pieces = self.begin(nodes, estimate, motor, delay)
        if pieces is not None:
            self.follow(motor, completed(pieces))

    def begin(
        self, nodes: ContextUpdate, estimate: Estimate, motor: int, delay: DelayEstimate
    ) -> Pieces[FitResult] | None:
        """Begin to test one motor by all the samples that count, as they are now.

        None where there is too little to tell by: it is asked again later.

        Args:
            nodes: the rule that has learnt it.
            estimate: of this motor alone, as the rule gives it.
            motor: its place on the motor axis.
            delay: what is known of its delay.
        """
        subject = self._begin(nodes, estimate, motor, delay)
        test = self._tests[motor]
        count = subject.count(test.most)
        wait = test.fewest - count if count < test.fewest else SHORTEST_WAIT
        if count < test.fewest or not test.can_tell(subject, count):
            self.schedule.put_off(motor, subject.place + wait)
            if count >= test.fewest and self._results[motor] is None:
                self._keep(motor, None, test.without_test(subject, count))
            self._doubt_another(motor, estimate)
            return None
        return test.pieces(subject.snapshot(), count)

    def _doubt_another(self, motor: int, estimate: Estimate) -> None:
        """Withhold an estimate that has moved since the motor passed its test.

        The test that would tell cannot be made yet, and the one that was made was of other values.
        """
        result = self._results[motor]
        is_misfit = result is None or result.assessment.verdict is FitVerdict.MISFIT
        if not is_misfit and not self.schedule.covers(motor, estimate):
            self.withhold(motor)

    def withhold(self, motor: int) -> None:
        """Believe nothing of a motor until its next test."""
        self._withheld_motors.add(motor)
        self._limits[motor] = EstimateLimit(self._tests[motor].white_box.parameters, None)
        self._assessments[motor] = _UNTESTED

    def leaves_noise_alone(self, nodes: ContextUpdate, motor: int) -> bool:
        """Tell whether the newest samples of a rotor leave noise alone; False: a test is to tell.

        Args:
            nodes: the rule that has learnt it.
            motor: its place on the motor axis.
        """
        rule = nodes.rule(motor) if isinstance(nodes, RotorGroup) else nodes
        test = self._tests[motor]
        if type(rule) is not RotorUpdate or rule.knows_voltage_noise or rule.noise_memory:
            return False
        one = slice(motor, motor + 1)
        count = int(min(nodes.replay.remembered(one)[0], RECENT))
        samples = nodes.replay.newest(count, one)[:, 0]
        if count < test.fewest or is_held(samples[VOLTAGE]):
            return False
        if not leaves_noise_alone(test.white_box, nodes.theta[motor], samples):
            return False
        self.schedule.begin_test(motor, nodes.replay.received_of(motor))
        return True

    def test_newest(
        self, nodes: ContextUpdate, estimate: Estimate, motor: int, delay: DelayEstimate
    ) -> None:
        """Test one motor by its newest samples alone: only a misfit counts.

        Arguments are those of :meth:`test`.
        """
        subject = self._begin(nodes, estimate, motor, delay)
        test = self._tests[motor]
        count = subject.count(RECENT)
        if count < test.fewest or not test.can_tell(subject, count):
            return
        result = test.test_change(subject.snapshot(), count)
        if result is not None:
            self.follow(motor, result)

    def _begin(
        self, nodes: ContextUpdate, estimate: Estimate, motor: int, delay: DelayEstimate
    ) -> MotorUnderTest:
        """Note that a motor is tested; return it as it is now."""
        subject = MotorUnderTest.view(nodes, estimate, motor, delay, self._results[motor])
        self.schedule.begin_test(motor, subject.place)
        return subject

    def follow(self, motor: int, result: FitResult) -> None:
        """Keep what a test has left: it counts from now on. The next one follows."""
        self._keep(motor, result)
        self.schedule.follow(motor, result)

    def _keep(
        self, motor: int, result: FitResult | None, without_test: Judgement | None = None
    ) -> None:
        """Keep what a test has left, or what follows without one, and how that limits estimates."""
        self._results[motor] = result
        self._without_tests[motor] = without_test
        self._withheld_motors.discard(motor)
        parameters = self._tests[motor].white_box.parameters
        names = [parameter.name for parameter in parameters]
        withheld = None
        self._assessments[motor] = _UNTESTED
        if result is not None:
            withheld = self._basis.withheld(result.assessment, names)
            self._assessments[motor] = replace(result.assessment, withheld=withheld)
        open_names = () if withheld is None else withheld.names
        limit = EstimateLimit(
            parameters, result, open_parameters=open_names, without_test=without_test
        )
        if limit.is_open:
            self._limits.pop(motor, None)
        else:
            self._limits[motor] = limit

    def judged(
        self, nodes: ContextUpdate, estimate: Estimate, motors: NDArray[np.intp]
    ) -> Estimate:
        """Return an estimate as far as the fit lets it be believed.

        Args:
            nodes: the rule that has learnt them.
            estimate: as it gives it, one row for each of some motors.
            motors: their places on the motor axis.
        """
        covariance = estimate.covariance
        verdicts: list[tuple[Verdict, ...]] = []
        for row, motor in enumerate(motors.tolist()) if self._limits else ():
            limit = self._limits.get(motor)
            if limit is None:
                continue
            verdicts = verdicts or list(estimate.verdicts)
            if limit.widens and covariance is estimate.covariance:
                covariance = covariance.copy()
            verdicts[row] = limit.apply(
                nodes, motor, estimate.value[row], covariance[row], verdicts[row]
            )
        if not verdicts:
            return estimate
        return Estimate(
            estimate.stamp_ns, estimate.parameters, estimate.value, covariance, tuple(verdicts)
        )

    def forget(self) -> None:
        """Start anew: what was tested is no more."""
        for motor in range(len(self._tests)):
            self._keep(motor, None)
        self.schedule.forget()

    def state(
        self, motor: int, received_count: int, later_result: FitResult | None = None
    ) -> dict[str, Any]:
        """Everything about one motor, as plain values; places count back from the newest.

        Args:
            motor: its place on the motor axis.
            received_count: place of its newest sample.
            later_result: of a test that has begun and does not count yet.
        """
        result = self._results[motor]
        saved_result = {} if result is None else result.state(received_count)
        later = {} if later_result is None else {'later': later_result.state(received_count)}
        withheld = {'is_withheld': True} if motor in self._withheld_motors else {}
        judgement = self._without_tests[motor]
        open_fit = {} if judgement is None else {'untested_spread': judgement.spread.tolist()}
        saved_schedule = self.schedule.state(motor, received_count)
        return {**saved_schedule, **saved_result, **withheld, **open_fit, **later}

    def restore(self, plain: dict[str, Any], motor: int, received_count: int) -> FitResult | None:
        """Take back what :meth:`state` gave; return the result that does not count yet.

        Raises:
            CheckpointError: it is no state that a test could have left.
        """
        parameters = len(self._tests[motor].white_box.parameters)
        check_saved_test(plain, parameters)
        later_result = None
        if 'later' in plain:
            saved_result = dict(group(plain, 'later'))
            check_saved_result(saved_result, parameters)
            later_result = FitResult.restored(saved_result, received_count)
        has_result = 'assessment' in plain
        result = FitResult.restored(plain, received_count) if has_result else None
        without_test = None
        if 'untested_spread' in plain and not has_result:
            spread = np.array(plain['untested_spread'], dtype=float)
            without_test = Judgement(FitVerdict.UNTESTED, np.ones(parameters), spread)
        self._keep(motor, result, without_test)
        if plain.get('is_withheld', False):
            self.withhold(motor)
        self.schedule.restore(plain, motor, received_count, result)
        return later_result
