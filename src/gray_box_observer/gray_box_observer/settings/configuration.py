"""Parameter values, checked one by one and as a set; one YAML serves node and ``identify``."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from gray_box_observer.errors import ConfigurationError, InputError, brief
from gray_box_observer.safe_io.bounded_yaml import read_yaml
from gray_box_observer.settings.device import check_name
from gray_box_observer.settings.parameters import (
    KNOWN_PARAMETERS,
    MOTOR_PARAMETERS,
    OBSERVER_PARAMETERS,
    ROTOR_NODES,
    SIGNALS,
    ParameterSpec,
)
from gray_box_observer.settings.signal_parameters import INPUT_PARAMETERS
from gray_box_observer.settings.signal_sources import (
    Feed,
    check_reading,
    feeds_of,
    input_names,
    stated_inputs,
)
from gray_box_observer.white_box import MotorWhiteBox
from gray_box_observer.white_box.declaration import TERMS, State

NODE_NAME = 'gray_box_observer'

NAME = re.compile(r'[A-Za-z_][A-Za-z0-9_]*')
"""What ROS allows between two slashes of a topic: a motor's name stands there."""

RANGE = re.compile(r'([A-Za-z_][A-Za-z0-9_]*)\[(\d{1,9})\.\.(\d{1,9})\]')
"""Many motors with a number behind their name: ``m[1..1000]``."""

MOST_MOTORS = 100_000
"""Of a whole list, ranges written out: more would take the node minutes and gigabytes before it
hears anything."""

DEFAULT_TOPICS = {
    name: next(spec.default for spec in OBSERVER_PARAMETERS if spec.name == f'{name}.topic')
    for name in SIGNALS
}

BACK_EMF = 'back_emf_constant'

DEFAULT_NODES = next(spec.default for spec in MOTOR_PARAMETERS if spec.name == 'context_nodes')
"""What is identified of a motor that states nothing."""

DEFAULTS = 'defaults'
"""Group of parameters for the motors that say nothing else in their own."""


