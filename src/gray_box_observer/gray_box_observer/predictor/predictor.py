"""The predictor of motors without a rotor: forecasts each torque before it is measured."""

from __future__ import annotations

from contextlib import nullcontext
from dataclasses import replace
from functools import partial

import numpy as np

from gray_box_observer.context_nodes.rotor.speed_filter import SpeedEstimate
from gray_box_observer.errors import ConfigurationError
from gray_box_observer.predictor.elementwise import Axis
from gray_box_observer.predictor.forecaster import Forecaster, ForecastRequest
from gray_box_observer.predictor.initial_network import first_network
from gray_box_observer.predictor.network_inputs import InputLayout, Variant
from gray_box_observer.predictor.predictor_settings import TrainingSettings
from gray_box_observer.predictor.steady_state import Course, course, flow, flow_each
from gray_box_observer.predictor.steady_state_forecaster import RelaxingForecaster
from gray_box_observer.predictor.thesis.window_forecaster import WindowForecaster
from gray_box_observer.predictor.torque_predictor import (
    Prediction,
    TorquePredictor,
    of_present,
    physics_of,
)
from gray_box_observer.samples.sample import Sample
from gray_box_observer.settings.device import DEVICE_FROM, watched
from gray_box_observer.white_box.interface import Array, WhiteBox


class Predictor(TorquePredictor):
    """Streams the network over the samples of a group of motors.

    Args:
        white_box: the physics; that of a single motor has plain numbers for constants.
        motors: number of motors.
        theta_reference: shape (parameter,): see :class:`InputLayout`.
        rules: settings.
        speed_measured: whether speed is a signal.
        seed: of a fresh network.
        device: torch's, on which very many motors are predicted (variant ``physics``); None: by
            numpy.

    Raises:
        ConfigurationError: from here on and of every method, where the device fails.
    """

    def __init__(
        self, white_box: WhiteBox, motors: int, theta_reference: Array, rules: TrainingSettings,
        *, speed_measured: bool, seed: int = 0, device: str | None = None,
    ) -> None:  # fmt: skip
        is_physics = rules.variant is Variant.PHYSICS
        device = device if is_physics and motors >= DEVICE_FROM else None
        self._rules = rules
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
        super().__init__(
            white_box, motors, theta_reference.size, self._forecaster,
            speed_measured=speed_measured, device=device,
        )  # fmt: skip
        self._way: Course | None = None
        self._rollout_nm = np.full(motors, np.nan)
        if (
            device is not None
        ):  # here, not where they are defined: one motor by numpy must not pay for it
            for name in (
                'predict',
                '_rollout',
                'forecast',
                'advance',
                'restore',
            ):
                setattr(self, name, watched(device)(getattr(self, name)))

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
            blank = np.full(self.motors, np.nan)
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
        axis = self._axis
        ops = self._axis.ops
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
        request = self._request(np.full(self.motors, horizon_s), voltage_v, theta)
        if request is None or (since is not None and since.memory is None):
            return np.full(self.motors, np.nan)
        if since is not None and since.memory is not None:
            request = replace(request, origin=(physics_of(since), since.memory))
        torque_nm = self._forecaster.forecast(request)[0]
        correction = self.residual.correction
        if correction is None or not self.residual.is_active:
            return torque_nm
        path_nm = self._forecaster.path(request, correction.instants_s(horizon_s))
        return torque_nm + self.residual.along(
            request, path_nm, None if since is None else since.residual_memory
        )

    def advance(
        self, sample: Sample, prediction: Prediction, speed: SpeedEstimate | None = None
    ) -> None:
        """Go on from a sample to where the next one is predicted from.

        Args:
            sample: what came.
            prediction: what had been expected of it.
            speed: unused; these motors have no rotor.
        """
        anew = sample.interval_s <= 0.0
        physics_nm = physics_of(prediction)
        self._forecaster.remember(
            physics_nm, sample.torque_nm, anew, prediction.memory, sample.present
        )
        added_nm = None if prediction.physics_nm is None else prediction.torque_nm - physics_nm
        self.residual.remember(added_nm, anew, prediction.residual_memory)
        has_prediction = np.isfinite(prediction.white_box_torque_nm) & ~anew
        rollout_nm = np.where(has_prediction, prediction.white_box_torque_nm, sample.torque_nm)
        self._way = prediction.way
        self._rollout_nm = of_present(sample, rollout_nm, self._rollout_nm)
        # a torque message without its speed must not put NaN into the network's memory or into a
        # training window
        self.speed_rad_s = np.where(
            np.isfinite(sample.speed_rad_s), sample.speed_rad_s, self.speed_rad_s
        )

    def _request(self, interval_s: Array, voltage_v: Array, theta: Array) -> ForecastRequest | None:
        """Say where an interval leads; None where no motor has a known start and voltage."""
        axis = self._axis
        ops = self._axis.ops
        voltage = axis.to_operand(voltage_v)
        speed = 0.0
        usable = (
            (axis.to_operand(interval_s) > 0.0)
            & ops.isfinite(axis.to_operand(self._rollout_nm))
            & ops.isfinite(voltage)
        )
        if self.speed_measured:
            speed = axis.to_operand(self.speed_rad_s)
            usable = usable & ops.isfinite(speed)
        if not ops.any(usable):
            return None
        voltage, speed = (ops.where(usable, signal, 0.0) for signal in (voltage, speed))
        columns = axis.columns(theta)
        way = self._way
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
