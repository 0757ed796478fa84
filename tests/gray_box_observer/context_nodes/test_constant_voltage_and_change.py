"""A voltage held for long, and a winding that warms: what may be believed, and what follows."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import pytest

from dc_motor_sim.plant import PlantParameters
from dc_motor_sim.simulation import Recording, Simulation
from gray_box_observer.context_nodes import Estimate, RecursiveEstimator, RecursiveSettings, Verdict
from gray_box_observer.samples import Sample
from gray_box_observer.white_box import MotorWhiteBox

TRUTH = np.array([0.5, 1.0, 10.0])
THREE_TIMES_OFF = np.array([[1.5, 3.0, 30.0]])
NOISE_NM = 1.1e-4
"""A hundredth of the torque's spread."""

L, R, K_HS = range(3)

Samples = Sequence[Sample]


def teach(nodes: RecursiveEstimator, samples: Samples) -> list[Estimate]:
    """Learn samples one by one; return the estimate after each that changed it."""
    return [nodes.estimate() for sample in samples if nodes.learn(sample)]


def held_on(
    last: Sample, seconds: float, noise_nm: float, seed: int, resistance: float = 1.0
) -> list[Sample]:
    """The thesis's motor under the last sample's voltage for ever: steady torque in noise."""
    volt = float(last.voltage_v[0])
    random = np.random.default_rng(seed)
    total = resistance + 1e-4  # V = (R + Kb Kt) i + K_HS Kt i^2
    current_a = (-total + np.sqrt(total**2 + 0.4 * volt)) / 0.2
    noise = noise_nm * random.standard_normal(round(seconds * 100.0))
    return [
        Sample.of_one_motor(
            last.stamp_ns + (k + 1) * 10_000_000, 0.01, volt, 0.01 * current_a + float(noise[k])
        )
        for k in range(noise.size)
    ]


@pytest.mark.slow
@pytest.mark.parametrize('seed', [1, 2])
def test_ten_minutes_of_constant_voltage_neither_move_nor_assure_what_they_do_not_excite(
    thesis_box: MotorWhiteBox,
    record: Callable[..., Recording],
    samples_of: Callable[..., Samples],
    seed: int,
) -> None:
    samples = list(samples_of(record('R[5,15]D[3,3]', 60.0, seed, torque_noise_std=NOISE_NM)))
    nodes = RecursiveEstimator(thesis_box, THREE_TIMES_OFF)
    before = teach(nodes, samples)[-1]
    after = teach(nodes, held_on(samples[-1], 600.0, float(nodes.noise_std_nm[0]), seed))[-1]
    for unexcited in (L, K_HS):
        assert after.std[0, unexcited] > 0.98 * before.std[0, unexcited]
        assert (
            abs(after.value[0, unexcited] - before.value[0, unexcited])
            < 0.5 * before.std[0, unexcited]
        )
    assert np.all(np.abs(after.value[0] - TRUTH) < 4.0 * after.std[0])
    assert nodes.change_count == 0


def test_without_a_limit_the_level_would_have_been_taken_for_news_of_everything(
    thesis_box: MotorWhiteBox, record: Callable[..., Recording], samples_of: Callable[..., Samples]
) -> None:
    samples = list(samples_of(record('R[5,15]D[3,3]', 60.0, 1, torque_noise_std=NOISE_NM)))
    nodes = RecursiveEstimator(
        thesis_box, THREE_TIMES_OFF, rules=RecursiveSettings(long_hold_s=1e9)
    )
    before = teach(nodes, samples)[-1]
    after = teach(nodes, held_on(samples[-1], 600.0, float(nodes.noise_std_nm[0]), 1))[-1]
    assert after.std[0, K_HS] < 0.95 * before.std[0, K_HS]