@dataclass(frozen=True)
class MotorConfiguration:
    """What is known of one motor beforehand.

    Attributes:
        name: its name.
        values: by the names of MOTOR_PARAMETERS.
        stated_names: names of those that the user has stated; the others have their defaults, which
            say nothing of it.
    """

    name: str
    values: Mapping[str, Any]
    stated_names: frozenset[str] = frozenset()

    def white_box(self, speed_measured: bool) -> MotorWhiteBox:
        """Build the white box of this motor."""
        mechanical = self.mechanical_nodes
        nodes = tuple(name for name in self.values['context_nodes'] if name not in mechanical)
        constants = {
            name: self.values[parameter]
            for name, parameter in KNOWN_PARAMETERS.items()
            if name not in nodes and self.values[parameter] > 0.0
        }
        if mechanical:
            constants = {
                name: value for name, value in constants.items() if not _is_mechanical(name)
            }
        if self.has_rotor and not self.states_back_emf:
            constants[BACK_EMF] = self.values['torque_constant']
        has_speed_signal = speed_measured and not self.has_rotor
        return MotorWhiteBox(nodes, self.values['torque_constant'], constants, has_speed_signal)

    @property
    def joint(self) -> str:
        """Its name in messages."""
        return self.values['joint'] or self.name

    @property
    def has_rotor(self) -> bool:
        """Whether its speed is a hidden state."""
        return bool(self.values['speed_source'] == 'rotor')

    @property
    def mechanical_nodes(self) -> tuple[str, ...]:
        """Context nodes of a rotor whose speed is measured; none where it is a hidden state."""
        if self.has_rotor:
            return ()
        nodes = self.values['context_nodes']
        return tuple(name for name in nodes if _is_mechanical(name))

    @property
    def known_mechanics(self) -> dict[str, float]:
        """What is known of the rotor and not identified, by the parameter's name."""
        nodes = self.values['context_nodes']
        return {
            name: self.values[parameter]
            for name, parameter in KNOWN_PARAMETERS.items()
            if _is_mechanical(name) and name not in nodes and self.values[parameter] > 0.0
        }

    def without_mechanics(self) -> MotorConfiguration:
        """Return the same motor with its electrical context nodes alone."""
        nodes = [n for n in self.values['context_nodes'] if n not in self.mechanical_nodes]
        return replace(self, values={**self.values, 'context_nodes': nodes})

    @property
    def states_back_emf(self) -> bool:
        """Whether Kb is stated; else a rotor takes it for Kt, which it nearly is in SI units."""
        return BACK_EMF in self.stated_names

    @property
    def needs_speed(self) -> bool:
        """Whether nothing can be learnt of it before speed is measured."""
        source = self.values['speed_source']
        nodes = self.values['context_nodes']
        return source == 'measured' or (
            source == 'auto' and any(TERMS[name].needs_speed for name in nodes)
        )

    def with_rotor(self) -> MotorConfiguration:
        """Return the same motor with its speed a hidden state.

        What is identified of its voltage balance stays, where it was stated: a list that is the
        default says nothing.

        Raises:
            ConfigurationError: the motor lacks what a rotor needs.
        """
        nodes = list(self.values['context_nodes'])
        if nodes == DEFAULT_NODES:
            nodes = []
        nodes += [name for name in ROTOR_NODES if name not in nodes and not self._is_known(name)]
        values = {**self.values, 'speed_source': 'rotor', 'context_nodes': nodes}
        motor = replace(self, values=values)
        _check_rotor(motor)
        motor.white_box(speed_measured=False)
        return motor

    def _is_known(self, name: str) -> bool:
        parameter = KNOWN_PARAMETERS.get(name)
        return parameter is not None and self.values[parameter] > 0.0

    def is_notable(self, spec: ParameterSpec) -> bool:
        """Tell whether a value must be known to repeat a run: constant, stated or no default."""
        differs = self.values[spec.name] != spec.default
        return (
            differs
            or spec.name in self.stated_names
            or spec.name in ('torque_constant', 'back_emf_constant')
        )

    @property
    def estimates_delay(self) -> bool:
        """Whether the delay between voltage and torque is estimated instead of declared."""
        return isinstance(self.values['delay'], str)

    @property
    def delay_s(self) -> float:
        """The declared delay in s; 0 to begin with where it is estimated."""
        return 0.0 if self.estimates_delay else float(self.values['delay'])

    def initial(self) -> list[float]:
        """Where identification starts, in the order of the context nodes."""
        return [float(self.values[f'initial.{name}']) for name in self.values['context_nodes']]

    def initial_relative_std(self) -> list[float]:
        """How well these are known, relative to them, in the same order; 0: nothing is said."""
        return [
            float(self.values[f'initial_relative_std.{name}'])
            for name in self.values['context_nodes']
        ]


