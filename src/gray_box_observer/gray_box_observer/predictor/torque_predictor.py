"""What every predictor of torque has: a network that runs, and what is learnt beside the physics.

Predict, then learn: :meth:`TorquePredictor.predict` changes nothing.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from gray_box_observer.context_nodes.rotor.speed_filter import SpeedEstimate
from gray_box_observer.predictor.forecaster import RunningNetwork
from gray_box_observer.predictor.network import Memory
from gray_box_observer.predictor.residual_model import (
    Recollection,
    ResidualForecaster,
    check_correction,
)
from gray_box_observer.predictor.steady_state import Course
from gray_box_observer.samples.sample import Sample
from gray_box_observer.white_box.interface import Array, WhiteBox


@dataclass(frozen=True, eq=False)
class Prediction:
    """What is expected of the next torque sample, with what has to be remembered if it comes.

    Attributes:
        torque_nm: shape (motor,): the predictor's forecast; NaN where it cannot tell: at the first
            sample of a history, for the thesis's variants also before the first training and while
            the network warms up.
        rollout: works out :attr:`white_box_torque_nm`, when it is asked for: only scores need it,
            which can wait until the forecast has gone out.
        memory: the network's memory after this step; None where it made none.
        way: where voltage and speed lead; None at the first sample of a history.
        physics_nm: shape (motor,): the forecast before the correction learnt from data; None where
            nothing was added.
        residual_memory: what the correction remembers after this step.
    """

    torque_nm: Array
    rollout: Callable[[], Array]
    memory: Memory | None
    way: Course | None
    physics_nm: Array | None = None
    residual_memory: Recollection | None = None

    @cached_property
    def white_box_torque_nm(self) -> Array:
        """Shape (motor,): the white box's rollout from voltages alone; NaN where none goes on."""
        return self.rollout()

    def for_motors(self, motors: slice) -> Prediction:
        """Return what is expected of some motors, by their places; nothing is remembered of it."""
        return Prediction(
            self.torque_nm[motors], lambda: self.white_box_torque_nm[motors], None, None
        )


class TorquePredictor(ABC):
    """Predicts the torque of motors.

    Args:
        white_box: the physics; that of a single motor has plain numbers for constants.
        motors: number of motors.
        parameters: number of context nodes.
        network: the network that runs, or what stands for none.
        speed_measured: whether speed is a signal.
        device: torch's, on which it is predicted; None: by numpy.

    Attributes:
        motors, parameters, network, speed_measured, device: as above.
        residual: the correction of what the physics says.
        speed_rad_s: shape (motor,): newest measured speed; NaN where there is none.
    """

    def __init__(
        self, white_box: WhiteBox, motors: int, parameters: int, network: RunningNetwork, *,
        speed_measured: bool, device: str | None = None,
    ) -> None:  # fmt: skip
        self.motors = motors
        self.parameters = parameters
        self.network = network
        self.speed_measured = speed_measured
        self.device = device
        self.residual = ResidualForecaster(white_box, motors)
        self.speed_rad_s = np.full(motors, np.nan)

    @abstractmethod
    def predict(self, interval_s: Array, voltage_v: Array, theta: Array) -> Prediction:
        """Forecast the torque at the end of an interval; changes nothing.

        Args:
            interval_s: shape (motor,): length of the interval; 0 where the history starts anew.
            voltage_v: shape (motor,): mean voltage over it.
            theta: shape (motor, parameter): context nodes before the sample is learnt.
        """

    @abstractmethod
    def forecast(
        self, horizon_s: float, voltage_v: Array, theta: Array, since: Prediction | None = None
    ) -> Array:
        """Forecast the torque after a planned voltage has been held for a while; changes nothing.

        Args:
            horizon_s: how long, counted from the last sample or from what ``since`` tells.
            voltage_v: shape (motor,): voltage that will be held.
            theta: shape (motor, parameter): context nodes.
            since: what was predicted of the next sample, to go on from there; None: go on from the
                last sample.

        Returns:
            Shape (motor,), in N m; NaN for a motor whose signal history has not begun.
        """

    @abstractmethod
    def advance(
        self, sample: Sample, prediction: Prediction, speed: SpeedEstimate | None = None
    ) -> None:
        """Go on from a sample to where the next one is predicted from.

        Args:
            sample: what came.
            prediction: what had been expected of it.
            speed: of a motor with a rotor, at the sample, as far as it is known.
        """

    def state(self, motor: int = 0) -> dict[str, Array]:
        """The network and what one motor has learnt beside the physics, as arrays."""
        residual_arrays = (
            {} if self.residual.correction is None else self.residual.correction.arrays()
        )
        return {**self.network.state(), **residual_arrays}

    def restore(self, arrays: dict[str, Array], motor: int = 0) -> None:
        """Take back what :meth:`state` gave of one motor.

        Raises:
            ConfigurationError: the network is of another variant or size.
            CheckpointError: it is no state that could have been learnt.
        """
        check_correction(arrays)
        self.network.restore(arrays)
        if self.motors == 1:
            self.residual.adopt(arrays)


def of_present(sample: Sample, now: Array, before: Array) -> Array:
    """What is now of the motors that were sampled, what was before of the others."""
    return now if sample.present is None else np.where(sample.present, now, before)


def physics_of(prediction: Prediction) -> Array:
    """What was predicted before the residual was added: the physics goes on from there."""
    return prediction.torque_nm if prediction.physics_nm is None else prediction.physics_nm
