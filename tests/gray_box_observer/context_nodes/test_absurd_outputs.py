"""Signals that no motor can have leave rules with outputs without a fit, and end nothing."""

from __future__ import annotations

import numpy as np
import pytest

from gray_box_observer.context_nodes.recursive.normal_equations import shortest_solution
from gray_box_observer.observer.observer import Observer
from gray_box_observer.settings.configuration import Configuration

PERIOD_NS = 10_000_000
SPEEDS = {
    'constant': lambda k: 1.0,
    'zero': lambda k: 0.0,
    'huge': lambda k: 1e150 * (-1.0) ** k,
    'tiny': lambda k: 1e-200 * (k % 3),
    'as the torque': lambda k: 0.02 * (1.5 + k % 5),
}


@pytest.mark.parametrize('speed_name', SPEEDS)
def test_a_speed_that_no_rotor_can_have_ends_nothing(speed_name: str) -> None:
    observer = Observer(
        Configuration.from_flat({'predictor': False, 'motor.torque_constant': 0.02})
    )
    for k in range(600):
        observer.voltage('motor', k * PERIOD_NS, 5.0 + k % 7)
        observer.torque('motor', k * PERIOD_NS, 0.02 * (1.5 + k % 5), SPEEDS[speed_name](k))
    assert observer.incidents == {}
    assert all(estimate.is_finite for estimate in observer.estimates().values())
    counts = observer.counts('motor')
    refused = counts.refusal_counts['torque'].total()
    assert counts.used_count + counts.waiting_count + refused == 600
    assert (refused == 600) == (speed_name == 'huge'), 'only what cannot be is refused'


def test_singular_equations_have_their_shortest_solution_and_broken_ones_none() -> None:
    singular = np.array([[1.0, 1.0], [1.0, 1.0]])
    assert shortest_solution(singular, np.array([2.0, 2.0])) == pytest.approx([1.0, 1.0])
    assert shortest_solution(np.eye(2), np.array([3.0, 4.0])) == pytest.approx([3.0, 4.0])
    assert np.isnan(shortest_solution(np.array([[np.nan, 0.0], [0.0, 1.0]]), np.ones(2))).all()