def test_a_warming_winding_is_still_followed_through_a_long_hold(
    thesis_box: MotorWhiteBox, record: Callable[..., Recording], samples_of: Callable[..., Samples]
) -> None:
    samples = list(samples_of(record('R[5,15]D[3,3]', 60.0, 1, torque_noise_std=NOISE_NM)))
    nodes = RecursiveEstimator(thesis_box, THREE_TIMES_OFF)
    before = teach(nodes, samples)[-1]
    level = held_on(samples[-1], 200.0, float(nodes.noise_std_nm[0]), 1)
    teach(nodes, level)
    warm = held_on(level[-1], 200.0, float(nodes.noise_std_nm[0]), 2, resistance=1.2)
    after = teach(nodes, warm)[-1]
    assert abs(after.value[0, R] - 1.2) < 0.01
    assert abs(after.value[0, K_HS] - before.value[0, K_HS]) < before.std[0, K_HS]


def at_rest(
    volt: float, seconds: float, seed: int, resistance: float = 1.0, after_ns: int = 0
) -> list[Sample]:
    """The thesis's motor, settled at a voltage since long ago, in 1 % noise."""
    return held_on(
        Sample.of_one_motor(after_ns, 0.01, volt, 0.0), seconds, 6e-5 * volt, seed, resistance
    )


def from_elsewhere() -> RecursiveEstimator:
    """Start where nothing is right."""
    box = MotorWhiteBox(
        ('inductance', 'resistance', 'hysteresis'), 0.01, {'back_emf_constant': 0.01}
    )
    return RecursiveEstimator(box, np.array([[1.5, 3.0, 1.0]]))


@pytest.mark.slow
@pytest.mark.parametrize('volt', [2.0, 10.0, 30.0])
@pytest.mark.parametrize('seed', range(3))
def test_a_motor_at_rest_since_the_first_sample_is_never_called_identified(
    volt: float, seed: int
) -> None:
    nodes = from_elsewhere()
    estimates = teach(nodes, at_rest(volt, 40.0, seed))
    assert len(estimates) > 100
    for estimate in estimates:
        assert Verdict.IDENTIFIED not in estimate.verdicts[0]
        assert [estimate.verdicts[0][j] for j in (L, K_HS)] == [Verdict.UNEXCITED] * 2
        assert np.all(
            np.abs(np.log(estimate.value[0] / TRUTH))
            < 4.0 * np.log1p(estimate.std[0] / estimate.value[0])
        )
    assert nodes.change_count == 0


@pytest.mark.slow
@pytest.mark.parametrize('rest_s', [2.0, 60.0])
def test_what_was_at_rest_is_identified_as_soon_as_it_moves(
    record: Callable[..., Recording], samples_of: Callable[..., Samples], rest_s: float
) -> None:
    moving = list(samples_of(record('R[5,15]D[1,20]', 60.0, 2, torque_noise_std=NOISE_NM)))
    never_at_rest = from_elsewhere()
    rested = from_elsewhere()
    teach(rested, at_rest(float(moving[0].voltage_v[0]) + 3.0, rest_s, 3))
    offset_ns = round((rest_s + 1.0) * 1e9)
    late = [sample._replace(stamp_ns=sample.stamp_ns + offset_ns) for sample in moving]
    late[0] = late[0].beginning(np.ones(1, dtype=bool))  # a pause between the two
    for nodes, samples in ((never_at_rest, moving), (rested, late)):
        teach(nodes, samples[:800])
        assert nodes.estimate().identified(0)
        estimate = teach(nodes, samples[800:])[-1]
        assert np.all(np.abs(estimate.value[0] - TRUTH) < 4.0 * estimate.std[0])
        assert nodes.change_count == 0
    assert np.all(rested.estimate().std[0] < 1.2 * never_at_rest.estimate().std[0])


def test_another_resistance_at_rest_is_another_level_from_which_it_starts_anew() -> None:
    nodes = from_elsewhere()
    teach(nodes, at_rest(10.0, 60.0, 1))
    estimate = teach(nodes, at_rest(10.0, 60.0, 2, resistance=1.3, after_ns=60_000_000_000))[-1]
    assert nodes.change_count == 1
    assert Verdict.IDENTIFIED not in estimate.verdicts[0]
    _, resistance, hysteresis = estimate.value[0]
    current_a = at_rest(10.0, 1.0, 3, resistance=1.3)[0].torque_nm[0] / 0.01
    assert resistance + 0.01 * hysteresis * current_a == pytest.approx(
        10.0 / current_a, rel=0.03
    ), 'what the level tells'


