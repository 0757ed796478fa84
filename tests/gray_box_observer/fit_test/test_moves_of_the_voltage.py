"""What the moves of the voltage tell: jumps at them, levels between them, values after them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from linear_motor_records import (
    INTERVAL_S,
    NODES,
    RESISTANCE_OHM,
    TORQUE_CONSTANT,
    Floats,
    Record,
    current_of,
    noise,
)

from gray_box_observer.context_nodes import Verdict
from gray_box_observer.context_nodes.recursive.trajectory import follow_moves, voltage_moves
from gray_box_observer.fit_test import FitVerdict
from gray_box_observer.fit_test.fit_schedule import SHORTEST_WAIT
from gray_box_observer.fit_test.monitor import FitMonitor
from gray_box_observer.observer.observer import Observer
from gray_box_observer.samples.voltage_level import is_held
from gray_box_observer.settings.configuration import Configuration


def _stop_and_go(samples: int, seed: int) -> Floats:
    rng = np.random.default_rng(seed)
    levels_v = rng.choice([-9.0, -4.5, 4.5, 7.2, 9.0], samples)
    levels_v[::2] = 0.0
    return np.repeat(levels_v, rng.integers(100, 400, samples))[:samples]


def _observer(**motor: object) -> Observer:
    own = {'torque_constant': TORQUE_CONSTANT, **motor}
    values = {f'motor.{name}': value for name, value in own.items()}
    return Observer(Configuration.from_flat({'predictor': False, **values}))


def _feed(observer: Observer, voltage_v: Floats, current_a: Floats, first: int = 0) -> None:
    pairs = zip(voltage_v.tolist(), current_a.tolist(), strict=True)
    for sample, (volt, ampere) in enumerate(pairs, first):
        stamp_ns = round(sample * INTERVAL_S * 1e9)
        observer.voltage('motor', stamp_ns, volt)
        observer.torque('motor', stamp_ns, TORQUE_CONSTANT * ampere)


def test_jumps_at_most_moves_of_the_voltage_are_the_models_fault() -> None:
    voltage_v = np.zeros((2, 400))
    voltage_v[:, 100:200], voltage_v[:, 300:] = 6.0, -6.0
    kicks = np.zeros((2, 400), dtype=bool)
    kicks[0, [100, 201]] = True  # two of three moves, one of them an interval late
    kicks[1, [50, 100]] = True  # one of three, and a bump
    assert follow_moves(kicks, voltage_moves(voltage_v)).tolist() == [True, False]


def test_jumps_at_wrong_readings_of_the_voltage_are_not() -> None:
    """A reading of zero in one sample of fifty moves the voltage more often than its source."""
    voltage_v = np.concatenate([np.full((1, 200), 6.0), np.full((1, 200), -6.0)], axis=1)
    voltage_v[0, 20::50] = 0.0
    kicks = np.zeros(voltage_v.shape, dtype=bool)
    kicks[0, 20::50] = True
    assert follow_moves(kicks, voltage_moves(voltage_v)).tolist() == [False]


def test_an_inductance_that_explains_no_move_of_the_voltage_is_not_believed() -> None:
    """With L/R far below a sample interval, a run anew behind every step fits any inductance."""
    voltage_v = _stop_and_go(5000, 3)
    current_a = np.concatenate([[0.0], voltage_v[:-1]]) / 23.0 + noise(5000, 0.002, 4)
    observer = _observer(speed_source='torque_constant')
    _feed(observer, voltage_v, current_a)
    observer.flush()
    motor = observer.motors['motor']
    inductance, resistance, _ = motor.estimate.value[0]
    assert inductance < 0.1 * 23.0 * INTERVAL_S or inductance < 3.0 * motor.estimate.std[0, 0]
    assert motor.estimate.verdicts[0][0] is not Verdict.IDENTIFIED
    assert resistance == pytest.approx(23.0, rel=0.01)
    assert motor.fit.verdict is FitVerdict.OK


@pytest.mark.parametrize(
    ('relative', 'sine_v', 'held'), [(0.0, 0.0, True), (0.005, 0.0, True), (0.005, 1.0, False)]
)
def test_a_level_is_held_though_it_is_measured_with_noise(
    relative: float, sine_v: float, held: bool
) -> None:
    """Of a free rotor at one voltage the misfit stands: its current fits a large inductance."""
    moving_v = 6.0 + sine_v * np.sin(np.linspace(0.0, 20.0, 4096))
    assert is_held(moving_v * (1.0 + noise(4096, relative, 6))) is held


def test_the_smallest_steps_that_excite_are_no_noise() -> None:
    assert not is_held(12.0 + 0.5 * np.sign(noise(4096, 1.0, 7)))


def test_values_that_have_moved_since_their_test_are_tested_before_they_are_believed() -> None:
    voltage_v = np.concatenate([_stop_and_go(1200, 8), np.zeros(SHORTEST_WAIT)])
    current_a = current_of(voltage_v) + noise(voltage_v.size, 0.02, 9)
    observer = _observer(speed_source='torque_constant', context_nodes=list(NODES))
    _feed(observer, voltage_v[:1200], current_a[:1200])
    group = observer.group_of('motor')
    assert group.observer is not None
    nodes = group.observer.context_nodes
    motor = observer.configuration.motors['motor']
    monitor = FitMonitor([motor], [group.observer.white_box])
    only = np.array([0])
    monitor.test(nodes, nodes.estimate(), 0, group.observer.delay_of(0))
    _feed(observer, voltage_v[1200:], current_a[1200:], 1200)
    same = nodes.estimate()
    assert monitor.assessment(0).verdict is FitVerdict.OK
    assert monitor.schedule.due(nodes.replay, same, only) == []
    assert not monitor.schedule.is_urgent(0)
    moved = replace(same, value=1.2 * same.value)
    assert monitor.schedule.due(nodes.replay, moved, only) == [0]
    assert monitor.schedule.is_urgent(0)
    nobody = replace(moved, verdicts=((Verdict.CONVERGING, Verdict.CONVERGING),))
    assert monitor.schedule.due(nodes.replay, nobody, only) == []


def test_a_motor_that_rests_at_first_is_still_identified() -> None:
    voltage_v = np.concatenate([np.zeros(500), _stop_and_go(2500, 8)])
    record = Record(voltage_v, current_of(voltage_v) + noise(3000, 0.02, 9))
    motor = record.observed().motors['motor']
    assert motor.estimate.verdicts[0] == (Verdict.IDENTIFIED, Verdict.IDENTIFIED)
    assert motor.estimate.value[0, 1] == pytest.approx(RESISTANCE_OHM, rel=0.01)
