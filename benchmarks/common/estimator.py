"""What every online method of the benchmarks offers, and the rules of the package behind that."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np

from common.cases import Record
from common.motion import FloatArray
from gray_box_observer import context_nodes
from gray_box_observer.context_nodes import GradientUpdate, Verdict
from gray_box_observer.samples import Sample
from gray_box_observer.white_box import MotorWhiteBox

OWN_RULES = {'gradient': GradientUpdate}
if hasattr(context_nodes, 'RecursiveEstimator'):
    OWN_RULES = {'recursive': context_nodes.RecursiveEstimator, **OWN_RULES}


class Online(Protocol):
    """An estimator that takes the samples of one recording in order."""

    def learn(self, k: int) -> None:
        """Take sample k."""

    @property
    def theta(self) -> FloatArray:
        """Present values, shape (parameter,)."""

    @property
    def covariance(self) -> FloatArray | None:
        """Present covariance, shape (parameter, parameter); None where the method states none."""


class OwnRule:
    """A rule of ``gray_box_observer.context_nodes`` on one recording.

    Args:
        name: which rule, a key of :data:`OWN_RULES`.
        record: what it will learn from.
    """

    def __init__(self, name: str, record: Record) -> None:
        case = record.case
        known = (
            {}
            if 'back_emf_constant' in case.parameters
            else {'back_emf_constant': case.plant.back_emf_constant}
        )
        white_box = MotorWhiteBox(
            case.parameters, case.plant.torque_constant, known, speed_measured=case.rotor
        )
        self.rule: Any = OWN_RULES[name](white_box, record.start[None, :], record.seed)
        self._samples = samples_of(record)

    def learn(self, k: int) -> None:
        """Take sample k."""
        self.rule.learn(self._samples[k])

    @property
    def theta(self) -> FloatArray:
        """Present values."""
        values: FloatArray = self.rule.theta[0]
        return values

    @property
    def covariance(self) -> FloatArray:
        """Stated covariance."""
        matrix: FloatArray = self.rule.estimate().covariance[0]
        return matrix

    @property
    def identified(self) -> FloatArray:
        """One where the verdict of a parameter is ``identified``, else zero."""
        return np.array([float(v is Verdict.IDENTIFIED) for v in self.rule.estimate().verdicts[0]])

    @property
    def alarms(self) -> int:
        """How often a drift was announced; the gradient rule announces none."""
        return int(np.sum(getattr(self.rule, 'change_count', 0)))


def samples_of(record: Record) -> list[Sample]:
    """Turn a recording into samples of the observer, each with the voltage before it."""
    inputs = record.inputs
    intervals = np.concatenate([[0.0], inputs.interval_s])
    voltages = np.concatenate([[0.0], inputs.voltage_v])
    columns = (record.stamp_ns, intervals, voltages, record.torque_nm, record.speed_rad_s)
    return [
        Sample.of_one_motor(int(t), float(h), float(v), float(y), float(w))
        for t, h, v, y, w in zip(*columns, strict=True)
    ]
