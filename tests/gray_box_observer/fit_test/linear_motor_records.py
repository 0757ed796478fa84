"""Records of linear motors, simulated exactly: what the residual analysis is tested on."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm
from scipy.signal import lfilter

from gray_box_observer.context_nodes.recursive.trajectory import SampleWindow
from gray_box_observer.observer.observer import Observer
from gray_box_observer.settings.configuration import Configuration
from gray_box_observer.white_box import MotorWhiteBox

Floats = NDArray[np.float64]

INTERVAL_S = 1e-3
INDUCTANCE_H = 4e-3
RESISTANCE_OHM = 2.0
TORQUE_CONSTANT = 0.02
NODES = ('inductance', 'resistance')
WHITE_BOX = MotorWhiteBox(NODES, TORQUE_CONSTANT)
TRUTH = np.array([[1.0 / INDUCTANCE_H, RESISTANCE_OHM / INDUCTANCE_H]])
"""The true values as coordinates."""


@dataclass(frozen=True)
class Record:
    """Voltage held from every sample on, and the current at it."""

    voltage_v: Floats
    current_a: Floats

    @property
    def stretch(self) -> SampleWindow:
        """The record as a stretch of one motor."""
        current_a = self.current_a[None]
        voltage_v = self.voltage_v[None, :-1]
        restart = np.zeros(voltage_v.shape, dtype=bool)
        return SampleWindow(
            current_a, voltage_v, np.full(voltage_v.shape, INTERVAL_S), 0.0 * current_a, restart
        )

    def observed(
        self, lost: Collection[int] = (), stamp_step_s: float = 1e-9, **motor: object
    ) -> Observer:
        """Return an observer that has learnt the record, but for voltages that were lost."""
        observer = _observer(motor)
        for sample, (voltage_v, current_a) in enumerate(
            zip(self.voltage_v, self.current_a, strict=True)
        ):
            stamp_ns = round(round(sample * INTERVAL_S / stamp_step_s) * stamp_step_s * 1e9)
            if sample not in lost:
                observer.voltage('motor', stamp_ns, float(voltage_v))
            observer.torque('motor', stamp_ns, TORQUE_CONSTANT * float(current_a))
        observer.flush()
        return observer


def _observer(motor: Mapping[str, object]) -> Observer:
    """Return an observer of a motor, with parameters of it besides the usual ones."""
    values = {
        'torque_constant': TORQUE_CONSTANT,
        'back_emf_constant': 1e-6,
        'context_nodes': list(NODES),
    }
    own = {f'motor.{name}': value for name, value in {**values, **motor}.items()}
    return Observer(Configuration.from_flat({'predictor': False, **own}))


def steps(samples: int, seed: int, low_v: float = -12.0, high_v: float = 12.0) -> Floats:
    """A voltage drawn anew every 20 to 200 samples."""
    rng = np.random.default_rng(seed)
    holds = rng.integers(20, 200, samples)
    levels = rng.uniform(low_v, high_v, samples)
    return np.repeat(levels, holds)[:samples]


def current_of(voltage_v: Floats, inductance_h: float = INDUCTANCE_H) -> Floats:
    """Current of the blocked motor at every sample, exactly."""
    decay = np.exp(-INTERVAL_S * RESISTANCE_OHM / inductance_h)
    return np.asarray(lfilter([0.0, (1.0 - decay) / RESISTANCE_OHM], [1.0, -decay], voltage_v))


def current_of_free_rotor(voltage_v: Floats, mechanical_s: float = 0.05) -> Floats:
    """Current of the same motor with a rotor that turns freely, exactly."""
    stiffness = RESISTANCE_OHM / mechanical_s  # a = Kb Kt / J in V/(A s)
    rates = np.array(
        [
            [-RESISTANCE_OHM / INDUCTANCE_H, -1.0 / INDUCTANCE_H, 1.0 / INDUCTANCE_H],
            [stiffness, 0.0, 0.0],
            [0.0, 0.0, 0.0],
        ]
    )
    step = expm(rates * INTERVAL_S)
    state = np.zeros(2)
    current_a = np.empty(voltage_v.size)
    for sample, volt in enumerate(voltage_v):
        current_a[sample] = state[0]
        state = step[:2, :2] @ state + step[:2, 2] * volt
    return current_a


def noise(samples: int, std: float, seed: int, memory: float = 0.0) -> Floats:
    """White noise, or noise of first order with a memory from sample to sample."""
    white = np.random.default_rng(seed).normal(size=samples)
    scale = std * np.sqrt(1.0 - memory**2)
    return np.asarray(lfilter([scale], [1.0, -memory], white))
