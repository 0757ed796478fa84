"""Builds the observer of one motor out of what the configuration says and what the first sample shows."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from gray_box_observer.configuration import Configuration, MotorConfiguration
from gray_box_observer.context_nodes import (
    ContextUpdate,
    Estimate,
    GradientRules,
    GradientUpdate,
    RecursiveRules,
    RecursiveUpdate,
    VerdictRules,
)
from gray_box_observer.delay import DelayWatch
from gray_box_observer.errors import ConfigurationError
from gray_box_observer.motor_observer import MotorObserver
from gray_box_observer.predictor import AlarmRules, Predictor, ResidualAlarm, Training, TrainingRules, Variant
from gray_box_observer.samples.pairing import PairingRules
from gray_box_observer.white_box import MotorWhiteBox

TrainingFactory = Callable[[dict[str, Any]], Training]


def motor_observer(
    configuration: Configuration, motor: MotorConfiguration, training: TrainingFactory | None, *, measured: bool
) -> MotorObserver:
    """Build a motor's observer at its first sample, when it is known whether speed is measured.

    Args:
        configuration: of the observer as a whole.
        motor: of this motor.
        training: makes the predictor's trainer; None: no predictor.
        measured: whether the first sample came with speed.

    Raises:
        ConfigurationError: speed has to be measured, and is not.
    """
    source = motor.values['speed_source']
    if source == 'measured' and not measured:
        raise ConfigurationError(
            f'motor {motor.name}: speed_source is measured, but its first torque sample came without speed'
        )
    white_box = motor.white_box(speed_measured=measured and source != 'torque_constant')
    nodes = context_nodes(configuration, motor, white_box)
    watch = DelayWatch(
        white_box,
        np.array([motor.initial()]),
        motor.delay_s,
        asked=motor.estimates_delay,
        gap_s=configuration['gap_s'],
    )
    predictor = alarm = None
    if training is not None:
        predictor = _predictor(configuration, motor, white_box, training)
        if configuration['variant'] == Variant.PHYSICS.value:
            alarm = ResidualAlarm(1, alarm_rules(configuration))
    return MotorObserver(white_box, nodes, predictor, watch, alarm)


def context_nodes(configuration: Configuration, motor: MotorConfiguration, white_box: MotorWhiteBox) -> ContextUpdate:
    """Build context nodes that know nothing yet, under the rule that the configuration names."""
    verdicts = verdict_rules(configuration)
    initial, seed = np.array([motor.initial()]), _seed(configuration, motor)
    if configuration['context_update'] == 'gradient':
        return GradientUpdate(white_box, initial, seed, GradientRules(**configuration.group('gradient')), verdicts)
    known = np.array([motor.initial_relative_std()])
    return RecursiveUpdate(
        white_box, initial, seed, RecursiveRules(**configuration.group('recursive')), verdicts, known
    )


def initial_estimate(configuration: Configuration, motor: MotorConfiguration) -> Estimate:
    """Return what is known of a motor before its first sample: the initial values, as sure as the configuration is."""
    white_box = motor.white_box(speed_measured=motor.values['speed_source'] != 'torque_constant')
    return context_nodes(configuration, motor, white_box).estimate()


def pairing_rules(configuration: Configuration) -> PairingRules:
    """How patient pairing is."""
    return PairingRules(configuration['gap_s'], configuration['hold_s'], configuration['jump_back_s'])


def verdict_rules(configuration: Configuration) -> VerdictRules:
    """When a parameter counts as identified."""
    return VerdictRules(**configuration.group('verdict'))


def alarm_rules(configuration: Configuration) -> AlarmRules:
    """Settings of the alarm."""
    return AlarmRules(**configuration.group('alarm'))


def _predictor(
    configuration: Configuration, motor: MotorConfiguration, white_box: MotorWhiteBox, training: TrainingFactory
) -> Predictor:
    low_v, high_v = motor.values['voltage_limits']
    rules = TrainingRules(
        variant=Variant(configuration['variant']),
        horizon_s=configuration['horizon_s'],
        voltage_limits_v=(low_v, high_v),
        **configuration.group('training'),
    )
    initial, seed = np.array(motor.initial()), _seed(configuration, motor)
    job = {
        'white_box': white_box.to_dict(),
        'rules': rules.to_dict(),
        'theta_reference': initial.tolist(),
        'seed': seed,
    }
    return Predictor(white_box, 1, initial, rules, training(job), speed_measured=white_box.speed_measured, seed=seed)


def _seed(configuration: Configuration, motor: MotorConfiguration) -> int:
    """A seed of the motor's own."""
    seed = [configuration['seed'], *motor.name.encode()]
    return int(np.random.SeedSequence(seed).generate_state(1)[0])
