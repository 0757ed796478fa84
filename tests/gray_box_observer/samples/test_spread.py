"""The spread of readings that are all the same is none, however their mean is rounded."""

from __future__ import annotations

import numpy as np
import pytest

from gray_box_observer.samples.spread import spread


@pytest.mark.parametrize('value', [0.0, 0.1, 0.3, -1.7e-9, 3.3e8])
@pytest.mark.parametrize('count', [1, 3, 1000, 99_991])
def test_equal_readings_have_no_spread(value: float, count: int) -> None:
    assert spread(np.full(count, value)) is None


@pytest.mark.parametrize('offset', [0.0, 0.1, 1e5])
def test_readings_that_differ_have_their_standard_deviation(offset: float) -> None:
    readings = offset + 1e-6 * np.random.default_rng(1).normal(size=1000)
    assert spread(readings) == np.std(readings)
