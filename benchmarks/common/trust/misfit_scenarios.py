"""Scenarios of motors, sensors and drivers that the white box does not explain."""

from __future__ import annotations

from collections.abc import Iterator

from common.trust import effects
from common.trust.excitations import (
    CurrentLoop,
    SpeedLoop,
    chirp,
    prbs,
    ramps,
    sine,
    steps,
)
from common.trust.kinds import (
    CHANGE,
    CURRENT_LAG,
    CURRENT_OFFSET,
    FORWARD,
    FREE,
    GEAR,
    LAG_OR_DELAY,
    NO_SUSPECT,
    QUANTISATION,
    THESIS_LIKE,
    VOLTAGE_GAIN,
    VOLTAGE_OFFSET,
    case,
    motor_changed,
    motor_with,
)
from common.trust.motors import (
    fast_motor,
    hysteresis_motor,
    slow_motor,
    steady_motor,
    sticky_motor,
    thesis_like_motor,
)
from common.trust.records import Scenario


def misfit_scenarios() -> Iterator[Scenario]:
    """Yield every one, class by class."""
    yield from _rotors()
    yield from _sensors()
    yield from _drivers()
    yield from _changes()


def _rotors() -> Iterator[Scenario]:
    group = 'free rotor, speed not measured'
    yield case(group, 'wide steps', FREE)
    yield case(group, 'forward steps', FREE, excitation=FORWARD)
    yield case(group, 'PRBS', FREE, excitation=prbs(-9.0, 9.0, 0.05))
    yield case(group, 'sine', FREE, excitation=sine(9.0, 2.0))
    yield case(group, 'chirp', FREE, excitation=chirp(9.0, 0.5, 50.0))
    yield case(group, 'ramps', FREE, excitation=ramps(-12.0, 12.0, 1.0))
    yield case(group, 'default start', FREE, start={})
    yield case(group, 'current loop', FREE, excitation=CurrentLoop(steps(-0.3, 0.3, 0.02, 0.2)))
    yield case(group, 'slow sampling', FREE, motor=slow_motor, rate_hz=250.0, duration_s=20.0)
    yield case(group, 'hysteresis', FREE, motor=hysteresis_motor)
    yield case(group, 'speed loop', FREE, excitation=SpeedLoop(steps(-0.7, 0.7, 0.1, 0.5)))
    group = 'speed bends between samples'
    fast = GEAR | {'motor': fast_motor, 'holds': False}
    yield case(group, 'wide steps', fast)
    yield case(group, 'PRBS, noise 0.2 %', fast, excitation=prbs(-9.0, 9.0, 0.02), noise=0.002)
    group = 'friction that makes the rotor follow'
    yield case(group, 'steps', FREE, motor=sticky_motor)
    yield case(group, 'PRBS', FREE, motor=sticky_motor, excitation=prbs(0.0, 9.0, 0.05))


def _sensors() -> Iterator[Scenario]:
    wrong = THESIS_LIKE | {'holds': False}
    gear = GEAR | {'holds': False}
    both = steps(-15.0, 15.0, 0.5, 5.0)
    group = 'current quantised'
    coarse = {'suspects': QUANTISATION}
    yield case(
        group,
        '0.1 of the spread, no noise',
        wrong | coarse,
        noise=0.0,
        log=(effects.quantised_current(0.1),),
    )
    yield case(
        group,
        '0.3, noise a fifth of it',
        gear | coarse,
        noise=0.06,
        log=(effects.quantised_current(0.3),),
    )
    yield case(
        group,
        '0.1, noise a fifth of it',
        gear | coarse,
        noise=0.02,
        log=(effects.quantised_current(0.1),),
    )
    yield case(
        group,
        '0.3 of the spread, no noise',
        wrong | coarse,
        noise=0.0,
        log=(effects.quantised_current(0.3),),
    )
    group = 'current lags'
    lag = {'suspects': CURRENT_LAG}
    mean = {'suspects': LAG_OR_DELAY}
    yield case(group, '1 sample', gear | lag, sensor=(effects.low_pass(1.0),))
    yield case(group, '2 samples', gear | lag, sensor=(effects.low_pass(2.0),))
    yield case(group, '10 samples, no rotor', wrong | lag, sensor=(effects.low_pass(10.0),))
    yield case(
        group, '2 samples, no rotor', wrong | lag, excitation=both, sensor=(effects.low_pass(2.0),)
    )
    group = 'current lags, speed not measured'
    free = FREE | {
        'duration_s': 10.0,
        'suspects': NO_SUSPECT,
        'nodes': ('inductance', 'resistance'),
    }
    for samples in (0.3, 0.5, 0.7, 1.0):
        yield case(group, f'{samples:g} samples', free, sensor=(effects.low_pass(samples),))
    group = 'current averaged'
    yield case(group, 'over 1 sample', gear | mean, sensor=(effects.averaging(1.0),))
    yield case(group, 'over 8 samples', gear | mean, sensor=(effects.averaging(8.0),))
    yield case(
        group,
        'over 8 samples, no rotor',
        wrong | mean,
        excitation=both,
        sensor=(effects.averaging(8.0),),
    )
    group = 'current offset'
    offset = {'suspects': CURRENT_OFFSET}
    yield case(group, '1 %', wrong | offset, excitation=both, log=(effects.current_offset(0.01),))
    yield case(group, '3 %', wrong | offset, excitation=both, log=(effects.current_offset(0.03),))
    yield case(group, '3 %, speed measured', gear | offset, log=(effects.current_offset(0.03),))
    yield case(
        group,
        '-3 %, forward only',
        wrong,
        suspects=(*CURRENT_OFFSET, *VOLTAGE_OFFSET),
        log=(effects.current_offset(-0.03),),
    )
    group = 'current saturates'
    yield case(group, 'at 70 %', gear, log=(effects.saturated_current(0.7),))
    yield case(group, 'at 80 %, no rotor', wrong, log=(effects.saturated_current(0.8),))


