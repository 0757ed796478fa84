"""Cost of a motor-sample by number of motors, against filterpy filters and the machine.

One process, one thread, CPU time (so that a busy machine does not count against anybody),
everything in one run; where torch sees a GPU, or with ``--device``, up to a million motors on it
too, in wall time, for what it does is no CPU time. Motors are the thesis's, identified before the
clock starts, each with its own noise; what is timed is the context nodes' update and, apart from
it, the prediction. The first minute, with the seven fits of settling in, is told beside it. Ends
with one line of JSON.

A motor-sample, update and prediction together, is to cost a hundredth of one motor's where there
are 1,000; so is the update alone, which falls short of it. By far the largest of these four costs
is that of predicting one motor.

The limit is what the update has to touch (:data:`BYTES`) at the bandwidth of a large copy, and what
it has to compute (:data:`FLOPS`) at the speed of a large matrix product, both measured in the same
run; the slower binds.

Profile of 1,000 motors (perf record): compiled code of regular blocks three quarters, of which
following the motion with its sensitivities is two fifths, the test for a change, learning and
writing down two fifths, bringing samples and belief in one fifth; copying samples into memory, at
its speed, a fifth; Python the rest. Of one motor compiled code is a tenth, storing 32 samples three
quarters, Python around a block the rest: updates alone are not a hundred times cheaper for many
motors because that of one has become so cheap. Of predicting 1,000 motors the network is a third,
the white box's own rollout for the scores a third, its relaxation and the comparison of signals the
rest.
"""

from __future__ import annotations

import argparse
import importlib.util
import math
import sys
import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from common.many_motors import NOISE_NM, one_predictor, rule, sample
from common.on_device import TORCH_ON_CPU, device_of, rows_on_device

MOTORS = (1, 10, 100, 1000, 10_000)
TAUGHT = 6000
"""Samples that the motor is identified from before the clock starts; by then there are no more
fits."""

KEPT = 64
"""Samples of these that every motor remembers: the update reads a block and one sample more."""

MOST_FILTERS = 100
"""Copies of filterpy's filter that are really run: they share nothing, so more cost as many times
more."""

ROWS = 8224
"""Samples after which their memory is used again: its pages are handed out at the first touch, once
and for all."""

OUTLIERS = 0.01
"""Share of torques that are half too large, where it is asked what they cost."""

PARAMETERS = 3
BLOCK = 32
UNKNOWNS = PARAMETERS + 1

BYTES = 3 * 8 * 3 + 2 * 8 * (2 * UNKNOWNS**2 + 4 * PARAMETERS * (PARAMETERS + 1) + 24) / BLOCK
"""Bytes of memory that a motor-sample must move: interval, voltage and torque come in, are stored,
and are read once; and once a block, both ways, the covariance, that of long holds, four score tests
and two dozen numbers."""

