"""What is saved of the recursive estimator, and what it must be like to be taken back."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gray_box_observer.context_nodes.recursive.belief import (
    Belief,
    Prior,
    check_belief,
    check_prior,
)
from gray_box_observer.context_nodes.recursive.block_updater import WALK_AGAIN
from gray_box_observer.context_nodes.recursive.change_test import MEMORIES_BLOCKS
from gray_box_observer.context_nodes.recursive.constant_voltage import HoldState, check_hold
from gray_box_observer.context_nodes.recursive.estimator_state import EstimatorState
from gray_box_observer.errors import CheckpointError
from gray_box_observer.safe_io.saved_state import (
    LARGEST_SIGNAL,
    LATEST_NS,
    MOST,
    ArrayRule,
    check_arrays,
    counts,
    flag,
    whole,
)
from gray_box_observer.samples.replay_buffer import check_signals
from gray_box_observer.white_box.interface import Array

FASTEST_WALK = 1.0
"""Rate of a walk, relative to one second: no winding gets there."""

_ARRAYS = (
    'suspicion',
    'since',
    'left_out',
    'walk_rate',
    'least_noise',
    'share',
    'reach',
    'in_vain',
)
"""Arrays of the state that are saved under their own names."""

_PARTS = {'belief': 'belief', 'anchor': 'anchor', 'holds': 'hold'}
"""Parts of the state that are saved entry by entry: name in a checkpoint, attribute."""


def saved_arrays(state: EstimatorState) -> dict[str, Array]:
    """Return copies of a motor's arrays by their names in a checkpoint."""
    arrays = {name: getattr(state, name).copy() for name in _ARRAYS}
    arrays['prior_p'] = state.prior.p.copy()
    arrays['prior_covariance'] = state.prior.covariance.copy()
    arrays['drift_score'] = np.moveaxis(state.score, 1, 0).copy()
    arrays['drift_information'] = np.moveaxis(state.information, 1, 0).copy()
    for name, attribute in _PARTS.items():
        part: Any = getattr(state, attribute)
        for field in fields(part):
            arrays[f'{name}.{field.name}'] = getattr(part, field.name).copy()
    return arrays


def restored(
    state: EstimatorState,
    plain: dict[str, Any],
    arrays: dict[str, Array],
    received_count: NDArray[np.int_],
) -> EstimatorState:
    """Return the state that was saved; counts for diagnostics stay those of the present state.

    Args:
        state: present state of the motors, shape (motor, ...).
        plain: plain values that were saved.
        arrays: arrays that were saved.
        received_count: shape (motor,): samples in each motor's stream.
    """
    return EstimatorState(
        belief=Belief(**_below('belief', arrays)),
        prior=Prior(arrays['prior_p'], arrays['prior_covariance']),
        anchor=Belief(**_below('anchor', arrays)),
        anchor_position=received_count + plain['anchored'],
        position=received_count - plain['new'],
        is_started=np.array([plain['started']]),
        next_fit_at=np.array([plain['next_fit']]),
        task_code=np.array([plain['asked']]),
        noise_count=np.array([plain['noise_count']]),
        score=np.moveaxis(arrays['drift_score'], 1, 0),
        information=np.moveaxis(arrays['drift_information'], 1, 0),
        hold=HoldState(**_below('holds', arrays)),
        examined_at=received_count + plain['examined'],
        outliers=state.outliers,
        kicks=state.kicks,
        change_count=state.change_count,
        **{name: arrays[name] for name in _ARRAYS},  # type: ignore[arg-type]
    )


def _below(part: str, arrays: dict[str, Array]) -> dict[str, Any]:
    return {
        name[len(part) + 1 :]: array
        for name, array in arrays.items()
        if name.startswith(f'{part}.')
    }


def check(plain: dict[str, Any], arrays: dict[str, Array], coordinates: int) -> None:
    """Refuse a saved state that could not have been learnt.

    Raises:
        CheckpointError: something is missing, or no state of this rule.
    """
    n = coordinates
    memories = len(MEMORIES_BLOCKS)
    check_belief('belief', arrays, n)
    check_belief('anchor', arrays, n)
    check_prior(arrays, n)
    check_hold('holds', arrays, n)
    check_signals('replay', arrays.get('replay'))
    rules = {
        'suspicion': ArrayRule((1,), 0.0),
        'since': counts(1),
        'left_out': ArrayRule((1,), 0.0),
        'walk_rate': ArrayRule((1,), 0.0, FASTEST_WALK),
        'least_noise': ArrayRule((1,), 0.0),
        'share': ArrayRule((1, n), 0.0),
        'reach': ArrayRule((1, n), 0.0, endless=True),
        'in_vain': counts(1),
        'drift_score': ArrayRule((memories, 1, n)),
        'drift_information': ArrayRule((memories, 1, n, n)),
        'speed': ArrayRule((1,), -LARGEST_SIGNAL, LARGEST_SIGNAL),
    }
    check_arrays(arrays, rules)
    remembered_count = arrays['replay'].shape[2]
    dropped_count = whole(plain, 'gone')
    new = min(whole(plain, 'new'), remembered_count)
    whole(plain, 'next_fit', 1)
    whole(plain, 'stamp_ns', -LATEST_NS, LATEST_NS)
    whole(plain, 'noise_count')
    whole(plain, 'anchored', -MOST, -new)
    whole(plain, 'begin', 0, dropped_count + remembered_count - new)
    whole(plain, 'examined', -MOST, 0)
    task_code = whole(plain, 'asked', WALK_AGAIN)
    if not flag(plain, 'started') and task_code:
        raise CheckpointError('asked: a motor of which nothing is known yet cannot have changed')
    flag(plain, 'resumes')
