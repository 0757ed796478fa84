"""Quantiles and distinct values, against numpy's own, to the bit."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from gray_box_observer.samples.order_statistics import distinct, median, quantile


@pytest.mark.parametrize('share', [0.0, 0.02, 0.5, 0.9, 0.98, 0.99, 1.0])
@pytest.mark.parametrize('count', [1, 2, 7, 40, 4096])
def test_a_quantile_is_numpys(count: int, share: float) -> None:
    values = np.random.default_rng(count).normal(size=(3, count))
    kept = values.copy()
    np.testing.assert_array_equal(quantile(values, share), np.quantile(values, share, axis=1))
    np.testing.assert_array_equal(values, kept)


@pytest.mark.parametrize('count', [1, 2, 3, 40, 4097])
def test_a_median_is_numpys(count: int) -> None:
    values = np.random.default_rng(count).normal(size=(3, count))
    np.testing.assert_array_equal(median(values), np.median(values, axis=1))


def test_where_a_value_is_none_nothing_is_told() -> None:
    values = np.array([[1.0, np.nan, 3.0], [1.0, 2.0, 3.0]])
    np.testing.assert_array_equal(median(values), [np.nan, 2.0])
    np.testing.assert_array_equal(quantile(values, 0.5), [np.nan, 2.0])
    assert np.isnan(median(np.empty(0)))


@pytest.mark.parametrize('count', [0, 1, 5, 300])
def test_distinct_values_are_numpys(count: int) -> None:
    values = np.random.default_rng(count).integers(-20, 20, count) * 0.1
    np.testing.assert_array_equal(distinct(values), np.unique(values))


@pytest.mark.slow
def test_no_fit_loads_masked_arrays(tmp_path: Path) -> None:
    script = tmp_path / 'fit.py'
    script.write_text(
        'import math, sys\n'
        'from gray_box_observer.observer import Observer\n'
        'from gray_box_observer.settings import Configuration\n'
        "one = Observer(Configuration.from_flat({'motor.torque_constant': 0.01}))\n"
        'current = 0.0\n'
        'for k in range(600):\n'
        '    volt = 5.0 * math.copysign(1.0, math.sin(0.3 * k))\n'
        "    one.voltage('motor', k * 1_000_000, volt)\n"
        "    one.torque('motor', k * 1_000_000, 0.01 * round(current, 4))\n"
        '    current += 1e-3 * (volt - 1.0 * current) / 2e-3\n'
        "assert one.motors['motor'].estimate.identified(0) is not None\n"
        "sys.exit('numpy.ma' in sys.modules)\n"
    )
    subprocess.run([sys.executable, str(script)], check=True, timeout=120)
