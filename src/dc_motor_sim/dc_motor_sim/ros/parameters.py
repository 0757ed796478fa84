"""Every parameter of the node: default, description, unit, bounds, read-only or live.

The parameters of each motor are the fields of `PlantParameters`, under the motor's name, and stay
live; all others are read-only.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import Field, dataclass, field, fields, replace
from difflib import SequenceMatcher, get_close_matches
from typing import Any

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.node import Node

from dc_motor_sim.errors import ConfigurationError, PlantError
from dc_motor_sim.plant import SPEED_MODES, PlantParameters
from dc_motor_sim.quantity import Quantity, about, check_fields, quantity_of
from dc_motor_sim.ros.command_line import parameter_names
from dc_motor_sim.ros.parameter_sections import names_of_node
from dc_motor_sim.simulation import Simulation

_RANGE = re.compile(r'([A-Za-z][A-Za-z0-9_]*)\[(\d{1,9})\.\.(\d{1,9})\]')

MOST_MOTORS = 10_000
"""Of a whole list, ranges written out; each declares a dozen parameters."""

_ALIKE = 0.7
"""Share of letters that two parts of a name have in common where one may be a slip of the other."""

_SUGGESTED = 0.5
"""The same of whole names, where there is none of which it may be a slip."""

_MOST_TOLD = 8

_EXCITATION_OF_MOTOR = Quantity("excitation of this motor; empty for the node's own")


@dataclass(frozen=True, slots=True, kw_only=True)
class NodeParameters:
    """Parameters of the node itself."""

    motors: tuple[str, ...] = field(
        default=('motor',), metadata=about('names of the motors, at most 10,000')
    )
    excitation: str = field(
        default='R[5,15]D[1,20]',
        metadata=about(
            'voltage: R[a,b]D[c,d], C[v], external, table_5_1/1 to /8; +sin, +sin(A,w), +noise, '
            '+noise(std)'
        ),
    )
    seed: int = field(default=1, metadata=about('seed of everything random', '', 0, 2**31 - 1))
    sample_rate_hz: float = field(
        default=100.0, metadata=about('samples a second', 'Hz', 1.0, 1000.0)
    )
    duration_s: float = field(
        default=0.0,
        metadata=about('simulated time after which the node ends; 0 for never', 's', 0.0, 1e9),
    )
    speed_mode: str = field(
        default='thesis',
        metadata=about('thesis: speed = Kt i; rotor: speed is a state', choices=SPEED_MODES),
    )
    speed_measured: bool = field(
        default=False,
        metadata=about(
            'publish the speed in thesis mode too (rotor mode does unless speed_hidden)'
        ),
    )
    speed_hidden: bool = field(
        default=False,
        metadata=about('in rotor mode, publish no speed: a motor without encoder'),
    )
    solver_step_s: float = field(
        default=0.01,
        metadata=about(
            'longest solver step, always also at most a tenth of the time constant', 's', 1e-6, 1.0
        ),
    )
    voltage_noise_std: float = field(
        default=0.0,
        metadata=about(
            'noise on the voltage of every motor; 0: only where +noise says so, 0.5 V then',
            'V',
            0.0,
            1e4,
        ),
    )
    torque_noise_std: float = field(
        default=0.0, metadata=about('noise of the torque sensor', 'N m', 0.0, 1e6)
    )
    torque_noise_relative: float = field(
        default=0.0,
        metadata=about(
            'the same, as a fraction of the spread of the noise-free torque in a dry run of 60 s',
            '',
            0.0,
            1e3,
        ),
    )
    torque_offset: float = field(
        default=0.0, metadata=about('what the torque sensor reads too high', 'N m', -1e6, 1e6)
    )
    torque_lag_s: float = field(
        default=0.0,
        metadata=about(
            'time constant of the torque sensor, first order, from 1e-6 on; 0: reads at once',
            's',
            0.0,
            10.0,
        ),
    )
    torque_quantisation: float = field(
        default=0.0, metadata=about('resolution of the torque sensor; 0 for none', 'N m', 0.0, 1e6)
    )
    torque_limit: float = field(
        default=0.0,
        metadata=about('the torque sensor saturates here; 0 for never', 'N m', 0.0, 1e6),
    )
    speed_noise_std: float = field(
        default=0.0, metadata=about('noise of the speed sensor', 'rad/s', 0.0, 1e6)
    )
    speed_quantisation: float = field(
        default=0.0, metadata=about('resolution of the speed sensor; 0 for none', 'rad/s', 0.0, 1e6)
    )
    schedule: tuple[str, ...] = field(
        default=(),
        metadata=about(
            'changes over time: motor.resistance=1.3@60 or motor.resistance=1.0..1.2@0..60'
        ),
    )
    command_timeout_s: float = field(
        default=0.0,
        metadata=about(
            'an external command older than this counts as 0 V; 0: never', 's', 0.0, 1e9
        ),
    )
    publish_clock: bool = field(
        default=False, metadata=about('publish /clock; stamps then begin at start_stamp_s')
    )
    clock_speed_up: float = field(
        default=1.0,
        metadata=about(
            'simulated seconds in a second; needs publish_clock unless 1', '', 0.001, 1000.0
        ),
    )
    start_stamp_s: float = field(
        default=0.0,
        metadata=about('first stamp with publish_clock; without it that is now', 's', 0.0, 2e9),
    )
    wait_for_subscribers: int = field(
        default=0,
        metadata=about('subscribers of motor/torque to wait for before the start', '', 0, 1000),
    )
    wait_timeout_s: float = field(
        default=30.0,
        metadata=about('start after this long without them, with a warning', 's', 0.0, 1e6),
    )

    def __post_init__(self) -> None:
        check_fields(self, ConfigurationError)
        object.__setattr__(self, 'motors', _expanded(self.motors))
        _check_names(self.motors)
        if self.clock_speed_up != 1.0 and not self.publish_clock:
            raise ConfigurationError(
                f'clock_speed_up is {self.clock_speed_up:g}, which needs publish_clock: true'
            )


@dataclass(frozen=True, slots=True)
class Settings:
    """Everything the node was started with."""

    node: NodeParameters
    motors: Mapping[str, PlantParameters]
    excitation: Mapping[str, str]

    def simulation(self) -> Simulation:
        """Build the simulation, stamped from 0.

        Raises:
            SimulationError: Some value cannot be used.
        """
        node = self.node
        return Simulation(
            self.motors,
            self.excitation,
            sample_rate_hz=node.sample_rate_hz,
            seed=node.seed,
            speed_mode=node.speed_mode,
            solver_step_s=node.solver_step_s,
            voltage_noise_std=node.voltage_noise_std,
            torque_noise_std=node.torque_noise_std,
            torque_noise_relative=node.torque_noise_relative,
            torque_offset=node.torque_offset,
            torque_lag_s=node.torque_lag_s,
            torque_quantisation=node.torque_quantisation,
            torque_limit=node.torque_limit,
            speed_noise_std=node.speed_noise_std,
            speed_quantisation=node.speed_quantisation,
            command_timeout_s=node.command_timeout_s,
            schedule=node.schedule,
        )


def declare(node: Node) -> Settings:
    """Declare every parameter on the node and read what it was started with.

    Raises:
        ConfigurationError: A value has the wrong type or cannot be used.
        PlantError: A physical parameter is out of its bounds; the motor is named.
    """
    own = NodeParameters(
        **{f.name: _declare(node, f.name, f, live=False) for f in fields(NodeParameters)}
    )
    excitation = {}
    motors = {}
    for motor in own.motors:
        name = f'{motor}.excitation'
        descriptor = _descriptor(_EXCITATION_OF_MOTOR, live=False)
        excitation[motor] = (
            _declare_one(node, name, '', _EXCITATION_OF_MOTOR, descriptor) or own.excitation
        )
        values = {
            f.name: _declare(node, f'{motor}.{f.name}', f, live=True)
            for f in fields(PlantParameters)
        }
        motors[motor] = PlantParameters(**values)
    return Settings(own, motors, excitation)


def replace_parameters(
    motor: str, present: PlantParameters, values: Mapping[str, float]
) -> PlantParameters:
    """Return a motor's parameters with some replaced; a PlantError names the motor."""
    try:
        return replace(present, **values)
    except PlantError as error:
        raise PlantError(f'{motor}.{error}') from None


