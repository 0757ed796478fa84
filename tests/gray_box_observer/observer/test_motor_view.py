"""What is said of one motor's delay beside its fit."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import pytest

from gray_box_observer.delay import DelayEstimate
from gray_box_observer.delay.watch import DelayVerdict
from gray_box_observer.fit_test import FitAssessment, FitVerdict, Suspect
from gray_box_observer.observer.motor_view import MotorView


@pytest.mark.parametrize(
    ('verdict', 'suspects', 'is_told'),
    [
        (FitVerdict.OK, (), True),
        (FitVerdict.WARNING, ('rotor',), True),
        (FitVerdict.MISFIT, (), True),
        (FitVerdict.MISFIT, ('delay', 'torque_sign'), True),
        (FitVerdict.MISFIT, ('torque_sign', 'delay'), False),
    ],
)
def test_of_a_misfit_a_delay_is_told_only_where_it_is_the_likeliest(
    verdict: FitVerdict, suspects: tuple[str, ...], is_told: bool
) -> None:
    fit = FitAssessment(verdict, 9.0, 9.0, tuple(Suspect(one, 1.0, 'x') for one in suspects), 100)
    delay = DelayEstimate(0.0, False, 0.01, 1e-4, DelayVerdict.UNDECLARED)
    stub = SimpleNamespace(
        fit_of=lambda place: fit,
        delay_of=lambda place: delay,
        configuration_of=lambda place: SimpleNamespace(name='wheel'),
        context_nodes=None,
    )
    view = MotorView(cast('Any', stub), 0)
    said = view.delay_complaint
    assert (said is not None) == is_told
    assert said is None or 'set wheel.delay to 0.01' in said
