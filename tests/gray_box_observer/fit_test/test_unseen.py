"""What no residual shows: a voltage that was sampled and not held, a rotor that is blocked."""

from __future__ import annotations

import numpy as np
import pytest
from linear_motor_records import (
    INDUCTANCE_H,
    INTERVAL_S,
    NODES,
    RESISTANCE_OHM,
    TORQUE_CONSTANT,
    TRUTH,
    WHITE_BOX,
    Floats,
    Record,
    current_of,
    noise,
    steps,
)

from gray_box_observer.context_nodes import Estimate, Verdict
from gray_box_observer.fit_test.policy import (
    FEW_PERIODS,
    SAFETY,
    UNIFORM_STD,
    UNTOLD_DELAY,
    WHITENESS_DOUBT,
    WHITENESS_WIDENS,
    Judgement,
    judge,
)
from gray_box_observer.fit_test.projection import bandwidth
from gray_box_observer.fit_test.residual_analysis import analyse

SAMPLES = 3000
STD_A = 0.01
SURE = np.array([1e-3, 1e-3])


def _slow_sines(scale_s: float) -> tuple[Floats, Floats]:
    """Voltage at every sample, and the current of the blocked motor that it drives all the time."""
    time_s = np.arange(SAMPLES) * INTERVAL_S
    voltage_v = np.zeros(SAMPLES)
    current_a = np.zeros(SAMPLES)
    for share in (1.0, 1.7, 2.9):
        rate = share / scale_s
        impedance = RESISTANCE_OHM + 1j * rate * INDUCTANCE_H
        wave = np.exp(1j * rate * time_s)
        voltage_v += 3.0 * wave.imag
        current_a += 3.0 * (wave / impedance).imag
    return voltage_v, current_a


def _judged(record: Record, *, stamps_exact: bool) -> Judgement:
    analysis = analyse(WHITE_BOX, TRUTH, record.stretch)
    return judge(analysis, SURE, SAMPLES, speed_measured=False, stamps_exact=stamps_exact)


def test_steps_tell_the_instant_at_which_the_voltage_acts() -> None:
    voltage_v = steps(SAMPLES, 1)
    record = Record(voltage_v, current_of(voltage_v) + noise(SAMPLES, STD_A, 2))
    analysis = analyse(WHITE_BOX, TRUTH, record.stretch)
    assert analysis.stamps.delay.amount.std < 0.1 * UNTOLD_DELAY
    assert not _judged(record, stamps_exact=False).spread.any()


@pytest.mark.parametrize('exact', [False, True])
def test_slow_sines_do_not_and_leave_the_inductance_open(exact: bool) -> None:
    voltage_v, _ = _slow_sines(1.0)
    record = Record(voltage_v, current_of(voltage_v) + noise(SAMPLES, STD_A, 3))
    analysis = analyse(WHITE_BOX, TRUTH, record.stretch)
    assert analysis.stamps.delay.amount.std > UNTOLD_DELAY
    spread = _judged(record, stamps_exact=exact).spread
    half_interval = 0.5 * INTERVAL_S * RESISTANCE_OHM / INDUCTANCE_H
    assert np.sqrt(spread[0, 0]) == pytest.approx(
        0.0 if exact else 2.0 * UNIFORM_STD * half_interval, rel=0.3
    )


@pytest.mark.parametrize('error', [0.05, -0.05], ids=['later', 'earlier'])
@pytest.mark.parametrize('seed', range(3))
def test_small_errors_of_the_stamps_count_where_the_data_tell_them(error: float, seed: int) -> None:
    """Stamps 5 % of an interval late or early blend a voltage with the one before or behind."""
    voltage_v = steps(SAMPLES, 10 + seed)
    other_v = np.roll(voltage_v, 1 if error > 0.0 else -1)
    stamped = Record(
        voltage_v + abs(error) * (other_v - voltage_v),
        current_of(voltage_v) + noise(SAMPLES, 5.0 * STD_A, seed),
    )
    analysis = analyse(WHITE_BOX, TRUTH, stamped.stretch)
    stamp_error = analysis.stamps.delay if error > 0.0 else analysis.stamps.lead
    assert abs(stamp_error.amount.mean) == pytest.approx(abs(error), rel=0.3)
    spread = (
        _judged(stamped, stamps_exact=False).spread - _judged(stamped, stamps_exact=True).spread
    )
    assert np.sqrt(spread[0, 0]) > 0.7 * abs(error * stamp_error.shift[0])


