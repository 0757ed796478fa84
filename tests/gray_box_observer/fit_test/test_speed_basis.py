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
        ('measured', 1, SpeedBasis.MEASURED),
        ('measured', 2, SpeedBasis.EXACT),
        ('torque_constant', 2, SpeedBasis.ASSUMED),
    ],
)
def test_the_form_and_the_company_of_a_motor_say_what_its_speed_is(
    source: str, motors: int, basis: SpeedBasis
) -> None:
    flat = {'motor.speed_source': source, 'motor.back_emf_constant': 0.02}
    motor = Configuration.from_flat(flat).motors['motor']
    white_box = motor.white_box(speed_measured=source == 'measured')
    assert SpeedBasis.from_form(white_box, motors) is basis


NAMES = ('inductance', 'resistance')


@pytest.mark.parametrize(
    ('basis', 'verdict', 'ratio', 'samples', 'count'),
    [
        (SpeedBasis.HIDDEN, OK, 1.09, 4096, 0),
        (SpeedBasis.HIDDEN, OK, 1.12, 4096, 2),
        (SpeedBasis.HIDDEN, OK, 1.19, 400, 0),
        (SpeedBasis.HIDDEN, OK, 1.21, 400, 2),
        (SpeedBasis.HIDDEN, WARNING, 1.02, 2048, 0),
        (SpeedBasis.MEASURED, OK, 1.12, 4096, 1),
        (SpeedBasis.MEASURED, WARNING, 1.05, 2048, 0),
        (SpeedBasis.EXACT, OK, 1.25, 2048, 1),
        (SpeedBasis.EXACT, WARNING, 1.05, 2048, 2),
        (SpeedBasis.ASSUMED, WARNING, 3.0, 2048, 0),
    ],
)
def test_a_weaker_basis_bears_less(
    basis: SpeedBasis, verdict: FitVerdict, ratio: float, samples: int, count: int
) -> None:
    """Of few: the inductance first."""
    open_names = basis.open_parameters(FitAssessment(verdict, ratio, 1.0, (), samples), NAMES)
    assert open_names == set(NAMES[:count])
