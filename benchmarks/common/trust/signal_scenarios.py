"""Scenarios of stamps, noise and speeds that the white box lacks, and mistakes of users."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from common.trust import effects
from common.trust.excitations import (
    CurrentLoop,
    constant,
    plus,
    steps,
)
from common.trust.kinds import (
    BLOCKED,
    CHANGE,
    COLOURED_NOISE,
    CURRENT_LAG,
    DELAY,
    FORWARD,
    FREE,
    GEAR,
    NO_SUSPECT,
    SLOW,
    SPEED_NOISE,
    SPEED_SIGN,
    THESIS_LIKE,
    UNITS,
    case,
    motor_changed,
)
from common.trust.motors import (
    hysteresis_motor,
    slow_motor,
    strong_motor,
    tiny_motor,
)
from common.trust.records import NODES_WITH_SPEED, Scenario


def signal_scenarios() -> Iterator[Scenario]:
    """Yield every one, class by class."""
    yield from _stamps()
    yield from _noises()
    yield from _speeds()
    yield from _nothing_to_learn()
    yield from _hardly_seen()
    yield from _mistakes()


def _stamps() -> Iterator[Scenario]:
    wrong = THESIS_LIKE | {'holds': False, 'excitation': steps(3.0, 15.0, 0.3, 3.0)}
    gear = GEAR | {'holds': False}
    group = 'late stamps'
    delay = {'suspects': DELAY}
    yield case(group, 'voltage 0.5 samples', gear | delay, driver=(effects.late_voltage(0.5),))
    yield case(group, 'voltage 1 sample', gear | delay, driver=(effects.late_voltage(1.0),))
    yield case(group, 'voltage 3 samples', wrong | delay, driver=(effects.late_voltage(3.0),))
    yield case(
        group, 'voltage 1.5 samples, no rotor', wrong | delay, driver=(effects.late_voltage(1.5),)
    )
    group = 'stamps late at random'
    jitter = {'suspects': (*DELAY, *CURRENT_LAG)}
    yield case(group, 'up to 1 sample', gear | jitter, log=(effects.jittered_stamps(1.0),))
    yield case(
        group, 'up to 1 sample, no rotor', wrong | jitter, log=(effects.jittered_stamps(1.0),)
    )
    yield case(
        group, 'up to 3 samples, no rotor', wrong | jitter, log=(effects.jittered_stamps(3.0),)
    )
    group = 'L/R shorter than a sample, skew'
    short = {
        'motor': lambda rng: tiny_motor(0.6e-3, 2.0, 0.05),
        'start': {'inductance': 2e-3, 'resistance': 5.0},
        'suspects': DELAY,
    }
    yield case(group, '0.3 samples', gear | short, driver=(effects.late_voltage(0.3),))
    yield case(group, '0.1 samples', gear | short, driver=(effects.late_voltage(0.1),))


def _noises() -> Iterator[Scenario]:
    coloured = {'holds': False, 'memory': 0.9, 'suspects': COLOURED_NOISE}
    group = 'coloured noise'
    yield case(group, 'no rotor', THESIS_LIKE | coloured)
    yield case(group, 'speed measured', GEAR | coloured)
    yield case(group, 'memory 0.98, no rotor', THESIS_LIKE | coloured, memory=0.98)
    yield case(group, 'memory 0.6, speed measured', GEAR | coloured, memory=0.6)
    group = 'coloured noise, closed loop'
    currents = CurrentLoop(steps(-0.5, 0.5, 0.02, 0.2))
    slow_currents = CurrentLoop(steps(0.2, 0.9, 0.5, 3.0))
    yield case(group, 'current loop', GEAR | coloured, excitation=currents)
    yield case(group, 'current loop, memory 0.7', GEAR | coloured, excitation=currents, memory=0.7)
    yield case(group, 'current loop, no rotor', THESIS_LIKE | coloured, excitation=slow_currents)
    yield case(
        group,
        'fast current loop, no rotor',
        THESIS_LIKE | coloured,
        excitation=replace(slow_currents, bandwidth=0.3),
    )
    yield case(
        group,
        'fast current loop, Kb too',
        GEAR | coloured,
        excitation=replace(currents, bandwidth=0.3),
        nodes=NODES_WITH_SPEED,
    )
    yield case(group, 'hysteresis', GEAR | coloured, motor=hysteresis_motor, excitation=currents)
    group = 'supply noise'
    supply = {'holds': False}
    yield case(group, '0.5 V', GEAR | supply, driver=(effects.voltage_noise(0.5),))
    yield case(group, '0.5 V, no rotor', THESIS_LIKE | supply, driver=(effects.voltage_noise(0.5),))


def _speeds() -> Iterator[Scenario]:
    gear = GEAR | {'holds': False, 'suspects': SPEED_NOISE}
    with_constant = {'nodes': NODES_WITH_SPEED}
    group = 'speed measured with noise'
    yield case(group, '0.5 %', gear, excitation=SLOW, log=(effects.speed_noise(0.005),))
    yield case(
        group,
        '0.9 %, 500 Hz',
        gear,
        rate_hz=500.0,
        duration_s=12.0,
        motor=slow_motor,
        excitation=FORWARD,
        log=(effects.speed_noise(0.009),),
    )
    yield case(group, '5 %', gear, log=(effects.speed_noise(0.05),))
    yield case(
        group,
        '2 %, Kb too',
        gear | with_constant,
        excitation=FORWARD,
        log=(effects.speed_noise(0.02),),
    )
    group = 'speed from an encoder'
    yield case(group, '64 counts', gear, excitation=FORWARD, log=(effects.encoder(64),))
    yield case(group, '500 counts', gear, excitation=SLOW, log=(effects.encoder(500),))
    yield case(group, '500 counts, Kb too', gear | with_constant, log=(effects.encoder(500),))
    group = 'speed late'
    late = {'suspects': (*SPEED_NOISE, 'speed_delay', *DELAY)}
    yield case(group, '5 samples', gear | late, log=(effects.late_speed(5),))
    yield case(
        group, '2 samples, Kb too', gear | late | with_constant, log=(effects.late_speed(2),)
    )
    group = 'speed filtered'
    for samples in (0.5, 1.0, 1.5, 3.0):
        yield case(
            group, f'{samples:g} samples', gear | late, log=(effects.filtered_speed(samples),)
        )


def _nothing_to_learn() -> Iterator[Scenario]:
    group = 'constant voltage throughout'
    yield case(group, 'speed not measured', FREE, excitation=constant(6.0))
    yield case(group, 'speed measured', GEAR, excitation=constant(6.0))
    yield case(group, 'no rotor', THESIS_LIKE, excitation=constant(6.0))
    group = 'rest'
    rest = {'excitation': constant(0.0), 'holds': False, 'suspects': NO_SUSPECT}
    converter = plus(steps(-0.008, 0.008, 0.001, 0.001))
    yield case(
        group,
        'converter noise, current zero',
        FREE | rest,
        excitation=converter,
        log=(effects.resting_current,),
    )
    yield case(
        group,
        'converter noise, current zero, speed',
        GEAR | rest,
        excitation=converter,
        log=(effects.resting_current,),
    )
    yield case(group, 'nothing at all', THESIS_LIKE | rest, log=(effects.resting_current,))
    yield case(group, 'current noise', FREE | rest, excitation=converter, noise=30.0)


def _hardly_seen() -> Iterator[Scenario]:
    """Yield what no window of a few thousand samples shows, in records of many."""
    wrong = BLOCKED | {'holds': False}
    noisy = wrong | {'noise': 0.1, 'suspects': DELAY}
    group = 'small delay, noisy current'
    yield case(group, 'voltage 0.1 samples', noisy, driver=(effects.late_voltage(0.1),))
    yield case(group, 'voltage 0.2 samples', noisy, driver=(effects.late_voltage(0.2),))
    yield case(group, 'lag of 0.1 samples', noisy, sensor=(effects.low_pass(0.1),))
    yield case(group, 'lag of 0.2 samples', noisy, sensor=(effects.low_pass(0.2),))
    group = 'noise of the voltage'
    yield case(group, 'supply 1 V', wrong, driver=(effects.voltage_noise(1.0),))
    yield case(group, 'reading 1 V', wrong, log=(effects.noisy_voltage(1.0),))
    yield case(
        group, 'supply 1 V, noise 10 %', wrong, noise=0.1, driver=(effects.voltage_noise(1.0),)
    )
    yield case(
        group, 'reading 0.3 V, noise 10 %', wrong, noise=0.1, log=(effects.noisy_voltage(0.3),)
    )
    group = 'moves are rare, current noisy'
    rare = steps(-12.0, 12.0, 0.5, 0.5)
    yield case(group, 'blocked, 80 moves', BLOCKED, noise=0.02, excitation=rare)
    yield case(group, 'blocked, noise 10 %', BLOCKED, noise=0.1)
    yield case(
        group, 'speed measured, 40 moves', GEAR, noise=0.02, duration_s=20.0, excitation=rare
    )
    yield case(group, 'speed measured, noise 3 %', GEAR, noise=0.03, duration_s=20.0)
    group = 'readings without noise, rounded'
    for step in (0.01, 0.03, 0.1, 0.2):
        yield case(
            group,
            f'current {step:g} of the spread',
            wrong,
            noise=0.0,
            duration_s=20.0,
            log=(effects.quantised_current(step),),
        )
    group = 'voltage rounded'
    yield case(group, '2 V', wrong, duration_s=20.0, log=(effects.quantised_voltage(2.0),))
    yield case(group, '0.5 V', wrong, duration_s=20.0, log=(effects.quantised_voltage(0.5),))
    group = 'speed by differences, noise 3 %'
    late = GEAR | {'holds': False, 'noise': 0.03, 'duration_s': 10.0}
    yield case(group, 'Kb known', late, log=(effects.differenced_speed,))
    yield case(group, 'Kb too', late, log=(effects.differenced_speed,), nodes=NODES_WITH_SPEED)
    group = 'a change that noise hides'
    for parameter, factor, noise in (
        ('inductance', 1.2, 0.1),
        ('inductance', 0.8, 0.1),
        ('inductance', 1.08, 0.05),
        ('resistance', 1.03, 0.1),
    ):
        yield case(
            group,
            f'{parameter} times {factor:g}, noise {100.0 * noise:g} %',
            wrong,
            noise=noise,
            course=motor_changed(**{parameter: factor}),
            suspects=CHANGE,
        )
    group = 'current averaged, speed measured, noise 5 %'
    averaged = GEAR | {'holds': False, 'noise': 0.05, 'duration_s': 12.0, 'suspects': CURRENT_LAG}
    yield case(group, 'over 0.4 samples', averaged, sensor=(effects.averaging(0.4),))
    yield case(group, 'over 0.3 samples', averaged, sensor=(effects.averaging(0.3),))


def _mistakes() -> Iterator[Scenario]:
    group = 'scale errors'
    scale = {'holds': False, 'scale': True}
    yield case(group, 'current 5 %', GEAR | scale, log=(effects.current_gain(1.05),))
    yield case(group, 'voltage -10 %', THESIS_LIKE | scale, log=(effects.voltage_gain(0.9),))
    group = 'units and signs'
    wrong = GEAR | {'motor': strong_motor, 'holds': False, 'suspects': UNITS}
    constant_kb = {'parameters': {'back_emf_constant': None}}
    yield case(
        group, 'mA for A', wrong, log=(effects.current_gain(1000.0),), words='\\bmA\\b|milliamp'
    )
    yield case(
        group,
        'speed sign',
        wrong,
        suspects=SPEED_SIGN,
        log=(effects.speed_gain(-1.0),),
        words='\\bsign',
    )
    yield case(
        group,
        'Kb forgotten',
        wrong | constant_kb,
        suspects=('back_emf_constant', *UNITS),
        words='back_emf_constant|\\bKb\\b',
    )
    yield case(
        group,
        'ms for s',
        wrong,
        log=(effects.stretched_stamps(1000.0),),
        words='\\bms\\b|millisecond',
    )
    yield case(
        group, 'mV for V', wrong, log=(effects.voltage_gain(1000.0),), words='\\bmV\\b|millivolt'
    )