@dataclass(frozen=True)
class Configuration:
    """The whole configuration.

    Attributes:
        values: by the names of OBSERVER_PARAMETERS; of INPUT_PARAMETERS below each input's name.
        motors: one entry a motor.
        unknown: names that were given but nobody declared, for the caller to warn of: a file with
            ``/**`` may hold parameters of other nodes.
    """

    values: Mapping[str, Any]
    motors: Mapping[str, MotorConfiguration] = field(default_factory=dict)
    unknown: tuple[str, ...] = ()

    def __getitem__(self, name: str) -> Any:
        return self.values[name]

    def notable(self) -> dict[str, Any]:
        """Return this configuration's stated and non-default values, by dotted names."""
        notable_values = {
            spec.name: self.values[spec.name]
            for spec in OBSERVER_PARAMETERS
            if self.values[spec.name] != spec.default
        }
        notable_values.update(
            {
                name: self.values[name]
                for name, spec in self.input_specs()
                if self.values[name] != spec.default
            }
        )
        for name, motor in self.motors.items():
            notable_values.update(
                {
                    f'{name}.{spec.name}': motor.values[spec.name]
                    for spec in MOTOR_PARAMETERS
                    if motor.is_notable(spec)
                }
            )
        return notable_values

    def input_specs(self) -> list[tuple[str, ParameterSpec]]:
        """Return the parameters of every input that an expression names, by dotted names."""
        return [
            (f'{name}.{spec.name}', spec)
            for name in input_names(self.values)
            for spec in INPUT_PARAMETERS
        ]

    @property
    def feeds(self) -> tuple[Feed, ...]:
        """Every topic to listen to."""
        return feeds_of(self.values)

    @property
    def has_own_speed(self) -> bool:
        """Whether speed comes from a topic or an expression of its own."""
        return bool(self.values['speed.topic'] or self.values['speed.expression'].strip())

    def group(self, prefix: str) -> dict[str, Any]:
        """Return the values below a prefix, by the rest of their names."""
        return {
            name[len(prefix) + 1 :]: v
            for name, v in self.values.items()
            if name.startswith(f'{prefix}.')
        }

    @classmethod
    def from_flat(cls, flat_values: Mapping[str, Any]) -> Configuration:
        """Build the configuration from dotted names; what is not given has its default.

        Raises:
            ConfigurationError: a value out of range, or motors that fit no white box.
        """
        unread_values = {
            name: value for name, value in flat_values.items() if not _is_foreign(name)
        }
        values = {
            spec.name: spec.check(unread_values.pop(spec.name, spec.default))
            for spec in OBSERVER_PARAMETERS
        }
        names = values['motors'] = expanded(values['motors'])
        if (
            not names
            or len(set(names)) != len(names)
            or not all(isinstance(n, str) and NAME.fullmatch(n) and n != DEFAULTS for n in names)
        ):
            raise ConfigurationError(
                'motors must be distinct names that can stand in a topic (letters, digits, _; '
                f'not {DEFAULTS}), got '
                f'{brief(names)}'
            )
        reserved_names = [name for name in names if name in RESERVED]
        if reserved_names:
            raise ConfigurationError(
                f'motors: {reserved_names[0]} is the name of parameters of the observer itself; '
                'give the motor another one'
            )
        if values['verdict.identified_relative_std'] > values['verdict.excited_relative_std']:
            raise ConfigurationError(
                'parameter verdict.identified_relative_std must not be above '
                'verdict.excited_relative_std, got '
                f'{values["verdict.identified_relative_std"]} and '
                f'{values["verdict.excited_relative_std"]}'
            )
        for small, large in FITS_TWICE:
            if 2 * values[small] > values[large]:
                raise ConfigurationError(
                    f'parameter {large} must be at least twice {small}, got {values[large]} and '
                    f'{values[small]}'
                )
        if values['horizon_s'] > 0.0 and values['variant'] != 'physics':
            raise ConfigurationError(
                f'parameter horizon_s must be 0 with variant {values["variant"]}, got '
                f'{values["horizon_s"]!r}: '
                'only variant physics looks beyond the next sample'
            )
        check_name(values['device'])
        for name in SIGNALS:
            _check_signal(name, values)
        values |= stated_inputs(values, unread_values, {*names, *RESERVED, DEFAULTS})
        feeds_of(values)
        shared_names = _stated_names(DEFAULTS, unread_values)
        common = {
            spec.name: unread_values.pop(f'{DEFAULTS}.{spec.name}', spec.default)
            for spec in MOTOR_PARAMETERS
        }
        motors = _motors(names, unread_values, common, shared_names)
        _check_joints(motors)
        _check_rule(values['context_update'], motors)
        return cls(values, motors, tuple(sorted(unread_values)))

    def with_values(self, new_values: Mapping[str, Any]) -> Configuration:
        """Return the configuration with values changed by dotted names; unknown ones are ignored.

        Raises:
            ConfigurationError: as in :meth:`from_flat`.
        """
        flat = dict(self.values)
        for name, motor in self.motors.items():
            flat.update({f'{name}.{key}': value for key, value in motor.values.items()})
        changes = {name: value for name, value in new_values.items() if name in flat}
        configuration = self.from_flat(flat | changes)
        motors = {
            name: replace(
                motor, stated_names=self.motors[name].stated_names | _stated_names(name, changes)
            )
            for name, motor in configuration.motors.items()
        }
        return replace(configuration, motors=motors, unknown=self.unknown)

    def alike(self, name: str) -> list[str]:
        """Return declared names that an unknown one may have been meant for.

        A motor that is not listed may be one of another node; it is taken for a slip of a motor of
        which nothing is stated, and of no other.
        """
        candidates = [spec.name for spec in OBSERVER_PARAMETERS]
        candidates += [name for name, _ in self.input_specs()]
        group = name.partition('.')[0]
        if group in self.motors or group == DEFAULTS:
            groups = [group]
        else:
            groups = [
                DEFAULTS,
                *(motor for motor, of in self.motors.items() if not of.stated_names),
            ][:MOST_ALIKE]
        return candidates + [
            f'{motor}.{spec.name}' for motor in groups for spec in MOTOR_PARAMETERS
        ]

    @classmethod
    def from_yaml(cls, path: Path) -> Configuration:
        """Read a ROS parameter file (``/**`` or the node's name, then ``ros__parameters``).

        Raises:
            ConfigurationError: no such file, not YAML, or a value that does not fit.
        """
        return cls.from_flat(read_parameter_file(path))


