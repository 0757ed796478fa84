"""What tests tell of an amount is pooled by its variance, and no sample counts twice."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from linear_motor_records import (
    INDUCTANCE_H,
    RESISTANCE_OHM,
    TORQUE_CONSTANT,
    TRUTH,
    WHITE_BOX,
    Record,
    current_of,
    current_of_free_rotor,
    noise,
    steps,
)

from gray_box_observer.delay.watch import DelayEstimate
from gray_box_observer.errors import CheckpointError
from gray_box_observer.fit_test import FitAssessment, FitVerdict
from gray_box_observer.fit_test.evidence import NO_EVIDENCE, WINDOW, Evidence
from gray_box_observer.fit_test.fit_result import FitResult
from gray_box_observer.fit_test.least_squares import LEAST_SQUARES, allowances_of_stamps
from gray_box_observer.fit_test.motor_under_test import MotorUnderTest
from gray_box_observer.fit_test.policy import Judgement
from gray_box_observer.fit_test.projection import UNKNOWN, Amount
from gray_box_observer.fit_test.residual_analysis import analyse
from gray_box_observer.fit_test.saved_test import check_evidence
from gray_box_observer.fit_test.stamp_errors import DELAY, StampError
from gray_box_observer.samples import ReplayBuffer
from gray_box_observer.white_box import MotorWhiteBox
from gray_box_observer.white_box.flow import to_coordinates

SAMPLES = 4000
ROTOR = MotorWhiteBox(
    ('inductance', 'resistance', 'inertia'), TORQUE_CONSTANT, {'back_emf_constant': TORQUE_CONSTANT}
)
ROTOR_TRUTH = to_coordinates(
    np.array([[INDUCTANCE_H, RESISTANCE_OHM, 0.05 * TORQUE_CONSTANT**2 / RESISTANCE_OHM]])
)
"""With a mechanical time constant of 0.05 s."""
MOVED = 0.1
"""By how much the inductance is not what fits, as a logarithm."""


def test_windows_side_by_side_count_by_their_variance() -> None:
    first = NO_EVIDENCE.with_window({DELAY: Amount(1.0, 0.1)}, 1000, 1000)
    both = first.with_window({DELAY: Amount(2.0, 0.2)}, 1000, 1000)
    amount = both.amount(DELAY)
    assert amount.mean == pytest.approx((1.0 / 0.01 + 2.0 / 0.04) / (1.0 / 0.01 + 1.0 / 0.04))
    assert amount.std == pytest.approx((1.0 / 0.01 + 1.0 / 0.04) ** -0.5)
    assert both.samples == 2000.0


def test_many_windows_tell_as_much_as_their_samples_do() -> None:
    evidence = NO_EVIDENCE
    for _ in range(9):  # each holds half of the one before
        evidence = evidence.with_window({DELAY: Amount(0.5, 0.1)}, 4096, 2048)
    assert evidence.amount(DELAY).mean == pytest.approx(0.5)
    assert evidence.amount(DELAY).std == pytest.approx(0.1 / math.sqrt(1.0 + 8.0 / 2.0))
    assert evidence.is_mature


def test_a_window_that_holds_all_samples_stands_for_all() -> None:
    few = NO_EVIDENCE.with_window({DELAY: Amount(9.0, 0.1)}, 64, 64)
    assert few.with_window({DELAY: Amount(0.0, 0.05)}, 128, 64) == Evidence(
        {DELAY: Amount(0.0, 0.05)}, 128
    )


def test_what_says_nothing_leaves_all_as_it_is() -> None:
    known = NO_EVIDENCE.with_window({DELAY: Amount(1.0, 0.1)}, 1000, 1000)
    for nothing in (UNKNOWN, Amount(math.nan, 0.1), Amount(1.0, math.nan), Amount(1.0, 0.0)):
        assert known.with_window({DELAY: nothing}, 1000, 1000).amount(DELAY) == Amount(1.0, 0.1)
    assert known.amount('another') == UNKNOWN


def test_what_a_window_cannot_tell_stays_as_it_was_known() -> None:
    known = NO_EVIDENCE.with_window({DELAY: Amount(1.0, 0.1)}, 1000, 1000)
    later = known.with_window({'lead': Amount(2.0, 0.1), DELAY: UNKNOWN}, 2000, 1000)
    assert later.amount(DELAY) == Amount(1.0, 0.1)
    assert later.amount('lead') == Amount(2.0, 0.1)


def test_a_place_that_has_gone_back_adds_nothing() -> None:
    known = Evidence({DELAY: Amount(0.1, 0.01)}, 7000.0)
    assert known.with_window({DELAY: Amount(0.5, 0.5)}, WINDOW, -3000) == known


def test_all_that_is_pooled_can_be_saved() -> None:
    window = {'lead': Amount(0.0, 9e11), DELAY: Amount(0.0, 2e-12)}
    evidence = Evidence({DELAY: Amount(1.0, 0.1)}, 9000.0).with_window(window, WINDOW, 64)
    check_evidence(evidence.to_dict())
    assert evidence.amount('lead') == UNKNOWN


def test_least_squares_that_contradict_all_others_stand_alone() -> None:
    records = []
    for seed, factor in ((1, 1.0), (2, 1.2)):
        voltage_v = steps(SAMPLES, seed)
        current_a = current_of(voltage_v, inductance_h=factor * INDUCTANCE_H)
        records.append(Record(voltage_v, current_a + noise(SAMPLES, 0.05, 10 + seed)))
    first, other = (record.stretch for record in records)
    before = analyse(WHITE_BOX, TRUTH, first).evidence
    same = analyse(WHITE_BOX, TRUTH, first, earlier=before, new=SAMPLES).evidence
    assert same.samples == 2 * before.samples
    changed = analyse(WHITE_BOX, TRUTH, other, earlier=same, new=SAMPLES)
    alone = analyse(WHITE_BOX, TRUTH, other).evidence
    for name in (f'{LEAST_SQUARES}inductance', f'{LEAST_SQUARES}resistance'):
        assert changed.evidence.amount(name) == alone.amount(name)
    assert changed.evidence.amount(DELAY).std < alone.amount(DELAY).std
    assert np.abs(changed.open_shifts)[:, 0].max() == pytest.approx(math.log(1.2), rel=0.3)
    half_new = analyse(WHITE_BOX, TRUTH, other, earlier=same, new=SAMPLES // 2).evidence
    for name in (f'{LEAST_SQUARES}inductance', f'{LEAST_SQUARES}resistance'):
        assert half_new.amount(name).std == pytest.approx(math.sqrt(2.0) * alone.amount(name).std)


def test_a_delay_that_moves_the_least_squares_contradicts_nothing() -> None:
    known = Evidence({LEAST_SQUARES: Amount(0.0, 0.001)}, 9000.0)
    moved = {LEAST_SQUARES: Amount(0.05, 0.001)}
    assert known.contradicts(moved, {LEAST_SQUARES: 0.0})
    apart = 4.0 * math.hypot(0.001, 0.001)
    assert known.contradicts(moved, {LEAST_SQUARES: 0.049 - apart})
    assert not known.contradicts(moved, {LEAST_SQUARES: 0.051 - apart})
    shift = np.array([-1.0, 0.1])
    shown = StampError(shift, Amount(0.05, 0.001))
    hidden = StampError(shift, Amount(0.05, 0.02))
    allowances = allowances_of_stamps(WHITE_BOX, (shown, hidden))
    assert allowances[f'{LEAST_SQUARES}inductance'] == pytest.approx(0.05, rel=1e-3)
    assert allowances[f'{LEAST_SQUARES}resistance'] == pytest.approx(0.005, rel=1e-3)


def test_a_delay_that_shows_lets_the_least_squares_go_on_under_another_excitation() -> None:
    """A twentieth of an interval moves R by 2 % under a sine, and not under steps."""
    sine_v = 12.0 * np.sin(0.5 * np.arange(SAMPLES))
    windows = []
    for voltage_v in (steps(SAMPLES, 1), sine_v):
        late_v = voltage_v - 0.05 * np.diff(voltage_v, prepend=0.0)
        windows.append(Record(voltage_v, current_of(late_v) + noise(SAMPLES, 0.02, 11)).stretch)
    before = analyse(WHITE_BOX, TRUTH, windows[0]).evidence
    alone = analyse(WHITE_BOX, TRUTH, windows[1]).evidence
    name = f'{LEAST_SQUARES}resistance'
    assert before.contradicts({name: alone.amount(name)}, {})
    after = analyse(WHITE_BOX, TRUTH, windows[1], earlier=before, new=SAMPLES // 8).evidence
    assert after.amount(name).std < before.amount(name).std


def test_evidence_of_a_rotor_is_of_stamps_and_noise() -> None:
    voltage_v = steps(SAMPLES, 1)
    stretch = Record(voltage_v, current_of_free_rotor(voltage_v) + noise(SAMPLES, 0.05, 7)).stretch
    one = analyse(ROTOR, ROTOR_TRUTH, stretch)
    two = analyse(ROTOR, ROTOR_TRUTH, stretch, earlier=one.evidence, new=SAMPLES)
    assert one.whiteness < 2.0
    assert two.evidence.samples == 2 * one.evidence.samples
    assert not any(name.startswith(LEAST_SQUARES) for name in two.evidence.amounts)
    assert two.evidence.amount(DELAY).std < one.evidence.amount(DELAY).std


def test_a_winding_that_heats_forgets_the_resistance_that_it_had() -> None:
    voltage_v = steps(SAMPLES, 1)
    record = Record(voltage_v, current_of(voltage_v) + noise(SAMPLES, 0.05, 7))
    before = analyse(WHITE_BOX, TRUTH, record.stretch).evidence
    warm = analyse(WHITE_BOX, TRUTH, record.stretch, True, before, SAMPLES).evidence
    assert before.amount(f'{LEAST_SQUARES}resistance') != UNKNOWN
    assert warm.amount(f'{LEAST_SQUARES}resistance') == UNKNOWN
    assert warm.amount(f'{LEAST_SQUARES}inductance').std < math.inf


def test_a_checkpoint_takes_it_back() -> None:
    known = Evidence({DELAY: Amount(1.0, 0.1)}, 4000.0)
    plain = known.to_dict()
    check_evidence(plain)
    assert Evidence.from_dict(plain) == known


@pytest.mark.parametrize(
    'pair', [[0.0, 0.0], [0.0, -1.0], [math.nan, 1.0], [0.0, math.inf], [0.0], 'no', [1e300, 1.0]]
)
def test_a_checkpoint_with_absurd_evidence_is_refused(pair: object) -> None:
    with pytest.raises(CheckpointError):
        check_evidence({'samples': 10.0, 'amounts': {DELAY: pair}})
    with pytest.raises(CheckpointError):
        check_evidence({'samples': -1.0, 'amounts': {}})
    with pytest.raises(CheckpointError):
        check_evidence({'samples': 1.0, 'amounts': {f'{k}': [0.0, 1.0] for k in range(99)}})
    with pytest.raises(CheckpointError, match='nobody can have written'):
        check_evidence({'samples': 1.0, 'amounts': {'\x1b[2J': [0.0, 1.0]}})


@pytest.mark.parametrize('seed', range(3))
def test_an_estimate_beside_the_least_squares_is_open_by_the_distance(seed: int) -> None:
    voltage_v = steps(SAMPLES, seed)
    record = Record(voltage_v, current_of(voltage_v) + noise(SAMPLES, 0.05, seed + 100))
    inductance = f'{LEAST_SQUARES}inductance'
    there = analyse(WHITE_BOX, TRUTH, record.stretch)
    assert np.abs(there.open_shifts).max() < 0.2 * MOVED
    beside = TRUTH * np.exp(-MOVED)  # of the coordinates 1/L and R/L
    away = analyse(WHITE_BOX, beside, record.stretch)
    least_squares = there.evidence.amount(inductance)
    assert away.evidence.amount(inductance).mean == pytest.approx(least_squares.mean, abs=0.01)
    assert np.abs(away.open_shifts)[:, 0].max() == pytest.approx(MOVED, rel=0.3)


def test_evidence_goes_on_from_window_to_window() -> None:
    voltage_v = steps(SAMPLES, 1)
    record = Record(voltage_v, current_of(voltage_v) + noise(SAMPLES, 0.05, 7))
    one = analyse(WHITE_BOX, TRUTH, record.stretch).evidence
    two = analyse(WHITE_BOX, TRUTH, record.stretch, earlier=one, new=SAMPLES).evidence
    assert two.samples == 2 * one.samples > WINDOW
    assert two.amount(DELAY).std == pytest.approx(one.amount(DELAY).std / math.sqrt(2.0), rel=1e-3)


def _motor_under_test(begin: int, delay_s: float) -> MotorUnderTest:
    """Return a motor whose last test began at sample 2048, with no delay."""
    answers = {'is_drifting': lambda _: False, 'present_since': lambda _: begin}
    nodes: Any = SimpleNamespace(replay=ReplayBuffer(1, 2), **answers)
    judgement = Judgement(FitVerdict.OK, np.ones(2), np.zeros((2, 2)))
    assessment = FitAssessment(FitVerdict.OK, 1.0, 1.0, (), WINDOW)
    known = Evidence({DELAY: Amount(1.0, 0.1)}, 9000.0)
    numbers = (9000, 8000, 64, 1.0, 0, 0.1)
    before = FitResult(assessment, judgement, np.ones(2), *numbers, True, known, present_since=2048)
    estimate: Any = None
    return MotorUnderTest.view(nodes, estimate, 0, DelayEstimate(delay_s, False), before)


def test_evidence_lasts_until_the_motor_or_its_delay_is_another() -> None:
    same = _motor_under_test(begin=2048, delay_s=0.0)
    assert same.before is not None
    assert same.evidence == same.before.evidence
    for begin in (8000, 0):  # a change, and a speed that is believed again
        assert _motor_under_test(begin, delay_s=0.0).evidence == NO_EVIDENCE
    assert _motor_under_test(begin=2048, delay_s=1e-4).evidence == NO_EVIDENCE


def test_a_checkpoint_knows_of_which_delay_evidence_is() -> None:
    before = _motor_under_test(begin=2048, delay_s=0.0).before
    assert before is not None
    result = replace(before, delay_s=1e-4)
    plain = result.state(9000)
    again = FitResult.restored(plain, 9000)
    assert (again.present_since, again.delay_s) == (2048, 1e-4)
    assert again.evidence == result.evidence
    del plain['delay_s']  # as of a release before
    assert FitResult.restored(plain, 9000).delay_s == 0.0
