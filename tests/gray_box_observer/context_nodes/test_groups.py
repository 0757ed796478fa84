"""Motors in a group learn what each would alone, whatever happens to the others."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from dc_motor_sim.plant import PlantParameters
from dc_motor_sim.simulation import Simulation
from gray_box_observer.context_nodes import RecursiveEstimator, Verdict
from gray_box_observer.context_nodes.recursive import block_updater, schedule
from gray_box_observer.samples import Sample
from gray_box_observer.white_box import MotorWhiteBox

NAMES = ('inductance', 'resistance', 'hysteresis')
CALM, CHANGED, DISTURBED, RESTING, LATE, GONE, STIFF, PATCHY = range(8)
MOTORS = 8
START = np.tile([[1.5, 3.0, 30.0]], (MOTORS, 1))
START[STIFF] = [3e-3, 3.0, 30.0]
BOX = MotorWhiteBox(NAMES, np.full(MOTORS, 0.01), {'back_emf_constant': np.full(MOTORS, 0.01)})


@pytest.fixture(scope='module')
def samples() -> list[Sample]:
    """Eight motors: change, outliers, rest, late start, early end, fast, gaps, and plain."""
    plants = {f'm{k}': PlantParameters(resistance=1.0 + 0.1 * k) for k in range(MOTORS)}
    plants[f'm{STIFF}'] = PlantParameters(inductance=1e-3, resistance=1.6)
    excitation = dict.fromkeys(plants, 'R[5,15]D[0.2,3]') | {f'm{RESTING}': 'C[8]'}
    schedule = {f'm{CHANGED}': (f'm{CHANGED}.resistance=1.6@15',)}
    # one by one: all motors of a simulation take the steps of the fastest
    recordings = [
        Simulation(
            {name: plant}, excitation[name], seed=seed, torque_noise_std=1e-4,
            schedule=schedule.get(name, ()),
        ).record(30.0)
        for seed, (name, plant) in enumerate(plants.items())
    ]  # fmt: skip
    stamps = recordings[0].stamp_ns
    voltage_v = np.concatenate([recording.voltage_v for recording in recordings])
    torque = np.concatenate([recording.torque_nm for recording in recordings])
    random = np.random.default_rng(1)
    made = []
    torque[DISTURBED, random.choice(np.arange(300, 3000), 60, replace=False)] *= 1.5
    present = np.ones((stamps.size, MOTORS), dtype=bool)
    present[:777, LATE] = present[2100:, GONE] = False
    present[random.choice(np.arange(100, 3000), 300, replace=False), PATCHY] = False
    last = np.full(MOTORS, -1)
    for k, stamp in enumerate(stamps.tolist()):
        before = np.maximum(last, 0)
        interval = np.where(last < 0, 0.0, (k - last) * 0.01)
        held = [voltage_v[m, before[m] : max(k, before[m] + 1)].mean() for m in range(MOTORS)]
        made.append(
            Sample(
                stamp, interval, np.array(held), torque[:, k], np.full(MOTORS, np.nan), present[k]
            )
        )
        last = np.where(present[k], k, last)
    return made


def learnt_by(nodes: RecursiveEstimator, samples: list[Sample]) -> list[list[bytes]]:
    """Every value and covariance that each motor's estimate has taken."""
    taken: list[list[bytes]] = [[] for _ in range(nodes.theta.shape[0])]
    for sample in samples:
        if nodes.learn(sample):
            estimate = nodes.estimate()
            for motor in np.flatnonzero(nodes.changed):
                taken[motor].append(
                    estimate.value[motor].tobytes() + estimate.covariance[motor].tobytes()
                )
    return taken


@pytest.fixture(scope='module')
def alone(samples: list[Sample]) -> tuple[list[list[bytes]], list[RecursiveEstimator]]:
    """What each motor learns alone, a sample where it was absent left out."""
    taken = []
    rules = []
    for motor in range(MOTORS):
        chosen = slice(motor, motor + 1)
        nodes = RecursiveEstimator(BOX.of_motors(chosen), START[chosen])
        own = [
            s.select(chosen)._replace(present=None)
            for s in samples
            if s.present is None or s.present[motor]
        ]
        taken += learnt_by(nodes, own)
        rules.append(nodes)
    return taken, rules


@pytest.mark.slow
def test_what_happens_to_one_motor_leaves_the_others_alone(
    samples: list[Sample], alone: tuple[list[list[bytes]], list[RecursiveEstimator]]
) -> None:
    nodes = RecursiveEstimator(BOX, START)
    together = learnt_by(nodes, samples)
    for motor in range(MOTORS):
        assert together[motor] == alone[0][motor][: len(together[motor])]
        assert (
            len(alone[0][motor]) - len(together[motor]) <= 1
        )  # whoever is due last may still wait
        assert nodes.counters(motor) == alone[1][motor].counters()
    assert nodes.counters(CHANGED)['motor changes'] == 1
    assert nodes.counters(CALM)['motor changes'] == 0
    assert nodes.counters(DISTURBED)['torque outliers'] >= 50
    np.testing.assert_allclose(nodes.theta[CHANGED], [0.5, 1.6, 10.0], rtol=0.02)
    estimate = nodes.estimate()
    assert set(estimate.verdicts[CALM]) == set(estimate.verdicts[LATE]) == {Verdict.IDENTIFIED}
    assert (
        estimate.verdicts[RESTING][2] is not Verdict.IDENTIFIED
    )  # one transition does not tell hysteresis from R


