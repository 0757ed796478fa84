"""A driven rotor that stands still is told, one that turns round or rests is not."""

from __future__ import annotations

import numpy as np
import pytest

from gray_box_observer.observer.group_stalls import GroupStalls
from gray_box_observer.observer.observer import Observer
from gray_box_observer.observer.stall_watch import StallWatch
from gray_box_observer.samples import Sample as PairedSample
from gray_box_observer.settings.configuration import Configuration

INDUCTANCE = 4e-3
RESISTANCE = 2.0
KT = 0.02
INERTIA = 1e-5
VISCOUS = 1e-5
COULOMB = 8.4e-3
CONSTANTS = RESISTANCE, KT
INTERVAL_S = 1e-3
SUBSTEPS = 20


def watched(voltage_v: float, speed_rad_s: float, samples: int) -> StallWatch:
    """Return a watch after so many samples at one voltage and speed."""
    watch = StallWatch()
    watch.step(0.0, 12.0, 0.0, 0.0, CONSTANTS)
    current_a = (voltage_v - KT * speed_rad_s) / RESISTANCE
    for _ in range(samples):
        watch.step(INTERVAL_S, voltage_v, current_a, speed_rad_s, CONSTANTS)
    return watch


def test_a_blocked_rotor_is_stalled_after_a_while() -> None:
    assert not watched(6.0, 0.1, 200).is_stalled
    watch = watched(6.0, 0.1, 400)
    assert watch.is_stalled
    assert watch.count == 1
    assert watch.sentence is not None
    assert watch.sentence.startswith('stalled: 6 V and 3 A for 0.4 s')


def test_a_rotor_that_turns_or_is_hardly_driven_is_not_stalled() -> None:
    assert not watched(6.0, 100.0, 400).is_stalled
    assert not watched(1.0, 0.0, 400).is_stalled
    assert not watched(0.0, 0.0, 400).is_stalled


def test_a_stall_ends_when_the_rotor_turns() -> None:
    watch = watched(6.0, 0.0, 400)
    watch.step(INTERVAL_S, 6.0, 1.0, 200.0, CONSTANTS)
    assert not watch.is_stalled
    assert watch.sentence is None


def test_motors_of_a_group_stall_as_each_would_alone() -> None:
    rng = np.random.default_rng(8)
    motors = 5
    back_emf = rng.uniform(0.01, 0.05, motors)
    together = GroupStalls(back_emf)
    alone = [StallWatch() for _ in range(motors)]
    resistance = rng.uniform(1.0, 3.0, motors)
    nothing = np.full(motors, np.nan)
    for k in range(6000):
        voltage_v = np.where(rng.random(motors) < 5e-4, 0.0, 6.0)
        speed_rad_s = np.where((k // 400 + np.arange(motors)) % 2, 0.0, 100.0)
        current_a = (voltage_v - back_emf * speed_rad_s) / resistance
        seen_rad_s = np.where(rng.random(motors) < 3e-3, np.nan, speed_rad_s)
        interval_s = np.where(rng.random(motors) < 1e-3, 0.0, INTERVAL_S)
        present = rng.random(motors) < 0.95
        sample = PairedSample(k, interval_s, voltage_v, current_a, nothing, present)
        seen_rad_s[~present] = np.nan
        together.step(sample, current_a, seen_rad_s, resistance)
        for motor in np.flatnonzero(present).tolist():
            speed = float(seen_rad_s[motor])
            alone[motor].step(
                *(float(signal[motor]) for signal in (interval_s, voltage_v, current_a)),
                None if np.isnan(speed) else speed,
                (float(resistance[motor]), float(back_emf[motor])),
            )
    for motor, single in enumerate(alone):
        watch = together.watch(motor)
        assert watch.count == single.count
        assert watch.sentence == single.sentence
        assert watch.still_s == pytest.approx(single.still_s)
    assert sum(single.count for single in alone) > motors


def currents(voltage_v: np.ndarray, blocked_from: int) -> np.ndarray:
    """Current at every sample of a rotor that something holds from a sample on."""
    current = speed = 0.0
    step_s = INTERVAL_S / SUBSTEPS
    rows = []
    for k, volt in enumerate(voltage_v.tolist()):
        rows.append(current)
        for _ in range(SUBSTEPS):
            dry = speed * (0.03 + abs(speed)) / (0.0009 + 0.03 * abs(speed) + speed * speed)
            torque = KT * current - VISCOUS * speed - COULOMB * dry
            speed = 0.0 if k >= blocked_from else speed + step_s * torque / INERTIA
            current += step_s * (volt - RESISTANCE * current - KT * speed) / INDUCTANCE
    return np.array(rows)


@pytest.mark.slow
def test_the_observer_tells_a_stall_without_any_speed() -> None:
    rng = np.random.default_rng(3)
    lively = np.repeat(rng.uniform(-12.0, 12.0, 3000), rng.integers(50, 300, 3000))[:3000]
    voltage_v = np.concatenate([lively, np.full(800, 8.0)])
    current_a = currents(voltage_v, 3000)
    torque_nm = KT * (current_a + rng.normal(0.0, 0.02, current_a.size))
    values = {'motor.torque_constant': KT, 'motor.back_emf_constant': KT}
    observer = Observer(Configuration.from_flat(values))
    for k, (volt, torque) in enumerate(zip(voltage_v.tolist(), torque_nm.tolist(), strict=True)):
        observer.voltage('motor', k * 1_000_000, volt)
        observer.torque('motor', k * 1_000_000, torque)
        if k == 2999:
            before = observer.motors['motor'].stall
            assert before is not None
            assert before.count == 0
    stall = observer.motors['motor'].stall
    assert stall is not None
    assert stall.is_stalled
    assert stall.count == 1
