"""What becomes of one motor in the observer, and what is claimed of its L and R on the way."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from common.claims import claims, is_known, is_near
from common.motion import FloatArray
from common.trust.motors import Motor
from gray_box_observer.fit_test import FitVerdict
from gray_box_observer.observer.observer import Observer
from gray_box_observer.settings.configuration import Configuration

MOTOR = 'motor'


@dataclass(frozen=True, slots=True)
class MotorTrial:
    """What came of one motor.

    Attributes:
        is_known: whether R is identified and right at the end.
        is_near: whether R is right, whatever its verdict.
        is_misfit: whether the white box does not explain it, at the end.
        claims, false: identified L and R over all estimates, and those of them that were false.
    """

    is_known: bool
    is_near: bool
    is_misfit: bool
    claims: int
    false: int


def counts(trials: Sequence[MotorTrial]) -> list[str]:
    """Return how many motors there were, were known, right and misfits, and what was claimed."""
    numbers = [
        len(trials),
        sum(trial.is_known for trial in trials),
        sum(trial.is_near for trial in trials),
        sum(trial.is_misfit for trial in trials),
        sum(trial.claims for trial in trials),
        sum(trial.false for trial in trials),
    ]
    return [*map(str, numbers)]


def observed_trial(
    motor: Motor,
    voltage_v: FloatArray,
    current_a: FloatArray,
    speed_rad_s: FloatArray | None,
    rate_hz: float,
    *,
    phase: float = 0.0,
    delay: float | str = 0.0,
) -> MotorTrial:
    """Run the observer without predictor over a record; it is told Kt and Kb.

    Args:
        motor: the truth.
        voltage_v: shape (k,): held from every sample to the next.
        current_a: shape (k + 1,): readings.
        speed_rad_s: shape (k + 1,): likewise; None: the speed is not measured.
        rate_hz: of the samples.
        phase: how long after a sample the voltage is stamped, in sample intervals.
        delay: of the voltage, as the observer is told it, ``estimate`` or in s.
    """
    speeds = np.full(current_a.size, math.nan) if speed_rad_s is None else speed_rad_s
    constants = {'torque_constant': motor.torque_constant}
    constants['back_emf_constant'] = motor.back_emf_constant
    flat: dict[str, object] = {f'{MOTOR}.{name}': value for name, value in constants.items()}
    flat[f'{MOTOR}.delay'] = delay
    observer = Observer(Configuration.from_flat(flat), None)
    if phase:
        observer.voltage(MOTOR, round((phase - 1.0) / rate_hz * 1e9), 0.0)
    claim_counts = np.zeros(2, dtype=int)
    volts = [*voltage_v.tolist(), 0.0]
    torque = motor.torque_constant * current_a
    for place, (volt, reading, own_speed) in enumerate(zip(volts, torque, speeds, strict=True)):
        stamp_ns = round(place / rate_hz * 1e9)
        messages = [
            partial(observer.voltage, MOTOR, round((place + phase) / rate_hz * 1e9), volt),
            partial(observer.torque, MOTOR, stamp_ns, float(reading), float(own_speed)),
        ]
        results = [result for say in messages[:: -1 if phase else 1] for result in say()]
        for result in results:
            if result.estimate is not None:
                claim_counts += claims(result.estimate, motor)
    observer.finish()
    end = observer.estimates()[MOTOR]
    return MotorTrial(
        is_known(end, motor),
        is_near(end, motor),
        observer.fit(MOTOR).verdict is FitVerdict.MISFIT,
        int(claim_counts[0]),
        int(claim_counts[1]),
    )
