"""The benchmark of wirings still runs, on one mistake of one robot."""

from __future__ import annotations

import pytest
import wirings
from common.wirings.mistakes import MISTAKES

NAMES = [mistake.name for mistake in MISTAKES]


@pytest.mark.slow
@pytest.mark.parametrize('name', ['sign of the voltage', 'gain 0.9'])
def test_a_mistake_on_a_drawn_robot_is_named_and_nothing_wrong_is_believed(name: str) -> None:
    trial = wirings.try_mistake(NAMES.index(name), seed=0)
    assert (trial.mistake, trial.seed) == (name, 0)
    assert any(trial.named)
    assert trial.wrong == []


@pytest.mark.slow
def test_of_a_robot_that_is_wired_rightly_nothing_is_said() -> None:
    assert wirings.false_flags(10.5, seed=10_000) == ([], [])


def test_a_row_of_the_table_counts_robots_and_wheels() -> None:
    trials = [
        wirings.Trial('mA', 3, (True, False), []),
        wirings.Trial('mA', 4, (False, False), ['left.resistance']),
        wirings.Trial('ms', 3, (True, True), []),
    ]
    assert wirings._row('mA', trials) == ['mA', '1 of 2', '1 of 4', '4', 'left.resistance']
