"""Figures of drawn motors whose speed nobody measures, and of the form that is chosen for them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from common.cases import CASES, simulate
from common.figures import Figure, number, table
from common.motion import FloatArray
from common.rotor.choices import Choice, run_choice
from common.rotor.fleet import run_fleet
from common.rotor.records import NODES, Record, draw
from common.rotor.runs import run_trial
from common.rotor.thesis_sets import NOISE, ThesisTrial, run_thesis_set
from common.rotor.trial_tables import (
    WITHIN_STDS,
    false_of_claims,
    nees_band,
    over_bound,
    share_false,
    share_of,
    show,
    show_choices,
)
from common.rotor.voltages import ramps, slow_sine, soft_levels, trapezoids
from common.trust.motors import (
    brush_fan_motor,
    brush_hysteresis_motor,
    brush_motor,
    fan_hysteresis_motor,
    fan_motor,
    gear_motor,
    slight_hysteresis_motor,
    sticky_motor,
    strong_hysteresis_motor,
    thesis_like_motor,
)
from common.trust.plant import Motor

FLEET, FLEET_HZ = 1000, 100.0
"""Motors, and samples a second of each, that the cost of many is reckoned for."""

FLEET_S, FLEET_DRAWN = 200.0, 50
"""Length of a record of many motors, and motors that are drawn: each stands for as many."""

QUICK_FLEET, QUICK_FLEET_S = 100, 40.0

SMOOTH_DRIVES = (ramps, trapezoids, soft_levels, slow_sine)
FIRST_REPORT_SEED = 60
SMOOTH_S = 3.0

ELECTRICAL = slice(0, 2)
QUICK_SEEDS = 3


def fast_figures(seeds: int, length_s: float, *, counts: bool) -> list[Figure]:
    """Run drawn gear motors at 1 kHz."""
    trials = [run_trial(draw(gear_motor, seed, 1000.0, length_s)) for seed in range(seeds)]
    show('gear motors, 1 kHz', trials)
    over = over_bound(trials)
    right = [
        bool(
            trial.identified[ELECTRICAL].all()
            and (np.abs(trial.z[ELECTRICAL]) <= WITHIN_STDS).all()
        )
        for trial in trials
    ]
    band = nees_band(seeds * len(NODES))
    return [
        *(
            Figure(f'1 kHz: RMSE of {name} over the bound', float(value), 1.3, counts)
            for name, value in zip(NODES, over, strict=True)
        ),
        Figure('1 kHz: NEES', float(np.mean([t.nees for t in trials])), band, counts),
        Figure('1 kHz: false of all that was called identified', share_false(trials), 0.0, counts),
        Figure(
            '1 kHz: L and R not identified and right, share',
            1.0 - float(np.mean(right)),
            0.05,
            counts,
        ),
        Figure(
            '1 kHz: seconds to R within 2 %, median',
            float(np.median([trial.near_s for trial in trials])),
            5.0,
            counts,
        ),
        Figure(
            '1 kHz: processor time a sample, us',
            float(np.mean([trial.sample_us for trial in trials])),
            None,
        ),
    ]


def slow_figures(
    seeds: int, rate_hz: float, length_s: float, nearest: float, *, counts: bool
) -> list[Figure]:
    """Run drawn gear motors at a rate at which L/R is shorter than a few samples."""
    trials = [run_trial(draw(gear_motor, seed, rate_hz, length_s)) for seed in range(seeds)]
    name = f'{rate_hz:g} Hz'
    show(f'gear motors, {name}', trials)
    over = over_bound(trials)
    worst = max(abs(float(trial.error[NODES.index('resistance')])) for trial in trials)
    cost = []
    if rate_hz == FLEET_HZ:
        cores = FLEET * rate_hz * 1e-6 * float(np.mean([trial.sample_us for trial in trials]))
        cost.append(Figure(f'{FLEET} motors at {name}, one by one: cores', cores, None))
    return [
        *cost,
        Figure(f'{name}: RMSE of inductance over the bound', float(over[0]), 1.3, counts),
        Figure(f'{name}: RMSE of resistance over the bound', float(over[1]), 1.3, counts),
        Figure(f'{name}: R of the worst motor, %', 100.0 * worst, 100.0 * nearest, counts),
        Figure(
            f'{name}: false of all that was called identified', share_false(trials), 0.0, counts
        ),
    ]


def fleet_figures(*, counts: bool) -> list[Figure]:
    """Run many gear motors in the same messages, from where nothing is known of any of them."""
    motors, length_s = (FLEET, FLEET_S) if counts else (QUICK_FLEET, QUICK_FLEET_S)
    drawn = FLEET_DRAWN if counts else QUICK_SEEDS
    records = [draw(gear_motor, seed, FLEET_HZ, length_s) for seed in range(drawn)]
    fleet = run_fleet(records, motors)
    halves = np.array(fleet.cores).reshape(2, -1).mean(axis=1)
    name = f'{motors} motors together at {FLEET_HZ:g} Hz'
    false = fleet.false / max(1, fleet.claims)
    return [
        Figure(f'{name}: cores while they are new', float(halves[0]), None),
        Figure(f'{name}: cores once they are known', float(halves[1]), 0.5, counts),
        Figure(f'{name}: longest sample, ms', 1e3 * fleet.worst_s, None),
        Figure(f'{name}: R not within 2 % at the end, share', 1.0 - fleet.near, None),
        Figure(f'{name}: R not identified at the end, share', 1.0 - fleet.identified, None),
        Figure(f'{name}: false of what is identified at the end', false, 0.02, counts),
    ]


def sticky_figures(seeds: int, length_s: float, *, counts: bool) -> list[Figure]:
    """Run motors whose friction takes many times what the rotor does."""
    trials = [run_trial(draw(sticky_motor, seed, 1000.0, length_s)) for seed in range(seeds)]
    show('viscous friction 3 to 10 times Kt Kb / R, 5 to 20 ms', trials)
    known = [name != 'coulomb_friction' for name in NODES]  # there is none
    within = np.mean([np.abs(trial.z[known]) <= WITHIN_STDS for trial in trials])
    return [
        Figure('strong friction: share beyond 3 std', 1.0 - float(within), 0.03, counts),
        Figure('strong friction: false of all identified', share_false(trials), 0.0, counts),
    ]


def smooth_figures(motors: int, *, counts: bool) -> list[Figure]:
    """Let ``auto`` choose under voltages that hardly step: a rotor follows them unseen."""
    rows = []
    figures = []
    for drive in SMOOTH_DRIVES:
        name = drive.__name__.replace('_', ' ')
        seeds = range(FIRST_REPORT_SEED, FIRST_REPORT_SEED + motors)
        choices = [
            run_choice(draw(gear_motor, seed, 1000.0, SMOOTH_S, drive=drive)) for seed in seeds
        ]
        found = number(share_of(choices, 'rotor'))
        rows.append([name, found, false_of_claims(choices)])
        title = f'auto, {name}: false of all identified'
        figures.append(Figure(title, share_false(choices), 0.02, counts))
    print(f'\n{table(["voltage", "rotor found", "false"], rows)}')
    return figures


def hysteresis_figures(motors: int, length_s: float, *, counts: bool) -> list[Figure]:
    """Let ``auto`` choose, of gear motors whose hysteresis nobody has named."""
    kinds = {
        slight_hysteresis_motor: ('hysteresis',),
        strong_hysteresis_motor: ('hysteresis',),
    }
    return _unnamed_figures(kinds, motors, length_s, counts=counts)


def together_figures(motors: int, length_s: float, *, counts: bool) -> list[Figure]:
    """Let ``auto`` choose, of gear motors with effects that nobody has named, most of them two."""
    kinds = {
        brush_motor: ('brush_drop',),
        brush_fan_motor: ('brush_drop', 'quadratic_friction'),
        brush_hysteresis_motor: ('brush_drop', 'hysteresis'),
        fan_hysteresis_motor: ('quadratic_friction', 'hysteresis'),
    }
    return _unnamed_figures(kinds, motors, length_s, counts=counts)


def _unnamed_figures(
    kinds: Mapping[Callable[[np.random.Generator], Motor], tuple[str, ...]],
    motors: int,
    length_s: float,
    *,
    counts: bool,
) -> list[Figure]:
    """Let ``auto`` choose, of motors whose effects nobody has named.

    Args:
        kinds: what draws the motors, with the effects that they have.
        motors: how many of a kind.
        length_s: of a record.
        counts: whether the goals count.
    """
    rows = []
    figures = []
    for kind, effects in kinds.items():
        name = kind.__name__.removesuffix('_motor').replace('_', ' ')
        seeds = range(FIRST_REPORT_SEED, FIRST_REPORT_SEED + motors)
        choices = [run_choice(draw(kind, seed, 1000.0, length_s)) for seed in seeds]
        right = _share_right(choices, ('resistance',))
        all_right = _share_right(choices, ('resistance', *effects))
        rows.append([name, number(right), number(all_right), false_of_claims(choices)])
        figures += [
            Figure(f'auto, {name}: R not identified and right', 1.0 - right, None),
            Figure(f'auto, {name}: false of all identified', share_false(choices), 0.02, counts),
        ]
    print(f'\n{table(["motors", "R right", "effects right, too", "false"], rows)}')
    return figures


def _share_right(choices: Sequence[Choice], names: Sequence[str]) -> float:
    return float(np.mean([set(names) <= set(choice.right_names) for choice in choices]))


def choice_figures(seeds: int, length_s: float, *, counts: bool) -> list[Figure]:
    """Let ``speed_source: auto`` choose, of gear motors and of motors without rotor."""
    gears = [run_choice(draw(gear_motor, seed, 1000.0, length_s)) for seed in range(seeds)]
    still = [
        run_choice(draw(thesis_like_motor, seed, 100.0, 3.0 * length_s))
        for seed in range(max(1, seeds // 2))
    ]
    show_choices('auto: gear motors', gears)
    show_choices('auto: motors without rotor', still)
    fans = [run_choice(draw(fan_motor, seed, 1000.0, length_s)) for seed in range(seeds)]
    show_choices('auto: motors with a fan', fans)
    return [
        Figure('auto: gear motors without rotor, share', share_of(gears, 'torque_constant'), 0.01),
        Figure('auto: other motors with a rotor, share', share_of(still, 'rotor'), 0.01),
        Figure(
            'auto: L and R of gear motors not identified and right, share',
            1.0 - float(np.mean([choice.is_right for choice in gears])),
            0.05,
            counts,
        ),
        Figure(
            'auto: false of all that was called identified, gear motors',
            share_false(gears),
            0.02,
            counts,
        ),
        Figure(
            'auto: L and R of motors with a fan not identified and right, share',
            1.0 - float(np.mean([choice.is_right for choice in fans])),
            None,
        ),
        Figure(
            'auto: false of all that was called identified, motors with a fan',
            share_false(fans),
            0.02,
            counts,
        ),
    ]


def thesis_figures(seeds: int, *, counts: bool) -> list[Figure]:
    """Let ``auto`` choose on the thesis's sets, beside an observer that is told their form."""
    rows = []
    figures = []
    for case in [case for case in CASES if case.core]:
        clean = simulate(case, range(seeds))
        records = [clean.record(seed, NOISE) for seed in range(seeds)]
        free, told = (
            [run_thesis_set(record, source) for record in records]
            for source in ('auto', 'torque_constant')
        )
        ratio = float(np.max(_rms_over_bound(free) / _rms_over_bound(told)))
        times_s = [float(np.mean([trial.known_s for trial in runs])) for runs in (free, told)]
        for source, runs, time_s in zip(('auto', 'told'), (free, told), times_s, strict=True):
            over = ', '.join(number(float(value)) for value in _rms_over_bound(runs))
            rows.append([f'{case.name}, {source}', over, f'{time_s:.2f}', false_of_claims(runs)])
        other = float(np.mean([trial.source != 'torque_constant' for trial in free]))
        figures += [
            Figure(f'{case.name}: another form chosen, share', other, 0.01, counts),
            Figure(f'{case.name}: RMSE over that of the form told', ratio, 1.05, counts),
            Figure(
                f'{case.name}: seconds until known over those',
                times_s[0] / times_s[1],
                1.05,
                counts,
            ),
        ]
    print(f'\n{table(["thesis set", "L, R, K_HS over the bound", "known at s", "false"], rows)}')
    return figures


