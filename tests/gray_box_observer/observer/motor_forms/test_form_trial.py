"""In which order a trial compares forms, and what it spares."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from gray_box_observer.context_nodes.pieces import Pieces, completed
from gray_box_observer.observer.motor_forms.form_trial import FormTrial
from gray_box_observer.observer.motor_forms.motor_form import (
    POSSIBLE_EFFECTS,
    ROTOR,
    THESIS,
    FormKind,
)
from gray_box_observer.observer.motor_forms.open_forms import OpenForms
from gray_box_observer.observer.motor_forms.trial_start import TrialStart
from gray_box_observer.settings.motor_configuration import VARYING_LOAD

PLAIN = FormKind(ROTOR)
BRUSHES = FormKind(ROTOR, ('brush_drop',))
LOADED = BRUSHES.with_effect(VARYING_LOAD)
OPEN = OpenForms(lambda kind: pytest.fail('made'), (THESIS, ROTOR), POSSIBLE_EFFECTS)


def comparisons_of(
    *candidates: FormKind, is_misfit: bool = True, has_load: bool = False, samples: int = 2048
) -> list[tuple[str, FormKind]]:
    """Return what is compared, and how, where nothing is better.

    Args:
        candidates: of the trial.
        is_misfit: whether rotors fail.
        has_load: whether a load that varies explains the samples.
        samples: at 1 kHz.
    """
    content = np.zeros((6, 1, samples))
    content[0] = 1e-3
    start = TrialStart(BRUSHES, candidates, 6, 1, content, 0, before_a=1.0)
    trial: Any = FormTrial(start, OPEN)
    trial._fewest_misfit = 1024
    comparisons = []

    def noted(how: str) -> Any:
        def compare(*arguments: Any) -> Pieces[None]:
            kind = next(one for one in arguments if isinstance(one, FormKind))
            if how == 'alone' and kind.source == ROTOR and is_misfit:
                trial._misfits[kind] = None
            if how == 'load' and has_load:
                trial._load_fit = SimpleNamespace(explains=True)
            comparisons.append((how, kind))
            yield from ()

        return compare

    trial._compare = noted('alone')
    trial._compare_load = noted('load')
    trial._compare_load_beside_loss = noted('loss')
    trial._compare_searched = noted('search')
    for _, work in trial._comparisons():
        completed(work)
    return comparisons


def test_a_load_in_the_midst_comes_before_rivals_and_what_a_rotor_may_need_last() -> None:
    comparisons = comparisons_of(BRUSHES, LOADED, PLAIN)
    assert [how for how, _ in comparisons] == [
        *('alone', 'load', 'alone', 'search', 'search', 'load', 'loss', 'search', 'search'),
    ]
    assert comparisons[1] == ('load', LOADED)


def test_the_last_one_comes_behind_a_short_search() -> None:
    comparisons = comparisons_of(BRUSHES, LOADED)
    assert [how for how, _ in comparisons] == ['alone', 'search', 'load', 'loss', 'search']


def test_where_a_load_explains_the_samples_nothing_is_searched() -> None:
    hows = [how for how, _ in comparisons_of(BRUSHES, LOADED, PLAIN, has_load=True)]
    assert 'search' not in hows


@pytest.mark.parametrize('candidates', [(BRUSHES, LOADED, PLAIN), (BRUSHES, LOADED)])
def test_no_load_is_asked_for_where_rotors_explain_or_samples_are_few(
    candidates: tuple[FormKind, ...],
) -> None:
    for comparisons in (
        comparisons_of(*candidates, is_misfit=False),
        comparisons_of(*candidates, samples=900),
    ):
        assert not {'load', 'loss'} & {how for how, _ in comparisons}


def test_without_candidates_of_a_load_none_is_asked_for() -> None:
    assert comparisons_of(FormKind(THESIS), is_misfit=False) == [('alone', FormKind(THESIS))]


def test_a_load_is_fitted_once() -> None:
    content = np.zeros((6, 1, 2048))
    start = TrialStart(BRUSHES, (BRUSHES, LOADED, PLAIN), 6, 1, content, 0, before_a=1.0)
    trial: Any = FormTrial(start, OPEN)
    calls = []

    def alone(kind: FormKind, fewest: int) -> Pieces[None]:
        calls.append(kind)
        yield from ()

    trial._loads = SimpleNamespace(alone=alone)
    outcomes = [completed(trial._compare_load(LOADED)) for _ in range(2)]
    assert calls == [LOADED]
    assert outcomes[0] is outcomes[1]
    assert outcomes[0].form is None
