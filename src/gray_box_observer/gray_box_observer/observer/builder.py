"""Builds the observer of a motor or a group from the configuration and the first sample."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from gray_box_observer.context_nodes import (
    ContextUpdate,
    Estimate,
    GradientSettings,
    GradientUpdate,
    MeasuredSpeedUpdate,
    Mechanics,
    RecursiveEstimator,
    RecursiveSettings,
    RotorGroup,
    RotorUpdate,
    VerdictSettings,
    can_be_output,
    published_known_parts,
)
from gray_box_observer.context_nodes.native import filtered_speed, whole_motor
from gray_box_observer.delay import DeclaredDelay, DelayRound, DelayWatch, HiddenRotor
from gray_box_observer.errors import ConfigurationError
from gray_box_observer.fit_test.effects import HYSTERESIS
from gray_box_observer.fit_test.monitor import FitMonitor
from gray_box_observer.fit_test.twin_effects import LOAD_TORQUE
from gray_box_observer.observer.motor_forms.form_choice import NOTHING_ADDED, FormChoice
from gray_box_observer.observer.motor_forms.motor_form import (
    MEASURED,
    POSSIBLE_EFFECTS,
    ROTOR,
    SOURCES_OF,
    THESIS,
    FormKind,
    FormMaker,
    MotorForm,
)
from gray_box_observer.observer.motor_forms.open_forms import OpenForms
from gray_box_observer.observer.motor_forms.voltage_path import VoltagePath
from gray_box_observer.observer.motor_observer import MotorObserver
from gray_box_observer.observer.scale_doubt import scale_doubt
from gray_box_observer.samples.pairing import PairingSettings
from gray_box_observer.settings.configuration import Configuration
from gray_box_observer.settings.device import CPU, DEVICE_FROM, torch_device
from gray_box_observer.settings.motor_configuration import (
    COASTING,
    CURRENT_LAG,
    DEAD_ZONE,
    VARYING_LOAD,
    MotorConfiguration,
)
from gray_box_observer.settings.parameters import KNOWN_PARAMETERS, PHYSICS
from gray_box_observer.white_box import MotorWhiteBox

if TYPE_CHECKING:  # loaded where something is predicted
    from gray_box_observer.predictor import AlarmSettings, Forecasting, TorquePredictor, Training

UNUSED_SEED = 0
"""Of a rule that draws nothing."""

TrainingFactory = Callable[[dict[str, Any]], 'Training']


def motor_observer(
    configuration: Configuration,
    motors: Sequence[MotorConfiguration],
    training: TrainingFactory | None,
    *,
    speed_measured: bool,
    kind: FormKind | None = None,
) -> MotorObserver:
    """Build the observer at the first sample, when it is known whether speed is measured.

    Args:
        configuration: of the observer as a whole.
        motors: of the motors, alike in :func:`kind`.
        training: makes the predictor's trainer; None: no predictor.
        speed_measured: whether the first sample came with speed.
        kind: of the form that data have led to before; None: to none.

    Raises:
        ConfigurationError: speed has to be measured, and is not.
    """
    first = motors[0]
    source = first.values['speed_source']
    if source == MEASURED and not speed_measured:
        raise ConfigurationError(
            f'motor {first.name}: speed_source is measured, but its first torque sample came '
            'without speed'
        )
    uses_speed = speed_measured and source != THESIS

    def make(kind: FormKind) -> MotorForm:
        motor = first.with_rotor() if kind.source == ROTOR != source else first
        motor = motor.with_effects(kind.effects, kind.dead_zone_v, kind.lag)
        has_speed = uses_speed and kind.source == MEASURED
        return _form(configuration, [motor], training, speed_measured=has_speed)

    choice = _form_choice(configuration, motors, make, speed_measured=uses_speed)
    if kind is not None and first.coasts:  # what was found may have been stated since
        kind = kind.without(COASTING)
    if kind is not None and kind != choice.kind and choice.may_take(kind):
        form = choice.form_of(kind)
    elif kind is not None and kind.lag is not None:
        raise ConfigurationError(
            f'motor {first.name}: the checkpoint was learnt with a lag of the current, which '
            f'{first.name}.effects does not let be found now'
        )
    else:
        form = _form(configuration, motors, training, speed_measured=uses_speed)
    return MotorObserver(form, choice)


def _form(
    configuration: Configuration,
    motors: Sequence[MotorConfiguration],
    training: TrainingFactory | None,
    *,
    speed_measured: bool,
) -> MotorForm:
    """Make everything that motors are observed by."""
    first = motors[0]
    boxes = [motor.white_box(speed_measured=speed_measured) for motor in motors]
    white_box = boxes[0] if len(motors) == 1 else _joined(boxes)
    nodes = context_nodes(configuration, motors, white_box)
    motors = [motor.without_mechanics() for motor in motors]

    hidden_rotor = _hidden_rotor(configuration, first, white_box) if len(motors) == 1 else None

    def watch(motor: int) -> DelayWatch:
        initial = np.array([motors[motor].initial()])
        estimates_delay = first.estimates_delay
        has_effects = boxes[motor].has_rotor and bool(first.added_effects)
        is_declared = has_effects or first.current_lag is not None or motors[motor].coasts
        kind_of_watch = DeclaredDelay if is_declared else DelayWatch
        return kind_of_watch(
            boxes[motor],
            initial,
            first.delay_s,
            is_estimated=estimates_delay,
            gap_s=configuration['gap_s'],
            hidden_rotor=hidden_rotor,
        )

    def make_forecasting() -> Forecasting | None:
        is_physics = configuration['variant'] == PHYSICS
        if training is None or (white_box.has_rotor and not is_physics):
            return None  # the networks of the thesis know no hidden speed
        return _forecasting(configuration, motors, white_box, training)

    delay = watch(0) if len(motors) == 1 else DelayRound(len(motors), watch, first.delay_s)
    scales = scale_doubt(configuration, motors, boxes)
    fit = FitMonitor(motors, boxes, configuration['torque.quantity'])
    path = None
    if _makes_voltage(motors):
        dead_zone_v = np.array([motor.dead_zone_v for motor in motors])
        path = VoltagePath(dead_zone_v, first.current_lag, coasts=first.coasts)
    return MotorForm(white_box, nodes, delay, fit, make_forecasting, scales, path)


def _hidden_rotor(
    configuration: Configuration, motor: MotorConfiguration, white_box: MotorWhiteBox
) -> HiddenRotor | None:
    """Return the rotor that a motor alone has or may have unseen; None: it can have none."""
    if not white_box.has_rotor:
        may_turn = motor.values['speed_source'] == 'auto' and not white_box.speed_measured
        if not may_turn or _obstacle(configuration, [motor]) is not None:
            return None
        motor = motor.with_rotor()
        white_box = motor.white_box(speed_measured=False)
    return HiddenRotor(white_box, np.array(motor.without_mechanics().initial()))


def _makes_voltage(motors: Sequence[MotorConfiguration]) -> bool:
    """Tell whether the voltage that the white box takes is made of commands."""
    first = motors[0]
    has_zone = any(motor.dead_zone_v for motor in motors)
    return has_zone or first.current_lag is not None or first.coasts


def _form_choice(
    configuration: Configuration,
    motors: Sequence[MotorConfiguration],
    make: FormMaker,
    *,
    speed_measured: bool,
) -> FormChoice:
    """Say which form the physics of motors takes, and whether data may lead to another one."""
    source = motors[0].values['speed_source']
    sources: tuple[str, ...] = (source,)
    reason = 'as configured'
    if source == 'auto' and speed_measured:
        has_other = _obstacle(configuration, motors) is None
        sources = (MEASURED, ROTOR) if has_other else (MEASURED,)
        reason = 'the first torque sample brought a speed'
    elif source == 'auto':
        obstacle = _obstacle(configuration, motors)
        sources = (THESIS,)
        reason = f'a rotor is not tried: {obstacle}'
        if obstacle is None:
            sources = (THESIS, ROTOR)
            reason = 'a speed of Kt i is assumed, as in the thesis, until the data call for a rotor'
    effects, why_none = _open_effects(configuration, motors, sources)
    of_rotor: tuple[str, ...] = ()
    if effects and ROTOR in sources and HYSTERESIS not in effects:
        has_it = motors[0].with_rotor().has_value(HYSTERESIS)
        of_rotor = () if has_it else (HYSTERESIS,)  # a default list gives way to those of a rotor
    return FormChoice(sources[0], reason, OpenForms(make, sources, effects, of_rotor), why_none)


def _open_effects(
    configuration: Configuration, motors: Sequence[MotorConfiguration], sources: Sequence[str]
) -> tuple[tuple[str, ...], str]:
    """Return the effects that data may add to the form of motors, and why there are none.

    Args:
        configuration: of the observer as a whole.
        motors: alike.
        sources: that their speed may come from.
    """
    first = motors[0]
    if first.values['effects'] != 'auto':
        return (), 'as configured'
    if len(motors) > 1:
        return (), 'none are added: the motor is computed together with others'
    if configuration['context_update'] != 'recursive':
        return (), f'none are added: context_update is {configuration["context_update"]}'
    if first.estimates_delay:
        return (), 'none are added: the delay is estimated'
    possible = [
        name
        for name in POSSIBLE_EFFECTS
        if any(source in SOURCES_OF.get(name, sources) for source in sources)
    ]
    # what a dead zone takes would lag, too; and a lag needs L/R beside it
    if first.has_value(DEAD_ZONE) or first.coasts or not first.has_value('resistance'):
        possible = [name for name in possible if name != CURRENT_LAG]
    if first.has_value(LOAD_TORQUE):  # of one that varies it would be a part
        possible = [name for name in possible if name != VARYING_LOAD]
    return tuple(name for name in possible if not first.has_value(name)), NOTHING_ADDED


def _obstacle(configuration: Configuration, motors: Sequence[MotorConfiguration]) -> str | None:
    """Say why a rotor cannot be tried; None where it can."""
    if len(motors) > 1:
        return (
            'the motor is computed together with others; set its speed_source to rotor and '
            'predictor to false, or group_from above the number of motors'
        )
    if configuration['context_update'] != 'recursive':
        return f'context_update is {configuration["context_update"]}, and a rotor needs recursive'
    if whole_motor.library() is None:
        return 'the package was built without a C compiler'
    if not motors[0].has_value('resistance'):
        return 'resistance is neither among context_nodes nor known'
    try:
        motors[0].with_rotor()
    except ConfigurationError as error:
        return str(error)
    return None


def kind(configuration: Configuration, motor: MotorConfiguration) -> Hashable | None:
    """Return what motors must share to be computed together; None for one that stays alone.

    Alone stays whose stamps are not those of the others (its delay is estimated, its speed has a
    topic of its own), and where the thesis's rules were asked for.
    """
    rules_alone = (
        configuration['context_update'] != 'recursive' or configuration['variant'] != PHYSICS
    )
    alone = rules_alone or configuration.has_own_speed
    if motor.has_rotor and not _can_be_joined(configuration, motor):
        return None
    if alone or motor.estimates_delay or motor.mechanical_nodes or motor.coasts:
        return None
    values = motor.values
    constants = frozenset(
        name for name, parameter in KNOWN_PARAMETERS.items() if values[parameter] != 0.0
    )
    limits_v = tuple(values['voltage_limits'])
    return (
        tuple(values['context_nodes']),
        constants,
        motor.delay_s,
        limits_v,
        values['speed_source'],
    )


def _can_be_joined(configuration: Configuration, motor: MotorConfiguration) -> bool:
    """Tell whether a motor with a rotor may be computed together with others.

    Each has a prediction of its own. What makes voltages of commands, or whitens the noise of a
    current, is made for one motor, too.
    """
    is_plain = motor.current_lag is None and not motor.dead_zone_v and motor.noise_memory == 0.0
    load_varies = motor.white_box(speed_measured=False).load_varies
    has_library = filtered_speed.library() is not None
    return is_plain and has_library and not (load_varies or configuration['predictor'])


def _joined(boxes: Sequence[MotorWhiteBox]) -> MotorWhiteBox:
    """One white box for many motors: constants become arrays of shape (motor,)."""
    constants = {name: np.array([box.known[name] for box in boxes]) for name in boxes[0].known}
    return replace(
        boxes[0], torque_constant=np.array([box.torque_constant for box in boxes]), known=constants
    )


def context_nodes(
    configuration: Configuration, motors: Sequence[MotorConfiguration], white_box: MotorWhiteBox
) -> ContextUpdate:
    """Build context nodes that know nothing yet, under the rule that the configuration names."""
    verdicts = verdict_rules(configuration)
    mechanics = _mechanics(motors[0])
    motors = [motor.without_mechanics() for motor in motors]
    initial = np.array([motor.initial() for motor in motors])
    if configuration['context_update'] == 'gradient':
        seed = _seed(configuration, motors[0])
        return GradientUpdate(
            white_box, initial, seed, GradientSettings(**configuration.group('gradient')), verdicts
        )
    relative_std = np.array([motor.initial_relative_std() for motor in motors])
    rules = RecursiveSettings(**configuration.group('recursive'))
    if white_box.has_rotor and len(motors) > 1:
        boxes = [motor.white_box(speed_measured=False) for motor in motors]
        fit_share = 0.5 * configuration['group_core_share']  # tests have the other half
        return RotorGroup(boxes, initial, rules, verdicts, relative_std, fit_share)
    if white_box.has_rotor:
        merges_held = not _makes_voltage(motors)
        return RotorUpdate(
            white_box,
            initial,
            rules,
            verdicts,
            relative_std,
            merges_held=merges_held,
            noise_memory=motors[0].noise_memory,
        )
    if len(motors) == 1 and can_be_output(white_box):
        first = motors[0]
        is_open = first.values['effects'] == 'auto' and not first.estimates_delay
        # what a dead zone takes would lag, too
        finds_lag = is_open and not (first.has_value(DEAD_ZONE) or first.coasts)
        return MeasuredSpeedUpdate(
            white_box, initial, UNUSED_SEED, rules, verdicts, relative_std, mechanics,
            finds_lag=finds_lag,
        )  # fmt: skip
    return RecursiveEstimator(white_box, initial, UNUSED_SEED, rules, verdicts, relative_std)


def _mechanics(motor: MotorConfiguration) -> Mechanics | None:
    """Return what is asked of a rotor whose speed is measured; None where nothing is."""
    nodes = motor.mechanical_nodes
    if not nodes:
        return None
    return Mechanics(
        nodes,
        motor.initial_of(nodes),
        motor.initial_relative_std_of(nodes),
        motor.known_mechanics,
        motor.known_mechanical_parts,
    )


def initial_estimate(configuration: Configuration, motor: MotorConfiguration) -> Estimate:
    """Return a motor's belief before its first sample: initial values and their uncertainty."""
    white_box = motor.white_box(speed_measured=motor.values['speed_source'] != 'torque_constant')
    nodes = context_nodes(configuration, [motor], white_box)
    estimate = nodes.estimate()
    if isinstance(nodes, MeasuredSpeedUpdate):
        estimate = nodes.with_mechanics(estimate, is_believed=True)
    return estimate.with_known_parts(published_known_parts(nodes, white_box))


