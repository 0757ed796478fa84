"""The predictor of one motor with a rotor: current and speed run freely, from voltages alone.

Both states follow the identified values by the trajectory that the values are fitted by. A history
begins with the measured torque and an unknown speed. So nothing is predicted there until a few
samples have told the speed (:class:`~.context_nodes.rotor.speed_filter.SpeedFilter`). From then on
no measurement enters the run. What the physics lacks is learnt beside it as for every single motor.

A load that varies is in no parameter. There every run begins at the newest sample, with the speed
and the load of the filter, and nothing is learnt beside it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from gray_box_observer.context_nodes.rotor.coordinates import coordinates
from gray_box_observer.context_nodes.rotor.rotor_trajectory import LOAD, OneInterval, run
from gray_box_observer.context_nodes.rotor.speed_filter import SpeedEstimate
from gray_box_observer.predictor.forecaster import ForecastRequest
from gray_box_observer.predictor.held_speed import held_speed_current
from gray_box_observer.predictor.residual_model import Recollection
from gray_box_observer.predictor.steady_state import Course
from gray_box_observer.predictor.torque_predictor import Prediction, TorquePredictor
from gray_box_observer.safe_io.saved_state import LARGEST_SIGNAL, ArrayRule, check_arrays
from gray_box_observer.samples.sample import Sample
from gray_box_observer.white_box.declaration import State
from gray_box_observer.white_box.interface import Array
from gray_box_observer.white_box.motor import MotorWhiteBox

SURE = 0.02
"""Standard deviation of the speed, over the no-load speed, at which the run begins."""

LONGEST_WAIT = 64
"""Samples of a history after which it begins with any speed that is known."""

LEAST_V = 1e-3
"""Voltage by which the no-load speed is reckoned at least."""

MOST = 100.0
"""Times the no-load speed and the stalled motor's current beyond which the run is given up."""

_LARGEST_V = 'largest_voltage_v'

PIECES = 32
"""Equal parts of a long forecast, at most: every part has a bounded number of steps."""


@dataclass(frozen=True, eq=False)
class RotorPrediction(Prediction):
    """What is expected of the next torque sample of a motor with a rotor.

    Attributes:
        states: shape (state,): current in A and speed in rad/s at the end of the interval; None
            where nothing runs.
    """

    states: Array | None = None


class NoNetwork:
    """Stands for the network of a motor whose physics is integrated instead."""

    def adopt(self, result: dict[str, Any]) -> None:
        """Take nothing over."""

    def state(self) -> dict[str, Array]:
        """Return nothing."""
        return {}

    def restore(self, arrays: dict[str, Array]) -> None:
        """Take nothing back: what a checkpoint of another form holds has no place here."""

    def start(self) -> dict[str, Any]:
        """Return nothing."""
        return {}


