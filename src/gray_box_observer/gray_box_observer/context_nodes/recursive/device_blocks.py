"""Regular blocks of very many motors at once by torch, on a device of its own such as a GPU.

What `regular_block.c` does eight motors at a time, with the same formulas and the same answers to
rounding: a block with a restart, a kick, many outliers or doubt about the motor is left as it was,
and numpy learns it; so is that of a stiff motor. The motion over an interval is
:mod:`~gray_box_observer.white_box.flow` itself, so every term of a white box is known here.

What is believed stays on the host, where everything else reads it, and so do samples. For a block
of 32 samples and three parameters a motor sends 1,056 bytes of samples and 640 of belief, and 626
come back. Work is handed over in some hundred calls, however many motors there are, and more than
twice as many where one of them has an outlier.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from operator import attrgetter
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from gray_box_observer.context_nodes.native.regular_block import (
    ANCHOR_DUE,
    LEARNT,
    LONG_HOLD,
    READ,
    WRITTEN,
)
from gray_box_observer.context_nodes.recursive import change_test
from gray_box_observer.context_nodes.recursive.constant_voltage import HOLD_TOLERANCE, SETTLED
from gray_box_observer.context_nodes.recursive.device_path import Given, Predicted, Tensor, predict
from gray_box_observer.context_nodes.recursive.estimator_settings import RecursiveSettings
from gray_box_observer.context_nodes.recursive.estimator_state import Learnt, copied
from gray_box_observer.context_nodes.recursive.normal_equations import CORRELATION_SLACK
from gray_box_observer.context_nodes.recursive.random_walk import heating
from gray_box_observer.context_nodes.recursive.trajectory import COORDINATES, CURRENT, STATES
from gray_box_observer.samples.noise_floor import STILL
from gray_box_observer.samples.replay_buffer import ReplayBuffer
from gray_box_observer.settings.device import DEVICE_TURN, watched
from gray_box_observer.white_box.interface import bounds
from gray_box_observer.white_box.motor import MotorWhiteBox
from gray_box_observer.white_box.torch_ops import TorchOps

_SENT = ('p', 'state', 'covariance', 'noise', 'sensitivity', 'score', 'information', 'left_out',
    'noise_count',
         'hold_level', 'hold_largest', 'hold_held_s', 'current_a', 'gain', 'least_noise',
         'walk_rate')  # fmt: skip
_OF_LEARNT = {name: attrgetter(path) for name, path in {**READ, **WRITTEN}.items()}


@dataclass(frozen=True, slots=True)
class _Found:
    """What a device has found out about the blocks of some motors, back on the host.

    ``good`` has shape (motor,): whose block is an regular one; the others are of these alone: what
    is believed now, by name, whether the hold has settled, and how many outliers there were.
    """

    good: NDArray[np.bool_]
    believed: dict[str, NDArray[Any]]
    settled: NDArray[np.bool_]
    outliers: NDArray[np.int64]


class DeviceBlocks:
    """Learns regular blocks as `RegularBlocks` of `native.regular_block` does.

    Bits may depend on the company that a motor is in, for libraries of a device choose their way by
    how much there is.

    Args:
        white_box: of all motors.
        rules: settings.
        replay: samples of all motors.
        device: torch's.
    """

    def __init__(
        self, white_box: MotorWhiteBox, rules: RecursiveSettings, replay: ReplayBuffer, device: str
    ) -> None:
        self._rules, self._replay, self._ops, self._device = rules, replay, TorchOps(device), device
        with watched(device):
            constants = {name: self._constant(value) for name, value in white_box.known.items()}
            self._box = replace(
                white_box,
                torque_constant=self._constant(white_box.torque_constant),
                known=constants,
            )
            self._lower, self._upper = (
                self._ops.tensor(limit) for limit in bounds(white_box.parameters)
            )
            self._heats = self._ops.tensor(heating(white_box.parameters))
            self._keep = self._ops.tensor(change_test.keep())[:, None]

    def _constant(self, value: Any) -> Tensor:
        return self._ops.tensor(
            np.broadcast_to(np.asarray(value, dtype=float), self._replay.motors)
        )

    def learn(
        self,
        known: Learnt,
        motors: NDArray[np.int64],
        due: NDArray[np.int64],
        plain: NDArray[np.bool_],
    ) -> tuple[Learnt, NDArray[np.uint8]]:
        """Learn the next block of motors where it is regular, as :meth:`RegularBlocks.learn`.

        Everything is found out before any of it is written down: a device that fails leaves nothing
        half learnt.

        Raises:
            ConfigurationError: the device failed.
        """
        told = np.zeros(motors.size, dtype=np.uint8)
        if not all(_OF_LEARNT[name](known).flags.writeable for name in WRITTEN):
            known = copied(known)
        data, gone, _, begin = self._replay.streams
        at = known.at[motors]
        column = at - gone[motors] - 1
        there = (column >= 0) & (column < data.shape[2] - self._rules.block)
        there &= known.hold.begun[motors] & (at > begin[motors])
        places = np.flatnonzero(there)
        parts = [
            places[first : first + DEVICE_TURN] for first in range(0, places.size, DEVICE_TURN)
        ]
        with watched(self._device):
            found = [self._find(known, motors[part]) for part in parts]
        for part, of_part in zip(parts, found, strict=True):
            told[part[of_part.good]] = self._write(
                known, motors[part[of_part.good]], of_part, due, plain
            )
        return known, told

    @torch.no_grad()
    def _find(self, known: Learnt, motors: NDArray[np.int64]) -> _Found:
        """Work out the blocks of some motors; changes nothing."""
        which = _neighbours(motors)
        before = {name: self._ops.borrowed(_OF_LEARNT[name](known)[which]) for name in _SENT}
        given = self._given(known, motors, which, before)
        path, fine = predict(self._ops, given)
        path = _silent(path, given, before['least_noise'])
        score, information, left_out = self._examine(given, path, before, fine)
        after = self._conclude(given, path, before, fine)
        after |= {'score': score, 'information': information, 'left_out': left_out}
        held = self._hold(given, path, before)
        settled = held.pop('settled').cpu().numpy()
        good = fine.cpu().numpy()
        index, everyone = self._ops.flatnonzero(fine), bool(good.all())
        believed = {
            name: (value if everyone else value[index]).cpu().numpy()
            for name, value in {**after, **held}.items()
        }
        outliers = self._rules.block - path.used.long()
        return _Found(good, believed, settled[good], outliers.cpu().numpy()[good])

    def _given(
        self, known: Learnt, motors: NDArray[np.int64], which: Any, before: dict[str, Tensor]
    ) -> Given:
        """Bring the samples in."""
        k = self._rules.block
        signals = self._ops.borrowed(self._replay.newest(k + 1, which, known.at[motors] + k))
        interval, voltage, torque, speed = signals.contiguous()
        box = self._box.of_motors(which if isinstance(which, slice) else self._ops.tensor(which))
        believed = (
            before[name] for name in ('p', 'state', 'covariance', 'noise', 'gain', 'current_a')
        )
        return Given(box, interval, voltage, box.state(torque), speed, *believed)  # type: ignore[arg-type]

    def _examine(
        self, given: Given, path: Predicted, before: dict[str, Tensor], fine: Tensor
    ) -> tuple[Tensor, Tensor, Tensor]:  # fmt: skip
        """Test for ever-changing coordinates: block_step.py, change_test.py, block_updater.py."""
        unit, shares, n = given.noise[:, None] ** -2, before['sensitivity'], given.p.shape[1]
        reached = _solved(
            _plus_unit(path.info @ given.covariance),
            torch.cat([path.info, path.right[..., None]], dim=2),
            fine,
        )
        fine &= (reached.diagonal(dim1=1, dim2=2) >= 0.0).all(dim=1)
        turned = shares[:, :, None] * reached[:, CURRENT, None] + reached[:, COORDINATES]
        told = (turned[:, :, CURRENT, None] * shares[:, None, :] + turned[:, :, STATES:-1]) * unit[
            ..., None
        ]
        score = self._keep * before['score'] + (turned[:, :, -1] * unit)[:, None]
        information = self._keep[..., None] ** 2 * before['information'] + told[:, None]
        ridge = 1e-6 * information.diagonal(dim1=2, dim2=3).sum(dim=2)[..., None, None] / n + 1e-300
        loose = information + ridge * torch.eye(n, dtype=ridge.dtype, device=ridge.device)
        statistic = (score * _solved(loose, score[..., None], fine)[..., 0]).sum(dim=2)
        fine &= (statistic <= self._rules.drift_threshold).all(dim=1)
        samples = path.kept.shape[1]
        left_out = (
            change_test.LEFT_OUT_MEMORY * before['left_out'] + (samples - path.used) / samples
        )
        fine &= (path.used >= 0.5 * samples) & (left_out <= change_test.LEFT_OUT)
        return score, information, left_out

    def _conclude(
        self, given: Given, path: Predicted, before: dict[str, Tensor], fine: Tensor
    ) -> dict[str, Tensor]:
        """Learn: block_step.py, learn; block_updater.py, _follow_noise."""
        p, size, variance = given.p, given.current_a[:, None], given.noise**2
        posterior = _solved(_plus_unit(given.covariance @ path.info), given.covariance, fine)
        posterior = 0.5 * (posterior + posterior.transpose(1, 2))
        step = (posterior @ path.right[..., None])[..., 0]
        step[:, COORDINATES] = step[:, COORDINATES].clamp(-0.5, 1.0)
        spread = posterior.diagonal(dim1=1, dim2=2)
        most = spread[:, :, None] * spread[:, None, :] * (1.0 + CORRELATION_SLACK)
        fine &= (spread > 0.0).all(dim=1) & (posterior**2 <= most).all(dim=2).all(dim=1)
        found = p * (1.0 + step[:, COORDINATES])
        theta = torch.cat([torch.ones_like(size), found[:, 1:]], dim=1) / found[:, :1]
        theta = torch.minimum(torch.maximum(theta, self._lower), self._upper)
        found = torch.cat([torch.ones_like(size), theta[:, 1:]], dim=1) / theta[:, :1]
        transfer = torch.eye(p.shape[1] + STATES, dtype=p.dtype, device=p.device).repeat(
            p.shape[0], 1, 1
        )
        transfer[:, CURRENT] = torch.cat(
            [path.by_start[:, None], path.by_coordinate * p / size], dim=1
        )
        state = path.state[:, -1] + (transfer[:, CURRENT] * step).sum(dim=1) * given.current_a
        moved = transfer @ posterior @ transfer.transpose(1, 2)
        walked = before['walk_rate'] ** 2 * given.interval[:, 1:].sum(dim=1) / variance
        moved.diagonal(dim1=1, dim2=2)[:, COORDINATES] += walked[:, None] * self._heats
        ratio = torch.cat([torch.ones_like(size), p / found], dim=1)
        covariance = moved * ratio[:, :, None] * ratio[:, None, :]
        samples = path.kept.shape[1]
        count = (before['noise_count'] + samples).clamp_max(self._rules.noise_memory)
        power = variance + samples / count.to(variance.dtype) * (
            path.squares / path.used - variance
        )
        noise = torch.maximum(power.sqrt(), self._rules.noise_floor * given.current_a)
        noise = torch.maximum(noise, before['least_noise'])
        fine &= (state + found.sum(dim=1) + covariance.sum(dim=(1, 2)) + noise).isfinite()
        reached = path.by_coordinate * p + path.by_start[:, None] * (before['sensitivity'] * size)
        after = {
            'p': found,
            'state': state,
            'covariance': covariance,
            'sensitivity': reached / size,
        }
        return {**after, 'noise': noise, 'noise_count': count}

    def _hold(self, given: Given, path: Predicted, before: dict[str, Tensor]) -> dict[str, Tensor]:
        """Where motors stand in a hold of the voltage, and whether its transition is over.

        See constant_voltage.py, take.
        """
        level, voltage, speed = before['hold_level'], given.voltage[:, 1:], given.speed[:, 1:]
        low, high = voltage.amin(dim=1), voltage.amax(dim=1)
        largest = torch.maximum(before['hold_largest'], torch.maximum(-low, high))
        same = torch.maximum(high - level, level - low) <= HOLD_TOLERANCE * largest
        if given.box.speed_measured:
            slow, fast = speed.amin(dim=1), speed.amax(dim=1)
            same &= fast - slow <= HOLD_TOLERANCE * torch.maximum(-slow, fast)
        interval = given.interval[:, 1:]
        held_s = torch.where(same, before['hold_held_s'] + interval.sum(dim=1), 0.0)
        rate = (-path.factor.log() / interval).amin(dim=1)
        now = {
            'hold_level': torch.where(same, level, voltage[:, -1]),
            'hold_largest': largest,
            'hold_held_s': held_s,
        }
        return {**now, 'settled': same & (held_s * rate > SETTLED)}

    def _write(
        self, known: Learnt, motors: NDArray[np.int64], found: _Found, due: NDArray[np.int64],
        plain: NDArray[np.bool_]
    ) -> NDArray[np.uint8]:  # fmt: skip
        """Write down results and consequences, and report them: `regular_block.c`, reckon."""
        rules, hold, settled, into = self._rules, known.hold, found.settled, _neighbours(motors)
        for name, value in found.believed.items():
            _OF_LEARNT[name](known)[into] = value
        known.suspicion[motors], known.since[motors] = 0.0, 0
        known.outliers[motors] += found.outliers
        fresh = motors[settled & ~hold.settled[motors]]
        hold.settled[motors] = settled
        hold.p[fresh] = known.belief.p[fresh]
        hold.covariance[fresh] = known.belief.of(fresh).posterior
        at = known.at[motors] = known.at[motors] + rules.block
        walking, next_fit, update = (
            known.walk_rate[motors] != 0.0,
            known.next_fit[motors],
            at + rules.block,
        )
        fit = np.maximum(self._replay.begin(motors) + next_fit, at + 1)
        fit[walking | (next_fit > rules.replay_capacity)] = np.iinfo(np.int64).max
        due[motors], plain[motors] = np.minimum(fit, update), fit > update
        long = settled & (hold.held_s[motors] > rules.long_hold_s)
        far = at - known.anchored[motors] >= rules.replay_capacity // np.where(walking, 2, 1)
        told: NDArray[np.uint8] = (LEARNT + LONG_HOLD * long + ANCHOR_DUE * far).astype(np.uint8)
        return told


def _silent(path: Predicted, given: Given, least_noise: Tensor) -> Predicted:
    """Skip currents that have not moved by a step of their readings: block_updater.py, update."""
    moved = given.measured.amax(dim=1) - given.measured.amin(dim=1) > STILL * least_noise
    tells = (moved | (least_noise <= 0.0)).to(path.right.dtype)
    return replace(path, info=path.info * tells[:, None, None], right=path.right * tells[:, None])


def _plus_unit(matrix: Tensor) -> Tensor:
    return matrix + torch.eye(matrix.shape[-1], dtype=matrix.dtype, device=matrix.device)


def _solved(matrix: Tensor, right: Tensor, fine: Tensor) -> Tensor:
    """Solve one or several systems per motor; any singular one makes its block irregular."""
    found, failed = torch.linalg.solve_ex(matrix, right)
    fine &= (failed == 0).reshape(fine.shape[0], -1).all(dim=1)
    return found  # type: ignore[no-any-return]


def _neighbours(motors: NDArray[np.int64]) -> Any:
    """Neighbouring places as a slice, which is not copied; other places as they are."""
    if motors.size and motors[-1] - motors[0] + 1 == motors.size:
        return slice(int(motors[0]), int(motors[-1]) + 1)
    return motors
