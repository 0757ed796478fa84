"""Thousands of the thesis's motors for benchmarks of cost: physics, settings, sample arrays."""

from __future__ import annotations

from typing import Any

import numpy as np

NOISE_NM = 1e-4
STEP_NS = 10_000_000


def rule(motors: int, replay_capacity: int = 4096) -> Any:
    """Context nodes that know nothing yet."""
    from gray_box_observer.context_nodes import RecursiveEstimator, RecursiveSettings

    rules = RecursiveSettings(replay_capacity=replay_capacity)
    return RecursiveEstimator(
        white_box(motors), np.tile([[1.5, 3.0, 30.0]], (motors, 1)), rules=rules
    )


def white_box(motors: int) -> Any:
    """Physics of the thesis, of one motor or many."""
    from gray_box_observer.white_box import MotorWhiteBox

    constant: Any = 0.01 if motors == 1 else np.full(motors, 0.01)
    return MotorWhiteBox(
        ('inductance', 'resistance', 'hysteresis'), constant, {'back_emf_constant': constant}
    )


def sample(k: int, voltage_v: Any, torque_nm: Any) -> Any:
    """Sample k of motors that run alike."""
    from gray_box_observer.samples import Sample

    interval_s = np.full(voltage_v.size, 0.01 if k else 0.0)
    return Sample(k * STEP_NS, interval_s, voltage_v, torque_nm, np.full(voltage_v.size, np.nan))


def one_predictor(
    motors: int, device: str | None = None, replay_capacity: int = 6000
) -> tuple[Any, Any]:
    """An untrained predictor, and the parameters of its motors, shape (motor, parameter)."""
    from gray_box_observer.predictor import Forecasting, Predictor, TrainingSettings

    theta = np.tile([[0.5, 1.0, 10.0]], (motors, 1))
    rules = TrainingSettings(period=10**9, replay_capacity=replay_capacity)
    box = white_box(motors)
    predictor = Predictor(box, motors, theta[0], rules, speed_measured=False, device=device)
    return Forecasting(predictor, rules, NoTraining()), theta


class NoTraining:
    """Trains nothing: only the prediction is timed."""

    busy = False
    is_resting = True
    failure = None
    share = 0.0

    def submit(self, job: dict[str, Any]) -> None:
        """Nothing is handed over while resting."""

    def collect(self) -> None:
        """Nothing was handed over."""

    def close(self) -> None:
        """Nothing runs."""
