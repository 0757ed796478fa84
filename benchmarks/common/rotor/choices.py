"""What the observer chooses for a motor of which it is told Kt and Kb alone."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from common.rotor.records import Record
from common.rotor.runs import FALSE_SHARE, FALSE_STDS, MOTOR
from common.trust.plant import Motor
from gray_box_observer.context_nodes import Estimate, Verdict
from gray_box_observer.observer.observer import Observer
from gray_box_observer.settings.configuration import Configuration

ELECTRICAL = ('inductance', 'resistance')


@dataclass(frozen=True, slots=True)
class Choice:
    """What became of one record under ``speed_source: auto``.

    Attributes:
        source: where the speed comes from at the end.
        since_s: when that was chosen; NaN where nothing was chosen.
        right_names: parameters that are identified and right at the end.
        claims, false: identified parameters over all estimates, and those of them that were false.
    """

    source: str
    since_s: float
    right_names: tuple[str, ...]
    claims: int
    false: int

    @property
    def is_right(self) -> bool:
        """Whether L and R are identified and right at the end."""
        return set(ELECTRICAL) <= set(self.right_names)


def run_choice(record: Record) -> Choice:
    """Run the observer under its defaults over a record."""
    motor = record.motor
    constants = ('torque_constant', 'back_emf_constant')
    parameters = {f'{MOTOR}.{name}': getattr(motor, name) for name in constants}
    observer = Observer(Configuration.from_flat(parameters), None)
    stamps = np.round(np.arange(record.measured_a.size) * record.interval_s * 1e9).astype(int)
    torque_nm = record.measured_a * motor.torque_constant
    source = ''
    since_s = math.nan
    claims = 0
    false = 0
    for stamp, volt, reading in zip(
        stamps.tolist(), [*record.voltage_v.tolist(), 0.0], torque_nm.tolist(), strict=True
    ):
        observer.voltage(MOTOR, stamp, volt)
        for result in observer.torque(MOTOR, stamp, reading):
            if result.estimate is not None:
                right, wrong = _claims(result.estimate, motor)
                claims = claims + len(right) + len(wrong)
                false = false + len(wrong)
        view = observer.motors.get(MOTOR)
        if view is not None and view.white_box.speed_source != source:
            since_s = stamp * 1e-9 if source else math.nan
            source = view.white_box.speed_source
    right, _ = _claims(observer.estimates()[MOTOR], motor)
    return Choice(source, since_s, tuple(right), claims, false)


def _claims(estimate: Estimate, motor: Motor) -> tuple[list[str], list[str]]:
    """Names of what an estimate calls identified: those that are right, and those that are not."""
    right = []
    wrong = []
    for j, parameter in enumerate(estimate.parameters):
        if estimate.verdicts[0][j] is not Verdict.IDENTIFIED:
            continue
        truth = getattr(motor, parameter.name, 0.0)  # of an effect that it has not
        off = abs(estimate.value[0, j] - truth)
        is_wrong = off > FALSE_STDS * estimate.std[0, j] and off > FALSE_SHARE * truth
        (wrong if is_wrong else right).append(parameter.name)
    return right, wrong
