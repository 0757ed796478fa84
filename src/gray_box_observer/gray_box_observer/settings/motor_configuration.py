"""What is known of one motor beforehand, and of all that are listed: checked one by one."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from gray_box_observer.errors import ConfigurationError, brief
from gray_box_observer.settings.parameters import (
    KNOWN_PARAMETERS,
    MOTOR_PARAMETERS,
    ROTOR_NODES,
    ParameterSpec,
)
from gray_box_observer.settings.sensor_lag import CurrentLag
from gray_box_observer.white_box import MotorWhiteBox
from gray_box_observer.white_box.declaration import TERMS, State

RANGE = re.compile(r'([A-Za-z_][A-Za-z0-9_]*)\[(\d{1,9})\.\.(\d{1,9})\]')
"""Many motors with a number behind their name: ``m[1..1000]``."""

MOST_MOTORS = 10_000
"""Of a whole list, ranges written out: more would take the node minutes and gigabytes before it
hears anything."""

BACK_EMF = 'back_emf_constant'

DEAD_ZONE = 'dead_zone'
CURRENT_LAG = 'current_lag'
VARYING_LOAD = 'varying_load'
COASTING = 'coasting'
"""Effects that data may add and that are no context nodes: a lag of the current sensor, a load that
no term describes, and a driver that opens the winding at a command of 0."""

INITIAL_DEAD_ZONE = f'initial.{DEAD_ZONE}'

DEFAULT_NODES = next(spec.default for spec in MOTOR_PARAMETERS if spec.name == 'context_nodes')
"""What is identified of a motor that states nothing."""

OFFSET_STD = 0.1
"""Standard deviation of an offset of which nothing is stated, relative to its largest."""

SMALLEST_RELATIVE_STD = 1e-6
"""No initial value is known better; and the arithmetic would not bear it."""


@dataclass(frozen=True)
class MotorConfiguration:
    """What is known of one motor beforehand.

    Attributes:
        name: its name.
        values: by the names of MOTOR_PARAMETERS.
        stated_names: names of those that the user has stated; the others have their defaults, which
            say nothing of it.
        added_effects: effects of driver, sensor and load that data have added.
        current_lag: of the current sensor; None: there is none.
        reads_current: whether its torque is read as a current, so that Kt scales no estimate of
            the voltage balance but those of its speed.
    """

    name: str
    values: Mapping[str, Any]
    stated_names: frozenset[str] = frozenset()
    added_effects: tuple[str, ...] = ()
    current_lag: CurrentLag | None = None
    reads_current: bool = False

    @property
    def noise_memory(self) -> float:
        """Memory of the current's noise, where its sensor lags; 0: it has none."""
        return 0.0 if self.current_lag is None else self.current_lag.memory

    def white_box(self, speed_measured: bool) -> MotorWhiteBox:
        """Build the white box of this motor."""
        mechanical = self.mechanical_nodes
        nodes = tuple(name for name in self.values['context_nodes'] if name not in mechanical)
        constants = {
            name: self.values[parameter]
            for name, parameter in KNOWN_PARAMETERS.items()
            if name not in nodes and self.values[parameter] != 0.0
        }
        constants |= self._known_parts(nodes)
        if mechanical:
            constants = {
                name: value for name, value in constants.items() if not is_mechanical(name)
            }
        if self.has_rotor and not self.states_back_emf:
            constants[BACK_EMF] = self.values['torque_constant']
        has_speed_signal = speed_measured and not self.has_rotor
        load_varies = VARYING_LOAD in self.added_effects
        return MotorWhiteBox(
            nodes, self.values['torque_constant'], constants, has_speed_signal, load_varies
        )

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
        return tuple(name for name in nodes if is_mechanical(name))

    @property
    def known_mechanics(self) -> dict[str, float]:
        """What is known of the rotor and not identified, by the parameter's name."""
        nodes = self.values['context_nodes']
        return {
            name: self.values[parameter]
            for name, parameter in KNOWN_PARAMETERS.items()
            if is_mechanical(name) and name not in nodes and self.values[parameter] != 0.0
        }

    @property
    def known_mechanical_parts(self) -> dict[str, float]:
        """What is known in part of the mechanical context nodes, by name."""
        return self._known_parts(self.mechanical_nodes)

    def _known_parts(self, nodes: Sequence[str]) -> dict[str, float]:
        """Return what is known in part of context nodes that may have either sign, by name."""
        torque_constant = float(self.values['torque_constant'])
        return {
            name: TERMS[name].known_part_of(torque_constant)
            for name in nodes
            if name in TERMS and TERMS[name].has_either_sign
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

    def with_effects(
        self, effects: Sequence[str], dead_zone_v: float = 0.0, lag: CurrentLag | None = None
    ) -> MotorConfiguration:
        """Return the same motor with effects of driver and sensor, most among its context nodes.

        Args:
            effects: their names.
            dead_zone_v: where identification of a dead zone starts, in V; 0: nowhere special.
            lag: of the current sensor; None: there is none.
        """
        if not effects:
            return self
        nodes = [*self.values['context_nodes'], *(name for name in effects if name in TERMS)]
        motor = replace(
            self,
            values={**self.values, 'context_nodes': nodes},
            added_effects=tuple(effects),
            current_lag=lag,
        )
        if not dead_zone_v:
            return motor
        stated_names = self.stated_names | {INITIAL_DEAD_ZONE}
        values = {**motor.values, INITIAL_DEAD_ZONE: dead_zone_v}
        return replace(motor, values=values, stated_names=stated_names)

    @property
    def dead_zone_v(self) -> float:
        """Command up to which nothing drives the motor, in V, as far as it is stated; else 0."""
        if DEAD_ZONE not in self.values['context_nodes']:
            return float(self.values[KNOWN_PARAMETERS[DEAD_ZONE]])
        is_stated = INITIAL_DEAD_ZONE in self.stated_names
        return float(self.values[INITIAL_DEAD_ZONE]) if is_stated else 0.0

    @property
    def coasts(self) -> bool:
        """Whether a command of 0 opens the winding."""
        return COASTING in self.added_effects or bool(self.values[COASTING])

    def has_value(self, name: str) -> bool:
        """Tell whether a term is identified or known already, or a driver known to coast."""
        if name == COASTING:
            return self.coasts
        return name in self.values['context_nodes'] or self._is_known(name)

    def _is_known(self, name: str) -> bool:
        parameter = KNOWN_PARAMETERS.get(name)
        return parameter is not None and self.values[parameter] != 0.0

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
        """Where identification starts, in the order of the context nodes, without known parts."""
        return self.initial_of(self.values['context_nodes'])

    def initial_of(self, nodes: Sequence[str]) -> list[float]:
        """Return where identification of some nodes starts, without known parts."""
        parts = self._known_parts(nodes)
        return [float(self.values[f'initial.{name}']) - parts.get(name, 0.0) for name in nodes]

    def initial_relative_std(self) -> list[float]:
        """How well these are known, relative to them, in the same order; 0: nothing is said."""
        return self.initial_relative_std_of(self.values['context_nodes'])

    def initial_relative_std_of(self, nodes: Sequence[str]) -> list[float]:
        """Return how well the starts of some nodes are known, relative to :meth:`initial_of`."""
        return [
            self._signed_relative_std(name)
            if TERMS[name].has_either_sign
            else float(self.values[f'initial_relative_std.{name}'])
            for name in nodes
        ]

    def _signed_relative_std(self, name: str) -> float:
        """Return how well the start of a node of either sign is known, without its known part.

        What is stated is relative to the value itself; of a start at zero, to the largest value.
        """
        relative_std = float(self.values[f'initial_relative_std.{name}'])
        value = float(self.values[f'initial.{name}'])
        part = self._known_parts([name])[name]
        if value and relative_std:
            return max(relative_std * abs(value) / (value - part), SMALLEST_RELATIVE_STD)
        return relative_std or OFFSET_STD


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


def names_stated(group: str, flat: Mapping[str, Any]) -> frozenset[str]:
    """Return the names of MOTOR_PARAMETERS that a group states among dotted names."""
    return frozenset(spec.name for spec in MOTOR_PARAMETERS if f'{group}.{spec.name}' in flat)


def configured_motors(
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
    stated_names = shared_names | names_stated(name, unread_values)
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
        if values.get(f'known.{node}', 0.0) != 0.0:
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
    _check_starts(motor)
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


def check_joints(motors: Mapping[str, MotorConfiguration]) -> None:
    """Refuse a joint that two motors share."""
    joints = [motor.joint for motor in motors.values()]
    if len(set(joints)) < len(joints):
        twice = next(joint for joint, count in Counter(joints).items() if count > 1)
        raise ConfigurationError(
            f'two motors have the joint {brief(twice)}: give each a joint of its own'
        )


def _check_rotor(motor: MotorConfiguration) -> None:
    """Refuse a rotor without what it needs, and what is of a rotor where there is none."""
    name = motor.name
    values = motor.values
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
    if motor.coasts and motor.estimates_delay:
        raise ConfigurationError(
            f'motor {name}: the delay of a motor whose driver coasts cannot be estimated; declare '
            f'it with {name}.delay in s'
        )
    if not motor.has_rotor:
        return
    if motor.estimates_delay and motor.has_value(DEAD_ZONE):
        raise ConfigurationError(
            f'motor {name}: the delay of a rotor behind a dead zone cannot be estimated; declare '
            f'it with {name}.delay in s'
        )
    if not values['back_emf_constant'] > 0.0:
        raise ConfigurationError(
            f'motor {name}: speed_source is rotor, so {name}.back_emf_constant must be positive'
        )


def _check_starts(motor: MotorConfiguration) -> None:
    """Refuse a start beyond the range of a parameter that may have either sign.

    It need not be a context node: data may add it.
    """
    nodes = [name for name, term in TERMS.items() if term.has_either_sign]
    for node, start in zip(nodes, motor.initial_of(nodes), strict=True):
        term = TERMS[node]
        value = motor.values[f'initial.{node}']
        largest = -term.known_part_of(float(motor.values['torque_constant']))
        if not 0.0 < start < 2.0 * largest:
            raise ConfigurationError(
                f'parameter {motor.name}.initial.{node} must lie between {-largest:g} and '
                f'{largest:g} {term.parameter.unit}, got {value:g}'
            )


def is_mechanical(name: str) -> bool:
    """Tell whether a parameter is of the rotor; of a name that is none, it is not."""
    return name in TERMS and TERMS[name].state is State.SPEED


def _check_mechanics(motor: MotorConfiguration) -> None:
    """Refuse a measured rotor without what it needs."""
    name = motor.name
    values = motor.values
    nodes = values['context_nodes']
    if 'inertia' not in nodes:
        raise ConfigurationError(
            f'motor {name}: {motor.mechanical_nodes[0]} is among context_nodes without inertia: '
            'name inertia, viscous_friction and coulomb_friction, too'
        )
    if BACK_EMF in nodes or not values[BACK_EMF] > 0.0:
        raise ConfigurationError(
            f'motor {name}: inertia is among context_nodes, so {name}.{BACK_EMF} must be known '
            'and positive'
        )


def _own(value: Any) -> Any:
    """A list of one's own: what is common to all must not be changed by one."""
    return list(value) if isinstance(value, (list, tuple)) else value
