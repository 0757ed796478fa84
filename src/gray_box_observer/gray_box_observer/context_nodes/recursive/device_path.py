"""Blocks of very many motors predicted by torch, as in :mod:`block_step` and C.

The motion over an interval is :mod:`~gray_box_observer.white_box.flow` itself, called with tensors.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import torch

from gray_box_observer.context_nodes.recursive.batch_fit import CREDIBLE
from gray_box_observer.context_nodes.recursive.normal_equations import OUTLIER
from gray_box_observer.context_nodes.recursive.trajectory import (
    COORDINATE_ROWS,
    CURRENT,
    FAR,
    KICK,
    START_ROW,
    STATE_ROW,
)
from gray_box_observer.white_box.flow import flow, is_stiff
from gray_box_observer.white_box.motor import MotorWhiteBox
from gray_box_observer.white_box.torch_ops import TorchOps

Tensor = torch.Tensor


@dataclass(frozen=True, slots=True)
class Given:
    """Blocks, signals of shape (motor, k + 1), and the :class:`Belief` at their sample 0."""

    box: MotorWhiteBox
    interval: Tensor
    voltage: Tensor
    measured: Tensor
    speed: Tensor
    p: Tensor
    state: Tensor
    covariance: Tensor
    noise: Tensor
    gain: Tensor
    current_a: Tensor

    def of(self, index: Tensor) -> Given:
        """Return the blocks of the chosen motors."""
        tensors = (getattr(self, field.name)[index] for field in fields(self)[1:])
        return Given(self.box.of_motors(index), *tensors)


@dataclass(frozen=True, slots=True)
class Predicted:
    """Predicted blocks, with their normal equations.

    Attributes:
        sound: shape (motor,): whether the motion went nowhere absurd, and in not too many steps.
        state: shape (motor, k): predicted current.
        factor: shape (motor, k): how much of an error every interval leaves.
        error: shape (motor, k): measured less predicted current.
        kept: shape (motor, k): where the sample is no outlier.
        by_start, by_coordinate: shapes (motor,), (motor, coordinate): derivatives of the current at
            the end.
        used: shape (motor,): how many samples are kept.
        squares: shape (motor,): sum of their squared errors, in units of their spread.
        info, right: shapes (motor, unknown, unknown), (motor, unknown): normal equations of them.
    """

    sound: Tensor
    state: Tensor
    factor: Tensor
    error: Tensor
    kept: Tensor
    by_start: Tensor
    by_coordinate: Tensor
    used: Tensor
    squares: Tensor
    info: Tensor
    right: Tensor

    def put(self, index: Tensor, other: Predicted) -> None:
        """Take over the paths of some motors."""
        for field in fields(self):
            getattr(self, field.name)[index] = getattr(other, field.name)


def predict(ops: TorchOps, given: Given) -> tuple[Predicted, Tensor]:
    """Predict blocks, part good samples from bad ones; tell whose block is regular so far."""
    reach = CREDIBLE * given.current_a[:, None]
    about = given.measured.clamp(-reach, reach)
    about[:, 0] = given.state
    path = _follow(ops, given, about, None)
    fine = path.sound & (given.interval[:, 1:] > 0.0).all(dim=1)
    odd = ops.flatnonzero(fine & ~path.kept.all(dim=1))
    if odd.numel():
        some, about, near = given.of(odd), about[odd], path.kept[odd]
        fine[odd] &= ~_kicked(path.error[odd], path.factor[odd], KICK * some.noise[:, None])
        again = _follow(ops, some, about, near)
        about[:, 1:] = torch.where(again.kept, about[:, 1:], again.state)
        path.put(odd, _follow(ops, some, about, near))
        fine &= path.sound
    return path, fine


def _follow(ops: TorchOps, given: Given, about: Tensor, near: Tensor | None) -> Predicted:
    """The trajectory with derivatives, and the normal equations over all or the near samples.

    Sources: trajectory.py, linearise and follow; block_step.py, _from.
    """
    start, measured, speed = about[:, :-1], given.measured, given.speed
    voltage, interval, box = given.voltage[:, 1:], given.interval[:, 1:], given.box
    moved = flow(box, given.p, [start], voltage, speed[:, :-1], speed[:, 1:], interval, ops)  # type: ignore[arg-type, list-item]
    end, by_state, forced = moved.of_state(CURRENT)
    stiff: Any = is_stiff(box, given.p, [start], voltage, speed[:, :-1], interval, ops)  # type: ignore[arg-type, list-item]
    limit = FAR * (measured.abs().amax(dim=1, keepdim=True) + 1e-9)
    decay, gain = by_state.clamp(-1.0, 1.0), given.gain[:, None].expand(start.shape)
    if near is not None:
        gain = torch.cat([gain[:, :1], torch.where(near[:, :-1], gain[:, 1:], 0.0)], dim=1)
    factor = decay * (1.0 - gain)
    offset = end - decay * start + decay * gain * measured[:, :-1]
    rows = _recurrence(factor, offset, forced, given.state)
    units = torch.cat([given.current_a[:, None], given.p], dim=1)
    jacobian = (rows[START_ROW:] * units.T[..., None]).permute(1, 2, 0)
    error = measured[:, 1:] - rows[STATE_ROW]
    spread = 1.0 + ((jacobian @ given.covariance) * jacobian).sum(dim=2).clamp_min(0.0)
    kept = error**2 <= (OUTLIER * given.noise)[:, None] ** 2 * spread
    counts = torch.where(kept[..., None], jacobian, 0.0).transpose(1, 2)
    return Predicted(
        sound=(end.abs() <= limit).all(dim=1) & ~stiff,
        state=rows[STATE_ROW],
        factor=factor,
        error=error,
        kept=kept,
        by_start=rows[START_ROW, :, -1].clone(),
        by_coordinate=rows[COORDINATE_ROWS, :, -1].T.clone(),
        used=kept.sum(dim=1, dtype=error.dtype),
        squares=torch.where(kept, error**2 / spread, 0.0).sum(dim=1),
        info=counts @ jacobian,
        right=(counts @ error[..., None])[..., 0],
    )


def _recurrence(factor: Tensor, offset: Tensor, by_coordinate: Tensor, state: Tensor) -> Tensor:
    """States and their derivatives by start and coordinates, samples 1 ... k: (row, motor, k)."""
    inputs = torch.cat([offset[None], torch.zeros_like(offset)[None], by_coordinate])
    value = torch.zeros_like(inputs[..., 0])
    value[STATE_ROW], value[START_ROW] = state, 1.0
    rows = []
    for left, added in zip(
        factor.T.contiguous(), inputs.permute(2, 0, 1).contiguous(), strict=True
    ):
        value = left * value + added
        rows.append(value)
    return torch.stack(rows, dim=2)


def _kicked(error: Tensor, factor: Tensor, limit: Tensor) -> Tensor:
    """Whether the state was kicked: trajectory.py, find_kicks."""
    zero, end = torch.zeros_like(limit), torch.full_like(limit, torch.inf)
    jump = error - factor * torch.cat([zero, error[:, :-1]], dim=1)
    change = jump.abs()
    before, after = torch.cat([zero, change[:, :-1]], dim=1), torch.cat([change[:, 1:], end], dim=1)
    earlier = torch.cat([zero, before[:, :-1]], dim=1)
    both = (jump + factor * torch.cat([zero, jump[:, :-1]], dim=1)).abs()
    one = (change > limit) & (before < 0.5 * change) & (after < 0.5 * change)
    two = (both > limit) & (earlier < 0.25 * both) & (after < 0.25 * both) & (before > 0.0)
    return (one | two).any(dim=1) & (change > limit).any(dim=1)
