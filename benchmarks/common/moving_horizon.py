"""Peer: do-mpc's moving-horizon estimator.

The motor is a discrete model, one classical Runge-Kutta step a sample; the parameters are estimated
in units of the coordinates in which the rate is linear, kept positive. The arrival cost on the
parameters has a constant weight, as do-mpc has it: the larger, the longer the memory beyond the
horizon. One non-linear programme is solved a sample.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np

from common.cases import Record
from common.motion import FloatArray

SMALLEST_NOISE = 1e-4
"""Measurement noise assumed where there is none, as a fraction of the current's spread."""


@dataclass(frozen=True, slots=True)
class HorizonSettings:
    """What the tuning chooses.

    Attributes:
        horizon: samples.
        memory: weight of the previous parameters against one sample's squared residual in standard
            deviations.
    """

    horizon: int = 20
    memory: float = 1e3


class MovingHorizon:
    """do_mpc.estimator.MHE on one recording with even intervals."""

    def __init__(self, record: Record, settings: HorizonSettings) -> None:
        with warnings.catch_warnings():
            warnings.simplefilter('ignore')  # do-mpc warns of the extras that it can do without
            from do_mpc.estimator import MHE
        case = record.case
        self._p0 = _to_linear(record.start)
        self._count = len(self._p0)
        spread = float(np.std(record.torque_nm)) / case.plant.torque_constant
        self._current = record.torque_nm / case.plant.torque_constant
        inputs = record.inputs
        self._voltage = inputs.voltage_v
        self._speed = np.nan_to_num(record.speed_rad_s)
        step_s = float(np.median(inputs.interval_s))
        names = [f'p{j}' for j in range(self._count)]
        self._mhe = mhe = MHE(_model(record, step_s, self._p0, names), names)
        mhe.settings.n_horizon = settings.horizon
        mhe.settings.t_step = step_s
        mhe.settings.meas_from_data = True
        mhe.settings.store_full_solution = False
        mhe.settings.nlpsol_opts = {
            'ipopt.print_level': 0,
            'ipopt.sb': 'yes',
            'print_time': 0,
            'ipopt.max_iter': 50,
        }
        noise = max(record.noise_a, SMALLEST_NOISE * spread)
        weight = np.array([[1.0 / noise**2]])
        mhe.set_default_objective(
            P_v=weight, P_x=np.array([[1.0 / noise**2]]), P_p=settings.memory * np.eye(self._count)
        )
        for name in names:
            mhe.bounds['lower', '_p_est', name] = 1e-3
            mhe.bounds['upper', '_p_est', name] = 1e3
        template = mhe.get_p_template()
        mhe.set_p_fun(lambda now: template)
        mhe.setup()
        mhe.x0 = np.array([self._current[0]])
        mhe.p_est0 = np.ones(self._count)
        mhe.set_initial_guess()

    def learn(self, k: int) -> None:
        """Take sample k, with the voltage that led to it."""
        if k == 0:
            return
        v = self._voltage[k - 1]
        self._mhe.make_step(
            np.array([[self._current[k]], [v], [self._speed[k - 1]], [self._speed[k]]])
        )

    @property
    def theta(self) -> FloatArray:
        """Present values."""
        return _to_linear(self._p0 * np.asarray(self._mhe.p_est0.cat).ravel())

    @property
    def covariance(self) -> None:
        """None: do-mpc states none."""
        return


def _model(record: Record, step_s: float, p0: FloatArray, names: list[str]) -> Any:
    """The discrete model: current at the end of an interval."""
    with warnings.catch_warnings():
        warnings.simplefilter('ignore')
        from do_mpc.model import Model
    case = record.case
    model = Model('discrete')
    current = model.set_variable('_x', 'current')
    voltage, first, last = (
        model.set_variable('_u', name) for name in ('voltage', 'first_speed', 'last_speed')
    )
    p = [scale * model.set_variable('_p', name) for scale, name in zip(p0, names, strict=True)]
    kt = case.plant.torque_constant
    kb = case.plant.back_emf_constant

    def slope(i: Any, w: Any) -> Any:
        w = w if case.rotor else kt * i
        back_emf = p[3] * w if len(p) > 3 else p[0] * kb * w
        return p[0] * voltage - p[1] * i - p[2] * w * i - back_emf

    h = step_s
    middle = 0.5 * (first + last)
    k1 = slope(current, first)
    k2 = slope(current + 0.5 * h * k1, middle)
    k3 = slope(current + 0.5 * h * k2, middle)
    k4 = slope(current + h * k3, last)
    model.set_rhs('current', current + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4))
    model.set_meas('current_meas', current, meas_noise=True)
    for name, variable in (('voltage', voltage), ('first', first), ('last', last)):
        model.set_meas(f'{name}_meas', variable, meas_noise=False)
    model.setup()
    return model


def _to_linear(theta: FloatArray) -> FloatArray:
    """Map (L, R, K, ...) to (1/L, R/L, K/L, ...); the map is its own inverse."""
    return np.concatenate([[1.0], theta[1:]]) / theta[0]