FLOPS = (
    # rate of the current with its two derivatives, four times, and what Runge and Kutta make of it
    4 * 20 + 20
    + 4 * (3 + 3 * PARAMETERS) + 8 * UNKNOWNS  # the variational equation
    + 2 * (2 + PARAMETERS)  # recurrences: current, by the first current, by every coordinate
    + 2 * UNKNOWNS**2 + 2 * UNKNOWNS  # variance of the innovation
    + 2 * UNKNOWNS**2 + 2 * UNKNOWNS + 12  # normal equations, residual, limits
    # solves, transfer, score tests
    + (8 * UNKNOWNS**3 + 4 * PARAMETERS**3 + 16 * PARAMETERS**2) / BLOCK
)  # fmt: skip
"""Operations that the update of a motor-sample needs, products and sums alike."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the benchmark; return the exit status."""
    parser = argparse.ArgumentParser(prog='scale', description=str(__doc__).partition('\n')[0])
    parser.add_argument(
        '--quick', action='store_true', help='fewer samples, up to 1,000 motors: no verdicts'
    )
    parser.add_argument(
        '--device',
        help='device of torch for more rows, in wall time: cuda, cuda:1, ...; default: the GPU '
        'that torch sees, if it '
        f'sees one; {TORCH_ON_CPU}: a try of these rows without a GPU, of few motors',
    )
    options = parser.parse_args(arguments)
    if importlib.util.find_spec('filterpy') is None:
        print(
            'scale: error: filterpy is missing; install ros_ws/requirements/bench.txt (make bench '
            'does it)',
            file=sys.stderr,
        )
        return 2
    from common.figures import Figure, last_line, table

    from gray_box_observer.errors import GrayBoxError

    try:
        device = device_of(options.device)
    except GrayBoxError as error:
        print(f'scale: error: {error}', file=sys.stderr)
        return 2
    counts = [n for n in MOTORS if n <= 1000 or not options.quick]
    repeats = 2 if options.quick else 5
    nodes, samples = taught()
    bandwidth, arithmetic = machine()
    limit_us = 1e6 * max(BYTES / bandwidth, FLOPS / arithmetic)
    few = 200 if options.quick else 1000
    filter_us, update_us, predict_us = (dict.fromkeys(counts, math.inf) for _ in range(3))
    for n in 2 * counts:  # in turns, so that all meet the same weather
        filter_us[n] = min(filter_us[n], filters_us(min(n, MOST_FILTERS), few))
        update_us[n] = min(update_us[n], update(nodes, samples, n, repeats))
        predict_us[n] = min(predict_us[n], prediction(samples, n, repeats))
    both = {n: update_us[n] + predict_us[n] for n in counts}
    kilobytes = memory(nodes, 1000)
    rows = []
    for n in counts:
        ratios = (
            filter_us[n] / update_us[n],
            update_us[1] / update_us[n],
            update_us[n] / limit_us,
            both[1] / both[n],
        )
        costs = f'{update_us[n]:.3f}', f'{predict_us[n]:.3f}', f'{filter_us[n]:.1f}'
        rows.append([f'{n:,}', *costs, *(f'{ratio:.1f}' for ratio in ratios)])
    header = [
        'motors',
        'update us',
        'predict us',
        'EKF us',
        'EKF/update',
        'update 1/N',
        'x limit',
        'both 1/N',
    ]
    print('CPU time of a motor-sample\n\n' + table(header, rows))
    moved, worked = (f'{1e9 * x:.1f} ns' for x in (BYTES / bandwidth, FLOPS / arithmetic))
    print(f'\nlimit: {BYTES:.0f} bytes at {bandwidth / 1e9:.1f} GB/s are {moved}; ', end='')
    print(f'{FLOPS:.0f} operations at {arithmetic / 1e9:.1f} Gflop/s are {worked}')
    dirty_us = update(nodes, samples, 1000, repeats, OUTLIERS)
    print(f'1,000 motors with {100 * OUTLIERS:.0f} % of outliers in the torque: {dirty_us:.3f} us')
    settle_us = {n: settling(n, 1500 if options.quick else 6000) for n in (1, 100)}
    for n, cost_us in settle_us.items():
        print(
            f'the first {15 if options.quick else 60} s, fits included, {n:,} motors: '
            f'{cost_us:.2f} us'
        )
    figures_on_device = (
        [] if device is None else rows_on_device(device, samples, quick=options.quick)
    )
    whole = not options.quick
    thousand = update_us[1000]
    cores = 0.1 * both[1000]
    figures = [
        Figure('update of one motor, times the EKF', update_us[1] / filter_us[1], 1.0, whole),
        Figure(
            'update, 1,000 motors, as a fraction of as many EKFs',
            thousand / filter_us[1000],
            0.02,
            whole,
        ),
        Figure(
            'update and prediction, 1,000 motors, as a fraction of one motor',
            both[1000] / both[1],
            0.01,
            whole,
        ),
        Figure(
            'update alone, 1,000 motors, as a fraction of one motor',
            thousand / update_us[1],
            0.01,
            whole,
        ),
        Figure('update, 1,000 motors, times the limit', thousand / limit_us, 10.0, whole),
        Figure('update and prediction, 1,000 motors at 100 Hz, cores', cores, 1.0, whole),
        Figure('memory of context nodes, kB a motor at 1,000', kilobytes, None),
        *figures_on_device,
    ]
    print(last_line('scale', 1, figures))
    return 0


def taught() -> tuple[Any, list[tuple[float, float]]]:
    """Identify the thesis's motor; return its context nodes and further noise-free signals."""
    from dc_motor_sim.plant import PlantParameters
    from dc_motor_sim.simulation import Simulation

    recording = Simulation({'m': PlantParameters()}, 'R[5,15]D[0.2,3]', seed=1).record(100.0)
    nodes = rule(1)
    noise = np.random.default_rng(0).normal(0.0, NOISE_NM, recording.stamp_ns.size)
    voltage = recording.voltage_v[0]
    torque = recording.torque_nm[0]
    for k in range(TAUGHT):
        nodes.learn(sample(k, np.array([voltage[max(k - 1, 0)]]), np.array([torque[k] + noise[k]])))
    return nodes, [
        (float(voltage[k - 1]), float(torque[k])) for k in range(TAUGHT, recording.stamp_ns.size)
    ]


def stream(
    samples: Sequence[tuple[float, float]], motors: int, count: int, begin: int = 0,
    outliers: float = 0.0
) -> list[Any]:  # fmt: skip
    """Samples of many motors, each with its own noise; some torques are half too large."""
    random = np.random.default_rng([motors, begin])
    made = []
    for k, (v, t) in enumerate(samples[begin : begin + count], start=begin):
        torque = t * np.where(random.random(motors) < outliers, 1.5, 1.0) + random.normal(
            0.0, NOISE_NM, motors
        )
        made.append(sample(TAUGHT + k, np.full(motors, v), torque))
    return made


