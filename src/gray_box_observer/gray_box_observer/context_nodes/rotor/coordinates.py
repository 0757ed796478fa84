"""The motor with every term, and how its coordinates follow from the context nodes.

A coordinate is the inverse of a storage, or the coefficient of an effect over the storage of its
state: the rate of every state is linear in them (:mod:`gray_box_observer.white_box.flow`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from gray_box_observer.white_box import forms
from gray_box_observer.white_box.balance import Balance
from gray_box_observer.white_box.declaration import TERMS, State
from gray_box_observer.white_box.interface import Array
from gray_box_observer.white_box.motor import STORAGES, MotorWhiteBox

COORDINATES = len(TERMS)
_PLACES = {name: place for place, name in enumerate(TERMS)}


@dataclass(frozen=True)
class WholeMotor:
    """A motor that has every term; what :func:`gray_box_observer.white_box.flow.rate` asks of it.

    Attributes:
        torque_constant: Kt in N m/A.
    """

    torque_constant: float

    def balances(self, signal: Any) -> tuple[Balance, ...]:
        """Return the balance of every state."""
        return tuple(self._balance(state) for state in State)

    def _balance(self, state: State) -> Balance:
        names = [name for name, term in TERMS.items() if term.state is state and term.formula]
        effects = [forms.SHARP_EFFECTS[name] for name in names]
        return Balance(
            storage=_PLACES[STORAGES[state]],
            places=tuple(_PLACES[name] for name in names),
            unknown_effects=tuple(form.value for form in effects),
            unknown_slopes=tuple(tuple(form.partial[by] for form in effects) for by in State),
            known_effects=(),
            known_slopes=tuple(() for _ in State),
            drive_form=forms.DRIVES[state],
            torque_constant=self.torque_constant,
            speed_measured=False,
            following_speed=None,
        )


def coordinates(white_box: MotorWhiteBox, theta: Array) -> Array:
    """Return the coordinates of the whole motor, shape (coordinate,).

    Args:
        white_box: of one motor with a rotor.
        theta: shape (parameter,): its context nodes.
    """
    values = white_box.values(theta)
    result = np.zeros(COORDINATES)
    for name, term in TERMS.items():
        storage = values[STORAGES[term.state]]
        result[_PLACES[name]] = (values.get(name, 0.0) if term.formula else 1.0) / storage
    return result


def slopes(white_box: MotorWhiteBox, p: Array) -> Array:
    """Derivatives of the coordinates by the logarithms of the context nodes.

    Args:
        white_box: of one motor with a rotor.
        p: shape (coordinate,): :func:`coordinates` of them.

    Returns:
        Shape (coordinate, parameter).
    """
    result = np.zeros((COORDINATES, len(white_box.context_nodes)))
    for node, name in enumerate(white_box.context_nodes):
        term = TERMS[name]
        if term.formula:
            part = float(white_box.known_parts[node])
            result[_PLACES[name], node] = p[_PLACES[name]] - part * p[_PLACES[STORAGES[term.state]]]
            continue
        for other, place in _PLACES.items():
            if TERMS[other].state is term.state:
                result[place, node] = -p[place]
    return result
