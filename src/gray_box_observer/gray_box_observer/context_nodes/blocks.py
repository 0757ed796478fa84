"""One step of the recursion: a block of samples predicted from what is believed, and learnt.

An extended Kalman filter of (state, coordinates) whose step is a block of samples: exact zero-order-hold sensitivities,
outliers of torque left out, a wrong voltage sample met by letting the state go.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gray_box_observer.context_nodes.batch_fit import CREDIBLE
from gray_box_observer.context_nodes.belief import Belief
from gray_box_observer.context_nodes.normal_equations import OUTLIER, semidefinite, weighted
from gray_box_observer.context_nodes.trajectory import (
    Stretch,
    Trajectory,
    find_kicks,
    follow,
    left_of_restarts,
    linearise,
)
from gray_box_observer.white_box.base import Array, WhiteBox
from gray_box_observer.white_box.flow import within_bounds


@dataclass(frozen=True, slots=True)
class Block:
    """One block of samples, predicted: arrays of shape (motor, k), the Jacobian of (motor, k, unknown).

    Attributes:
        stretch: the samples, restarted where the state was kicked.
        path: the predicted trajectory, from the sample before the block.
        residual: measured less predicted current.
        jacobian: derivative of the predicted current by the unknowns.
        spread: standard deviation of the residual, in units of the noise.
        valid: where the interval is no restart.
        kept: where the sample is no outlier either.
        kicked: shape (motor,): whether the state was let go.
    """

    stretch: Stretch
    path: Trajectory
    residual: Array
    jacobian: Array
    spread: Array
    valid: NDArray[np.bool_]
    kept: NDArray[np.bool_]
    kicked: NDArray[np.bool_]


def predict(white_box: WhiteBox, belief: Belief, stretch: Stretch) -> Block:
    """Predict a block, and tell its good samples from the others.

    Args:
        white_box: the physics.
        belief: at the sample before the block.
        stretch: that sample and the block.
    """
    reach = CREDIBLE * belief.current_a[:, None]  # nothing is linearised about an absurd sample
    about = np.concatenate([belief.state[:, None], np.clip(stretch.state[:, 1:], -reach, reach)], axis=1)
    trust = np.tile(belief.gain[:, None], (1, stretch.state.shape[1]))
    path, residual, jacobian, spread = _from(white_box, belief, stretch, about, trust)
    limit = OUTLIER * belief.noise[:, None] * spread
    kicked = np.zeros(belief.state.size, dtype=bool)
    if np.any(np.abs(residual) > limit):
        kicks = find_kicks(path, residual, ~stretch.restart, belief.noise)
        kicked = np.any(kicks, axis=1)
        stretch = stretch.restarted(kicks)
        trust = trust * (np.abs(residual) <= limit)
        path, residual, jacobian, spread = _from(white_box, belief, stretch, about, trust)
        off = np.abs(residual) > OUTLIER * belief.noise[:, None] * spread
        if np.any(off):  # the motor never stood where an outlier says: linearise about where it was expected
            about = np.where(off, path.state, about)
            path, residual, jacobian, spread = _from(white_box, belief, stretch, about, trust)
        limit = OUTLIER * belief.noise[:, None] * spread
    valid = ~stretch.restart
    kept: NDArray[np.bool_] = valid & (np.abs(residual) <= limit)[:, 1:]
    return Block(stretch, path, residual[:, 1:], jacobian[:, 1:], spread[:, 1:], valid, kept, kicked)


def _from(
    white_box: WhiteBox, belief: Belief, stretch: Stretch, about: Array, trust: Array
) -> tuple[Trajectory, Array, Array, Array]:
    """Trajectory, residuals, their derivatives by the unknowns, and their spread in units of the noise."""
    path = follow(linearise(white_box, belief.p, stretch, about), stretch, belief.state, trust)
    jacobian = belief.frame.jacobian(path)
    residual = stretch.state - path.state
    residual[:, 0] = 0.0  # the first sample belongs to the block before
    variance = np.sum((jacobian @ belief.covariance) * jacobian, axis=2)
    return path, residual, jacobian, np.sqrt(1.0 + np.maximum(variance, 0.0))


def learn(white_box: WhiteBox, belief: Belief, block: Block, walked: Array) -> Belief:
    """Turn a block's residuals into new coordinates, state and covariance.

    Args:
        white_box: the physics.
        belief: what the block was predicted from.
        block: the block.
        walked: shape (motor, coordinate, coordinate): variance that the coordinates' logarithms have walked over it.
    """
    n = belief.p.shape[1]
    information, right = weighted(block.jacobian, block.kept.astype(float), block.residual)
    posterior = np.linalg.solve(np.eye(n + 1) + belief.covariance @ information, belief.covariance)
    posterior = 0.5 * (posterior + np.swapaxes(posterior, 1, 2))
    step = (posterior @ right[..., None])[..., 0]
    step[:, 1:] = np.clip(step[:, 1:], -0.5, 1.0)
    p = within_bounds(white_box, belief.p * (1.0 + step[:, 1:]))
    transfer = belief.frame.transfer(block.path)
    moved = transfer @ posterior @ np.swapaxes(transfer, 1, 2)
    if np.any(block.stretch.restart):
        moved[:, 0, 0] += left_of_restarts(block.path, block.stretch) / belief.current_a**2
    state = block.path.state[:, -1] + (transfer @ step[..., None])[:, 0, 0] * belief.current_a
    moved[:, 1:, 1:] += walked / (belief.noise**2)[:, None, None]
    after = replace(belief, p=p, state=state)
    after = replace(after, covariance=belief.frame.moved(moved, after.frame))
    return replace(belief, state=block.stretch.state[:, -1]).overwritten(after, after.finite)


def whitened(belief: Belief, block: Block, columns: Array) -> tuple[Array, Array, Array]:
    """Make innovations white and of unit variance; zero where a sample is not to be used.

    Args:
        belief: what the block was predicted from.
        block: the block.
        columns: shape (motor, k, column): turned along with them.

    Returns:
        The columns, the innovations of shape (motor, k), and the logarithm of their determinant, shape (motor,).
    """
    use: NDArray[np.bool_] = block.kept & ~block.kicked[:, None]
    jacobian = block.jacobian * use[..., None]
    ones = np.eye(use.shape[1])
    spread = jacobian @ belief.covariance @ np.swapaxes(jacobian, 1, 2) + ones
    try:
        root = np.linalg.cholesky(spread)
    except np.linalg.LinAlgError:  # rounding has made the covariance indefinite: mend it
        spread = jacobian @ semidefinite(belief.covariance) @ np.swapaxes(jacobian, 1, 2) + ones
        if not np.all(np.linalg.eigvalsh(np.nan_to_num(spread)) > 0.0):
            return 0.0 * columns, 0.0 * block.residual, np.zeros(use.shape[0])  # nothing can be said with this block
        root = np.linalg.cholesky(spread)
    stacked = np.concatenate([columns, block.residual[..., None]], axis=2) * use[..., None]
    white = np.linalg.solve(root, stacked) / belief.noise[:, None, None]
    size = np.sum(np.log(np.diagonal(root, axis1=1, axis2=2)), axis=1)
    return white[..., :-1], white[..., -1], size
