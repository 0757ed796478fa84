"""The scenarios, class by class: half of them choose thresholds, the other half report."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import cache

from common.trust import effects
from common.trust.excitations import CurrentLoop, SpeedLoop, chirp, plus, prbs, ramps, sine, steps
from common.trust.kinds import (
    BLOCKED,
    CHANGE,
    FORWARD,
    GEAR,
    THESIS,
    THESIS_LIKE,
    THESIS_STEPS,
    case,
    motor_changed,
    motor_drifted,
    motor_with,
)
from common.trust.misfit_scenarios import misfit_scenarios
from common.trust.motors import (
    hysteresis_motor,
    slow_motor,
    steady_motor,
    thesis_like_motor,
    tiny_motor,
)
from common.trust.records import NODES_WITH_SPEED, Scenario
from common.trust.signal_scenarios import signal_scenarios


@cache
def scenarios() -> tuple[Scenario, ...]:
    """Return every scenario, in the order of their classes."""
    return tuple(replace(one, name=f'{one.group}: {one.name}') for one in _all())


def half(scenario: Scenario) -> str:
    """Return ``choose`` or ``report``: the scenarios of a class take them in turn."""
    alike = [one.name for one in scenarios() if one.group == scenario.group]
    return ('report', 'choose')[alike.index(scenario.name) % 2]


def _all() -> Iterator[Scenario]:
    yield from _healthy()
    yield from _hard_but_right()
    yield from misfit_scenarios()
    yield from signal_scenarios()


def _healthy() -> Iterator[Scenario]:
    group = 'thesis sets'
    yield case(group, 'R[5,15]D[1,20]', THESIS)
    yield case(group, 'R[1,2]D[3,3]', THESIS, excitation=steps(1.0, 2.0, 3.0, 3.0))
    yield case(group, 'R[0,33]D[1,20]', THESIS, excitation=steps(0.0, 33.0, 1.0, 20.0))
    yield case(group, 'with sine', THESIS, excitation=plus(THESIS_STEPS, sine(1.0, 0.159)))
    yield case(group, 'R[5,15]D[0.001,2]', THESIS, excitation=steps(5.0, 15.0, 0.001, 2.0))
    yield case(group, 'both directions', THESIS, excitation=steps(-15.0, 15.0, 1.0, 10.0))
    group = 'thesis-like, other signals'
    yield case(group, 'noise 0.1 %', THESIS_LIKE, noise=0.001)
    yield case(
        group, 'noise 2 %, chirp', THESIS_LIKE, noise=0.02, excitation=chirp(6.0, 0.02, 5.0, 8.0)
    )
    yield case(group, 'PRBS', THESIS_LIKE, excitation=prbs(3.0, 12.0, 0.5))
    yield case(group, 'ramps', THESIS_LIKE, excitation=ramps(-12.0, 12.0, 4.0))
    group = 'gear, speed measured'
    yield case(group, 'wide steps', GEAR)
    yield case(group, 'forward steps', GEAR, excitation=FORWARD)
    yield case(
        group, 'PRBS, Kb too', GEAR, excitation=prbs(-9.0, 9.0, 0.02), nodes=NODES_WITH_SPEED
    )
    yield case(
        group, 'chirp, Kb too', GEAR, excitation=chirp(9.0, 0.5, 50.0), nodes=NODES_WITH_SPEED
    )
    yield case(group, 'hysteresis', GEAR, motor=hysteresis_motor)
    yield case(group, 'hysteresis, noise 0.1 %', GEAR, motor=hysteresis_motor, noise=0.001)
    yield case(group, 'slow sampling', GEAR, motor=slow_motor, rate_hz=250.0, duration_s=20.0)
    yield case(group, 'sine', GEAR, excitation=sine(9.0, 3.0, 1.0))
    group = 'gear, closed loop, white noise'
    random_current = steps(-0.5, 0.5, 0.02, 0.2)
    random_speed = steps(-0.7, 0.7, 0.1, 0.5)
    yield case(group, 'current loop', GEAR, excitation=CurrentLoop(random_current))
    yield case(group, 'speed loop', GEAR, excitation=SpeedLoop(random_speed))
    yield case(
        group,
        'current loop, Kb too',
        GEAR,
        excitation=CurrentLoop(random_current, 0.3),
        nodes=NODES_WITH_SPEED,
    )
    yield case(
        group,
        'speed loop, Kb too',
        GEAR,
        excitation=SpeedLoop(random_speed),
        nodes=NODES_WITH_SPEED,
    )
    group = 'thesis, closed loop, white noise'
    thesis_current = steps(0.2, 0.9, 0.5, 3.0)
    yield case(group, 'current loop', THESIS_LIKE, excitation=CurrentLoop(thesis_current))
    yield case(group, 'fast current loop', THESIS_LIKE, excitation=CurrentLoop(thesis_current, 0.3))
    group = 'mild imperfections'
    fine = effects.quantised_current(0.005)
    yield case(group, 'steps of half the noise', GEAR, log=(fine,))
    yield case(group, 'steps of the noise', THESIS, log=(effects.quantised_current(0.01),))
    yield case(group, 'speed with 0.01 % noise', GEAR, log=(effects.speed_noise(0.0001),))
    yield case(group, 'offset of 0.01 %', THESIS, log=(effects.current_offset(0.0001),))
    yield case(group, 'drop of 1 mV', GEAR, motor=motor_with(steady_motor, brush_drop=0.001))
    yield case(group, 'voltage noise 1 mV', GEAR, driver=(effects.voltage_noise(0.001),))


def _hard_but_right() -> Iterator[Scenario]:
    """Yield where the white box holds, but not all can be told."""
    group = 'K_HS = 0'
    no_hysteresis = motor_with(thesis_like_motor, hysteresis=0.0)
    yield case(group, 'no rotor', THESIS, motor=no_hysteresis)
    yield case(
        group,
        'no rotor, both directions',
        THESIS,
        motor=no_hysteresis,
        excitation=steps(-15.0, 15.0, 0.5, 5.0),
    )
    group = 'starts'
    for inductance_h, resistance_ohm, rate_hz, span_s in (
        (5e-6, 0.5, 20000.0, 5e-4),
        (5e-5, 1.0, 20000.0, 1e-3),
        (1e-4, 0.5, 10000.0, 2e-3),
        (1e-3, 1.0, 2000.0, 1e-2),
        (3e-2, 2.0, 500.0, 0.1),
        (1.0, 4.0, 100.0, 1.0),
    ):
        yield case(
            group,
            f'L of {inductance_h:g} H',
            GEAR,
            motor=lambda rng, L=inductance_h, R=resistance_ohm: tiny_motor(L, R),
            start={},
            rate_hz=rate_hz,
            duration_s=6000.0 / rate_hz,
            excitation=steps(-6.0, 6.0, span_s, 10.0 * span_s),
        )
    group = 'a motor that changes'
    hotter = motor_changed(resistance=1.3)
    stiffer = motor_changed(inductance=0.7)
    twice = {'duration_s': 120.0, 'excitation': steps(3.0, 15.0, 0.5, 5.0), 'suspects': CHANGE}
    yield case(group, 'R by 30 %, no rotor', THESIS | twice, course=hotter)
    yield case(group, 'L by -30 %, no rotor', THESIS | twice, course=stiffer)
    gear = GEAR | {'suspects': CHANGE, 'duration_s': 10.0}
    yield case(group, 'R by 30 %, speed measured', gear, course=hotter)
    yield case(group, 'R by 3 %, speed measured', gear, course=motor_changed(resistance=1.03))
    group = 'a winding that heats'
    noisy = BLOCKED | {'noise': 0.05, 'duration_s': 20.0}
    hot = motor_drifted(resistance=1.1)
    cold = motor_drifted(resistance=0.9)
    then_hot = motor_drifted(0.5, resistance=1.1)
    yield case(group, 'by 10 %, blocked', noisy, course=hot)
    yield case(group, 'by 10 %, then constant, blocked', noisy, course=then_hot)
    binary = prbs(-9.0, 9.0, 0.05)
    yield case(group, 'by 10 %, then constant, PRBS', noisy, course=then_hot, excitation=binary)
    yield case(group, 'by 10 %, PRBS', noisy, course=hot, excitation=binary)
    yield case(group, 'cools by 10 %, blocked', noisy, course=cold)
    yield case(group, 'by 10 %, sine', noisy, course=hot, excitation=sine(9.0, 3.0, 1.0))
    warm = GEAR | {'duration_s': 20.0}
    then_warm = motor_drifted(0.5, resistance=1.04)
    yield case(group, 'by 4 %, then constant, speed', warm, course=then_warm)
    yield case(group, 'by 4 %, speed', warm, course=motor_drifted(resistance=1.04))
    loop = CurrentLoop(steps(-0.5, 0.5, 0.02, 0.2))
    looped = warm | {'excitation': loop}
    yield case(group, 'by 4 %, current loop, speed', looped, course=motor_drifted(resistance=1.04))
    yield case(group, 'cools by 4 %, speed', warm, course=motor_drifted(resistance=0.96))
    group = 'a motor that changes, its speed noisy'
    noisy_speed = GEAR | {'holds': False, 'suspects': CHANGE, 'log': (effects.speed_noise(0.005),)}
    hotter_by_a_tenth = motor_changed(resistance=1.1)
    for duration_s in (4.0, 5.0, 20.0, 8.0):
        record = noisy_speed | {'duration_s': duration_s}
        yield case(group, f'R by 10 %, {duration_s:g} s', record, course=hotter_by_a_tenth)
    group = 'an inductance that drifts'
    drift = {'holds': False, 'duration_s': 20.0, 'course': motor_drifted(inductance=0.85)}
    yield case(group, 'by -15 %, blocked', BLOCKED | drift)
    yield case(group, 'by -15 %, speed measured', GEAR | drift)
    yield case(group, 'by -15 %, blocked, noise 5 %', BLOCKED | drift, noise=0.05)
    yield case(group, 'by -15 % in 5 s, speed measured', GEAR | drift | {'duration_s': 5.0})