class RotorPredictor(TorquePredictor):
    """Runs one motor with a rotor freely, sample after sample.

    Args:
        white_box: its physics.
    """

    def __init__(self, white_box: MotorWhiteBox) -> None:
        super().__init__(white_box, 1, len(white_box.parameters), NoNetwork(), speed_measured=False)
        self._white_box = white_box
        self._known_theta = b''
        self._interval: OneInterval | None = None
        self._p = np.empty(0)
        self._values: dict[str, float] = {}
        self._states: Array | None = None
        self._wait_count = 0
        self._largest_v = LEAST_V
        self._load_rad_s2: float | None = None

    def predict(self, interval_s: Array, voltage_v: Array, theta: Array) -> RotorPrediction:
        """Forecast the torque at the end of an interval; see :class:`TorquePredictor`."""
        self._look_up(theta)
        length_s = float(interval_s[0])
        volt = float(voltage_v[0])
        start = self._states
        if start is None or not (length_s > 0.0 and math.isfinite(volt)):
            return _nothing()
        end = self._moved(start, volt, length_s)
        if end is None:
            return _nothing()
        torque_nm = self._torque(end)
        correction_nm = None
        if self.residual.is_active:
            request = self._request(interval_s, volt, theta, start)
            correction_nm, recollection = self.residual.correct(request, torque_nm)
        if correction_nm is None:
            return RotorPrediction(torque_nm, lambda: torque_nm, None, None, states=end)
        return RotorPrediction(
            torque_nm + correction_nm, lambda: torque_nm, None, None, torque_nm, recollection, end
        )

    def forecast(
        self, horizon_s: float, voltage_v: Array, theta: Array, since: Prediction | None = None
    ) -> Array:
        """Forecast the torque after a held voltage; see :class:`TorquePredictor`."""
        self._look_up(theta)
        start = self._states
        memory: Recollection | None = None
        if since is not None:
            start = since.states if isinstance(since, RotorPrediction) else None
            memory = since.residual_memory
        volt = float(voltage_v[0])
        if start is None or not (horizon_s > 0.0 and math.isfinite(volt)):
            return np.full(1, np.nan)
        correction = self.residual.correction
        has_correction = correction is not None and self.residual.is_active
        instants_s = (
            horizon_s / PIECES * np.arange(1.0, PIECES + 1.0)
            if correction is None or not has_correction
            else correction.instants_s(horizon_s)
        )
        path = self._path(start, volt, _parts(instants_s))
        if path is None:
            return np.full(1, np.nan)
        torque_nm = self._torque(path[-1])
        if not has_correction:
            return torque_nm
        end_states = path[-instants_s.size :]
        request = self._request(np.array([horizon_s]), volt, theta, end_states[-1])
        path_nm = np.atleast_2d(self._white_box.output(end_states[:, State.CURRENT]))
        return torque_nm + self.residual.along(request, path_nm, memory)

    def advance(
        self, sample: Sample, prediction: Prediction, speed: SpeedEstimate | None = None
    ) -> None:
        """Go on from a sample; see :class:`TorquePredictor`."""
        anew = sample.interval_s <= 0.0
        states = prediction.states if isinstance(prediction, RotorPrediction) else None
        volt = abs(float(sample.voltage_v[0]))
        if math.isfinite(volt):
            self._largest_v = max(self._largest_v, volt)
        if anew[0]:
            states = None
            self._load_rad_s2 = None
            self._wait_count = 0
        elif states is None or self._white_box.load_varies:
            states = self._begun(sample, speed)
        self._states = states
        if speed is not None and speed.load_rad_s2 is not None:
            self._load_rad_s2 = speed.load_rad_s2
        added_nm = (
            None if prediction.physics_nm is None else prediction.torque_nm - prediction.physics_nm
        )
        self.residual.remember(added_nm, anew, prediction.residual_memory)

    def state(self, motor: int = 0) -> dict[str, Array]:
        """What the motor has learnt, see :class:`TorquePredictor`, and its largest voltage."""
        return {**super().state(motor), _LARGEST_V: np.array([self._largest_v])}

    def restore(self, arrays: dict[str, Array], motor: int = 0) -> None:
        """Take back what :meth:`state` gave; see :class:`TorquePredictor`."""
        if _LARGEST_V in arrays:  # not in files of releases that did not remember it
            check_arrays(arrays, {_LARGEST_V: ArrayRule((1,), LEAST_V, LARGEST_SIGNAL)})
        super().restore(arrays, motor)
        if _LARGEST_V in arrays:
            self._largest_v = float(arrays[_LARGEST_V][0])

    def _begun(self, sample: Sample, speed: SpeedEstimate | None) -> Array | None:
        """Return the states that a run begins with; None where the speed is not yet known."""
        self._wait_count += 1
        if speed is None or self._interval is None:
            return None
        most = SURE * self._largest_v / self._values['back_emf_constant']
        if speed.std_rad_s > most and self._wait_count < LONGEST_WAIT:
            return None
        current_a = float(self._white_box.state(sample.torque_nm)[0])
        states = np.array([current_a, speed.speed_rad_s])
        return states if np.isfinite(states).all() else None

    def _look_up(self, theta: Array) -> None:
        """Work out what follows from the parameters, shape (1, parameter), where they changed."""
        own_theta = theta.tobytes()
        if own_theta == self._known_theta:
            return
        self._known_theta = own_theta
        box = self._white_box
        self._values = box.values(theta[0])
        self._p = coordinates(box, theta[0])
        self._interval = OneInterval(float(box.torque_constant), self._p)

    def _moved(self, start: Array, volt: float, length_s: float) -> Array | None:
        """Follow a held voltage, shape (state,); None where the run leaves its bounds."""
        assert self._interval is not None  # it is looked up
        limits = self._limits(start, volt)
        return self._interval.end(start, volt, length_s, limits, self._further_load)

    def _path(self, start: Array, volt: float, parts_s: Array) -> Array | None:
        """The same part by part, shape (part + 1, state)."""
        volts = np.full(parts_s.size, volt)
        loads = np.full(parts_s.size, self._further_load)
        limits = np.array(self._limits(start, volt))
        path = run(
            float(self._white_box.torque_constant), self._p, start, volts, parts_s, limits, loads
        )
        return path.states if path.is_bounded else None

    def _limits(self, start: Array, volt: float) -> tuple[float, float]:
        """Return absolute values of the states at which a run is given up."""
        largest_v = max(self._largest_v, abs(volt))
        current_a, speed_rad_s = start.tolist()
        return (
            MOST * (largest_v / self._values['resistance'] + abs(current_a)),
            MOST * (largest_v / self._values['back_emf_constant'] + abs(speed_rad_s)),
        )

    @property
    def _further_load(self) -> float:
        """What a load takes of the acceleration, beside that of the parameters."""
        return 0.0 if self._load_rad_s2 is None else self._load_rad_s2 - float(self._p[LOAD])

    def _torque(self, states: Array) -> Array:
        """Torque of states in N m, shape (motor,)."""
        return np.asarray(self._white_box.output(states[State.CURRENT : State.CURRENT + 1]))

    def _request(
        self, interval_s: Array, volt: float, theta: Array, start: Array
    ) -> ForecastRequest:
        """Say what the residual is asked of: the speed at the start is held over the interval."""
        speed = float(start[State.SPEED])
        steady_a = float(held_speed_current(self._values, np.array(volt), np.array(speed)))
        way = Course(theta[0].tolist(), volt, speed, steady_a, 0.0, 0.0)
        return ForecastRequest(
            interval_s, np.array([volt]), np.array([speed]), theta, way, usable=True
        )


def _parts(instants_s: Array) -> Array:
    """Lengths of the parts between instants; a long way to the first one is cut into parts too."""
    first_s = float(instants_s[0])
    steps = np.diff(instants_s)
    return np.concatenate([np.full(PIECES, first_s / PIECES), steps])


def _nothing() -> RotorPrediction:
    """Return what stands for no prediction."""
    blank = np.full(1, np.nan)
    return RotorPrediction(blank, lambda: blank, None, None)
