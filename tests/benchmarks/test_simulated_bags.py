from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from common.simulated_bags import write_bag

from gray_box_observer.identify.offline_run import run
from gray_box_observer.settings.configuration import Configuration


@pytest.mark.slow
def test_the_same_seed_makes_the_same_bag_and_another_one_another(tmp_path: Path) -> None:
    for name, seed in (('a', 1), ('b', 1), ('c', 2)):
        write_bag(tmp_path / name / 'bag', seed, 2.0, start_ns=10**18)
    first, second, other = (next((tmp_path / name).rglob('*.mcap')).read_bytes() for name in 'abc')
    assert first == second != other


@pytest.mark.slow
def test_a_bag_is_of_the_motor_that_was_asked_for(tmp_path: Path) -> None:
    write_bag(tmp_path / 'bag', 1, 20.0, start_ns=10**18, resistance=2.0)
    outcome = run([tmp_path / 'bag'], Configuration.from_flat({}), None)
    assert outcome.courses['motor'].first_ns == 10**18
    assert outcome.observer.counts('motor').used_count == 2000
    np.testing.assert_allclose(
        outcome.observer.estimates()['motor'].value, [[0.5, 2.0, 10.0]], rtol=0.02
    )
