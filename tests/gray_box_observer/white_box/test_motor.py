from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest
import torch

from gray_box_observer.errors import ConfigurationError
from gray_box_observer.white_box import TERMS, MotorWhiteBox
from gray_box_observer.white_box.balance import Balance
from gray_box_observer.white_box.declaration import State

ALL = ('inductance', 'resistance', 'hysteresis', 'back_emf_constant', 'brush_drop')
CURRENTS = np.array([-9.0, -1.0, -0.05, 0.03, 0.7, 12.0])
SPEEDS = np.array([0.5, -3.0, 2.0, -0.2, 7.0, 100.0])


def electrical(box: MotorWhiteBox, current: Any, speed: Any) -> tuple[Balance, tuple[Any, ...]]:
    """The balance of the current, and its signals."""
    balance = box.balances(current)[State.CURRENT]
    return balance, balance.signals([current], speed, 0.0 * current)


@pytest.mark.parametrize(
    'name', [n for n, term in TERMS.items() if term.formula and term.state is State.CURRENT]
)
@pytest.mark.parametrize('speed_measured', [True, False])
def test_the_slope_of_every_term_is_its_finite_difference(name: str, speed_measured: bool) -> None:
    is_known = TERMS[name].needs_speed and not speed_measured  # known, it enters through the drive
    nodes, known = (('inductance',), {name: 1.0}) if is_known else (('inductance', name), {})
    box = MotorWhiteBox(nodes, 0.3, known, speed_measured)

    def value(current: np.ndarray) -> Any:
        balance, signals = electrical(box, current, SPEEDS)
        return -balance.drive(signals) if is_known else balance.basis(signals)[0]

    balance, signals = electrical(box, CURRENTS, SPEEDS)
    drop = -balance.drive_slope(State.CURRENT, signals)
    slope = drop if is_known else balance.basis_slope(State.CURRENT, signals)[0]
    h = 1e-6
    expected = (value(CURRENTS + h) - value(CURRENTS - h)) / (2 * h)
    np.testing.assert_allclose(
        np.broadcast_to(slope, CURRENTS.shape), expected, rtol=1e-5, atol=1e-7
    )


def test_a_known_term_moves_from_the_unknowns_to_the_drive() -> None:
    unknown = MotorWhiteBox(ALL, 0.3, {}, True)
    known = MotorWhiteBox(('inductance', 'resistance'), 0.3, dict.fromkeys(ALL[2:], 0.7), True)
    rest = sum(0.7 * phi for phi in unknown.basis(24.0 + 0 * CURRENTS, CURRENTS, SPEEDS)[1:])
    np.testing.assert_allclose(
        known.drive(24.0 + 0 * CURRENTS, CURRENTS, SPEEDS), 24.0 - rest, rtol=1e-14
    )


def test_hysteresis_takes_energy_in_all_four_quadrants() -> None:
    box = MotorWhiteBox(('inductance', 'hysteresis'), 0.3, {}, True)
    for current in (-2.0, 2.0):
        for speed in (-5.0, 5.0):
            assert (
                box.basis(np.ones(1), np.array([current]), np.array([speed]))[0][0] * current > 0.0
            )


def test_torque_and_current_turn_into_each_other_motor_by_motor() -> None:
    box = MotorWhiteBox(('inductance',), np.array([0.1, 0.5]))
    torque = np.array([[1.0, 2.0, 3.0], [1.0, 2.0, 3.0]])
    np.testing.assert_allclose(box.state(torque), [[10.0, 20.0, 30.0], [2.0, 4.0, 6.0]])
    np.testing.assert_allclose(box.output(box.state(torque)), torque)


@pytest.mark.parametrize('measured', [True, False])
def test_speed_is_the_measured_one_or_that_of_the_thesis(measured: bool) -> None:
    box = MotorWhiteBox(('inductance',), 0.3, {}, measured)
    np.testing.assert_allclose(box.speed(CURRENTS, SPEEDS), SPEEDS if measured else 0.3 * CURRENTS)