def _drivers() -> Iterator[Scenario]:
    wrong = THESIS_LIKE | {'holds': False}
    gear = GEAR | {'holds': False}
    both = {'excitation': steps(-15.0, 15.0, 0.5, 5.0)}
    group = 'voltage lost'
    lost = {'suspects': VOLTAGE_OFFSET}
    either = {'suspects': (*VOLTAGE_OFFSET, *CURRENT_OFFSET)}
    yield case(
        group, '0.3 V', wrong | lost | both, motor=motor_with(thesis_like_motor, brush_drop=0.3)
    )
    yield case(
        group, '1 V, speed measured', gear | lost, motor=motor_with(steady_motor, brush_drop=1.0)
    )
    yield case(
        group, '0.5 V, speed measured', gear | lost, motor=motor_with(steady_motor, brush_drop=0.5)
    )
    yield case(
        group,
        '1 V, forward only',
        wrong | either,
        motor=motor_with(thesis_like_motor, brush_drop=1.0),
    )
    yield case(
        group,
        '0.5 V, current loop',
        gear | lost,
        motor=motor_with(steady_motor, brush_drop=0.5),
        excitation=CurrentLoop(steps(-0.5, 0.5, 0.02, 0.2)),
    )
    group = 'voltage offset'
    yield case(
        group,
        '0.2 V',
        wrong | both,
        suspects=(*VOLTAGE_OFFSET, *CURRENT_OFFSET),
        driver=(effects.voltage_offset(0.2),),
        effects={'voltage_offset': -0.2},
    )
    yield case(
        group,
        '0.2 V, speed measured',
        gear,
        suspects=(*VOLTAGE_OFFSET, *CURRENT_OFFSET),
        driver=(effects.voltage_offset(0.2),),
        effects={'voltage_offset': -0.2},
    )
    group = 'dead zone'
    yield case(
        group,
        '2 V',
        wrong | lost | both,
        driver=(effects.dead_zone(2.0),),
        effects={'brush_drop': 2.0},
    )
    yield case(
        group,
        '1 V, speed measured',
        gear | lost,
        driver=(effects.dead_zone(1.0),),
        effects={'brush_drop': 1.0},
    )
    group = 'slew of the driver'
    slow = {'suspects': LAG_OR_DELAY}
    yield case(group, '3 samples', gear | slow, driver=(effects.slew(3.0, 12.0),))
    yield case(
        group,
        '20 samples, no rotor',
        wrong | slow,
        excitation=steps(0.0, 15.0, 0.5, 5.0),
        driver=(effects.slew(20.0, 12.0),),
    )
    group = 'battery sags'
    sag = {'suspects': VOLTAGE_GAIN}
    yield case(group, '20 %', wrong | sag, driver=(effects.sag(0.2),))
    yield case(group, '20 %, speed measured', gear | sag, driver=(effects.sag(0.2),))
    group = 'battery wanders'
    yield case(group, '3 %', wrong | sag, driver=(effects.wander(0.03),))
    yield case(group, '3 %, speed measured', gear | sag, driver=(effects.wander(0.03, 0.3),))


def _changes() -> Iterator[Scenario]:
    group = 'a motor that keeps changing'
    loose = motor_changed(24, resistance=1.3)
    suspects = (*CHANGE, *VOLTAGE_GAIN)
    yield case(group, 'R by 30 %', GEAR, course=loose, holds=False, suspects=suspects)
    yield case(
        group,
        'R by 10 %, no rotor',
        THESIS_LIKE,
        course=motor_changed(20, resistance=1.1),
        holds=False,
        suspects=suspects,
    )
