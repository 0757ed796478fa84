"""Figures of gear motors whose speed is measured: with noise, by an encoder, or late."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from common.figures import Figure, number, table
from common.rotor.records import NODES
from common.rotor.runs import FALSE_SHARE, FALSE_STDS, Trial, run_trial
from common.rotor.speed_records import ELECTRICAL, SpeedSensor, draw_with_speed
from common.rotor.trial_tables import (
    WITHIN_STDS,
    false_of_claims,
    nees_band,
    over_bound,
    share_false,
    share_misfit,
    show,
)
from common.rotor.voltages import Drive, one_level, ramps, random_levels, slow_sine, soft_levels

FINE_SENSOR = SpeedSensor('speed with 0.5 % noise', noise=0.005)
"""With it the rotor's own parameters are asked for too."""

SPEED_SENSORS = (
    (FINE_SENSOR, 1000.0),
    (SpeedSensor('speed with 1 % noise', noise=0.01), 1000.0),
    (SpeedSensor('speed with 3 % noise', noise=0.03), 1000.0),
    (SpeedSensor('encoder of 64 counts', counts=64), 1000.0),
    (SpeedSensor('encoder of 500 counts', counts=500), 1000.0),
    (SpeedSensor('encoder of 64 counts', counts=64), 500.0),
    (SpeedSensor('encoder of 500 counts', counts=500), 500.0),
    (SpeedSensor('speed 2 samples late', late=2), 1000.0),
)
ENCODER_COUNTS = (16, 32, 64, 128, 500, 2000)
ENCODER_RATES_HZ = (100.0, 250.0, 500.0, 1000.0)
ENCODER_SEEDS, FIRST_ENCODER_SEED, ENCODER_SAMPLES = 10, 60, 6000
"""Encoders, rates, motors of each and the samples of one. Motors 40 to 49 chose the thresholds."""

SMOOTH_DRIVES = (slow_sine, ramps, soft_levels)
SMOOTH_COUNTS = (16, 64, 500, 8192)
SMOOTH_RATES_HZ = (100.0, 250.0, 1000.0)
SMOOTH_SAMPLES = 3000
"""Voltages that hardly step, encoders and rates under them. Motors 200 to 239 chose the thresholds.
"""

STEADY_COUNTS = (2000, 8192)
STEADY_RATE_HZ = 1000.0
"""Encoders fine enough to leave R known at a steady speed, and their rate."""


def speed_figures(seeds: int, length_s: float, *, counts: bool) -> list[Figure]:
    """Run gear motors whose speed is measured with noise, by an encoder, or late."""
    figures = mechanical_figures(seeds, length_s, counts=counts)
    for sensor, rate_hz in SPEED_SENSORS:
        name = f'{sensor.name}, {rate_hz:g} Hz'
        trials = [
            run_trial(draw_with_speed(sensor, seed, rate_hz, length_s)) for seed in range(seeds)
        ]
        show(name, trials, ELECTRICAL)
        over = over_bound(trials)
        band = nees_band(seeds * len(ELECTRICAL))
        nees = float(np.mean([trial.nees for trial in trials]))
        figures += [
            Figure(f'{name}: RMSE of inductance over the bound', float(over[0]), 1.5, counts),
            Figure(f'{name}: RMSE of resistance over the bound', float(over[1]), 1.5, counts),
            Figure(f'{name}: NEES', nees, band, counts),
            Figure(f'{name}: false of all identified', share_false(trials), 0.0, counts),
            Figure(f'{name}: misfit, share', share_misfit(trials), 0.0, counts),
        ]
    return figures


def encoder_figures(seeds: int, *, counts: bool) -> list[Figure]:
    """Run gear motors with encoders of few and many counts: is anything believed that is wrong?"""
    rates_hz = ENCODER_RATES_HZ if counts else ENCODER_RATES_HZ[:1]
    motors = range(FIRST_ENCODER_SEED, FIRST_ENCODER_SEED + seeds)
    rows = []
    stepped = []
    for count in ENCODER_COUNTS:
        for rate_hz in rates_hz:
            trials = _encoder_trials(random_levels, count, rate_hz, ENCODER_SAMPLES, motors)
            stepped += trials
            over = [number(float(value)) for value in over_bound(trials)]
            misfit = number(share_misfit(trials))
            rows.append([f'{count} counts, {rate_hz:g} Hz', *over, misfit, false_of_claims(trials)])
    print(f'\n{table(["encoder, steps", "L over the bound", "R", "misfit", "false"], rows)}')
    return [
        Figure('encoders, steps: false of all identified', share_false(stepped), 0.02, counts),
        Figure('encoders, steps: misfit, share', share_misfit(stepped), None),
        *_smooth_figures(motors, counts=counts),
        *_steady_figures(motors, counts=counts),
    ]


