"""Regular blocks by compiled code, `regular_block.c`, with the numpy path as a fallback.

The numpy path is :mod:`block_step` and :mod:`block_updater`.

A block is regular where nothing restarts, the state is not kicked, outliers are few and nothing
speaks for a change of the motor. Nearly all are, and these decide what an update costs. What is not
regular is left to numpy, which can do either; so can a workspace that was built without a C
compiler, only slower.
"""

from __future__ import annotations

import ctypes
from operator import attrgetter, is_
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gray_box_observer.context_nodes.native import compiled
from gray_box_observer.context_nodes.native.compiled import address
from gray_box_observer.context_nodes.recursive import change_test
from gray_box_observer.context_nodes.recursive.batch_fit import CREDIBLE
from gray_box_observer.context_nodes.recursive.constant_voltage import HOLD_TOLERANCE, SETTLED
from gray_box_observer.context_nodes.recursive.estimator_settings import RecursiveSettings
from gray_box_observer.context_nodes.recursive.estimator_state import EstimatorState, copied
from gray_box_observer.context_nodes.recursive.normal_equations import CORRELATION_SLACK, OUTLIER
from gray_box_observer.context_nodes.recursive.random_walk import heating
from gray_box_observer.context_nodes.recursive.trajectory import FAR, KICK
from gray_box_observer.samples.noise_floor import STILL
from gray_box_observer.samples.replay_buffer import ReplayBuffer
from gray_box_observer.white_box import forms
from gray_box_observer.white_box.declaration import COMPILED
from gray_box_observer.white_box.flow import LARGEST_STEP, MAX_STEPS
from gray_box_observer.white_box.interface import WhiteBox, bounds
from gray_box_observer.white_box.motor import MotorWhiteBox

MOST_COORDINATES, MOST_KNOWN, MOST_SAMPLES, MOST_MEMORIES = 5, 8, 64, 8
"""Room in `regular_block.c`."""

LEARNT = 1
"""Bit that tells of a motor that its block is learnt."""

LONG_HOLD = 2
"""Bit that tells that it has been in a long hold."""

ANCHOR_DUE = 4
"""Bit that tells that its anchor lies far back."""

_COUNT = ctypes.c_int64
_NUMBER = ctypes.c_double
_POINTER = ctypes.c_void_p

WRITTEN = {
    'at': 'position',
    'p': 'belief.p',
    'state': 'belief.state',
    'covariance': 'belief.covariance',
    'noise': 'belief.noise',
    'sensitivity': 'belief.sensitivity',
    'score': 'score',
    'information': 'information',
    'noise_count': 'noise_count',
    'since': 'since',
    'outliers': 'outliers',
    'suspicion': 'suspicion',
    'left_out': 'left_out',
    'hold_level': 'hold.level',
    'hold_largest': 'hold.largest',
    'hold_held_s': 'hold.held_s',
    'hold_p': 'hold.p',
    'hold_covariance': 'hold.covariance',
    'hold_settled_now': 'hold.settled',
}
"""What a regular block changes, by its place in the estimator's state."""

READ = {
    'current_a': 'belief.current_a',
    'gain': 'belief.gain',
    'least_noise': 'least_noise',
    'walk_rate': 'walk_rate',
    'anchored': 'anchor_position',
    'next_fit': 'next_fit_at',
    'hold_begun': 'hold.begun',
}
"""What else is asked of a motor, and where that stands."""

_of_learnt = attrgetter(*READ.values(), *WRITTEN.values())
_parts = attrgetter(
    *dict.fromkeys(name.partition('.')[0] for name in (*READ.values(), *WRITTEN.values()))
)
"""Where these stand in it: arrays, and what is frozen and never gets other ones."""


class _Update(ctypes.Structure):
    """``Update`` of `regular_block.c`."""

    _fields_ = (
        *(
            (name, _COUNT)
            for name in ('coordinates', 'samples', 'memories', 'known_terms', 'speed_measured')
        ),
        ('codes', _COUNT * (MOST_COORDINATES + MOST_KNOWN)),
        *((name, _NUMBER * MOST_COORDINATES) for name in ('heats', 'lower', 'upper')),
        ('known', _POINTER),
        ('torque_constant', _POINTER),
        ('motors', _COUNT),
        ('keep', _NUMBER * MOST_MEMORIES),
        *(
            (name, _NUMBER)
            for name in ('outlier', 'kick', 'credible', 'far_away', 'largest_step', 'most_steps')
        ),
        *(
            (name, _NUMBER)
            for name in ('threshold', 'noise_floor', 'left_out_memory', 'left_out_limit')
        ),
        *((name, _NUMBER) for name in ('hold_tolerance', 'hold_settled', 'long_hold_s')),
        *((name, _NUMBER) for name in ('correlation_slack', 'still')),
        *((name, _COUNT) for name in ('noise_memory', 'replay_capacity')),
        ('data', _POINTER),
        *((name, _COUNT) for name in ('signal_stride', 'column_stride', 'columns')),
        *((name, _POINTER) for name in ('gone', 'end', 'begin', *READ, *WRITTEN, 'due', 'plain')),
    )