def update(
    one: Any, samples: Sequence[tuple[float, float]], motors: int, repeats: int,
    outliers: float = 0.0
) -> float:  # fmt: skip
    """CPU time in us of one motor-sample's update: median of runs of whole rounds of blocks.

    The runs follow each other in one recording, so that what comes now and then costs what it
    costs.
    """
    plain, arrays = one.state()
    arrays = {**arrays, 'replay': arrays['replay'][:, :, -KEPT:]}
    nodes = rule(motors)
    for _ in range(ROWS):
        nodes.replay.append(sample(0, np.zeros(motors), np.zeros(motors)))
    nodes.restore(plain, arrays, slice(None))
    count = 4 * BLOCK if motors > 100 else 16 * BLOCK
    costs = []
    for run in range(repeats + 1):
        given = stream(samples, motors, count, run * count, outliers)
        begin_s = time.process_time()
        for s in given:
            nodes.learn(s)
        costs.append(1e6 * (time.process_time() - begin_s) / count / motors)
    return float(np.median(costs[1:]))


def prediction(samples: Sequence[tuple[float, float]], motors: int, repeats: int) -> float:
    """CPU time in us of predicting and scoring a motor-sample: the median of some runs."""
    predictor, theta = one_predictor(motors)
    given = stream(samples, motors, 64 if motors > 100 else 256)
    costs = []
    for _ in range(repeats + 1):
        begin_s = time.process_time()
        for s in given:
            predictor.learn(s, predictor.predict(s.interval_s, s.voltage_v, theta), theta)
        costs.append(1e6 * (time.process_time() - begin_s) / len(given) / motors)
    return float(np.median(costs[1:]))


def settling(motors: int, count: int) -> float:
    """CPU time in us of a motor-sample from the first on, fits included."""
    from dc_motor_sim.plant import PlantParameters
    from dc_motor_sim.simulation import Simulation

    plants = {f'm{k}': PlantParameters() for k in range(motors)}
    r = Simulation(plants, 'R[5,15]D[0.2,3]', seed=2, torque_noise_std=NOISE_NM).record(
        count * 0.01
    )
    given = [
        sample(k, r.voltage_v[:, max(k - 1, 0)].copy(), r.torque_nm[:, k].copy())
        for k in range(count)
    ]
    nodes = rule(motors)
    begin_s = time.process_time()
    for s in given:
        nodes.learn(s)
    return 1e6 * (time.process_time() - begin_s) / count / motors


def filters_us(motors: int, count: int) -> float:
    """CPU time in us of one motor-sample in filterpy's extended Kalman filters, run in series."""
    from common.cases import CASES
    from common.study import simulate
    from common.tuning import estimators

    case = next(case for case in CASES if case.name == 'short holds')
    record = simulate(case, [0], 20.0).record(0, 0.01)
    filters = [estimators(case)['ekf'](record) for _ in range(motors)]
    count = min(count if motors < MOST_FILTERS else count // 5, record.stamp_ns.size)
    costs = []
    for _ in range(3):
        begin_s = time.process_time()
        for k in range(1, count):
            for one in filters:
                one.learn(k)
        costs.append(1e6 * (time.process_time() - begin_s) / (count - 1) / motors)
    return min(costs)


def machine() -> tuple[float, float]:
    """Bandwidth of a large copy in B/s (read and write) and speed of a matrix product in flop/s."""
    source = np.ones(20_000_000)
    target = np.zeros_like(source)
    matrix = np.random.default_rng(0).normal(size=(1200, 1200))
    copy_s = least(lambda: np.copyto(target, source))
    product_s = least(lambda: matrix @ matrix)
    return 2 * source.nbytes / copy_s, 2 * 1200**3 / product_s


def least(work: Callable[[], Any], repeats: int = 7) -> float:
    """Least CPU time in s of some calls."""
    times = []
    for _ in range(repeats):
        begin_s = time.process_time()
        work()
        times.append(time.process_time() - begin_s)
    return min(times)


def memory(one: Any, motors: int) -> float:
    """Arrays that context nodes hold, in kB per motor; unused sample memory counts too."""
    return nbytes(rule(motors), set()) / motors / 1e3


def nbytes(thing: Any, seen: set[int]) -> int:
    """Size of every array below an object, each once."""
    if id(thing) in seen:
        return 0
    seen.add(id(thing))
    if isinstance(thing, np.ndarray):
        return int(thing.nbytes) if thing.base is None else 0
    if isinstance(thing, (list, tuple)):
        return sum(nbytes(part, seen) for part in thing)
    names = [*getattr(thing, '__dict__', {}), *getattr(type(thing), '__slots__', ())]
    return sum(nbytes(getattr(thing, name, None), seen) for name in names)


if __name__ == '__main__':
    sys.exit(main())
