"""What it costs to predict very many motors on a device of torch, in wall time."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from common.figures import Figure, table
from common.many_motors import NOISE_NM, one_predictor, sample

TORCH_ON_CPU = 'cpu'

BLOCK = 32
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
    device: str, samples: Sequence[tuple[float, float]], *, quick: bool
) -> list[Figure]:
    """Measure and print a row a number of motors; return the figures.

    Args:
        device: torch's; on the processor few motors only.
        samples: voltages and torques without noise that follow.
        quick: fewer motors.
    """
    from gray_box_observer.settings.device import DEVICE_FROM

    if device == TORCH_ON_CPU:
        counts = [DEVICE_FROM] if quick else [DEVICE_FROM, 20_000]
    else:
        counts = [10_000, 100_000] if quick else [10_000, 100_000, 1_000_000]
    rows = []
    figures = []
    for motors in counts:
        cost_us = prediction(device, samples, motors)
        load = 1e-6 * RATE_HZ * motors * cost_us
        rows.append([f'{motors:,}', f'{cost_us:.4f}', f'{load:.2f}'])
        name = f'prediction, {motors:,} motors by torch on {device}, wall us'
        figures.append(Figure(name, cost_us, None))
    header = ['motors', 'predict us', f'of the time at {RATE_HZ:.0f} Hz']
    print(f'\nwall time of a motor-sample by torch on {device}\n\n' + table(header, rows))
    return figures


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