def usage_text() -> str:
    """Text of `--help`: how to start the node, and each parameter with default, unit, bounds."""
    lines = [
        'usage: motor_sim [--help] [--ros-args -p NAME:=VALUE ... --params-file FILE.yaml ...]',
        '',
        'Simulates DC motors; publishes motor/voltage and motor/torque, listens to '
        'motor/voltage_command.',
        '',
        'Parameters, fixed at the start:',
        *(_usage_line(f.name, f.default, quantity_of(f)) for f in fields(NodeParameters)),
        '',
        'Parameters of each motor, under its name (motor.resistance); all but excitation can be '
        'set live:',
        _usage_line('excitation', '', _EXCITATION_OF_MOTOR),
        *(_usage_line(f.name, f.default, quantity_of(f)) for f in fields(PlantParameters)),
    ]
    return '\n'.join(lines)


def _usage_line(name: str, default: object, quantity: Quantity) -> str:
    default_text = f'[{", ".join(default)}]' if isinstance(default, tuple) else str(default).lower()
    default_text = default if isinstance(default, str) else default_text
    unit = f' {quantity.unit}' if quantity.unit else ''
    bounds = quantity.bounds()
    return (
        f'  {name:<22} {quantity.text} (default '
        f'{default_text or "empty"}{unit}{bounds and f"; {bounds}"})'
    )


