"""Motors, excitations and faults drawn at random: none may cause a traceback or break numbers."""

from __future__ import annotations

import contextlib
import io
import json
import math
import tempfile
import traceback
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from common.figures import Figure, table
from common.trust import effects, motors
from common.trust.excitations import chirp, constant, plus, prbs, ramps, sine, steps
from common.trust.faults import FAULTS, select_samples
from common.trust.records import NODES, NODES_WITH_SPEED, Record, Scenario, make_record
from common.trust.scenarios import scenarios
from common.trust.trial import MOTOR, Trial, run_trial
from gray_box_observer.bag.joint_state import TYPE_NAME, encode_joint_state
from gray_box_observer.bag.schemas import built_in_lookup, schema_text
from gray_box_observer.bag.writer import BagOptions, BagWriter
from gray_box_observer.identify import command
from gray_box_observer.settings.parameters import MOTOR_PARAMETERS

COMMAND_EVERY = 100
"""Of so many drawn records, one goes as a bag through the command, too."""


BREAKERS = (
    ('free rotor, speed not measured: forward steps', 5, 3.0, 1285),
    ('free rotor, speed not measured: forward steps', 10, 4.0, 4000),
)
"""Records by scenario, seed, seconds and how many samples of them, from the default start; they
come first. The first had a negative variance and ended ``identify --json -`` in a traceback, the
second an indefinite covariance."""


def draw(number: int) -> tuple[Record, list[str]]:
    """Return the record of a number, and the names of what was done to it."""
    if number < len(BREAKERS):
        name, seed, duration_s, size = BREAKERS[number]
        scenario = next(one for one in scenarios() if one.name == name)
        whole = make_record(replace(scenario, duration_s=duration_s, start={}), seed)
        return replace(whole, readings=select_samples(whole.readings, slice(size))), [name]
    rng = np.random.default_rng([20_000, number])
    made = [_pick(rng, MOTORS), _pick(rng, EXCITATIONS)]
    names = [name for name, _ in made]
    rate_hz = 10.0 ** rng.uniform(1.5, 4.0)
    speed = bool(rng.random() < 0.4)
    parts: dict[str, list[Any]] = {'driver': [], 'sensor': [], 'log': []}
    for _ in range(rng.integers(0, 3)):
        name, (stage, effect) = _pick(rng, EFFECTS)
        parts[stage].append(effect)
        names.append(name)
    for _ in range(rng.integers(0, 3)):
        name, fault = _pick(rng, FAULTS)
        parts['log'].append(fault)
        names.append(name)
    nodes = NODES_WITH_SPEED if speed and rng.random() < 0.5 else NODES
    scenario = Scenario(
        f'drawn {number}',
        'drawn',
        made[0][1],
        made[1][1],
        rate_hz,
        rng.integers(60, 500) / rate_hz,
        holds=False,
        noise=float(rng.choice([0.0, 0.001, 0.01, 0.1, 3.0])),
        memory=float(rng.choice([0.0, 0.0, 0.9])),
        speed=speed,
        nodes=nodes,
        start=_start(rng, nodes),
        **{stage: tuple(some) for stage, some in parts.items()},
    )
    with np.errstate(all='ignore'):
        return make_record(scenario, number), names


def run_drawn(number: int) -> tuple[Trial, list[str]]:
    """Run one drawn record."""
    record, names = draw(number)
    trial = run_trial(record)
    by_command = number % COMMAND_EVERY == 0 or number < len(BREAKERS)
    if by_command and not trial.failure:
        trial.failure = command_failure(record)
    return trial, names


def drawn_figures(drawn: Sequence[tuple[Trial, list[str]]]) -> list[Figure]:
    """Count what must not be, each of all drawn records."""
    trials = [trial for trial, _ in drawn]
    counts = {
        'tracebacks': sum(bool(trial.failure) for trial in trials),
        'records with non-finite outputs': sum(trial.non_finite > 0 for trial in trials),
        'records with indefinite covariances': sum(trial.indefinite > 0 for trial in trials),
    }
    return [
        Figure(f'drawn motors and faults, {len(trials)}: {name}', float(count), 0.0)
        for name, count in counts.items()
    ]


def drawn_table(drawn: Sequence[tuple[Trial, list[str]]]) -> str:
    """Lay out the drawn records in which something broke."""
    rows = []
    for trial, names in drawn:
        if trial.failure or trial.non_finite or trial.indefinite:
            last = trial.failure.strip().splitlines()[-1:] or ['-']
            counts = [str(trial.non_finite), str(trial.indefinite)]
            rows.append([f'{trial.name}: {", ".join(names)}', *counts, last[0][:100]])
    return '\n' + table(['drawn and broken', 'non-finite', 'indefinite', 'traceback'], rows)


