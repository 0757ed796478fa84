"""Tests of the predictor share this: white boxes of every kind, and training that does nothing."""

from __future__ import annotations

from typing import Any

import pytest

from gray_box_observer.predictor.training.torch_network import TorchNetwork
from gray_box_observer.white_box import MotorWhiteBox

THETA = {
    'inductance': 0.5,
    'resistance': 1.0,
    'hysteresis': 10.0,
    'back_emf_constant': 0.02,
    'brush_drop': 0.4,
}


class Idle:
    """Training that takes every job and never ends one."""

    is_resting = False
    failure = None

    def __init__(self) -> None:
        self.jobs: list[dict[str, Any]] = []

    @property
    def busy(self) -> bool:
        """Never."""
        return False

    def submit(self, job: dict[str, Any]) -> None:
        """Take a job."""
        self.jobs.append(job)

    def collect(self) -> dict[str, Any] | None:
        """Give nothing."""
        return None

    def close(self) -> None:
        """End nothing."""


@pytest.fixture
def idle() -> Idle:
    """Training that only listens."""
    return Idle()


BOXES = {
    'thesis': MotorWhiteBox(
        ('inductance', 'resistance', 'hysteresis'), 0.01, {'back_emf_constant': 0.01}
    ),
    'linear': MotorWhiteBox(('inductance', 'resistance'), 0.01, {'back_emf_constant': 0.01}),
    'no resistance': MotorWhiteBox(('inductance', 'hysteresis'), 0.01),
    'nothing but inductance': MotorWhiteBox(('inductance',), 0.01),
    'brushes': MotorWhiteBox(('inductance', 'resistance', 'hysteresis', 'brush_drop'), 0.01),
    'known brushes': MotorWhiteBox(
        ('inductance', 'hysteresis', 'resistance'), 0.01, {'brush_drop': 0.3}
    ),
    'speed': MotorWhiteBox(
        ('inductance', 'resistance', 'hysteresis', 'back_emf_constant', 'brush_drop'),
        0.05,
        speed_measured=True,
    ),
}


@pytest.fixture(params=list(BOXES))
def box(request: pytest.FixtureRequest) -> MotorWhiteBox:
    """One white box after the other."""
    return BOXES[request.param]


@pytest.fixture
def theta(box: MotorWhiteBox) -> list[float]:
    """Plausible values of the white box's parameters."""
    return [THETA[name] for name in box.context_nodes]


@pytest.fixture
def taught_on(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Devices on which networks of torch are made, in order."""
    devices: list[str] = []
    made = TorchNetwork.__init__

    def make(self: TorchNetwork, inputs: int, hidden: int, device: str = 'cpu') -> None:
        devices.append(device)
        made(self, inputs, hidden, device)

    monkeypatch.setattr(TorchNetwork, '__init__', make)
    return devices
