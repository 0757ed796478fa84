"""Puts prediction and training together: what predicts, what judges it, and what has it taught.

Predict, then learn. A predictor knows nothing of its training: between two samples a network or a
residual that was trained takes the place of the one that runs.
"""

from __future__ import annotations

import numpy as np

from gray_box_observer.context_nodes.rotor.speed_filter import SpeedEstimate
from gray_box_observer.predictor.alarm import ResidualAlarm
from gray_box_observer.predictor.predictor_settings import TrainingSettings
from gray_box_observer.predictor.scores import Scores
from gray_box_observer.predictor.torque_predictor import (
    Prediction,
    TorquePredictor,
    of_present,
    physics_of,
)
from gray_box_observer.predictor.training.online_training import OnlineTraining
from gray_box_observer.predictor.training.training_backend import Training
from gray_box_observer.safe_io.saved_state import check_array, positive
from gray_box_observer.samples.sample import Sample
from gray_box_observer.settings.device import watched
from gray_box_observer.white_box.interface import Array


class Forecasting:
    """Predicts the torque of motors, scores that, and has the predictor trained.

    Args:
        predictor: of these motors.
        rules: settings of its training.
        training: where jobs run.
        alarm: watches the prediction's residual; None where no prediction is good enough.

    Attributes:
        predictor, alarm: as above.
        training: what is taught, when, with what result.
        scores: how good the predictions were.
    """

    def __init__(
        self,
        predictor: TorquePredictor,
        rules: TrainingSettings,
        training: Training,
        alarm: ResidualAlarm | None = None,
    ) -> None:
        motors = predictor.motors
        self.predictor = predictor
        self.alarm = alarm
        self.training = OnlineTraining(
            motors, rules, training, predictor.network, predictor.residual,
            speed_measured=predictor.speed_measured,
        )  # fmt: skip
        self.scores = Scores(motors)
        self._previous_torque = np.full(motors, np.nan)

    def predict(self, interval_s: Array, voltage_v: Array, theta: Array) -> Prediction:
        """Forecast the torque at the end of an interval; see :meth:`TorquePredictor.predict`."""
        return self.predictor.predict(interval_s, voltage_v, theta)

    def forecast(
        self, horizon_s: float, voltage_v: Array, theta: Array, since: Prediction | None = None
    ) -> Array:
        """Forecast the torque after a held voltage; see :meth:`TorquePredictor.forecast`."""
        return self.predictor.forecast(horizon_s, voltage_v, theta, since)

    def learn(
        self,
        sample: Sample,
        prediction: Prediction,
        theta: Array,
        covariance: Array | None = None,
        speed: SpeedEstimate | None = None,
    ) -> None:
        """Go on from a sample, score its prediction, and let it be trained on.

        Args:
            sample: what came.
            prediction: what had been expected of it.
            theta: shape (motor, parameter): context nodes before the sample is learnt.
            covariance: shape (motor, parameter, parameter): how uncertain they are; None: not at
                all.
            speed: of a motor with a rotor, at the sample, as far as it is known.

        Raises:
            ConfigurationError: a device has failed.
        """
        self.predictor.advance(sample, prediction, speed)
        self.score_and_train(sample, prediction, theta, covariance)

    def score_and_train(
        self, sample: Sample, prediction: Prediction, theta: Array, covariance: Array | None = None
    ) -> None:
        """Score what was predicted, and let the sample be trained on; see :meth:`learn`.

        Comes after :meth:`TorquePredictor.advance` and before the next sample is followed; where
        :attr:`training` is ``due_next``, also before it is predicted, for a trained network may
        take over.
        """
        if self.predictor.device is None:
            self._score_and_train(sample, prediction, theta, covariance)
        else:
            with watched(self.predictor.device):
                self._score_and_train(sample, prediction, theta, covariance)

    def _score_and_train(
        self, sample: Sample, prediction: Prediction, theta: Array, covariance: Array | None
    ) -> None:
        rivals = {
            'predictor': prediction.torque_nm,
            'persistence': np.where(sample.interval_s <= 0.0, np.nan, self._previous_torque),
            'white_box': prediction.white_box_torque_nm,
        }
        self.scores.add(sample.torque_nm, rivals)
        self._previous_torque = of_present(sample, sample.torque_nm, self._previous_torque)
        self.training.update(
            sample, self.predictor.speed_rad_s, physics_of(prediction), theta, covariance
        )

    def state(self, motor: int = 0) -> dict[str, Array]:
        """One motor's network, learnt additions, and state of training, as arrays."""
        return {**self.predictor.state(motor), **self.training.state(motor)}

    def restore(self, arrays: dict[str, Array], motor: int = 0) -> None:
        """Take back what :meth:`state` gave of one motor; training goes on from there.

        Raises:
            ConfigurationError: the network is of another variant or size.
            CheckpointError: it is no state that could have been learnt.
        """
        for name in ('job_theta', 'settled_theta'):
            if name in arrays:
                check_array(name, arrays[name], positive(1, self.predictor.parameters))
        self.predictor.restore(arrays, motor)
        self.training.restore(arrays, motor)