def command_failure(record: Record) -> str:
    """Run ``identify --json -`` on a bag of the record; return what is wrong, or nothing."""
    output = io.StringIO()
    with tempfile.TemporaryDirectory() as folder:
        bag = Path(folder) / 'bag'
        write_bag(bag, record)
        nested = {'/**': {'ros__parameters': _nested(record.parameters)}}
        parameters = Path(folder) / 'parameters.yaml'
        parameters.write_text(yaml.safe_dump(nested))
        arguments = [
            'identify',
            str(bag),
            '--params',
            str(parameters),
            '--skip-predictor',
            '--json',
            '-',
        ]
        try:
            with contextlib.redirect_stdout(output), contextlib.redirect_stderr(io.StringIO()):
                status = command.main(arguments)
            if status == 0:
                json.loads(output.getvalue(), parse_constant=_refuse)
        except Exception:
            return traceback.format_exc(limit=-3)
    return '' if status in (0, command.EXIT_USER_ERROR) else f'exit status {status}'


def write_bag(folder: Path, record: Record) -> None:
    """Write a record as a bag, in the order of the log."""
    schema = schema_text(TYPE_NAME, built_in_lookup)
    log = record.readings
    rows = zip(
        log.voltage_stamp_ns.tolist(),
        log.voltage_v.tolist(),
        log.torque_stamp_ns.tolist(),
        record.torque_nm.tolist(),
        log.speed_rad_s.tolist(),
        strict=True,
    )
    with BagWriter(folder, BagOptions(flush_period_s=1e9, library='gray_box_observer')) as bag:
        for topic in ('/motor/voltage', '/motor/torque'):
            bag.add_topic(topic, TYPE_NAME, schema)
        for voltage_ns, volt, torque_ns, torque, speed in rows:
            message = encode_joint_state(voltage_ns, [MOTOR], effort=[volt])
            bag.write('/motor/voltage', message, voltage_ns, voltage_ns)
            speeds = [] if math.isnan(speed) else [speed]
            message = encode_joint_state(torque_ns, [MOTOR], effort=[torque], velocity=speeds)
            bag.write('/motor/torque', message, torque_ns, torque_ns)


def _nested(flat: dict[str, object]) -> dict[str, Any]:
    nested: dict[str, Any] = {}
    for name, value in flat.items():
        *groups, last = name.split('.')
        place = nested
        for group in groups:
            place = place.setdefault(group, {})
        place[last] = value
    return nested


def _refuse(constant_name: str) -> float:
    raise ValueError(f'{constant_name} is not JSON')


def _pick(rng: np.random.Generator, choices: dict[str, Any]) -> tuple[str, Any]:
    name = str(rng.choice(list(choices)))
    return name, choices[name]


def _start(rng: np.random.Generator, nodes: tuple[str, ...]) -> dict[str, float]:
    """Draw initial values within their bounds, or leave the defaults."""
    if rng.random() < 0.4:
        return {}
    bounds = {spec.name: (spec.minimum, spec.maximum) for spec in MOTOR_PARAMETERS}
    start = {}
    for name in nodes:
        low, high = bounds[f'initial.{name}']
        start[name] = float(np.exp(rng.uniform(math.log(low * 1.001), math.log(high * 0.999))))
    return start


MOTORS: dict[str, Callable[[np.random.Generator], Any]] = {
    'gear': motors.gear_motor,
    'hysteresis': motors.hysteresis_motor,
    'fast': motors.fast_motor,
    'sticky': motors.sticky_motor,
    'strong': motors.strong_motor,
    'thesis': motors.thesis_motor,
    'thesis-like': motors.thesis_like_motor,
    'tiny': lambda rng: motors.tiny_motor(10.0 ** rng.uniform(-6.0, -3.0), rng.uniform(0.1, 5.0)),
}

EXCITATIONS: dict[str, Any] = {
    'wide steps': steps(-12.0, 12.0, 0.01, 0.2),
    'forward steps': steps(2.0, 12.0, 0.05, 1.0),
    'sine': sine(9.0, 3.0),
    'chirp': chirp(9.0, 0.5, 50.0),
    'ramps': ramps(-12.0, 12.0, 0.3),
    'PRBS': prbs(-9.0, 9.0, 0.02),
    'constant': constant(6.0),
    'rest': constant(0.0),
    'noise': plus(steps(-0.01, 0.01, 0.001, 0.001)),
    'large': steps(-400.0, 400.0, 0.01, 0.2),
}

EFFECTS: dict[str, tuple[str, Any]] = {
    'late voltage': ('driver', effects.late_voltage(1.5)),
    'dead zone': ('driver', effects.dead_zone(2.0)),
    'slew': ('driver', effects.slew(3.0, 12.0)),
    'sag': ('driver', effects.sag(0.3)),
    'wander': ('driver', effects.wander(0.05, 0.1)),
    'low-pass': ('sensor', effects.low_pass(2.0)),
    'averaging': ('sensor', effects.averaging(8.0)),
    'offset': ('log', effects.current_offset(0.05)),
    'saturation': ('log', effects.saturated_current(0.5)),
    'speed noise': ('log', effects.speed_noise(0.05)),
    'encoder': ('log', effects.encoder(64)),
    'speed sign': ('log', effects.speed_gain(-1.0)),
    'jitter': ('log', effects.jittered_stamps(2.0)),
    'current zero': ('log', effects.resting_current),
}
