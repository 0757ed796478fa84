"""What one training leaves for the next to go on from, and its checks before that."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from gray_box_observer.errors import CheckpointError
from gray_box_observer.predictor.network import check_moments, check_weights
from gray_box_observer.predictor.network_inputs import Variant
from gray_box_observer.predictor.operating_range import saved_range
from gray_box_observer.predictor.residual_model import INPUTS, check_correction
from gray_box_observer.safe_io.saved_state import (
    LARGEST_SIGNAL,
    MOST,
    SMALLEST,
    WHOLE,
    ArrayRule,
    check_arrays,
    check_covariance,
    check_words,
    counts,
    flags,
    positive,
)
from gray_box_observer.samples.replay_buffer import LONGEST_INTERVAL_S
from gray_box_observer.white_box.interface import Array

Arrays = Mapping[str, Array]

LEARNING = 'learning_'
JOB = 'job_'


def check_learning(arrays: Arrays, variant: Variant) -> None:
    """Refuse what no trainer of a variant has told under ``learning_*``; it need not be there.

    Args:
        arrays: the network that runs, and what a trainer told, among others.
        variant: what the network is taught on.

    Raises:
        CheckpointError: an array is missing, of another shape or out of range.
    """
    if not any(name.startswith(LEARNING) for name in arrays):
        return
    check_words(arrays, f'{LEARNING}random')
    if variant is Variant.PHYSICS:
        check_arrays(arrays, {'refused': counts()}, LEARNING)
        _check_trainable(
            arrays, f'{LEARNING}pupil_', arrays['input'].shape[1] if 'input' in arrays else None
        )
        _check_residual(arrays, f'{LEARNING}residual_')
        return
    rules = {
        'rate': ArrayRule((), SMALLEST, 1.0),
        'best': ArrayRule((), endless=True),
        'bad': counts(),
        'jobs': counts(),
    }
    check_arrays(arrays, rules, LEARNING)
    if 'input' in arrays:  # else nothing is gone on from
        check_moments(arrays, *check_weights(arrays), prefix=LEARNING)


def _check_residual(arrays: Arrays, prefix: str) -> None:
    """Refuse what is no state of a trainer of the residual."""
    check_words(arrays, f'{prefix}random')
    trainable = _check_trainable(arrays, f'{prefix}pupil_', INPUTS)
    if trainable != (f'{prefix}size' in arrays):
        raise CheckpointError(f'{prefix}pupil_ and {prefix}size do not stand together')
    if trainable:
        check_arrays(arrays, {'size': positive(3), 'limit_a': positive()}, prefix)
    check_correction(arrays, f'{prefix}best_')


def _check_trainable(arrays: Arrays, prefix: str, inputs: int | None) -> bool:
    """Refuse what is no network under training; tell whether there is one."""
    has_network = any(name.startswith(prefix) for name in arrays)
    if has_network:
        check_moments(arrays, *check_weights(arrays, inputs, prefix), prefix=prefix)
    return has_network


def check_job(arrays: Arrays) -> None:
    """Refuse what is no job whose result is still to come; it need not be there.

    Raises:
        CheckpointError: an array is missing, of another shape or out of range.
    """
    if not any(name.startswith(JOB) for name in arrays):
        return
    check_arrays(
        arrays, {'number': ArrayRule((None,), -MOST, MOST, WHOLE), 'theta': positive(1, None)}, JOB
    )
    samples = arrays[f'{JOB}number'].size
    parameters = arrays[f'{JOB}theta'].shape[1]
    signal: dict[str, Any] = {'shape': (1, samples), 'low': -LARGEST_SIGNAL, 'high': LARGEST_SIGNAL}
    rules = {
        'interval_s': ArrayRule((1, samples), 0.0, LONGEST_INTERVAL_S),
        'voltage_v': ArrayRule(**signal),
        'torque_nm': ArrayRule(**signal),
        'speed_rad_s': ArrayRule(**signal, blank=True),
        'covariance': ArrayRule((1, parameters, parameters)),
        'residual': flags(),
        'residual_anew': flags(),
        'motor': counts(high=0),
    }
    check_arrays(arrays, rules, JOB)
    check_covariance(f'{JOB}covariance', arrays[f'{JOB}covariance'])
    number = arrays[f'{JOB}number']
    if not samples or (number[1:] <= number[:-1]).any():
        raise CheckpointError(f'{JOB}number does not count samples')
    saved_range(arrays, f'{JOB}seen')
