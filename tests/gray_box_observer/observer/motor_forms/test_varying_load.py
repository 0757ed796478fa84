"""A joint whose load varies, its speed unmeasured: R and L are found, the rotor stays open."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from rotor_records import (
    CONSTANTS,
    GEAR_MOTOR,
    feed,
    made,
    observed,
    recorded_under,
    samples_of,
    told,
)

from dc_motor_sim.plant import PlantParameters
from dc_motor_sim.simulation import Recording
from gray_box_observer.context_nodes import Verdict
from gray_box_observer.context_nodes.pieces import completed
from gray_box_observer.fit_test import FitVerdict
from gray_box_observer.observer.motor_forms.form_comparison import TrialOutcome
from gray_box_observer.observer.motor_forms.form_trial import FormTrial
from gray_box_observer.observer.motor_forms.motor_form import (
    POSSIBLE_EFFECTS,
    ROTOR,
    THESIS,
    VARYING_LOAD,
    FormKind,
)
from gray_box_observer.observer.motor_forms.open_forms import OpenForms
from gray_box_observer.observer.motor_forms.trial_start import NEWEST, TrialStart
from gray_box_observer.observer.observer import Observer
from gray_box_observer.observer.verdict_advice import LOAD_ADVICE, verdict_advice
from gray_box_observer.settings.configuration import Configuration

SAMPLES = 12000
MOTOR = replace(GEAR_MOTOR, inductance=6e-3)
LARGEST_LOAD_NM = 0.02
GEAR_RATIO = 50.0

ELECTRICAL = ('inductance', 'resistance')
MECHANICAL = ('inertia', 'viscous_friction', 'coulomb_friction')


def gravity_nm(angle_rad: float) -> float:
    """Torque that an arm takes at an angle of the motor."""
    return LARGEST_LOAD_NM * float(np.sin(angle_rad / GEAR_RATIO))


@cache
def arm(samples: int = SAMPLES, seed: int = 1) -> Recording:
    """A gear motor that swings an arm: its load follows the sine of the arm's angle."""
    return recorded_under(MOTOR, gravity_nm, samples, seed)


@cache
def observer_of_arm() -> Observer:
    """An observer that has seen the arm."""
    return observed(arm())


@pytest.mark.slow
def test_a_load_that_varies_is_found_and_the_electrical_half_with_it() -> None:
    motor = observer_of_arm().motors['motor']
    assert motor.added_effects == (VARYING_LOAD,)
    assert motor.fit.verdict is FitVerdict.OK
    for name in ELECTRICAL:
        value, std, verdict = told(motor, name)
        assert verdict is Verdict.IDENTIFIED
        assert abs(value - getattr(MOTOR, name)) < 4.0 * std
    assert told(motor, 'resistance')[0] == pytest.approx(MOTOR.resistance, rel=0.01)


@pytest.mark.slow
def test_of_its_rotor_nothing_is_identified() -> None:
    motor = observer_of_arm().motors['motor']
    for name in MECHANICAL:
        value, std, verdict = told(motor, name)
        assert verdict not in (Verdict.IDENTIFIED, Verdict.NEGLIGIBLE)
        assert abs(value - getattr(MOTOR, name)) < 3.0 * std


@pytest.mark.slow
def test_no_voltage_is_asked_for_to_tell_its_rotor() -> None:
    advice = verdict_advice(observer_of_arm().motors['motor'])
    assert advice is not None
    assert advice.endswith(LOAD_ADVICE)
    assert 'inertia' in advice
    assert 'inductance' not in advice


def outcome_of_trial(plant: PlantParameters, samples: int) -> TrialOutcome:
    """Try a rotor, alone and with a load that varies, on so many samples of an arm."""
    thesis = made('torque_constant')
    for sample in samples_of(recorded_under(plant, gravity_nm, samples, 3)):
        thesis.step(sample)
    content = thesis.context_nodes.replay.newest(samples)
    choice = made().form_choice
    open_forms = OpenForms(choice.form_of, (THESIS, ROTOR), POSSIBLE_EFFECTS)
    candidates = FormKind(ROTOR), FormKind(ROTOR, (VARYING_LOAD,))
    start = TrialStart(FormKind(THESIS), candidates, 3, 1, content, 0, before_a=10.0)
    return completed(FormTrial(start, open_forms).work)


@pytest.mark.slow
def test_what_brushes_drop_is_found_beside_it() -> None:
    plant = replace(MOTOR, brush_drop=0.5)
    outcome = outcome_of_trial(plant, NEWEST)
    assert outcome.form is not None
    assert outcome.kind == FormKind(ROTOR, (VARYING_LOAD, 'brush_drop'))
    estimate = outcome.form.context_nodes.estimate()
    for name in ('resistance', 'brush_drop'):
        place = outcome.form.white_box.context_nodes.index(name)
        true = getattr(plant, name)
        assert abs(estimate.value[0, place] - true) < 4.0 * estimate.std[0, place]
        assert estimate.value[0, place] == pytest.approx(true, rel=0.1)


@pytest.mark.slow
@pytest.mark.parametrize('samples', [900, 1200])
def test_few_samples_do_not_tell_it_from_what_takes_voltage(samples: int) -> None:
    """Below 1,024 it is not asked for."""
    outcome = outcome_of_trial(MOTOR, samples)
    assert outcome.form is None
    is_asked = 'a rotor with a load that varies needs more samples' in outcome.reason
    assert is_asked == (samples > 1024)


def test_a_load_that_varies_has_a_constant_part() -> None:
    observer = Observer(Configuration.from_flat(CONSTANTS))
    feed(observer, [arm(10)])
    choice = observer.motors['motor'].observer.form_choice
    assert choice.may_take(FormKind(ROTOR, (VARYING_LOAD,)))
    assert not choice.may_take(FormKind(ROTOR, (VARYING_LOAD, 'load_torque')))
    assert not choice.may_take(FormKind('torque_constant', (VARYING_LOAD,)))


def test_beside_a_load_that_is_stated_none_is_added() -> None:
    stated = {'motor.speed_source': 'rotor', 'motor.known.load_torque': 0.01}
    observer = Observer(Configuration.from_flat({**CONSTANTS, **stated}))
    feed(observer, [arm(10)])
    choice = observer.motors['motor'].observer.form_choice
    assert not choice.may_take(FormKind(ROTOR, (VARYING_LOAD,)))
