"""A recorded motor with its speed as sensors read it, and what a rule learns of it."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
from rotor_motors import BOX, KB, KT, THETA, recorded, samples_of
from rotor_records import counted_speed

from gray_box_observer.context_nodes import MeasuredSpeedUpdate, RecursiveSettings, VerdictSettings
from gray_box_observer.context_nodes.measured_speed.output_fit import OutputFit, fit_outputs
from gray_box_observer.context_nodes.measured_speed.speed_start import speed_start
from gray_box_observer.context_nodes.pieces import completed
from gray_box_observer.context_nodes.rotor.history_unknowns import SpeedOutput, Unknowns
from gray_box_observer.context_nodes.rotor.logarithms import LogPrior
from gray_box_observer.context_nodes.rotor.window import Window
from gray_box_observer.observer.observer import Observer
from gray_box_observer.samples import Sample
from gray_box_observer.settings.configuration import Configuration
from gray_box_observer.white_box import MotorWhiteBox

MEASURED = MotorWhiteBox(('inductance', 'resistance'), KT, {'back_emf_constant': KB}, True)
START = np.array([[1.5, 3.0]])
TRUTH = THETA[:2]


def noisy(speed: np.ndarray, share: float = 0.02) -> np.ndarray:
    """White noise of a share of the spread."""
    return speed + np.random.default_rng(5).normal(0.0, share * np.std(speed), speed.size)


def late(speed: np.ndarray) -> np.ndarray:
    """Two samples late."""
    return np.concatenate([np.full(2, speed[0]), speed[:-2]])


def counted(speed: np.ndarray) -> np.ndarray:
    """Counts of an encoder of 200 lines between two samples of a millisecond."""
    return counted_speed(speed, 200)


SENSORS = {'noisy': noisy, 'late': late, 'counted': counted, 'exact': lambda speed: speed}


@cache
def readings(sensor: str, duration_s: float = 3.0) -> tuple[Sample, ...]:
    """Samples of the recorded motor with its speed as a sensor reads it."""
    recording = recorded(duration_s=duration_s)
    speed = SENSORS[sensor](recording.speed_rad_s[0])
    samples = samples_of(recording)
    return tuple(sample._replace(speed_rad_s=speed[k : k + 1]) for k, sample in enumerate(samples))


def rule() -> MeasuredSpeedUpdate:
    """A rule that knows nothing yet."""
    return MeasuredSpeedUpdate(
        MEASURED, START, 0, RecursiveSettings(), VerdictSettings(), np.zeros((1, 2))
    )


def learnt(samples: tuple[Sample, ...], update: Any = None) -> Any:
    """Let a rule learn samples."""
    update = rule() if update is None else update
    for sample in samples:
        update.learn(sample)
    return update


def window_of(content: np.ndarray, speed: np.ndarray) -> Window:
    """A window of content with a speed."""
    content = content.copy()
    content[3] = speed
    return Window.from_samples(BOX, content, Unknowns(SpeedOutput(1.0)))


def fitted(window: Window) -> OutputFit:
    """Both outputs, fitted from a start far off."""
    mean = np.log([parameter.initial for parameter in BOX.parameters])
    start = speed_start(BOX, window, np.exp(mean))
    assert start is not None
    fit = completed(fit_outputs(BOX, window, LogPrior(mean, np.eye(mean.size) / 25.0), [start]))
    assert fit is not None
    return fit


def observed(samples: list[Sample], **more: Any) -> tuple[Any, str]:
    """What the observer says of samples: its estimate and its verdict of the fit.

    Args:
        samples: of the motor.
        more: parameters of it.
    """
    parameters = {
        'predictor': False,
        'motor.torque_constant': KT,
        'motor.back_emf_constant': KB,
        'motor.speed_source': 'measured',
        'motor.context_nodes': ['inductance', 'resistance'],
        'motor.stamps_exact': True,
    } | {f'motor.{name}': value for name, value in more.items()}
    observer = Observer(Configuration.from_flat(parameters), None)
    volts = [float(sample.voltage_v[0]) for sample in samples[1:]]
    for sample, volt in zip(samples, [*volts, 0.0], strict=True):
        observer.voltage('motor', sample.stamp_ns, volt)
        torque = float(sample.torque_nm[0])
        speed = float(sample.speed_rad_s[0])
        observer.torque('motor', sample.stamp_ns, torque, speed)
    return observer.estimates()['motor'], observer.fit('motor').verdict.value