def pairing_rules(configuration: Configuration) -> PairingSettings:
    """How patient pairing is."""
    return PairingSettings(
        configuration['gap_s'], configuration['hold_s'], configuration['jump_back_s']
    )


def verdict_rules(configuration: Configuration) -> VerdictSettings:
    """When a parameter counts as identified."""
    return VerdictSettings(**configuration.group('verdict'))


def alarm_rules(configuration: Configuration) -> AlarmSettings:
    """Settings of the alarm."""
    from gray_box_observer.predictor import AlarmSettings

    return AlarmSettings(**configuration.group('alarm'))


def _forecasting(
    configuration: Configuration,
    motors: Sequence[MotorConfiguration],
    white_box: MotorWhiteBox,
    training: TrainingFactory,
) -> Forecasting:
    """Make what predicts torque, is trained, and raises the alarm."""
    from gray_box_observer.predictor import (
        Forecasting,
        Predictor,
        ResidualAlarm,
        RotorPredictor,
        TrainingSettings,
        Variant,
    )

    first = motors[0]
    count = len(motors)
    low_v, high_v = first.values['voltage_limits']
    device = torch_device(configuration['device'])
    # jobs of fewer motors are so small that a device idles
    taught_on = device if device is not None and count >= DEVICE_FROM else CPU
    rules = TrainingSettings(
        variant=Variant(configuration['variant']),
        horizon_s=configuration['horizon_s'],
        voltage_limits_v=(low_v, high_v),
        device=taught_on,
        **configuration.group('training'),
    )
    initial = np.array(first.initial())
    seed = _seed(configuration, first)
    job = {
        'white_box': white_box.to_dict(),
        'rules': rules.to_dict(),
        'theta_reference': initial.tolist(),
        'seed': seed,
    }
    is_physics = rules.variant is Variant.PHYSICS
    alarm = ResidualAlarm(count, alarm_rules(configuration)) if is_physics else None
    predictor: TorquePredictor
    if white_box.has_rotor:
        predictor = RotorPredictor(white_box)
    else:
        predictor = Predictor(
            white_box, count, initial, rules, speed_measured=white_box.speed_measured, seed=seed,
            device=device,
        )  # fmt: skip
    return Forecasting(predictor, rules, training(job), alarm)


def _seed(configuration: Configuration, motor: MotorConfiguration) -> int:
    """A seed of the motor's own."""
    seed = [configuration['seed'], *motor.name.encode()]
    return int(np.random.SeedSequence(seed).generate_state(1)[0])