def read_parameter_file(path: Path) -> dict[str, Any]:
    """What a ROS parameter file gives to the observer, by dotted names.

    Raises:
        ConfigurationError: no such file, not YAML, or nothing for the observer in it.
    """
    try:
        document = read_yaml(path)
    except InputError as error:
        raise ConfigurationError(f'parameter file {error}') from None
    flat_values: dict[str, Any] = {}
    for node, content in document.items() if isinstance(document, dict) else ():
        if str(node).strip('/') in ('**', NODE_NAME) or str(node).endswith(f'/{NODE_NAME}'):
            if not isinstance(content, dict) or not isinstance(
                content.get('ros__parameters'), dict
            ):
                raise ConfigurationError(f'{path}: expected ros__parameters below {brief(node)}')
            try:
                flat_values.update(flatten(content['ros__parameters']))
            except ConfigurationError as error:
                raise ConfigurationError(f'parameter file {path}: {error}') from None
    if not flat_values:
        raise ConfigurationError(
            f'{path} holds no parameters for {NODE_NAME}: expected "/**:" with "ros__parameters:"'
        )
    return flat_values


SMALLEST_RELATIVE_STD = 1e-6
"""No initial value is known better; and the arithmetic would not bear it."""

FITS_TWICE = (
    ('recursive.block', 'recursive.replay_capacity'),
    ('gradient.window', 'gradient.replay_capacity'),
    ('gradient.batch_size', 'gradient.replay_capacity'),
    ('training.context', 'training.replay_capacity'),
)
"""What has to fit twice into what: a memory must hold more than one piece of work on it."""

MOST_ALIKE = 100
"""Motors of which an unknown name is looked up."""

FOREIGN_PARAMETERS = frozenset({'use_sim_time', 'start_type_description_service'})
"""Parameters that rclpy declares itself."""

FOREIGN_GROUPS = ('qos_overrides.',)
"""Groups of parameters that rclpy declares itself."""


RESERVED = frozenset(
    name.partition('.')[0]
    for name in (*(spec.name for spec in OBSERVER_PARAMETERS), *FOREIGN_PARAMETERS, *FOREIGN_GROUPS)
)
"""Names that no motor may have: its parameters would be the observer's."""


def _is_foreign(name: str) -> bool:
    return name in FOREIGN_PARAMETERS or name.startswith(FOREIGN_GROUPS)


def flatten(tree: Mapping[str, Any], prefix: str = '') -> dict[str, Any]:
    """Turn nested groups into dotted names.

    Raises:
        ConfigurationError: a name is there twice, once with a dot and once as a group.
    """
    flat: dict[str, Any] = {}
    for name, value in tree.items():
        dotted_name = f'{prefix}{name}'
        values = (
            flatten(value, f'{dotted_name}.')
            if isinstance(value, Mapping)
            else {dotted_name: value}
        )
        twice = next((dotted_key for dotted_key in values if dotted_key in flat), None)
        if twice is not None:
            raise ConfigurationError(f'parameter {brief(twice)} stands twice')
        flat.update(values)
    return flat


