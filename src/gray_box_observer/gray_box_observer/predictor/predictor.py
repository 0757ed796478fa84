"""The predictor: forecasts each torque before it is measured, and trains in the background.

Predict, then learn: :meth:`Predictor.predict` changes nothing; scores use what it said.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np

from gray_box_observer.errors import ConfigurationError
from gray_box_observer.predictor.elementwise import Axis
from gray_box_observer.predictor.forecaster import Forecaster, ForecastRequest
from gray_box_observer.predictor.initial_network import first_network
from gray_box_observer.predictor.network import Memory
from gray_box_observer.predictor.network_inputs import InputLayout, Variant
from gray_box_observer.predictor.predictor_settings import TrainingSettings
from gray_box_observer.predictor.residual_model import (
    Recollection,
    ResidualForecaster,
    check_correction,
)
from gray_box_observer.predictor.scores import Scores
from gray_box_observer.predictor.steady_state import Course, course, flow, flow_each
from gray_box_observer.predictor.steady_state_forecaster import RelaxingForecaster
from gray_box_observer.predictor.thesis.window_forecaster import WindowForecaster
from gray_box_observer.predictor.training.online_training import OnlineTraining
from gray_box_observer.predictor.training.training_backend import Training
from gray_box_observer.safe_io.saved_state import check_array, positive
from gray_box_observer.samples.sample import Sample
from gray_box_observer.settings.device import DEVICE_FROM, watched
from gray_box_observer.white_box.interface import Array, WhiteBox


@dataclass(frozen=True)
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


class Predictor:
    """Streams the network over the samples of a group of motors.

    Args:
        white_box: the physics; that of a single motor has plain numbers for constants.
        motors: number of motors.
        theta_reference: shape (parameter,): see :class:`InputLayout`.
        rules: settings.
        training: where jobs run.
        speed_measured: whether speed is a signal.
        seed: of a fresh network.
        device: torch's, on which very many motors are predicted (variant ``physics``); None: by
            numpy.

    Attributes:
        residual: the correction of what the physics says.
        training: has both taught.
        scores: how good the predictions were.

    Raises:
        ConfigurationError: from here on and of every method, where the device fails.
    """

    def __init__(
        self, white_box: WhiteBox, motors: int, theta_reference: Array, rules: TrainingSettings,
        training: Training, *, speed_measured: bool, seed: int = 0, device: str | None = None,
    ) -> None:  # fmt: skip
        is_physics = rules.variant is Variant.PHYSICS
        device = device if is_physics and motors >= DEVICE_FROM else None
        self._rules = rules
        self._motors = motors
        self._parameters = theta_reference.size
        self._speed_measured = speed_measured
        self._forecaster: Forecaster
        with nullcontext() if device is None else watched(device):
            self._axis = Axis(motors, device)
            self._white_box = self._axis.white_box(white_box)
            if is_physics:
                self._forecaster = RelaxingForecaster(
                    white_box, motors, first_network(rules, seed), device
                )
            else:
                layout = InputLayout(theta_reference, rules.variant.sees_theta, speed_measured)
                self._forecaster = WindowForecaster(motors, layout, rules)
        if (
            device is not None
        ):  # here, not where they are defined: one motor by numpy must not pay for it
            for name in (
                'predict',
                '_rollout',
                'forecast',
                'advance',
                'score_and_train',
                'restore',
            ):
                setattr(self, name, watched(device)(getattr(self, name)))
        self.residual = ResidualForecaster(white_box, motors)
        blank = np.full(motors, np.nan)
        self._way: Course | None = None
        self._rollout_nm = self._previous_torque = self._previous_speed = blank
        self.training = OnlineTraining(
            motors, rules, training, self._forecaster, self.residual, speed_measured=speed_measured
        )
        self.scores = Scores(motors)

    def predict(self, interval_s: Array, voltage_v: Array, theta: Array) -> Prediction:
        """Forecast the torque at the end of an interval; changes nothing.

        Measured speed comes with the torque, so the forecast holds on to that of the sample before.

        Args:
            interval_s: shape (motor,): length of the interval; 0 where the history starts anew.
            voltage_v: shape (motor,): mean voltage over it.
            theta: shape (motor, parameter): context nodes before the sample is learnt.
        """
        request = self._request(interval_s, voltage_v, theta)
        if request is None:
            blank = np.full(self._motors, np.nan)
            return Prediction(blank, lambda: blank, None, None)
        rollout = partial(self._rollout, request, self._rollout_nm)
        torque_nm, memory = self._forecaster.forecast(request)
        correction_nm, recollection = self.residual.correct(request, torque_nm)
        if correction_nm is None:
            return Prediction(torque_nm, rollout, memory, request.way)
        return Prediction(
            torque_nm + correction_nm, rollout, memory, request.way, torque_nm, recollection
        )

    def _rollout(self, request: ForecastRequest, from_nm: Array) -> Array:
        """Torque of the white box alone at the end of an interval, (motor,); NaN: none."""
        axis, ops = self._axis, self._axis.ops
        start = ops.where(request.usable, self._white_box.state(axis.to_operand(from_nm)), 0.0)
        length_s = ops.where(request.usable, axis.to_operand(request.interval_s), 0.0)
        if axis.single:
            end = flow(ops, self._white_box, request.way, start, length_s)
        else:
            end = flow_each(ops, self._white_box, request.way, start, length_s)
        rollout_nm: Array = axis.to_array(
            self._white_box.output(ops.where(request.usable, end, np.nan))
        )
        return rollout_nm

    def forecast(
        self, horizon_s: float, voltage_v: Array, theta: Array, since: Prediction | None = None
    ) -> Array:
        """Forecast the torque after a planned voltage has been held for a while; changes nothing.

        The physics goes there in one step; what was learnt beside it follows at the pace at which
        it was learnt, in a bounded number of steps however long the horizon is
        (:meth:`Correction.instants_s`).

        Args:
            horizon_s: how long, counted from the last sample or from what ``since`` tells.
            voltage_v: shape (motor,): voltage that will be held.
            theta: shape (motor, parameter): context nodes.
            since: what was predicted of the next sample, to go on from there; None: go on from the
                last sample.

        Returns:
            Shape (motor,), in N m; NaN for a motor whose signal history has not begun.

        Raises:
            ConfigurationError: the network is one of the thesis, which goes from sample to sample
                only.
        """
        if not isinstance(self._forecaster, RelaxingForecaster):
            raise ConfigurationError(
                f'variant {self._rules.variant.value} forecasts the next sample only; for a '
                'horizon use variant physics'
            )
        request = self._request(np.full(self._motors, horizon_s), voltage_v, theta)
        if request is None or (since is not None and since.memory is None):
            return np.full(self._motors, np.nan)
        if since is not None and since.memory is not None:
            request = replace(request, origin=(_physics_of(since), since.memory))
        torque_nm = self._forecaster.forecast(request)[0]
        correction = self.residual.correction
        if correction is None or not self.residual.is_active:
            return torque_nm
        path_nm = self._forecaster.path(request, correction.instants_s(horizon_s))
        return torque_nm + self.residual.along(
            request, path_nm, None if since is None else since.residual_memory
        )

    def learn(
        self, sample: Sample, prediction: Prediction, theta: Array, covariance: Array | None = None
    ) -> None:
        """Go on from a sample and learn it: :meth:`advance` and :meth:`score_and_train`."""
        self.advance(sample, prediction)
        self.score_and_train(sample, prediction, theta, covariance)

    def advance(self, sample: Sample, prediction: Prediction) -> None:
        """Go on from a sample to where the next one is predicted from.

        Args:
            sample: what came.
            prediction: what had been expected of it.
        """
        anew = sample.interval_s <= 0.0
        physics_nm = _physics_of(prediction)
        self._forecaster.remember(
            physics_nm, sample.torque_nm, anew, prediction.memory, sample.present
        )
        added_nm = None if prediction.physics_nm is None else prediction.torque_nm - physics_nm
        self.residual.remember(added_nm, anew, prediction.residual_memory)
        has_prediction = np.isfinite(prediction.white_box_torque_nm) & ~anew
        rollout_nm = np.where(has_prediction, prediction.white_box_torque_nm, sample.torque_nm)
        self._way = prediction.way
        self._rollout_nm = _of_present(sample, rollout_nm, self._rollout_nm)
        # a torque message without its speed must not put NaN into the network's memory or into a
        # training window
        self._previous_speed = np.where(
            np.isfinite(sample.speed_rad_s), sample.speed_rad_s, self._previous_speed
        )

    def score_and_train(
        self, sample: Sample, prediction: Prediction, theta: Array, covariance: Array | None = None
    ) -> None:
        """Score what was predicted, and let the sample be trained on.

        Comes after :meth:`advance` and before the next sample is followed; where :attr:`training`
        is ``due_next``, also before it is predicted, for a trained network may take over.

        Args:
            sample: what came.
            prediction: what had been expected of it.
            theta: shape (motor, parameter): context nodes before the sample is learnt.
            covariance: shape (motor, parameter, parameter): how uncertain they are; None: not at
                all.
        """
        rivals = {
            'predictor': prediction.torque_nm,
            'persistence': np.where(sample.interval_s <= 0.0, np.nan, self._previous_torque),
            'white_box': prediction.white_box_torque_nm,
        }
        self.scores.add(sample.torque_nm, rivals)
        self._previous_torque = _of_present(sample, sample.torque_nm, self._previous_torque)
        self.training.update(
            sample, self._previous_speed, _physics_of(prediction), theta, covariance
        )

    def state(self, motor: int = 0) -> dict[str, Array]:
        """One motor's network, learnt additions, and state of training, as arrays."""
        residual_arrays = (
            {} if self.residual.correction is None else self.residual.correction.arrays()
        )
        return {**self._forecaster.state(), **residual_arrays, **self.training.state(motor)}

    def restore(self, arrays: dict[str, Array], motor: int = 0) -> None:
        """Take back what :meth:`state` gave of one motor; training goes on from there.

        Raises:
            ConfigurationError: the network is of another variant or size.
            CheckpointError: it is no state that could have been learnt.
        """
        check_correction(arrays)
        for name in ('job_theta', 'settled_theta'):
            if name in arrays:
                check_array(name, arrays[name], positive(1, self._parameters))
        self._forecaster.restore(arrays)
        if self._motors == 1:
            self.residual.adopt(arrays)
        self.training.restore(arrays, motor)

    def _request(self, interval_s: Array, voltage_v: Array, theta: Array) -> ForecastRequest | None:
        """Say where an interval leads; None where no motor has a known start and voltage."""
        axis, ops = self._axis, self._axis.ops
        voltage, speed = axis.to_operand(voltage_v), 0.0
        usable = (
            (axis.to_operand(interval_s) > 0.0)
            & ops.isfinite(axis.to_operand(self._rollout_nm))
            & ops.isfinite(voltage)
        )
        if self._speed_measured:
            speed = axis.to_operand(self._previous_speed)
            usable = usable & ops.isfinite(speed)
        if not ops.any(usable):
            return None
        voltage, speed = (ops.where(usable, signal, 0.0) for signal in (voltage, speed))
        columns, way = axis.columns(theta), self._way
        if not (
            way is not None
            and axis.same(way.voltage_v, voltage)
            and axis.same(way.speed_rad_s, speed)
            and axis.same(way.theta, columns)
        ):
            way = course(
                ops, self._white_box, columns, voltage, speed, 0.0 if way is None else way.steady_a
            )
        return ForecastRequest(
            interval_s, axis.to_array(voltage), axis.to_array(speed), theta, way, usable
        )


def _of_present(sample: Sample, now: Array, before: Array) -> Array:
    """What is now of the motors that were sampled, what was before of the others."""
    return now if sample.present is None else np.where(sample.present, now, before)


def _physics_of(prediction: Prediction) -> Array:
    """What was predicted before the residual was added: the physics goes on from there."""
    return prediction.torque_nm if prediction.physics_nm is None else prediction.physics_nm
