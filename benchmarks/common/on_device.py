"""What a motor-sample costs of very many motors on a device of torch, in wall time.

A million motors with the usual memory of 4,096 samples would need 260 GB, so they remember few
(:data:`CAPACITY`): after the first minute the update reads a block and one sample more. Their
samples are arrays, drawn before the clock.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from common.figures import Figure, table
from common.many_motors import NOISE_NM, one_predictor, rule, sample

TORCH_ON_CPU = 'cpu'

CAPACITY = 256
"""Samples that every motor remembers: 17 kB a motor."""

BLOCK = 32
ROUNDS = 8
"""Blocks that are timed: as many as pass until every motor's anchor moves."""

WARM = 4
"""Predictions before the clock starts."""

RATE_HZ = 100.0


def device_of(asked: str | None) -> str | None:
    """The requested device; without a request, the GPU that torch sees, or None.

    Raises:
        ConfigurationError: there is no such device.
    """
    from gray_box_observer.settings.device import torch_device

    if asked is not None:
        return torch_device(asked) or TORCH_ON_CPU
    try:
        import torch
    except ImportError:
        return None
    return 'cuda' if torch.cuda.is_available() else None


def rows_on_device(
    device: str, one: Any, samples: Sequence[tuple[float, float]], *, quick: bool
) -> list[Figure]:
    """Measure and print a row a number of motors; return the figures.

    Args:
        device: torch's; on the processor few motors only.
        one: identified context nodes of one motor, which every motor begins with.
        samples: voltages and torques without noise that follow.
        quick: fewer motors.
    """
    from gray_box_observer.settings.device import DEVICE_FROM

    if device == TORCH_ON_CPU:
        counts = [DEVICE_FROM] if quick else [DEVICE_FROM, 20_000]
    else:
        counts = [10_000, 100_000] if quick else [10_000, 100_000, 1_000_000]
    rows, figures = [], []
    for motors in counts:
        update_us, predict_us = (
            update(device, one, samples, motors),
            prediction(device, samples, motors),
        )
        load = 1e-6 * RATE_HZ * motors * (update_us + predict_us)
        rows.append([f'{motors:,}', f'{update_us:.4f}', f'{predict_us:.4f}', f'{load:.2f}'])
        for name, cost_us in (('update', update_us), ('prediction', predict_us)):
            figures.append(
                Figure(f'{name}, {motors:,} motors by torch on {device}, wall us', cost_us, None)
            )
    header = ['motors', 'update us', 'predict us', f'of the time at {RATE_HZ:.0f} Hz']
    print(f'\nwall time of a motor-sample by torch on {device}\n\n' + table(header, rows))
    return figures


def update(
    device: str, one: Any, samples: Sequence[tuple[float, float]], motors: int, rounds: int = ROUNDS
) -> float:
    """Wall time in us of one motor-sample's update over whole rounds of blocks after the first."""
    plain, arrays = one.state()
    arrays = {**arrays, 'replay': arrays['replay'][:, :, -2 * BLOCK :]}
    nodes = rule(motors, CAPACITY, device)
    nodes.restore({**plain, 'anchored': -plain['new']}, arrays, slice(None))
    nodes.replay.streams[0][...] += (
        0.0  # memory is handed out by the system at the first touch, once and for all
    )
    spent_s = 0.0
    for k, given in enumerate(stream(samples, motors, (rounds + 1) * BLOCK)):
        begin_s = time.perf_counter()
        nodes.learn(given)
        spent_s += time.perf_counter() - begin_s if k >= BLOCK else 0.0
    return 1e6 * spent_s / (rounds * BLOCK) / motors


def prediction(
    device: str, samples: Sequence[tuple[float, float]], motors: int, count: int = BLOCK
) -> float:
    """Wall time in us of predicting and scoring a motor-sample."""
    predictor, theta = one_predictor(motors, device, replay_capacity=BLOCK)
    spent_s = 0.0
    for k, given in enumerate(stream(samples, motors, WARM + count)):
        begin_s = time.perf_counter()
        predictor.learn(given, predictor.predict(given.interval_s, given.voltage_v, theta), theta)
        spent_s += time.perf_counter() - begin_s if k >= WARM else 0.0
    return 1e6 * spent_s / count / motors


def stream(samples: Sequence[tuple[float, float]], motors: int, count: int) -> Iterator[Any]:
    """Samples of motors that run alike, each with noise of its own."""
    random = np.random.default_rng(motors)
    for k, (voltage_v, torque_nm) in enumerate(samples[:count], start=1):
        yield sample(
            k, np.full(motors, voltage_v), torque_nm + random.normal(0.0, NOISE_NM, motors)
        )