@pytest.mark.parametrize(
    ('arguments', 'message'),
    [
        ((('inductance', 'reluctance'), 0.01), "no term named 'reluctance'"),
        ((('inductance',), 0.01, {'mass': 1.0}), "no term named 'mass'"),
        ((('resistance', 'inductance'), 0.01), 'must begin with inductance'),
        (((), 0.01), 'must begin with inductance'),
        ((('inductance', 'resistance', 'resistance'), 0.01), 'twice'),
        ((('inductance', 'back_emf_constant'), 0.01), 'without measured speed'),
        ((('inductance',), 0.0), 'torque_constant must be positive'),
        ((('inductance',), float('nan')), 'torque_constant must be positive'),
        (
            (('inductance',), [0.01, 0.02]),
            r'torque_constant must be a number or an array .* got \[0.01, 0.02\]',
        ),
        ((('inductance',), '0.01'), "torque_constant must be a number or an array .* got '0.01'"),
        ((('inductance',), np.array([0.01, -0.02])), 'torque_constant must be positive'),
    ],
)
def test_a_white_box_that_cannot_be_is_refused_in_one_line(
    arguments: tuple[Any, ...], message: str
) -> None:
    with pytest.raises(ConfigurationError, match=message) as caught:
        MotorWhiteBox(*arguments)
    assert '\n' not in str(caught.value)


def test_inductance_cannot_be_a_known_constant() -> None:
    box = MotorWhiteBox(('inductance', 'resistance'), 0.01, {'inductance': 0.5})
    np.testing.assert_allclose(
        box.drive(np.ones(1), np.ones(1), np.ones(1)), 1.0
    )  # it is unknown all the same


def test_a_description_survives_json_and_makes_the_same_white_box() -> None:
    box = MotorWhiteBox(
        ALL[:3], np.array([0.1, 0.2]), {'back_emf_constant': np.array([0.3, 0.4])}, True
    )
    again = MotorWhiteBox.from_dict(json.loads(json.dumps(box.to_dict())))
    assert again.to_dict() == box.to_dict()
    signal = np.ones((2, 3))
    np.testing.assert_array_equal(
        again.drive(signal, signal, 2 * signal), box.drive(signal, signal, 2 * signal)
    )


def test_motors_can_be_chosen_and_repeated() -> None:
    box = MotorWhiteBox(('inductance',), np.array([0.1, 0.2, 0.4]), {'brush_drop': 0.5})
    chosen = box.of_motors(np.array([2, 0, 2]))
    np.testing.assert_allclose(chosen.torque_constant, [0.4, 0.1, 0.4])
    assert chosen.known['brush_drop'] == 0.5


def test_parameters_come_in_the_order_of_the_context_nodes_with_room_around_their_start() -> None:
    box = MotorWhiteBox(('inductance', 'hysteresis', 'resistance'), 0.01)
    assert [p.name for p in box.parameters] == ['inductance', 'hysteresis', 'resistance']
    for term in TERMS.values():
        p = term.parameter
        assert 0.0 < p.lower < p.initial < p.upper
        assert p.unit
        assert p.description.endswith('.')


@pytest.mark.parametrize('measured', [True, False])
def test_tensors_give_what_arrays_give(measured: bool) -> None:
    names = ALL if measured else ALL[:3]
    box = MotorWhiteBox(
        names, np.array([0.3, 0.1]), {'back_emf_constant': np.array([0.2, 0.1])}, measured
    )
    twin = MotorWhiteBox.from_dict(box.to_dict(), lambda v: torch.as_tensor(v, dtype=torch.float64))
    i, w = np.stack([CURRENTS, -CURRENTS]), np.stack([SPEEDS, SPEEDS])
    ti = torch.as_tensor(i)
    tw = torch.as_tensor(w)
    balance, signals = electrical(box, i, w)
    tensors, of_twin = electrical(twin, ti, tw)
    pairs = [
        *zip(box.basis(i, i, w), twin.basis(ti, ti, tw), strict=True),
        *zip(
            balance.basis_slope(State.CURRENT, signals),
            tensors.basis_slope(State.CURRENT, of_twin),
            strict=True,
        ),
        (box.drive(i, i, w), twin.drive(ti, ti, tw)),
        (
            balance.drive_slope(State.CURRENT, signals),
            tensors.drive_slope(State.CURRENT, of_twin),
        ),
        (box.state(i), twin.state(ti)),
        (box.speed(i, w), twin.speed(ti, tw)),
    ]
    for array, tensor in pairs:
        np.testing.assert_allclose(np.asarray(tensor), array, rtol=1e-13)
