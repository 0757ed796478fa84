"""A small, fixed share of the search of `core_search`, and sequences that once broke it."""

from __future__ import annotations

import pytest
from core_search import (
    ROTORS,
    SEQUENCES,
    Action,
    Gap,
    Operation,
    Regular,
    Repeat,
    Setup,
    examine,
    setups,
)
from hypothesis import HealthCheck, Phase, given, settings


@settings(
    derandomize=True,
    max_examples=25,
    deadline=None,
    database=None,
    phases=(Phase.generate,),
    suppress_health_check=list(HealthCheck),
)
@given(setups(), SEQUENCES)
def test_no_sequence_breaks_the_core_or_its_books_or_depends_on_the_door(
    setup: Setup, whole: list[Action]
) -> None:
    examine(setup, whole)


BROKEN: dict[str, tuple[Setup, list[Action]]] = {
    'a voltage that drops out for half a second': (
        Setup(),
        [Regular(1021), Regular(55, missing=('voltage',)), Regular(100)],
    ),
    'speeds that come and go while torque waits for its voltage': (
        Setup(speed='in torque'),
        [
            Regular(1, missing=('torque',)),
            Regular(2, missing=('voltage',)),
            Regular(2, missing=('voltage', 'speed')),
            Regular(60),
        ],
    ),
    'torque next to nothing, whose covariance for unit noise is huge, and a new start': (
        Setup(speed='in torque', changes=(('*.speed_source', 'torque_constant'),)),
        [
            Repeat(31),
            Regular(76, missing=('speed',), kind='tiny', spoilt='torque', lead=20),
            Repeat(28),
            Operation('restart'),
            Gap(150),
        ],
    ),
    'a speed at 1 kHz whose rule has gone back to the samples of a fit, and a new start': (
        Setup(speed='in torque', predictor=False),
        [Regular(1021, period_ms=1), Operation('restart'), Regular(300, period_ms=1)],
    ),
    'a fit beside a speed of its own topic, which goes on when the bag has ended': (
        Setup(speed='own topic', predictor=False),
        [Regular(1500)],
    ),
    'a measured rotor whose speed comes with the torque': (
        Setup(speed='in torque', predictor=False, changes=ROTORS[1:]),
        [Regular(1100), Gap(300), Regular(300)],
    ),
    'a fit that ends between a forecast and the sample that it is of': (
        Setup(speed='own topic', changes=(('speed.expression', 'diff(angle)'),)),
        [Regular(130, spoilt='voltage'), Operation('flush'), Regular(1)],
    ),
}

KINDS: dict[str, tuple[Setup, list[Action]]] = {
    'a hidden rotor, whose windows are searched piece by piece': (
        Setup(predictor=False, changes=ROTORS[:1]),
        [Regular(1500), Operation('restart'), Regular(300)],
    ),
    'hidden rotors in the same messages': (
        Setup(motors=2, predictor=False, changes=(*ROTORS[:1], ('group_from', 2))),
        [
            Regular(700),
            Regular(40, missing=('torque',), spoken_of='some'),
            Operation('freeze', argument=True),
            Regular(60),
            Operation('freeze', argument=False),
            Gap(600),
            Regular(500, spoken_of='some'),
            Operation('restart'),
            Regular(300, missing=('voltage',), spoken_of='some'),
        ],
    ),
    'a current and a voltage that is an expression': (
        Setup(changes=(('torque.quantity', 'current'), ('voltage.expression', '0.5 * raw'))),
        [Regular(1021), Regular(55, missing=('voltage',)), Regular(100)],
    ),
    'a speed that is the rate of an angle': (
        Setup(speed='own topic', changes=(('speed.expression', 'diff(angle)'),)),
        [Regular(300), Regular(30, missing=('speed',)), Regular(100)],
    ),
}


@pytest.mark.parametrize('name', BROKEN)
def test_what_once_broke_something_does_so_no_more(name: str) -> None:
    examine(*BROKEN[name])


@pytest.mark.parametrize('name', KINDS)
def test_a_rotor_a_current_and_an_expression_are_the_same_whichever_door_they_take(
    name: str,
) -> None:
    examine(*KINDS[name])
