"""Stage 2: losses of the four variants (thesis 4.2.3, 4.2.4, 5.1); torch, trainer only."""

from __future__ import annotations

from dataclasses import dataclass

import torch

from gray_box_observer.predictor.network_inputs import Variant
from gray_box_observer.white_box.dynamics import rate
from gray_box_observer.white_box.interface import WhiteBox


@dataclass(frozen=True, eq=False)
class Windows:
    """Sequences drawn from the replay buffer, as tensors.

    Attributes:
        voltage_v: shape (window, time): mean voltage of the interval before each sample.
        interval_s: shape (window, time).
        torque_nm: shape (window, time): measured.
        speed_rad_s: shape (window, time).
        theta: shape (window, parameter): context nodes, frozen.
    """

    voltage_v: torch.Tensor
    interval_s: torch.Tensor
    torque_nm: torch.Tensor
    speed_rad_s: torch.Tensor
    theta: torch.Tensor


def stage_two_loss(
    variant: Variant,
    white_box: WhiteBox,
    windows: Windows,
    predicted_nm: torch.Tensor,
    skip: int,
    torque_span_nm: float,
    weight_floor: float,
) -> torch.Tensor:
    """Loss of one minibatch, in units of the torque's range.

    Args:
        variant: whose loss.
        white_box: physics with one entry a window.
        windows: the data.
        predicted_nm: shape (window, time): the network's torque.
        skip: leading steps on which the network only warms up.
        torque_span_nm: range of the torque.
        weight_floor: constant added to the transition weights.

    Returns:
        A scalar.
    """
    if variant in (Variant.SUPERVISED, Variant.SUPERVISED_WITH_PARAMETERS):
        error = (predicted_nm - windows.torque_nm)[:, skip:]
        return error.abs().mean() / torque_span_nm
    along = predicted_nm if variant is Variant.MAIN else windows.torque_nm
    change = torque_rate(white_box, windows, along)[:, skip:] * windows.interval_s[:, skip + 1 :]
    defect = predicted_nm[:, skip + 1 :] - predicted_nm[:, skip:-1] - change
    size = change.detach().abs()
    weights = size / size.amax(dim=1, keepdim=True).clamp_min(1e-12) + weight_floor
    return (weights * defect.abs()).mean() / (weights.mean() * torque_span_nm)


def torque_rate(white_box: WhiteBox, windows: Windows, torque_nm: torch.Tensor) -> torch.Tensor:
    """``dT/dt`` of the white box in the middle of each torque interval, (window, time - 1)."""
    middle = white_box.state(0.5 * (torque_nm[:, 1:] + torque_nm[:, :-1]))  # type: ignore[arg-type]
    speed = 0.5 * (windows.speed_rad_s[:, 1:] + windows.speed_rad_s[:, :-1])
    slope = rate(white_box, windows.theta[:, None, :], windows.voltage_v[:, 1:], middle, speed)
    return white_box.output(slope)  # type: ignore[return-value]
