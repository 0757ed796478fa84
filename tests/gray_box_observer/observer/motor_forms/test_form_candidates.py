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
from gray_box_observer.settings.motor_configuration import VARYING_LOAD

BRUSHES = FormKind(ROTOR, ('brush_drop',))
LOADED = BRUSHES.with_effect(VARYING_LOAD)
OPEN = OpenForms(lambda kind: pytest.fail('made'), (THESIS, ROTOR), POSSIBLE_EFFECTS)


def candidates_of(kind: FormKind, *suspects: tuple[str, float]) -> tuple[FormKind, ...]:
    """Return the candidates where a misfit has such suspects."""
    suspected = tuple(Suspect(effect, evidence, 'nothing') for effect, evidence in suspects)
    fit = FitAssessment(FitVerdict.MISFIT, 30.0, 900.0, suspected, 2048)
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


def test_a_load_that_varies_has_no_rivals_but_stays_the_last_resort() -> None:
    loads = [kind for kind in candidates_of(LOADED) if VARYING_LOAD in kind.effects]
    assert loads == [LOADED.without(VARYING_LOAD).with_effect(VARYING_LOAD)]
    assert candidates_of(LOADED)[-1] in loads


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