def _check_signal(name: str, values: Mapping[str, Any]) -> None:
    """Refuse a signal that comes from nowhere, or from two places."""
    has_expression = bool(values[f'{name}.expression'].strip())
    if not values[f'{name}.topic'] and name != 'speed' and not has_expression:
        raise ConfigurationError(
            f'parameter {name}.topic is empty: voltage and torque each need a topic'
        )
    if has_expression and values[f'{name}.topic'] not in ('', DEFAULT_TOPICS[name]):
        raise ConfigurationError(
            f'parameter {name}.topic is given beside {name}.expression, whose inputs have topics '
            'of their own: leave one of them out'
        )
    check_reading(name, values)


def _check_rule(rule: str, motors: Mapping[str, MotorConfiguration]) -> None:
    """Refuse to be told what the rule could not make use of."""
    informed_motors = [name for name, motor in motors.items() if any(motor.initial_relative_std())]
    rotor_motors = [name for name, motor in motors.items() if motor.has_rotor]
    if rule != 'recursive' and rotor_motors:
        raise ConfigurationError(
            f'motor {rotor_motors[0]}: speed_source rotor needs context_update recursive, '
            f'got {rule}'
        )
    inertia_motors = [name for name, motor in motors.items() if motor.mechanical_nodes]
    if rule != 'recursive' and inertia_motors:
        raise ConfigurationError(
            f'motor {inertia_motors[0]}: inertia among context_nodes needs context_update '
            f'recursive, got {rule}'
        )
    if rule != 'recursive' and informed_motors:
        raise ConfigurationError(
            f'motor {informed_motors[0]}: initial_relative_std needs context_update recursive, got '
            f'{rule}: '
            'the gradient rule has no prior'
        )


def expanded(names: Any) -> Any:
    """Write out ranges of motors: ``m[1..3]`` is m1, m2, m3; other values stay as they are."""
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        return names
    ranges = [RANGE.fullmatch(name) for name in names]
    counts = [max(0, int(r[3]) - int(r[2]) + 1) if r else 1 for r in ranges]
    if sum(counts) > MOST_MOTORS:  # before any is written out
        raise ConfigurationError(
            f'motors: {brief(names)} stands for {sum(counts)} motors, expected {MOST_MOTORS} at '
            'most'
        )
    expanded_names: list[str] = []
    for name, range_match, count in zip(names, ranges, counts, strict=True):
        numbers = range(int(range_match[2]), int(range_match[3]) + 1) if range_match else range(0)
        expanded_names += (
            [f'{range_match[1]}{number}' for number in numbers] if range_match and count else [name]
        )
    return expanded_names


def _stated_names(group: str, flat: Mapping[str, Any]) -> frozenset[str]:
    """Return the names of MOTOR_PARAMETERS that a group states among dotted names."""
    return frozenset(spec.name for spec in MOTOR_PARAMETERS if f'{group}.{spec.name}' in flat)


def _motors(
    names: Sequence[str],
    unread_values: dict[str, Any],
    common: Mapping[str, Any],
    shared_names: frozenset[str],
) -> dict[str, MotorConfiguration]:
    """Configure every motor; those without a group of their own are alike, checked once."""
    motors_with_group = {name.partition('.')[0] for name in unread_values}
    motors: dict[str, MotorConfiguration] = {}
    alike: dict[str, Any] = {}
    lists: list[str] = []
    for name in names:
        if name in motors_with_group:
            motors[name] = _motor(name, unread_values, common, shared_names)
            continue
        if not alike:
            alike = dict(_motor(name, unread_values, common, shared_names).values)
            lists = [key for key, value in alike.items() if isinstance(value, list)]
        motors[name] = MotorConfiguration(
            name, alike | {key: list(alike[key]) for key in lists}, shared_names
        )
    return motors