def _smooth_figures(motors: Sequence[int], *, counts: bool) -> list[Figure]:
    """Run encoders under voltages that hardly step: a shaft then begins to turn slowly."""
    rates_hz = SMOOTH_RATES_HZ if counts else SMOOTH_RATES_HZ[:1]
    rows = []
    figures = []
    for drive in SMOOTH_DRIVES:
        name = drive.__name__.replace('_', ' ')
        driven = []
        for count in SMOOTH_COUNTS:
            for rate_hz in rates_hz:
                trials = _encoder_trials(drive, count, rate_hz, SMOOTH_SAMPLES, motors)
                driven += trials
                misfit = number(share_misfit(trials))
                right = number(_share_right(trials))
                row = [name, f'{count} counts, {rate_hz:g} Hz', right, misfit]
                rows.append([*row, false_of_claims(trials)])
        title = f'encoders, {name}: false of all identified'
        figures.append(Figure(title, share_false(driven), 0.02, counts))
    print(f'\n{table(["voltage", "encoder", "R right", "misfit", "false"], rows)}')
    return figures


def _steady_figures(motors: Sequence[int], *, counts: bool) -> list[Figure]:
    """Run fine encoders under one level of the voltage, at which L tells nothing."""
    trials = [
        trial
        for count in STEADY_COUNTS
        for trial in _encoder_trials(one_level, count, STEADY_RATE_HZ, SMOOTH_SAMPLES, motors)
    ]
    wrong = 1.0 - _share_right(trials)
    return [
        Figure('fine encoders, one level: R not identified and right, share', wrong, None),
        Figure('fine encoders, one level: false', share_false(trials), 0.02, counts),
    ]


def _encoder_trials(
    drive: Drive, count: int, rate_hz: float, samples: int, motors: Sequence[int]
) -> list[Trial]:
    """Run some motors with an encoder of so many counts."""
    sensor = SpeedSensor(f'encoder of {count} counts', counts=count)
    return [
        run_trial(draw_with_speed(sensor, seed, rate_hz, samples / rate_hz, drive=drive))
        for seed in motors
    ]


def _share_right(trials: Sequence[Trial]) -> float:
    """Return of how many motors R is identified and right at the end, as a share."""
    place = ELECTRICAL.index('resistance')
    identified, error, z = (
        np.array([getattr(trial, name)[place] for trial in trials])
        for name in ('identified', 'error', 'z')
    )
    is_right = (np.abs(error) <= FALSE_SHARE) | (np.abs(z) <= FALSE_STDS)
    return float(np.mean(identified * is_right))


def mechanical_figures(seeds: int, length_s: float, *, counts: bool) -> list[Figure]:
    """Ask for inertia and frictions of gear motors whose speed is measured with little noise."""
    trials = [
        run_trial(draw_with_speed(FINE_SENSOR, seed, 1000.0, length_s, NODES))
        for seed in range(seeds)
    ]
    name = f'{FINE_SENSOR.name}, rotor asked for'
    show(name, trials)
    right = [
        bool((np.abs(trial.z) <= WITHIN_STDS).all() and trial.identified.all()) for trial in trials
    ]
    band = nees_band(seeds * len(NODES))
    return [
        *(
            Figure(f'{name}: RMSE of {node} over the bound', float(value), 1.3, counts)
            for node, value in zip(NODES, over_bound(trials), strict=True)
        ),
        Figure(f'{name}: NEES', float(np.mean([t.nees for t in trials])), band),
        Figure(f'{name}: false of all identified', share_false(trials), 0.0, counts),
        Figure(f'{name}: not all identified and right, share', 1.0 - float(np.mean(right)), None),
    ]