def _looped(seed: int, every: int) -> Record:
    """The motor with a current loop that answers the noise of one reading of so many."""
    rng = np.random.default_rng(seed)
    references_a = steps(SAMPLES, seed, -3.0, 3.0)
    decay = np.exp(-INTERVAL_S * RESISTANCE_OHM / INDUCTANCE_H)
    gain = (1.0 - decay) / RESISTANCE_OHM
    current_a = integral_v = 0.0
    voltage_v = np.zeros(SAMPLES)
    readings_a = np.zeros(SAMPLES)
    for sample, reference_a in enumerate(references_a):
        readings_a[sample] = current_a + STD_A * rng.normal()
        voltage_v[sample] = voltage_v[sample - 1]
        if sample % every == 0:
            error_a = reference_a - readings_a[sample]
            integral_v += 0.1 * RESISTANCE_OHM * error_a
            voltage_v[sample] = integral_v + 0.2 / gain * error_a
        current_a = decay * current_a + gain * voltage_v[sample]
    return Record(voltage_v, readings_a)


@pytest.mark.parametrize('every', [1, 3, 4])
@pytest.mark.parametrize('seed', range(5))
def test_a_current_loop_that_answers_noise_is_not_taken_for_stamps(seed: int, every: int) -> None:
    record = _looped(seed, every)
    lead = analyse(WHITE_BOX, TRUTH, record.stretch).stamps.lead.amount
    assert lead.std < 0.05
    assert abs(lead.mean) < 3.0 * lead.std
    spread = _judged(record, stamps_exact=False).spread
    assert np.sqrt(spread[0, 0]) < 0.01


@pytest.mark.slow
def test_the_inductance_of_a_voltage_that_was_sampled_is_not_believed_wrongly() -> None:
    """It comes out too small by R times half an interval, and the residual is white."""
    voltage_v, current_a = _slow_sines(1.0)
    motor = Record(voltage_v, current_a + noise(SAMPLES, STD_A, 4)).observed().motors['motor']
    inductance = motor.estimate.value[0, 0]
    std = motor.estimate.std[0, 0]
    assert inductance < 0.85 * INDUCTANCE_H
    assert abs(inductance - INDUCTANCE_H) < 3.0 * std
    assert motor.estimate.verdicts[0][0] is not Verdict.IDENTIFIED


def _blocked(**motor: object) -> Estimate:
    voltage_v = steps(2000, 5)
    record = Record(voltage_v, current_of(voltage_v) + noise(2000, STD_A, 6))
    return record.observed(**motor).motors['motor'].estimate


def test_kb_kt_is_left_open_where_a_speed_of_kt_i_is_a_guess() -> None:
    """Of a blocked rotor R comes out smaller by Kb Kt, which is a tenth of it here."""
    kb = 0.1 * RESISTANCE_OHM / TORQUE_CONSTANT
    guess = _blocked(back_emf_constant=kb)
    assert guess.value[0, 1] == pytest.approx(0.9 * RESISTANCE_OHM, rel=0.01)
    assert abs(guess.value[0, 1] - RESISTANCE_OHM) < 3.0 * guess.std[0, 1]
    assert guess.verdicts[0] == (Verdict.IDENTIFIED, Verdict.CONVERGING)


@pytest.mark.parametrize(
    'motor',
    [{'back_emf_constant': 1e-3}, {'speed_source': 'torque_constant', 'back_emf_constant': 10.0}],
)
def test_kb_kt_is_not_left_open_where_it_is_small_or_the_speed_is_stated(
    motor: dict[str, object],
) -> None:
    assert list(NODES) == ['inductance', 'resistance']
    assert _blocked(**motor).verdicts[0] == (Verdict.IDENTIFIED, Verdict.IDENTIFIED)


def test_standard_deviations_grow_with_a_residual_that_is_hardly_coloured() -> None:
    voltage_v = steps(SAMPLES, 7)
    record = Record(voltage_v, current_of(voltage_v) + noise(SAMPLES, STD_A, 8, memory=0.35))
    analysis = analyse(WHITE_BOX, TRUTH, record.stretch)
    assert WHITENESS_WIDENS < analysis.whiteness < WHITENESS_DOUBT
    judgement = judge(analysis, 0.3 * SURE, SAMPLES, speed_measured=False, stamps_exact=True)
    few = 1.0 + FEW_PERIODS * bandwidth(analysis.samples) / analysis.samples
    widening = SAFETY * few
    assert 1.25 < widening < 1.5
    assert judgement.factor == pytest.approx(
        np.maximum(widening * analysis.robust_std / (0.3 * SURE), 1.0)
    )