def _motor(
    name: str,
    unread_values: dict[str, Any],
    common: Mapping[str, Any],
    shared_names: frozenset[str],
) -> MotorConfiguration:
    """Take one motor's group out of the values; what it lacks is that of all motors."""
    stated_names = shared_names | _stated_names(name, unread_values)
    values = {
        spec.name: spec.check(
            unread_values.pop(f'{name}.{spec.name}', _own(common[spec.name])), f'{name}.'
        )
        for spec in MOTOR_PARAMETERS
    }
    motor = MotorConfiguration(name, values, stated_names)
    if motor.has_rotor and 'context_nodes' not in stated_names:
        values['context_nodes'] = list(ROTOR_NODES)
    _check_rotor(motor)
    for node in values['context_nodes']:
        if values.get(f'known.{node}', 0.0) > 0.0:
            raise ConfigurationError(
                f'motor {name}: {node} is among context_nodes and has known.{node}: leave one of '
                'them out'
            )
        std = values.get(f'initial_relative_std.{node}', 0.0)
        if 0.0 < std < SMALLEST_RELATIVE_STD:
            raise ConfigurationError(
                f'parameter {name}.initial_relative_std.{node} must be 0 or at least '
                f'{SMALLEST_RELATIVE_STD:g}, got '
                f'{std:g}: take a constant that is known for certain out of context_nodes'
            )
    limits_v = values['voltage_limits']
    if len(limits_v) != 2 or limits_v[0] > limits_v[1]:
        raise ConfigurationError(
            f'parameter {name}.voltage_limits must be [lowest, highest] in V, got {brief(limits_v)}'
        )
    try:
        motor.white_box(speed_measured=values['speed_source'] != 'torque_constant')
    except ConfigurationError as error:
        raise ConfigurationError(f'motor {name}: {error}') from error
    return motor


def _check_joints(motors: Mapping[str, MotorConfiguration]) -> None:
    """Refuse a joint that two motors share."""
    joints = [motor.joint for motor in motors.values()]
    if len(set(joints)) < len(joints):
        twice = next(joint for joint, count in Counter(joints).items() if count > 1)
        raise ConfigurationError(
            f'two motors have the joint {brief(twice)}: give each a joint of its own'
        )


def _check_rotor(motor: MotorConfiguration) -> None:
    """Refuse a rotor without what it needs, and what is of a rotor where there is none."""
    name, values = motor.name, motor.values
    has_inertia = 'inertia' in values['context_nodes']
    if motor.has_rotor and not has_inertia:
        raise ConfigurationError(
            f'motor {name}: speed_source is rotor, but inertia is not among context_nodes'
        )
    if has_inertia and not motor.has_rotor and values['speed_source'] != 'measured':
        raise ConfigurationError(
            f'motor {name}: inertia is among context_nodes; set {name}.speed_source: rotor, or '
            'measured where a sensor reads its speed'
        )
    if motor.mechanical_nodes:
        _check_mechanics(motor)
    if not motor.has_rotor:
        return
    if motor.estimates_delay:
        raise ConfigurationError(
            f'motor {name}: the delay of a motor whose speed_source is rotor cannot be estimated; '
            f'declare it with {name}.delay in s'
        )
    if not values['back_emf_constant'] > 0.0:
        raise ConfigurationError(
            f'motor {name}: speed_source is rotor, so {name}.back_emf_constant must be positive'
        )


def _is_mechanical(name: str) -> bool:
    """Tell whether a parameter is of the rotor; of a name that is none, it is not."""
    return name in TERMS and TERMS[name].state is State.SPEED


def _check_mechanics(motor: MotorConfiguration) -> None:
    """Refuse a measured rotor without what it needs."""
    name, values = motor.name, motor.values
    nodes = values['context_nodes']
    if 'inertia' not in nodes:
        raise ConfigurationError(
            f'motor {name}: {motor.mechanical_nodes[0]} is among context_nodes without inertia'
        )
    if BACK_EMF in nodes or not values[BACK_EMF] > 0.0:
        raise ConfigurationError(
            f'motor {name}: inertia is among context_nodes, so {name}.{BACK_EMF} must be known '
            'and positive'
        )


def _own(value: Any) -> Any:
    """A list of one's own: what is common to all must not be changed by one."""
    return list(value) if isinstance(value, (list, tuple)) else value
