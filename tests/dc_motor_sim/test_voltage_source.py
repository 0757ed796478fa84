"""Voltages on the sample grid."""

from __future__ import annotations

import numpy as np
import pytest

from dc_motor_sim.excitation import parse_excitation
from dc_motor_sim.voltage_source import VoltageSource

PERIOD_NS = 10_000_000


def voltages(texts, count, *, seed=1, period_ns=PERIOD_NS, **options):
    source = VoltageSource(
        [parse_excitation(t) for t in texts], seed=seed, period_ns=period_ns, **options
    )
    return np.stack([source.step() for _ in range(count)], axis=1)  # shape: (motor, sample)


def test_a_level_of_three_seconds_holds_for_exactly_three_hundred_samples():
    series = voltages(['R[1,2]D[3,3]'], 3000)[0]
    changes = np.flatnonzero(np.diff(series)) + 1
    assert changes.tolist() == list(range(300, 3000, 300))


def test_levels_and_holds_are_uniform_in_their_ranges():
    series = voltages(['R[5,15]D[0.1,0.3]'], 100_000)[0]
    changes = np.flatnonzero(np.diff(series)) + 1
    levels = series[changes]
    holds_s = np.diff(changes) * 0.01
    assert 5.0 <= levels.min() < 5.1
    assert 14.9 < levels.max() <= 15.0
    assert levels.mean() == pytest.approx(10.0, abs=4 * np.sqrt(100 / 12 / len(levels)))
    assert 0.09 <= holds_s.min() < 0.12
    assert 0.28 < holds_s.max() <= 0.31
    assert holds_s.mean() == pytest.approx(0.2, abs=4 * np.sqrt(0.04 / 12 / len(holds_s)))


def test_a_slower_grid_sees_the_same_levels_at_the_same_instants():
    fine = voltages(['R[5,15]D[0.001,2]'], 60_000, period_ns=1_000_000)[0]
    coarse = voltages(['R[5,15]D[0.001,2]'], 600, period_ns=100_000_000)[0]
    assert coarse.tolist() == fine[::100].tolist()


def test_the_same_seed_gives_the_same_voltages_and_another_seed_others():
    texts = ['table_5_1/8', 'table_5_1/7']
    first = voltages(texts, 1000)
    assert first.tolist() == voltages(texts, 1000).tolist()
    assert not np.allclose(first, voltages(texts, 1000, seed=2))


def test_a_second_motor_has_a_stream_of_its_own_and_leaves_the_first_alone():
    pair = voltages(['table_5_1/8', 'table_5_1/8'], 1000)
    assert pair[0].tolist() == voltages(['table_5_1/8'], 1000)[0].tolist()
    assert abs(np.corrcoef(np.diff(pair))[0, 1]) < 0.2


def test_noise_is_white_with_its_deviation_and_leaves_the_levels_alone():
    noise = voltages(['R[5,15]D[1,20]+noise(0.2)'], 20_000) - voltages(['R[5,15]D[1,20]'], 20_000)
    assert noise.std() == pytest.approx(0.2, rel=0.03)
    assert abs(np.corrcoef(noise[0, 1:], noise[0, :-1])[0, 1]) < 0.03


def test_a_sine_begins_at_zero_and_has_its_amplitude_and_frequency():
    time_s = np.arange(1000) * 0.01
    assert voltages(['C[5]+sin(2,3)+sin(t)'], 1000)[0] == pytest.approx(
        5.0 + 2.0 * np.sin(3.0 * time_s) + np.sin(time_s), abs=1e-12
    )


def external(**options):
    return VoltageSource(
        [parse_excitation('external'), parse_excitation('C[3]')],
        seed=1,
        period_ns=PERIOD_NS,
        **options,
    )


def test_an_external_motor_has_no_voltage_until_a_command_which_then_holds():
    source = external()
    assert source.step().tolist() == [0.0, 3.0]
    assert source.command(0, 7.5)
    assert [source.step()[0] for _ in range(1000)] == [7.5] * 1000


@pytest.mark.parametrize('voltage_v', [float('nan'), float('inf'), -float('inf'), 2e4])
def test_a_command_that_no_motor_should_see_is_refused_and_the_last_one_holds(voltage_v):
    source = external()
    source.command(0, 7.5)
    assert not source.command(0, voltage_v)
    assert source.step()[0] == 7.5


def test_a_motor_with_its_own_excitation_takes_no_command():
    source = external()
    assert not source.command(1, 9.0)
    assert source.step()[1] == 3.0


def test_a_command_older_than_the_timeout_counts_as_zero():
    source = external(command_timeout_s=0.05)
    source.command(0, 7.5)
    assert [source.step()[0] for _ in range(7)] == [7.5] * 5 + [0.0] * 2
    source.command(0, 4.0)
    assert source.step()[0] == 4.0
