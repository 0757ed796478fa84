"""How large a residual a fit bears, by what its speed rests on."""

from __future__ import annotations

import pytest

from gray_box_observer.fit_test import FitAssessment, FitVerdict
from gray_box_observer.fit_test.speed_basis import SpeedBasis
from gray_box_observer.settings.configuration import Configuration

OK = FitVerdict.OK
WARNING = FitVerdict.WARNING


@pytest.mark.parametrize(
    ('source', 'motors', 'basis'),
    [
        ('rotor', 1, SpeedBasis.HIDDEN),
        ('measured', 1, SpeedBasis.SOUND),
        ('measured', 2, SpeedBasis.EXACT),
        ('torque_constant', 2, SpeedBasis.SOUND),
    ],
)
def test_the_form_and_the_company_of_a_motor_say_what_its_speed_is(
    source: str, motors: int, basis: SpeedBasis
) -> None:
    flat = {'motor.speed_source': source, 'motor.back_emf_constant': 0.02}
    motor = Configuration.from_flat(flat).motors['motor']
    white_box = motor.white_box(speed_measured=source == 'measured')
    assert SpeedBasis.from_form(white_box, motors) is basis


@pytest.mark.parametrize(
    ('basis', 'verdict', 'ratio', 'samples', 'is_borne'),
    [
        (SpeedBasis.HIDDEN, OK, 1.09, 4096, True),
        (SpeedBasis.HIDDEN, OK, 1.12, 4096, False),
        (SpeedBasis.HIDDEN, OK, 1.19, 400, True),
        (SpeedBasis.HIDDEN, OK, 1.21, 400, False),
        (SpeedBasis.HIDDEN, WARNING, 1.02, 2048, True),
        (SpeedBasis.EXACT, OK, 1.25, 2048, True),
        (SpeedBasis.EXACT, WARNING, 1.05, 2048, False),
        (SpeedBasis.SOUND, WARNING, 3.0, 2048, True),
    ],
)
def test_a_weaker_basis_bears_less(
    basis: SpeedBasis, verdict: FitVerdict, ratio: float, samples: int, is_borne: bool
) -> None:
    assert basis.bears(FitAssessment(verdict, ratio, 1.0, (), samples)) == is_borne
