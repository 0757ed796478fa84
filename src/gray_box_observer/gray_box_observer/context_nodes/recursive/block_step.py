"""One step of the recursion: a block of samples predicted from what is believed, and learnt.

An extended Kalman filter of (state, coordinates) whose step is a block of samples: exact
zero-order-hold sensitivities, outliers of torque left out, a wrong voltage sample met by letting
the state go.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gray_box_observer.context_nodes.recursive.batch_fit import CREDIBLE
from gray_box_observer.context_nodes.recursive.belief import Belief
from gray_box_observer.context_nodes.recursive.normal_equations import (
    OUTLIER,
    Scaling,
    definite,
    is_sound,
    semidefinite,
    solved,
    weighted,
)
from gray_box_observer.context_nodes.recursive.trajectory import (
    COORDINATES,
    CURRENT,
    STATES,
    SampleWindow,
    Trajectory,
    find_kicks,
    follow,
    linearise,
    restart_variance,
    taken_over,
)
from gray_box_observer.white_box.flow import within_bounds
from gray_box_observer.white_box.interface import Array, WhiteBox


@dataclass(frozen=True, eq=False)
class Block:
    """One predicted block: arrays of shape (motor, k), Jacobian (motor, k, unknown).

    Attributes:
        stretch: the samples, restarted where the state was kicked.
        path: the predicted trajectory, from the sample before the block.
        residual: measured less predicted current.
        jacobian: derivative of the predicted current by the unknowns.
        spread: standard deviation of the residual, in units of the noise.
        valid: where the interval is no restart.
        is_inlier: where the sample is no outlier either.
        weights: what each sample counts: less than one after a restart, nothing where it is not
            kept.
        left_variance: shape (motor,): variance that restarts leave in the state at the end, in
            units of the noise's.
        has_kick: shape (motor,): whether the state was let go.
        samples: shape (motor,): how many are valid.
        inlier_count: shape (motor,): how many are kept.
        information: shape (motor, unknown, unknown): ``A = J'J`` of the samples kept.
        right: shape (motor, unknown): ``b = J'r`` of them; with the information all that learning
            and testing ask for.
    """

    stretch: SampleWindow
    path: Trajectory
    residual: Array
    jacobian: Array
    spread: Array
    valid: NDArray[np.bool_]
    is_inlier: NDArray[np.bool_]
    weights: Array
    left_variance: Array
    has_kick: NDArray[np.bool_]
    samples: NDArray[np.int_]
    inlier_count: NDArray[np.int_]
    information: Array
    right: Array

    def select(self, index: NDArray[np.intp]) -> Block:
        """Return the block of the chosen motors."""
        signals: Any = (getattr(self, field.name)[index] for field in fields(self)[2:])
        return Block(self.stretch.select(index), self.path.select(index), *signals)

    def silenced(self, selection: NDArray[np.bool_]) -> Block:
        """Return the block without information on some motors, (motor,); they only move on."""
        information = np.where(selection[:, None, None], 0.0, self.information)
        return replace(
            self, information=information, right=np.where(selection[:, None], 0.0, self.right)
        )


def predict(white_box: WhiteBox, belief: Belief, stretch: SampleWindow) -> Block:
    """Predict a block, and tell its good samples from the others.

    Args:
        white_box: the physics.
        belief: at the sample before the block.
        stretch: that sample and the block.
    """
    about, near = _outset(belief, stretch)
    path, residual, jacobian, spread, loose = _from(white_box, belief, stretch, about, near)
    limit = OUTLIER * belief.noise[:, None] * spread
    has_kick = np.zeros(belief.state.size, dtype=bool)
    if (off := np.abs(residual) > limit).any():
        odd = off.any(
            axis=1, keepdims=True
        )  # whoever has no outlier is asked nothing, as it would be alone
        kicks = find_kicks(path, residual, ~stretch.restart, belief.noise) & odd
        has_kick = np.any(kicks, axis=1)
        stretch = stretch.restarted(kicks)
        near = np.abs(residual) <= limit
        path, residual, jacobian, spread, loose = _from(white_box, belief, stretch, about, near)
        off = np.abs(residual) > OUTLIER * belief.noise[:, None] * spread
        if np.any(
            off
        ):  # the motor never stood where an outlier says: linearise about where it was expected
            about = np.where(off, path.state, about)
            path, residual, jacobian, spread, loose = _from(white_box, belief, stretch, about, near)
        limit = OUTLIER * belief.noise[:, None] * spread
    valid = ~stretch.restart
    is_inlier: NDArray[np.bool_] = valid & (np.abs(residual) <= limit)[:, 1:]
    residual = residual[:, 1:]
    jacobian = jacobian[:, 1:]
    counts = valid.sum(axis=1), is_inlier.sum(axis=1)
    weights = is_inlier / (1.0 + loose[:, 1:])
    normal = weighted(jacobian, weights, residual)
    left_variance = taken_over(loose[:, -1])
    return Block(
        stretch,
        path,
        residual,
        jacobian,
        spread[:, 1:],
        valid,
        is_inlier,
        weights,
        left_variance,
        has_kick,
        *counts,
        *normal,
    )


def _outset(belief: Belief, stretch: SampleWindow) -> tuple[Array, NDArray[np.bool_]]:
    """States to linearise about, and samples near enough to tell of them, (motor, k + 1)."""
    reach = CREDIBLE * belief.current_a[:, None]  # nothing is linearised about an absurd sample
    about = np.clip(stretch.state, -reach, reach)
    about[:, 0] = belief.state
    return about, np.ones(stretch.state.shape, dtype=bool)


def _from(
    white_box: WhiteBox,
    belief: Belief,
    stretch: SampleWindow,
    about: Array,
    near: NDArray[np.bool_],
) -> tuple[Trajectory, Array, Array, Array, Array]:
    """Trajectory, residuals, derivatives by the unknowns, spread, and variance left by restarts.

    Spread and variance are in units of the noise; the state takes nothing over from samples that
    are not near.
    """
    loose = np.zeros_like(about)
    gain = belief.gain[:, None]
    maps = linearise(white_box, belief.p, stretch, about)
    if stretch.restart.any():
        loose = restart_variance(maps.decay, stretch.restart)
        gain = np.maximum(gain, taken_over(loose))
    path = follow(maps, stretch, belief.state, gain * near)
    jacobian = belief.frame.jacobian(path)
    residual = stretch.state - path.state
    residual[:, 0] = 0.0  # the first sample belongs to the block before
    variance = loose + np.maximum(((jacobian @ belief.covariance) * jacobian).sum(axis=2), 0.0)
    return path, residual, jacobian, np.sqrt(1.0 + variance), loose


def learn(white_box: WhiteBox, belief: Belief, block: Block, walk_spread: Array | None) -> Belief:
    """Turn a block's residuals into new coordinates, state and covariance.

    Args:
        white_box: the physics.
        belief: what the block was predicted from.
        block: the block.
        walk_spread: shape (motor, coordinate, coordinate): variance that the coordinates'
            logarithms
            have walked over it; None: none.
    """
    n = belief.p.shape[1]
    posterior = solved(
        np.eye(n + STATES) + belief.covariance @ block.information, belief.covariance
    )
    posterior = 0.5 * (posterior + posterior.swapaxes(1, 2))
    if not (sound := is_sound(posterior)).all():  # rounding has made it indefinite
        ones = np.ones(posterior.shape[:2])
        posterior = np.where(
            sound[:, None, None], posterior, definite(np.nan_to_num(posterior), ones)
        )
    step = (posterior @ block.right[..., None])[..., 0]
    step[:, COORDINATES] = step[:, COORDINATES].clip(-0.5, 1.0)
    p = within_bounds(white_box, belief.p * (1.0 + step[:, COORDINATES]))
    transfer = belief.frame.transfer(block.path)
    end_covariance = transfer @ posterior @ transfer.swapaxes(1, 2)
    end_covariance[:, CURRENT, CURRENT] += block.left_variance / belief.current_a**2
    state = block.path.state[:, -1] + (transfer @ step[..., None])[:, CURRENT, 0] * belief.current_a
    if walk_spread is not None:
        end_covariance[:, COORDINATES, COORDINATES] += (
            walk_spread / (belief.noise**2)[:, None, None]
        )
    covariance = belief.frame.convert(end_covariance, Scaling(belief.current_a, p))
    after = replace(belief, p=p, state=state, covariance=covariance)
    return replace(belief, state=block.stretch.state[:, -1]).overwritten(after, after.finite)


def surprise(belief: Belief, block: Block) -> tuple[Array, Array]:
    """Score and information of a block about always different coordinates; zero if unknown.

    With ``W = (I + J P J')^-1``, which makes innovations white, and sensitivities ``S = J T`` to
    coordinates that were wrong since the sensitivity of the state was last zero, these are ``S'W
    r`` and ``S'W S``, here without any matrix of the size of the block: ``S'W = T' (I + A P)^-1
    J'``.

    Args:
        belief: what the block was predicted from.
        block: the block.

    Returns:
        Shapes (motor, coordinate) and (motor, coordinate, coordinate).
    """
    n = belief.p.shape[1]
    both = np.empty((*block.right.shape, n + STATES + 1))
    both[..., :-1] = block.information
    both[..., -1] = block.right
    solution = solved(np.eye(n + STATES) + block.information @ belief.covariance, both)
    sound = ~block.has_kick & (np.diagonal(solution, axis1=1, axis2=2) >= 0.0).all(axis=1)
    if not sound.all():  # rounding has made the covariance indefinite: mend it
        mended_covariance = semidefinite(belief.covariance)
        again = solved(np.eye(n + STATES) + block.information @ mended_covariance, both)
        solution = np.where(sound[:, None, None], solution, again)
        sound = ~block.has_kick & (np.diagonal(solution, axis1=1, axis2=2) >= 0.0).all(axis=1)
    score_terms = (
        belief.sensitivity[:, :, None] * solution[:, CURRENT, None] + solution[:, COORDINATES]
    )
    information = (
        score_terms[:, :, CURRENT, None] * belief.sensitivity[:, None, :]
        + score_terms[:, :, STATES:-1]
    )
    unit = sound / belief.noise**2
    return _cleared(score_terms[:, :, -1], unit), _cleared(information, unit)


def _cleared(values: Array, unit: Array) -> Array:
    """Values times a factor a motor; exactly zero, whatever they are, where that is zero."""
    factor = unit.reshape((-1,) + (1,) * (values.ndim - 1))
    product: Array = np.where(factor > 0.0, values * factor, 0.0)
    return product


def likelihood(belief: Belief, block: Block) -> tuple[Array, Array, NDArray[np.int_]]:
    """How well a block was predicted, each of shape (motor,).

    Args:
        belief: what the block was predicted from.
        block: the block.

    Returns:
        The sum of its squared white innovations, the logarithm of the determinant of what made them
        white, and of how many samples: none where the state was kicked or nothing can be said.
    """
    n = belief.p.shape[1]
    gram = np.eye(n + STATES) + block.information @ belief.covariance
    sign, logarithm = np.linalg.slogdet(gram)
    square_reduction = np.sum(
        block.right * (belief.covariance @ solved(gram, block.right[..., None]))[..., 0], axis=1
    )
    squares = (
        np.sum(block.weights * block.residual**2, axis=1) - square_reduction
    ) / belief.noise**2
    logarithm = logarithm - np.sum(np.log(np.where(block.is_inlier, block.weights, 1.0)), axis=1)
    is_valid = ~block.has_kick & (sign > 0.0) & (squares >= 0.0) & np.isfinite(squares + logarithm)
    count = np.where(is_valid, block.inlier_count, 0)
    return np.where(is_valid, squares, 0.0), np.where(is_valid, 0.5 * logarithm, 0.0), count
