"""What is left out is named by the voltage balance, and only by what can be."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
import yaml
from linear_motor_records import WHITE_BOX, Record, current_of, current_of_free_rotor, noise, steps

from gray_box_observer.fit_test.assessment import Suspect
from gray_box_observer.fit_test.effects import EFFECTS
from gray_box_observer.fit_test.suspects import (
    Explanation,
    explanations,
    select_explanations,
    with_delay,
)

SAMPLES = 3000


def _first(voltage_v: np.ndarray, current_a: np.ndarray) -> str:
    noisy = Record(voltage_v, current_a + noise(current_a.size, 0.02, 3))
    return select_explanations(explanations(WHITE_BOX, noisy.stretch).values(), {})[0].effect.name


def test_what_comes_late_is_named() -> None:
    voltage_v = steps(SAMPLES, 1)
    late_v = np.concatenate([np.zeros(2), voltage_v[:-2]])
    assert _first(voltage_v, current_of(late_v)) in ('delay', 'current_lag')
    lagging = current_of(voltage_v)
    for sample in range(1, SAMPLES):
        lagging[sample] = lagging[sample - 1] + (lagging[sample] - lagging[sample - 1]) / 3.0
    assert _first(voltage_v, lagging) in ('current_lag', 'delay')


@pytest.mark.parametrize('frequency_hz', [2.0, 5.0])
def test_of_one_frequency_a_voltage_that_acts_before_it_is_stamped_is_no_explanation(
    frequency_hz: float,
) -> None:
    """Current that leads, as a free rotor's does, would be a negative delay: the rotor is named."""
    voltage_v = 9.0 * np.sin(2.0 * np.pi * frequency_hz * 1e-3 * np.arange(SAMPLES))
    assert _first(voltage_v, current_of_free_rotor(voltage_v)) == 'rotor'


def test_a_supply_that_wanders_is_named() -> None:
    voltage_v = steps(SAMPLES, 4)
    wander = 1.0 + 0.1 * np.sin(2.0 * np.pi * np.arange(SAMPLES) / 1100.0)
    assert _first(voltage_v, current_of(wander * voltage_v)) == 'sag'


def test_of_currents_next_to_nothing_no_explanation_has_a_number_that_is_none() -> None:
    tiny = Record(steps(SAMPLES, 1), 5e-324 * np.arange(SAMPLES) % 3.0)
    with warnings.catch_warnings():
        warnings.simplefilter('error')
        found = explanations(WHITE_BOX, tiny.stretch)
    assert all(np.isfinite((one.evidence, one.amount, one.total)).all() for one in found.values())


def test_a_rotor_beside_no_resistance_at_all_is_named_all_the_same() -> None:
    found = Explanation(EFFECTS['rotor'], 100.0, 1.0, 1.0, 0.0)
    assert select_explanations([found], {}) == [found]
    assert 'velocity' in found.suspect('motor', 0.02).remedy


@pytest.mark.parametrize(
    ('evidence', 'before', 'after'),
    [
        (301.0, ['sag', 'current_lag'], ['sag', 'delay', 'current_lag']),
        (299.0, ['delay', 'sag', 'current_lag'], ['current_lag', 'sag', 'delay']),
        (1.0, ['sag'], ['sag', 'delay']),
    ],
)
def test_of_a_lag_and_a_delay_that_a_search_has_found_the_likelier_is_first(
    evidence: float, before: list[str], after: list[str]
) -> None:
    suspects = [Suspect(effect, 100.0, 'by the balance') for effect in before]
    delay = Suspect('delay', evidence, 'by the search')
    found = with_delay(suspects, delay)
    assert [one.effect for one in found] == after
    assert found[after.index('delay')] is delay


@pytest.mark.parametrize('name', sorted(EFFECTS))
def test_a_remedy_by_parameters_is_a_line_of_a_parameter_file(name: str) -> None:
    remedy = Explanation(EFFECTS[name], 100.0, 0.25, 0.25, 2.0).suspect('left', 0.02).remedy
    parameter, colon, _ = remedy.partition(': ')
    if not colon or ' ' in parameter:
        without_parameter = ('dead_zone', 'sag', 'current_lag', 'change', 'hysteresis')
        assert name in (*without_parameter, 'speed_delay')
        return
    ((key, value),) = yaml.safe_load(remedy).items()
    assert key == parameter
    assert isinstance(value, (float, list)) or value in ('rotor', 'estimate')
    assert '  # ' in remedy, 'the reason'


def test_a_kb_that_is_off_is_named_by_the_value_that_it_has() -> None:
    explanation = Explanation(EFFECTS['back_emf_constant'], 100.0, 0.0015, 0.0015, 2.0)
    assert yaml.safe_load(explanation.suspect('left', 0.02, 0.0285).remedy) == {
        'left.back_emf_constant': 0.03
    }


def test_of_less_than_no_lost_voltage_no_parameter_is_named() -> None:
    explanation = Explanation(EFFECTS['lost_voltage'], 100.0, -0.0017, -0.0017, 2.0)
    assert 'brush_drop' not in explanation.suspect('left', 0.02).remedy