def _declare(node: Node, name: str, declaration: Field[Any], *, live: bool) -> Any:
    quantity = quantity_of(declaration)
    return _declare_one(
        node, name, declaration.default, quantity, _descriptor(quantity, live=live, of=declaration)
    )


def _declare_one(
    node: Node, name: str, default: Any, quantity: Quantity, descriptor: ParameterDescriptor
) -> Any:
    """Declare one parameter and return its value in the type of its default."""
    # rclpy refuses `1` for `1.0` and reports a range without its unit, hence the look at the
    # override itself.
    override = getattr(node, '_parameter_overrides', {}).get(name)
    value = default if override is None else _converted(name, override.value, default)
    complaint = quantity.complaint(name, value)
    if complaint is not None:
        raise ConfigurationError(complaint)
    # An empty list has no element type to declare, so no text at all stands for it.
    as_declared = (list(value) or ['']) if isinstance(value, tuple) else value
    node.declare_parameter(name, as_declared, descriptor, ignore_override=True)
    return value


def _converted(name: str, value: Any, default: Any) -> Any:
    if isinstance(default, tuple):
        if isinstance(value, list | tuple) and all(isinstance(text, str) for text in value):
            return tuple(text for text in value if text.strip())
        raise ConfigurationError(f'{name} must be a list of texts, like [one, two]; got {value!r}')
    if isinstance(default, float) and isinstance(value, int) and not isinstance(value, bool):
        return float(value)
    if type(value) is not type(default):
        kind = {bool: 'true or false', int: 'a whole number', float: 'a number', str: 'a text'}[
            type(default)
        ]
        raise ConfigurationError(f'{name} must be {kind}; got {value!r}')
    return value


def _descriptor(
    quantity: Quantity, *, live: bool, of: Field[Any] | None = None
) -> ParameterDescriptor:
    unit = f', in {quantity.unit}' if quantity.unit else ''
    descriptor = ParameterDescriptor(description=f'{quantity.text}{unit}', read_only=not live)
    if quantity.choices:
        descriptor.additional_constraints = f'one of {", ".join(quantity.choices)}'
    default = of.default if of is not None else ''
    if isinstance(default, float):
        descriptor.floating_point_range = [
            FloatingPointRange(from_value=quantity.low, to_value=quantity.high)
        ]
    elif isinstance(default, int) and not isinstance(default, bool):
        descriptor.integer_range = [
            IntegerRange(from_value=int(quantity.low), to_value=int(quantity.high), step=1)
        ]
    return descriptor