def library(kind: type[ctypes.CDLL] = ctypes.CDLL) -> ctypes.CDLL | None:
    """Load the compiled code; None if absent, or of another ``Update`` or motor.

    Args:
        kind: how functions are called, see :func:`~compiled.load`.
    """
    handle = compiled.library('update_size', _Update, kind)
    if handle is None:
        return None
    handle.learn_blocks.argtypes = (ctypes.POINTER(_Update), _POINTER, _COUNT, _POINTER)
    handle.learn_blocks.restype = None
    handle.learn_due.argtypes = (ctypes.POINTER(_Update), _COUNT, *4 * (_POINTER,))
    handle.learn_due.restype = _COUNT
    handle.term_values.argtypes = (_COUNT, _COUNT, *4 * (_NUMBER,), ctypes.POINTER(_NUMBER))
    handle.term_values.restype = _COUNT
    handle.forms_fingerprint.restype = _COUNT
    return handle if handle.forms_fingerprint() == forms.FINGERPRINT else None


class BatchResult(NamedTuple):
    """What became of the motors of a group at one of its samples.

    Attributes:
        motors: places of those whose block was looked at; None where they were too many, and
            nothing was done.
        status: what became of each block, as of :meth:`RegularBlocks.learn`.
        has_learnt: shape (motor,), of all motors: whether it has learnt.
        wait: samples until somebody is due again; 0 where there is more to do now.
    """

    motors: NDArray[np.int64] | None
    status: NDArray[np.uint8]
    has_learnt: NDArray[np.bool_]
    wait: int

    @classmethod
    def nothing_done(cls, motors: int) -> BatchResult:
        """Return the result of a step in which nothing was done."""
        return cls(None, np.empty(0, dtype=np.uint8), np.zeros(motors, dtype=bool), 0)