def _rms_over_bound(trials: Sequence[ThesisTrial]) -> FloatArray:
    """Return root mean squares of the errors over the bound, shape (parameter,)."""
    squares = np.array([trial.over_bound for trial in trials]) ** 2
    return np.asarray(np.sqrt(squares.mean(axis=0)))


def peer_figures(seeds: int, length_s: float, *, counts: bool) -> list[Figure]:
    """Compare with joint Kalman filters, tuned on other seeds, and a batch output error fit."""
    # only here, for tests run without requirements/bench.txt
    from common.rotor.joint_filters import JointExtended, tuned
    from common.rotor.peers import BATCH, OWN, peer_runs

    def drawn(seed: int, duration_s: float) -> Record:
        return draw(gear_motor, seed, 1000.0, duration_s)

    settings = tuned(drawn, quick=not counts)
    records = [drawn(seed, length_s) for seed in range(seeds)]
    runs = peer_runs(records, settings)
    bounds = np.array([record.bound() for record in records])
    over = {name: np.abs([run.error for run in found]) / bounds for name, found in runs.items()}
    cost = {
        name: float(np.nanmean([one.sample_us for one in found])) for name, found in runs.items()
    }
    rows = [
        [
            name,
            *(number(float(np.sqrt(np.mean(column**2)))) for column in of_method.T),
            *(number(float(np.median(column))) for column in of_method.T),
            f'{cost[name]:.1f}',
        ]
        for name, of_method in over.items()
    ]
    heads = [*(f'{node[:9]} RMS' for node in NODES), *('median' for _ in NODES)]
    print(f'\npeers: {settings}')
    print(table(['errors over the bound', *heads, 'us a sample'], rows))
    means = {name: float(np.mean(np.median(one, axis=0))) for name, one in over.items()}
    return [
        *(
            Figure(
                f'median error over that of {name}',
                means[OWN] / mean,
                1.3 if name == BATCH else 1.0,
                counts,
            )
            for name, mean in means.items()
            if name != OWN
        ),
        Figure(
            "cost of an update over that of filterpy's EKF",
            cost[OWN] / cost[JointExtended.title],
            1.0,
            counts,
        ),
    ]