@pytest.mark.slow
def test_whoever_has_to_wait_learns_the_same_later(
    samples: list[Sample],
    alone: tuple[list[list[bytes]], list[RecursiveEstimator]],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(block_updater, 'BLOCKS_PER_STEP', 2)
    monkeypatch.setattr(schedule, 'MAX_NUMPY_BLOCKS_PER_STEP', 1)
    monkeypatch.setattr(schedule, 'MAX_FIT_SAMPLES_PER_STEP', 100)
    together = learnt_by(RecursiveEstimator(BOX, START), samples)
    for motor in range(MOTORS):
        assert len(together[motor]) >= len(alone[0][motor]) - 2
        assert together[motor] == alone[0][motor][: len(together[motor])]


@pytest.mark.slow
def test_a_group_can_be_taken_apart_and_go_on_as_single_motors(samples: list[Sample]) -> None:
    whole = RecursiveEstimator(BOX, START)
    learnt_by(whole, samples[:1500])
    parts = []
    for motor in range(MOTORS):
        chosen = slice(motor, motor + 1)
        nodes = RecursiveEstimator(BOX.of_motors(chosen), START[chosen])
        nodes.restore(*whole.state(motor))
        parts.append(nodes)
    again = RecursiveEstimator(BOX, START)
    for motor in range(MOTORS):
        again.restore(*parts[motor].state(), motor)
    rest = [samples[1500]._replace(interval_s=np.zeros(MOTORS)), *samples[1501:2000]]
    together = learnt_by(again, rest)
    for motor in range(MOTORS):
        own = [
            s.select(slice(motor, motor + 1))._replace(present=None)
            for s in rest
            if s.present[motor]
        ]
        single = learnt_by(parts[motor], own)[0]
        assert together[motor] == single[: len(together[motor])]
        assert len(single) - len(together[motor]) <= 1


def test_a_group_frozen_while_a_motor_was_away_begins_its_history_anew(
    samples: list[Sample], record: Callable[..., object]
) -> None:
    nodes = RecursiveEstimator(BOX, START)
    learnt_by(nodes, samples[:1000])
    nodes.freeze(True)
    assert learnt_by(nodes, samples[1000:1200]) == [[] for _ in range(MOTORS)]
    nodes.freeze(False)
    nodes.learn(samples[1200]._replace(present=np.arange(MOTORS) != CALM))
    nodes.learn(samples[1201]._replace(present=None))
    intervals = nodes.replay.newest(1)[0][:, 0]
    assert intervals[CALM] == 0.0
    assert np.all(np.delete(intervals, CALM) > 0.0)


def rough(seed: int, speed_measured: bool) -> tuple[MotorWhiteBox, np.ndarray, list[Sample]]:
    """Fast and slow motors with stepped voltages and loads, torque outliers; physics, start."""
    random = np.random.default_rng(seed)
    motors = 5
    inductance = np.array([0.5, 0.02, 0.3, 0.5, 0.1])
    box = MotorWhiteBox(
        NAMES, np.full(motors, 0.01), {'back_emf_constant': np.full(motors, 0.01)}, speed_measured
    )
    start = np.column_stack([3.0 * inductance, np.full(motors, 3.0), np.full(motors, 30.0)])
    current, voltage, speed = np.zeros((3, motors))
    samples = []
    for k in range(400):
        before, speed = speed, random.uniform(-0.3, 0.3, motors)
        for step in range(20):
            driven = (
                before + (step + 0.5) / 20 * (speed - before) if speed_measured else 0.01 * current
            )
            current = current + 5e-4 / inductance * (
                voltage - current - 10.0 * np.abs(driven) * current - 0.01 * driven
            )
        torque = 0.01 * current * np.where(random.random(motors) < 0.04, 1.3, 1.0)
        interval = np.full(motors, 0.01 if k else 0.0)
        noise = random.normal(0.0, 2e-4, motors)
        samples.append(Sample(k * 10_000_000, interval, voltage, torque + noise, speed))
        voltage = random.uniform(2.0, 15.0, motors) if random.random() < 0.05 else voltage
    return box, start, samples


@pytest.mark.slow
@pytest.mark.parametrize(('seed', 'speed_measured'), [(9, False), (44, False), (4, True)])
def test_no_motor_is_treated_otherwise_for_the_company_that_it_is_in(
    seed: int, speed_measured: bool
) -> None:
    box, start, samples = rough(seed, speed_measured)
    together = learnt_by(RecursiveEstimator(box, start), samples)
    for motor in range(start.shape[0]):
        chosen = slice(motor, motor + 1)
        single = learnt_by(
            RecursiveEstimator(box.of_motors(chosen), start[chosen]),
            [s.select(chosen) for s in samples],
        )[0]
        assert together[motor] == single[: len(together[motor])]
        assert len(together[motor]) > 10
