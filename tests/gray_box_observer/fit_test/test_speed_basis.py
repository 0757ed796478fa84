"""How large a residual a fit bears, by what its speed rests on."""

from __future__ import annotations

from dataclasses import replace

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
        (SpeedBasis.HIDDEN, OK, 1.17, 512, 0),
        (SpeedBasis.HIDDEN, OK, 1.18, 512, 2),
        (SpeedBasis.HIDDEN, OK, 1.0, 511, 2),
        (SpeedBasis.ASSUMED, OK, 1.0, 100, 0),
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
    withheld = basis.withheld(FitAssessment(verdict, ratio, 1.0, (), samples), NAMES)
    names = () if withheld is None else withheld.names
    assert names == NAMES[:count]


def test_what_is_withheld_is_said_with_its_remedy() -> None:
    fit = FitAssessment(OK, 1.2, 1.0, (), 4096)
    withheld = SpeedBasis.HIDDEN.withheld(fit, NAMES)
    assert not fit.has_advice
    told = replace(fit, withheld=withheld)
    assert told.has_advice
    assert told.to_dict()['withheld'] == ['inductance', 'resistance']
    assert told.sentence == (
        'The white box explains the data: the residual of the free run is 1.2 times the noise. '
        'So much leaves open: inductance, resistance. The cause may be a filter of the current: '
        'send it as it is measured, or undo a moving average by torque.expression: '
        'unsmoothed(raw, WEIGHT); send the speed too, where there is one.'
    )


def test_of_a_misfit_nothing_is_believed_anyway() -> None:
    fit = FitAssessment(FitVerdict.MISFIT, 9.0, 1.0, (), 4096)
    assert SpeedBasis.HIDDEN.withheld(fit, NAMES) is None