class RegularBlocks:
    """Learns regular blocks in place.

    Args:
        white_box: of all motors.
        rules: settings.
        replay: samples of all motors.
    """

    def __init__(self, white_box: WhiteBox, rules: RecursiveSettings, replay: ReplayBuffer) -> None:
        self._library: ctypes.CDLL | None = None
        self._target_parts: tuple[Any, ...] = ()
        # of one motor it keeps the interpreter lock, which takes as long to get back as a block
        handle = library(ctypes.PyDLL if replay.motors == 1 else ctypes.CDLL)
        if (
            handle is not None
            and isinstance(white_box, MotorWhiteBox)
            and _fits(handle, white_box, rules)
        ):
            self._library = handle
            self._describe(white_box, rules, replay)

    @property
    def compiled(self) -> bool:
        """Whether compiled code knows this physics; else no block counts as regular."""
        return self._library is not None

    def _describe(
        self, white_box: MotorWhiteBox, rules: RecursiveSettings, replay: ReplayBuffer
    ) -> None:
        """Write down what never changes."""
        motors = replay.motors
        lower, upper = bounds(white_box.parameters)
        keep = change_test.keep()
        data, dropped_count, end, begin = replay.streams
        constants = [np.broadcast_to(white_box.known[name], motors) for name in white_box.given]
        self._constant_arrays = (  # pointers point to these
            np.array(constants, dtype=float).reshape(len(white_box.given), motors),
            np.array(np.broadcast_to(white_box.torque_constant, motors), dtype=float),
            data,
            dropped_count,
            end,
            begin,
        )
        # the samples stand in another order of axes: their strides go along
        places = [array.ctypes.data for array in self._constant_arrays]
        self._update = _Update(
            coordinates=len(white_box.parameters),
            samples=rules.block,
            memories=keep.size,
            known_terms=len(white_box.given),
            speed_measured=int(white_box.speed_measured),
            codes=white_box.codes,
            heats=tuple(heating(white_box.parameters).tolist()),
            lower=tuple(lower.tolist()),
            upper=tuple(upper.tolist()),
            known=places[0],
            torque_constant=places[1],
            motors=motors,
            keep=tuple(keep.tolist()),
            outlier=OUTLIER,
            kick=KICK,
            credible=CREDIBLE,
            far_away=FAR,
            largest_step=LARGEST_STEP,
            most_steps=MAX_STEPS,
            threshold=rules.drift_threshold,
            noise_floor=rules.noise_floor,
            left_out_memory=change_test.LEFT_OUT_MEMORY,
            left_out_limit=change_test.LEFT_OUT,
            hold_tolerance=HOLD_TOLERANCE,
            hold_settled=SETTLED,
            long_hold_s=rules.long_hold_s,
            correlation_slack=CORRELATION_SLACK,
            still=STILL,
            noise_memory=rules.noise_memory,
            replay_capacity=rules.replay_capacity,
            data=places[2],
            signal_stride=data.strides[0] // data.itemsize,
            column_stride=data.strides[2] // data.itemsize,
            columns=data.shape[2],
            gone=places[3],
            end=places[4],
            begin=places[5],
        )
        self._batch = (
            np.empty(motors, dtype=int),
            np.empty(motors, dtype=np.uint8),
            np.zeros(motors, dtype=bool),
        )
        self._wait = _COUNT()
        self._batch_places = (
            *(address(array) for array in self._batch),
            ctypes.byref(self._wait),
        )

    def learn(
        self,
        state: EstimatorState,
        motors: NDArray[np.int64],
        next_update_at: NDArray[np.int64],
        is_block_update: NDArray[np.bool_],
    ) -> tuple[EstimatorState, NDArray[np.uint8]]:
        """Learn the next block of some motors where it is a regular one.

        Of several motors the interpreter lock is let go meanwhile: what is known, and the samples,
        are one thread's alone; others are given copies.

        Args:
            state: of all motors; written to.
            motors: their places; their samples reach to the end of the block.
            next_update_at: shape (motor,): where in its stream the next work on a motor is due;
                written to.
            is_block_update: shape (motor,): whether that is a block; written to.

        Returns:
            What is known then, and what became of every block, shape (place,): 0 where nothing has
            changed, else LEARNT and what there is to do besides.
        """
        status = np.zeros(motors.size, dtype=np.uint8)
        if self._library is None:
            return state, status
        state = self._point(state, next_update_at, is_block_update)
        self._library.learn_blocks(self._update, address(motors), motors.size, address(status))
        return state, status

    def learn_due(
        self,
        state: EstimatorState,
        next_update_at: NDArray[np.int64],
        is_block_update: NDArray[np.bool_],
        most: int,
    ) -> tuple[EstimatorState, BatchResult]:
        """Learn the next block of every motor that is due for one, as :meth:`learn` does.

        Args:
            state: of all motors; written to; the samples must have been settled.
            next_update_at: as there.
            is_block_update: as there.
            most: how many motors at most; where more are due nothing is done, nor without compiled
                code.

        Returns:
            What is known then, and the turn.
        """
        if self._library is None:
            return state, BatchResult.nothing_done(next_update_at.size)
        state = self._point(state, next_update_at, is_block_update)
        count = self._library.learn_due(self._update, most, *self._batch_places)
        motors, status, has_learnt = self._batch
        block_motors = None if count > most else motors[:count].copy()
        return state, BatchResult(
            block_motors, status[:count].copy(), has_learnt.copy(), self._wait.value
        )

    def _point(
        self,
        state: EstimatorState,
        next_update_at: NDArray[np.int64],
        is_block_update: NDArray[np.bool_],
    ) -> EstimatorState:
        """Let the compiled code write to the arrays themselves, or to writable copies of them."""
        parts = (*_parts(state), next_update_at, is_block_update)
        if self._target_parts and all(map(is_, parts, self._target_parts)):
            return state
        arrays = (*_of_learnt(state), next_update_at, is_block_update)
        if not all(array.flags.c_contiguous and array.flags.writeable for array in arrays):
            state = copied(state)
            arrays = (*_of_learnt(state), next_update_at, is_block_update)
        for name, array in zip((*READ, *WRITTEN, 'due', 'plain'), arrays, strict=True):
            setattr(self._update, name, address(array))
        self._target_parts = (*_parts(state), next_update_at, is_block_update)
        return state


def _fits(handle: ctypes.CDLL, white_box: MotorWhiteBox, rules: RecursiveSettings) -> bool:
    """Whether `regular_block.c` has room for it and knows its terms."""
    values = (_NUMBER * 2)()
    return (
        white_box.states == COMPILED
        and len(white_box.parameters) <= MOST_COORDINATES
        and len(white_box.given) <= MOST_KNOWN
        and rules.block <= MOST_SAMPLES
        and rules.block < rules.replay_capacity
        and all(handle.term_values(code, 0, *4 * (0.0,), values) for code in white_box.codes)
    )