def _expanded(motors: tuple[str, ...]) -> tuple[str, ...]:
    """Write out ranges of motors: ``m[1..3]`` stands for m1, m2 and m3."""
    ranges = [_RANGE.fullmatch(text) for text in motors]
    counts = [
        max(0, int(range_match[3]) - int(range_match[2]) + 1) if range_match else 1
        for range_match in ranges
    ]
    if sum(counts) > MOST_MOTORS:  # before any is written out
        raise ConfigurationError(
            f'motors stands for {sum(counts)} motors; expected {MOST_MOTORS} at most'
        )
    names: list[str] = []
    for text, range_match in zip(motors, ranges, strict=True):
        names += (
            [f'{range_match[1]}{k}' for k in range(int(range_match[2]), int(range_match[3]) + 1)]
            if range_match
            else [text]
        )
    return tuple(names)


def _check_names(motors: tuple[str, ...]) -> None:
    parameter_names = {f.name for f in fields(NodeParameters)}
    if not motors or len(set(motors)) != len(motors):
        raise ConfigurationError(
            f'motors must be one name or more, all different; got {list(motors)}'
        )
    for motor in motors:
        if not re.fullmatch(r'[A-Za-z][A-Za-z0-9_]*', motor) or motor in parameter_names:
            raise ConfigurationError(
                f'motors: {motor!r} cannot name a motor; use letters, digits and _, and no '
                'parameter name'
            )


def settle_unread(node: Node, args: Sequence[str]) -> None:
    """Refuse parameters that nothing has asked for, once everything has been declared.

    A name on the command line is meant for this node. A parameter file may serve several nodes: of
    its names only slips of our own are refused. Of others the log warns where the file's section
    names this node, or where a name is our own but for its motor, which is not listed. What else
    stands below a wildcard is that of other nodes.

    Args:
        node: To which they were given.
        args: The command line.

    Raises:
        ConfigurationError: One of them was meant for this node; says which of ours comes nearest.
    """
    overrides = getattr(node, '_parameter_overrides', {})
    unread = sorted(name for name in overrides if not node.has_parameter(name))
    declared_names = list(getattr(node, '_parameters', {}))
    # A motor that is not listed may be one of another node: only one that is bare can be meant.
    stated_groups = {name.partition('.')[0] for name in overrides}
    bare = {name.partition('.')[0] for name in declared_names} - stated_groups
    command_line_names = parameter_names(args)
    slips: list[str] = []
    for name in unread:
        group = name.partition('.')[0]
        valid_names = [
            candidate
            for candidate in declared_names
            if candidate.partition('.')[0] in {group, *bare} or '.' not in name
        ]
        near = _slip_of(name, valid_names)
        if not near and name in command_line_names:
            near = next(iter(get_close_matches(name, valid_names, 1, _SUGGESTED)), '')
        if near or name in command_line_names:
            slips.append(f'{name} (did you mean {near}?)' if near else name)
    if slips:
        raise ConfigurationError(
            f'no parameter of motor_sim: {", ".join(slips[:_MOST_TOLD])}; --help lists them'
        )
    own_section_names = names_of_node(args, node.get_name()) if unread else set()
    fields_of_motor = {field.name for field in fields(PlantParameters)}
    dubious = [
        name
        for name in unread
        if name in own_section_names or name.partition('.')[2] in fields_of_motor
    ]
    if dubious:
        node.get_logger().warning(
            f'no parameter of motor_sim, ignored: {", ".join(dubious[:_MOST_TOLD])}; --help lists '
            'them'
        )
    others = sorted(set(unread) - set(dubious))
    if others:
        node.get_logger().debug(
            f'of other nodes, by a wildcard in a parameter file: {", ".join(others[:_MOST_TOLD])}'
        )


def _slip_of(name: str, valid_names: Sequence[str]) -> str:
    """Return the known name that a name misspells: one part is alike, the others are the same."""
    parts = name.split('.')
    best_name = ''
    alike = _ALIKE
    for candidate in valid_names:
        candidate_parts = candidate.split('.')
        differing_parts = [
            pair for pair in zip(parts, candidate_parts, strict=False) if pair[0] != pair[1]
        ]
        if len(parts) == len(candidate_parts) and len(differing_parts) == 1:
            ratio = SequenceMatcher(None, *differing_parts[0]).ratio()
            if ratio >= alike and (not best_name or ratio > alike):
                best_name = candidate
                alike = ratio
    return best_name
