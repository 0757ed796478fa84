"""Which forms a trial compares, and in which order."""

from __future__ import annotations

import pytest

from gray_box_observer.fit_test import FitAssessment, FitVerdict, Suspect
from gray_box_observer.observer.motor_forms.form_candidates import FormCandidates
from gray_box_observer.observer.motor_forms.load_search import LAST_LOOK, look_counts
from gray_box_observer.observer.motor_forms.motor_form import (
    POSSIBLE_EFFECTS,
    ROTOR,
    THESIS,
    FormKind,
)
from gray_box_observer.observer.motor_forms.open_forms import OpenForms
from gray_box_observer.observer.motor_forms.standstill import StandstillLine
from gray_box_observer.settings.motor_configuration import VARYING_LOAD

BRUSHES = FormKind(ROTOR, ('brush_drop',))
LOADED = BRUSHES.with_effect(VARYING_LOAD)
OPEN = OpenForms(lambda kind: pytest.fail('made'), (THESIS, ROTOR), POSSIBLE_EFFECTS)


def candidates_of(
    kind: FormKind, *suspects: tuple[str, float], ratio: float = 30.0
) -> tuple[FormKind, ...]:
    """Return the candidates where a misfit has such suspects."""
    fit_suspects = tuple(Suspect(effect, evidence, 'nothing') for effect, evidence in suspects)
    fit = FitAssessment(FitVerdict.MISFIT, ratio, 900.0, fit_suspects, 2048)
    return FormCandidates(kind, OPEN).instead(fit, is_doubted=True)


@pytest.mark.parametrize('suspects', [[('load', 900.0)], [('change', 900.0)], [('sag', 9.0)], []])
def test_a_rotor_that_seems_loaded_is_asked_for_a_load_before_its_rivals(
    suspects: list[tuple[str, float]],
) -> None:
    candidates = candidates_of(BRUSHES, *suspects)
    assert candidates.index(LOADED) == candidates.index(BRUSHES) + 1
    assert candidates[-1] == FormKind(ROTOR)


def test_one_that_lacks_something_else_is_asked_for_it_last() -> None:
    assert candidates_of(BRUSHES, ('dead_zone', 900.0), ('load', 800.0))[-1] == LOADED
    assert candidates_of(FormKind(THESIS), ('load', 900.0))[-1].effects == (VARYING_LOAD,)


@pytest.mark.parametrize('ratio', [1.3, float('nan')])
def test_one_that_fails_by_little_is_asked_for_it_last(ratio: float) -> None:
    assert candidates_of(BRUSHES, ('load', 900.0), ratio=ratio)[-1] == LOADED


@pytest.mark.parametrize('kind', [FormKind(THESIS), BRUSHES, BRUSHES.with_effect('hysteresis')])
@pytest.mark.parametrize('drop_v', [0.0, 0.5])
def test_a_load_with_the_brushes_that_pauses_tell_comes_first(
    kind: FormKind, drop_v: float
) -> None:
    line = StandstillLine(2.0, 0.01, drop_v, 0.02 if drop_v else 0.0)
    fit = FitAssessment(FitVerdict.MISFIT, 30.0, 900.0, (), 2048)
    candidates = FormCandidates(kind, OPEN, line).instead(fit, is_doubted=True)
    loss = ('brush_drop',) if drop_v else ()
    assert candidates[0] == FormKind(ROTOR, (VARYING_LOAD, *loss))
    assert not any(VARYING_LOAD in one.effects for one in candidates[1:])


@pytest.mark.parametrize('kind', [LOADED, LOADED.without('brush_drop')])
@pytest.mark.parametrize('suspect', ['dead_zone', 'current_offset', 'coasting', 'lost_voltage'])
def test_of_forms_with_a_load_that_varies_one_is_tried_and_last(
    kind: FormKind, suspect: str
) -> None:
    candidates = candidates_of(kind, (suspect, 900.0))
    assert [one for one in candidates if VARYING_LOAD in one.effects] == [candidates[-1]]
    assert candidates[-1].is_like(kind)


@pytest.mark.parametrize(
    ('total', 'counts'),
    [(500, [500]), (700, [700]), (768, [512, 768]), (1166, [512, 1166]), (2048, [512, 1024, 2048])],
)
def test_the_last_look_has_so_many_more_samples_that_a_load_is_fitted_again(
    total: int, counts: list[int]
) -> None:
    assert look_counts(total, growth=LAST_LOOK) == counts
    assert look_counts(total, fewest=600, growth=LAST_LOOK)[-1] == total


def test_looks_without_a_load_may_be_as_near_as_they_come() -> None:
    assert look_counts(1166) == [512, 1024, 1166]
    assert look_counts(1024, fewest=600) == [1024]