@pytest.mark.slow
def test_with_a_data_sheet_resistance_is_followed_at_rest(thesis_box: MotorWhiteBox) -> None:
    told = np.array([[0.05, 0.0, 0.05]])
    nodes = RecursiveEstimator(thesis_box, np.array([[0.51, 1.2, 10.2]]), initial_relative_std=told)
    cold = teach(nodes, at_rest(10.0, 100.0, 1))[-1]
    warm = teach(nodes, at_rest(10.0, 100.0, 2, resistance=1.2, after_ns=100_000_000_000))[-1]
    for estimate, truth in ((cold, 1.0), (warm, 1.2)):
        assert abs(estimate.value[0, R] - truth) < 3.0 * estimate.std[0, R] < 0.6
    assert warm.value[0, R] - cold.value[0, R] == pytest.approx(0.2, abs=0.03)


@pytest.mark.slow
@pytest.mark.parametrize('excitation', ['R[1,2]D[3,3]', 'R[5,15]D[1,20]', 'R[5,15]D[0.001,2]'])
def test_a_resistance_that_climbs_is_followed_and_its_neighbours_are_not_blamed(
    thesis_box: MotorWhiteBox,
    record: Callable[..., Recording],
    samples_of: Callable[..., Samples],
    excitation: str,
) -> None:
    climb = tuple(f'motor.resistance={1.0 + 0.2 * k / 300:.5f}@{0.2 * k:g}' for k in range(1, 300))
    samples = samples_of(record(excitation, 60.0, 1, torque_noise_std=NOISE_NM, schedule=climb))
    nodes = RecursiveEstimator(thesis_box, THREE_TIMES_OFF)
    last = teach(nodes, samples)[-1]
    climbed = np.array([0.5, 1.2, 10.0])
    assert np.all(np.abs(last.value[0] / climbed - 1.0) < [0.01, 0.01, 0.03])
    assert np.all(np.abs(last.value[0] - climbed) < 4.0 * last.std[0])


@pytest.mark.slow
def test_a_motor_that_keeps_still_is_given_no_freedom_to_drift(
    thesis_box: MotorWhiteBox, samples_of: Callable[..., Samples]
) -> None:
    plants = {f'motor_{k}': PlantParameters() for k in range(3)}
    simulation = Simulation(plants, 'R[5,15]D[0.001,2]', seed=0, torque_noise_std=NOISE_NM)
    samples = samples_of(simulation.record(60.0))
    for motor in range(3):
        nodes = RecursiveEstimator(thesis_box, THREE_TIMES_OFF)
        teach(nodes, [sample.select(np.array([motor])) for sample in samples])
        assert not np.any(nodes.state()[1]['walk_rate'])
        assert nodes.change_count == 0


@pytest.mark.slow
def test_what_comes_while_frozen_is_never_learnt(
    thesis_box: MotorWhiteBox, record: Callable[..., Recording], samples_of: Callable[..., Samples]
) -> None:
    excitation = 'R[5,15]D[0.001,2]'
    good = list(samples_of(record(excitation, 30.0, 1, torque_noise_std=NOISE_NM)))
    bad = list(
        samples_of(
            record(
                excitation,
                30.0,
                2,
                torque_noise_std=NOISE_NM,
                schedule=('motor.resistance=2.0@0',),
            )
        )
    )
    nodes = RecursiveEstimator(thesis_box, THREE_TIMES_OFF)
    teach(nodes, good[:1000])
    before = nodes.theta.copy()
    nodes.freeze(True)
    teach(nodes, bad[1:1501])
    nodes.freeze(False)
    teach(nodes, good[1000:1001])
    np.testing.assert_array_equal(nodes.theta, before)
    last = teach(nodes, good[1001:])[-1]
    assert np.all(np.abs(last.value[0] - TRUTH) < 4.0 * last.std[0])
    assert nodes.change_count == 0
