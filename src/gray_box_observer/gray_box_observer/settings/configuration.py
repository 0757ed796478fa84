"""Parameter values, checked one by one and as a set; one YAML serves node and ``identify``."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from gray_box_observer.errors import ConfigurationError, brief
from gray_box_observer.settings.device import check_name
from gray_box_observer.settings.motor_configuration import (
    MotorConfiguration,
    check_joints,
    configured_motors,
    expanded,
    names_stated,
)
from gray_box_observer.settings.parameter_names import MOST_COMPARED, in_words, slip_of
from gray_box_observer.settings.parameters import (
    MOTOR_PARAMETERS,
    OBSERVER_PARAMETERS,
    PHYSICS,
    SIGNALS,
    ParameterSpec,
)
from gray_box_observer.settings.ros_parameter_file import read_parameter_file
from gray_box_observer.settings.signal_parameters import INPUT_PARAMETERS, TORQUE_CONSTANT
from gray_box_observer.settings.signal_sources import (
    Feed,
    check_reading,
    feeds_of,
    input_names,
    stated_inputs,
)

NAME = re.compile(r'[A-Za-z_][A-Za-z0-9_]*')
"""What ROS allows between two slashes of a topic: a motor's name stands there."""

DEFAULT_TOPICS = {
    name: next(spec.default for spec in OBSERVER_PARAMETERS if spec.name == f'{name}.topic')
    for name in SIGNALS
}

DEFAULTS = 'defaults'
"""Group of parameters for the motors that say nothing else in their own."""


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
        if values['horizon_s'] > 0.0 and values['variant'] != PHYSICS:
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
        shared_names = names_stated(DEFAULTS, unread_values)
        common = {
            spec.name: unread_values.pop(f'{DEFAULTS}.{spec.name}', spec.default)
            for spec in MOTOR_PARAMETERS
        }
        motors = configured_motors(names, unread_values, common, shared_names)
        if _reads_current(values):
            motors = {name: replace(motor, reads_current=True) for name, motor in motors.items()}
        check_joints(motors)
        _check_rule(values['context_update'], motors)
        return cls(values, motors, tuple(sorted(unread_values)))

    def with_values(self, new_values: Mapping[str, Any]) -> Configuration:
        """Return the configuration with values changed by dotted names; unknown ones are ignored.

        Raises:
            ConfigurationError: as in :meth:`from_flat`.
        """
        changes = {name: value for name, value in new_values.items() if self._has(name)}
        if not changes:  # rclpy declares four parameters of every publisher, and asks each time
            return self
        flat = dict(self.values)
        for name, motor in self.motors.items():
            flat.update({f'{name}.{key}': value for key, value in motor.values.items()})
        configuration = self.from_flat(flat | changes)
        motors = {
            name: replace(
                motor, stated_names=self.motors[name].stated_names | names_stated(name, changes)
            )
            for name, motor in configuration.motors.items()
        }
        return replace(configuration, motors=motors, unknown=self.unknown)

    def _has(self, name: str) -> bool:
        """Whether a dotted name is one of the observer's, of its inputs or of its motors."""
        motor, _, own_name = name.partition('.')
        return name in self.values or (
            motor in self.motors and own_name in self.motors[motor].values
        )

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

    def require_no_slips(self) -> None:
        """Refuse unknown names that are slips of declared ones, as the node does.

        Raises:
            ConfigurationError: there are such names; it gives the nearest of each.
        """
        names = self.unknown[:MOST_COMPARED]
        slips = {name: near for name in names if (near := slip_of(name, self.alike(name)))}
        if slips:
            kind = 'parameters' if len(slips) > 1 else 'a parameter'
            raise ConfigurationError(
                f'not {kind} of the observer: {in_words(slips)}; observer --help lists them'
            )

    @classmethod
    def from_yaml(cls, path: Path) -> Configuration:
        """Read a ROS parameter file (``/**`` or the node's name, then ``ros__parameters``).

        Raises:
            ConfigurationError: no such file, not YAML, or a value that does not fit.
        """
        return cls.from_flat(read_parameter_file(path))


def _is_foreign(name: str) -> bool:
    return name in FOREIGN_PARAMETERS or name.startswith(FOREIGN_GROUPS)


def _reads_current(values: Mapping[str, Any]) -> bool:
    """Tell whether torque is read as a current, which Kt makes a torque."""
    return values['torque.quantity'] == 'current' or TORQUE_CONSTANT in values['torque.expression']


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
