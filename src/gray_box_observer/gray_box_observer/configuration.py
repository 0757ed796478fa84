"""Every parameter of the observer, declared once: node, ``identify``, YAML, documentation and tests read this list.

Names are those of ROS parameters. One YAML file serves the node and ``identify``; each motor has a group of its own.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

from gray_box_observer.bag.fields import FieldPath
from gray_box_observer.errors import ConfigurationError
from gray_box_observer.white_box import TERMS, MotorWhiteBox

NODE_NAME = 'gray_box_observer'

NAME = re.compile(r'[A-Za-z_][A-Za-z0-9_]*')
"""What ROS allows between two slashes of a topic: a motor's name stands there."""

MESSAGE_TYPE = re.compile(r'[a-z][a-z0-9_]*/(?:msg/)?[A-Z][A-Za-z0-9]*')

SIGNALS = ('voltage', 'torque', 'speed')
"""What is measured; each has a group of parameters that say where it comes from."""


@dataclass(frozen=True, slots=True)
class ParameterSpec:
    """One parameter as a user sees it.

    Attributes:
        name: dotted ROS parameter name; for a motor's parameters, below the motor's name.
        default: value and, by its type, the type.
        description: what it does, with its unit.
        minimum, maximum: inclusive range of a number.
        choices: allowed values of a string.
        words: words that may stand in place of a number.
        live: whether it may be changed while the node runs.
    """

    name: str
    default: Any
    description: str
    minimum: float | None = None
    maximum: float | None = None
    choices: tuple[str, ...] = ()
    words: tuple[str, ...] = ()
    live: bool = False

    def check(self, value: Any, where: str = '') -> Any:
        """Return the value in the declared type.

        Raises:
            ConfigurationError: wrong type, outside the range, or not among the choices.
        """
        name = f'{where}{self.name}'
        if isinstance(self.default, float) and isinstance(value, int) and not isinstance(value, bool):
            value = float(value)
        if isinstance(self.default, list) and isinstance(value, tuple):
            value = list(value)
        if isinstance(self.default, list) and isinstance(self.default[0], float) and isinstance(value, list):
            value = [float(v) if isinstance(v, int) and not isinstance(v, bool) else v for v in value]
        if value in self.words:
            return value
        if self.words and (isinstance(value, bool) or not isinstance(value, (int, float))):
            raise ConfigurationError(f'parameter {name} must be a number or {" or ".join(self.words)}, got {value!r}')
        if type(value) is not type(self.default):
            wanted, got = type(self.default).__name__, type(value).__name__
            raise ConfigurationError(f'parameter {name} must be of type {wanted}, got {value!r} ({got})')
        if isinstance(value, list) and any(type(entry) is not type(self.default[0]) for entry in value):
            wanted = type(self.default[0]).__name__
            raise ConfigurationError(f'parameter {name} must be a list of {wanted}, got {value!r}')
        if self.choices and value not in self.choices:
            raise ConfigurationError(f'parameter {name} must be one of {", ".join(self.choices)}, got {value!r}')
        numbers = value if isinstance(value, list) else [value]
        for number in numbers:
            if isinstance(number, (int, float)) and not isinstance(number, bool):
                self._check_range(name, number)
        return value

    def _check_range(self, name: str, number: float) -> None:
        above = self.minimum is None or number >= self.minimum
        below = self.maximum is None or number <= self.maximum
        if not (above and below):  # NaN is neither
            low = '-inf' if self.minimum is None else f'{self.minimum:g}'
            high = 'inf' if self.maximum is None else f'{self.maximum:g}'
            raise ConfigurationError(f'parameter {name} must be in [{low}, {high}], got {number!r}')


def _signal(name: str, topic: str, type_name: str, field_path: str, scale: bool, what: str) -> list[ParameterSpec]:
    specs = [
        ParameterSpec(f'{name}.topic', topic, f'Topic that carries {what}; empty: none of its own.'),
        ParameterSpec(f'{name}.type', type_name, f'Message type of {name}.topic.'),
        ParameterSpec(
            f'{name}.field',
            field_path,
            f'Field path of {what} in the message, such as data or wrench.torque.z.',
        ),
    ]
    if scale:
        specs.append(
            ParameterSpec(f'{name}.scale', 1.0, f'Factor from the field to {what} in SI units (a current: give Kt).')
        )
    return specs


OBSERVER_PARAMETERS: tuple[ParameterSpec, ...] = (
    ParameterSpec('motors', ['motor'], 'Names of the motors, as in JointState.name.'),
    ParameterSpec('autostart', True, 'Configure and activate the node by itself when it starts.'),
    ParameterSpec(
        'context_update',
        'recursive',
        'Rule that learns the context nodes: recursive maximum likelihood, or the gradient rule of the thesis.',
        choices=('recursive', 'gradient'),
    ),
    ParameterSpec('predictor', True, 'Train and run the LSTM predictor.'),
    ParameterSpec(
        'variant',
        'physics',
        'What the LSTM is taught on: physics over all the operating range, or a variant of the thesis (5.1).',
        choices=('physics', 'main', 'sees_data', 'supervised_with_parameters', 'supervised'),
    ),
    ParameterSpec('horizon_s', 0.0, 'Horizon of ~/forecast_torque, in s (variant physics); 0: none.', 0.0, 1e6),
    ParameterSpec('seed', 0, 'Seed of everything random.', 0),
    ParameterSpec('freeze', False, 'Stop learning; the service ~/freeze sets it too.', live=True),
    ParameterSpec('gap_s', 0.5, 'Silence of torque, in s, after which the signal history starts anew.', 1e-6, 1e6),
    ParameterSpec('hold_s', 0.25, 'How far torque may run ahead of voltage, in s, before voltage is held.', 0.0, 1e6),
    ParameterSpec('jump_back_s', 1.0, 'Backward jump of a stamp, in s, that means a restarted clock.', 0.0, 1e6),
    *_signal('voltage', 'motor/voltage', 'sensor_msgs/msg/JointState', 'effort', True, 'armature voltage'),
    *_signal('torque', 'motor/torque', 'sensor_msgs/msg/JointState', 'effort', True, 'motor torque'),
    *_signal('speed', '', 'sensor_msgs/msg/JointState', 'velocity', True, 'shaft speed'),
    ParameterSpec('recursive.block', 32, 'Samples between two updates of the context nodes.', 4, 100000),
    ParameterSpec('recursive.replay_capacity', 4096, 'Samples remembered for repeated fits.', 80, 10_000_000),
    ParameterSpec('recursive.prior_relative_std', 2.0, 'Relative std of the initial values.', 1e-6, 100.0),
    ParameterSpec('recursive.drift_relative_std', 0.4, 'Relative std after a detected change.', 1e-6, 100.0),
    ParameterSpec('recursive.drift_threshold', 60.0, 'Chi-square threshold of the change test.', 1.0, 1e9),
    ParameterSpec(
        'recursive.long_hold_s',
        60.0,
        'In a longer hold of the voltage, in s, the level moves only what heats.',
        0.0,
        1e9,
    ),
    ParameterSpec('gradient.batch_size', 25, 'New samples between two updates of the context nodes.', 1, 100000),
    ParameterSpec('gradient.window', 10, 'Samples between the two ends of a difference.', 1, 10000),
    ParameterSpec('gradient.learning_rate', 0.02, 'Adam, on the logarithm of the parameters.', 1e-6, 1.0),
    ParameterSpec('gradient.replay_capacity', 6000, 'Samples remembered for the context nodes.', 100, 10_000_000),
    ParameterSpec('training.hidden', 12, 'Hidden units of the LSTM (thesis: 2).', 1, 1024),
    ParameterSpec('training.context', 64, 'Past samples the LSTM warms up on (thesis: 64).', 2, 100000),
    ParameterSpec('training.period', 100, 'Samples between two training jobs.', 1, 1_000_000),
    ParameterSpec('training.steps', 7, 'Adam steps of a training job.', 1, 100000),
    ParameterSpec('training.minibatch', 12, 'Windows of a training step.', 1, 100000),
    ParameterSpec('training.learning_rate', 0.005, 'Adam, on the weights (thesis: 0.001).', 1e-7, 1.0),
    ParameterSpec('training.core_share', 0.1, 'Share of one core that background training may use.', 1e-4, 1.0),
    ParameterSpec(
        'training.start',
        'shipped',
        'What variant physics begins with: the network that comes with the package, or a fresh one.',
        choices=('shipped', 'fresh'),
    ),
    ParameterSpec('training.residual', True, 'Learn what physics does not explain, if held-out samples gain.'),
    ParameterSpec('training.replay_capacity', 6000, 'Samples remembered for training.', 200, 10_000_000),
    ParameterSpec(
        'verdict.identified_relative_std', 0.02, 'Largest relative std that is called identified.', 1e-9, 1.0
    ),
    ParameterSpec(
        'verdict.excited_relative_std', 0.3, 'Relative std above which a parameter is unexcited.', 1e-9, 10.0
    ),
    ParameterSpec('alarm.false_a_day', 0.1, 'False alarms a day that are accepted of each motor.', 1e-9, 1e4),
    ParameterSpec('alarm.memory', 3000, 'Samples over which the spread of the residual is followed.', 2, 10_000_000),
    ParameterSpec('alarm.learn', 1000, 'Samples of an identified motor before the alarm is armed.', 2, 10_000_000),
    ParameterSpec(
        'checkpoint.path', 'gray_box_observer.safetensors', 'File that save writes and load reads.', live=True
    ),
)
"""Parameters of the node as a whole."""

KNOWN_PARAMETERS = {
    'back_emf_constant': 'back_emf_constant',
    'brush_drop': 'brush_drop',
    'resistance': 'known.resistance',
    'hysteresis': 'known.hysteresis',
}
"""Where the value of a term stands that is not among the context nodes, by the term's name; all but the inductance."""

MOTOR_PARAMETERS: tuple[ParameterSpec, ...] = (
    ParameterSpec('torque_constant', 0.01, 'Torque constant Kt in N m/A; known.', 1e-9, 1e6),
    ParameterSpec(
        'back_emf_constant',
        0.01,
        'Back-EMF constant Kb in V s/rad; known unless among context_nodes.',
        0.0,
        1e6,
    ),
    ParameterSpec('brush_drop', 0.0, 'Brush drop V_b in V; known unless among context_nodes.', 0.0, 1e3),
    ParameterSpec(
        'context_nodes',
        ['inductance', 'resistance', 'hysteresis'],
        'Parameters to identify; inductance first.',
    ),
    ParameterSpec('known.resistance', 0.0, 'Resistance R in ohm where it is not among context_nodes.', 0.0, 1e4),
    ParameterSpec(
        'known.hysteresis', 0.0, 'Hysteresis K_HS in V s/(rad A) where it is not among context_nodes.', 0.0, 1e6
    ),
    ParameterSpec(
        'speed_source',
        'auto',
        'measured: speed is a signal; torque_constant: w = Kt i (thesis); auto: measured where torque brings speed.',
        choices=('auto', 'measured', 'torque_constant'),
    ),
    ParameterSpec(
        'voltage_limits',
        [0.0, 0.0],
        'Lowest and highest voltage in V that the predictor must be ready for; equal: learnt from what is seen.',
        -1e6,
        1e6,
    ),
    ParameterSpec(
        'delay',
        0.0,
        'By how much voltage acts on torque later than it is stamped, in s; or the word estimate.',
        -1.0,
        1.0,
        words=('estimate',),
    ),
    *(
        ParameterSpec(
            f'initial.{term.parameter.name}',
            term.parameter.initial,
            f'Where identification of {term.parameter.name} starts, in {term.parameter.unit}.',
            term.parameter.lower,
            term.parameter.upper,
        )
        for term in TERMS.values()
    ),
)
"""Parameters of one motor, in the group under its name."""


@dataclass(frozen=True)
class MotorConfiguration:
    """What is known of one motor beforehand; values by the names of MOTOR_PARAMETERS."""

    name: str
    values: Mapping[str, Any]

    def white_box(self, speed_measured: bool) -> MotorWhiteBox:
        """Build the white box of this motor."""
        nodes = tuple(self.values['context_nodes'])
        known = {
            name: self.values[parameter]
            for name, parameter in KNOWN_PARAMETERS.items()
            if name not in nodes and self.values[parameter] > 0.0
        }
        return MotorWhiteBox(nodes, self.values['torque_constant'], known, speed_measured)

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


@dataclass(frozen=True)
class Configuration:
    """The whole configuration.

    Attributes:
        values: by the names of OBSERVER_PARAMETERS.
        motors: one entry a motor.
        unknown: names that were given but nobody declared, for the caller to warn of: a file with ``/**`` may hold
            parameters of other nodes.
    """

    values: Mapping[str, Any]
    motors: Mapping[str, MotorConfiguration] = field(default_factory=dict)
    unknown: tuple[str, ...] = ()

    def __getitem__(self, name: str) -> Any:
        return self.values[name]

    def group(self, prefix: str) -> dict[str, Any]:
        """Return the values below a prefix, by the rest of their names."""
        return {name[len(prefix) + 1 :]: v for name, v in self.values.items() if name.startswith(f'{prefix}.')}

    @classmethod
    def from_flat(cls, given: Mapping[str, Any]) -> Configuration:
        """Build the configuration from dotted names; what is not given has its default.

        Raises:
            ConfigurationError: a value out of range, or motors that fit no white box.
        """
        rest = {name: value for name, value in given.items() if name not in FOREIGN_PARAMETERS}
        values = {spec.name: spec.check(rest.pop(spec.name, spec.default)) for spec in OBSERVER_PARAMETERS}
        names = values['motors']
        if (
            not names
            or len(set(names)) != len(names)
            or not all(isinstance(n, str) and NAME.fullmatch(n) for n in names)
        ):
            raise ConfigurationError(
                f'motors must be distinct names that can stand in a topic (letters, digits, _), got {names!r}'
            )
        for small, large in FITS_TWICE:
            if 2 * values[small] > values[large]:
                raise ConfigurationError(
                    f'parameter {large} must be at least twice {small}, got {values[large]} and {values[small]}'
                )
        if values['horizon_s'] > 0.0 and values['variant'] != 'physics':
            raise ConfigurationError(
                f'parameter horizon_s must be 0 with variant {values["variant"]}, got {values["horizon_s"]!r}: '
                'only variant physics looks beyond the next sample'
            )
        for name in SIGNALS:
            _check_signal(name, values)
        motors = {name: _motor(name, rest) for name in names}
        return cls(values, motors, tuple(sorted(rest)))

    @classmethod
    def from_yaml(cls, path: Path) -> Configuration:
        """Read a ROS parameter file (``/**`` or the node's name, then ``ros__parameters``).

        Raises:
            ConfigurationError: no such file, not YAML, or a value that does not fit.
        """
        try:
            document = yaml.safe_load(path.read_text(encoding='utf-8'))
        except OSError as error:
            raise ConfigurationError(f'cannot read the parameter file {path}: {error.strerror}') from error
        except (yaml.YAMLError, UnicodeDecodeError) as error:
            raise ConfigurationError(f'{path} is not YAML: {" ".join(str(error).split())}') from error
        given: dict[str, Any] = {}
        for node, content in document.items() if isinstance(document, dict) else ():
            if str(node).strip('/') in ('**', NODE_NAME) or str(node).endswith(f'/{NODE_NAME}'):
                if not isinstance(content, dict) or not isinstance(content.get('ros__parameters'), dict):
                    raise ConfigurationError(f'{path}: expected ros__parameters below {node!r}')
                given.update(flatten(content['ros__parameters']))
        if not given:
            raise ConfigurationError(
                f'{path} holds no parameters for {NODE_NAME}: expected "/**:" with "ros__parameters:"'
            )
        return cls.from_flat(given)


FITS_TWICE = (
    ('recursive.block', 'recursive.replay_capacity'),
    ('gradient.window', 'gradient.replay_capacity'),
    ('gradient.batch_size', 'gradient.replay_capacity'),
    ('training.context', 'training.replay_capacity'),
)
"""What has to fit twice into what: a memory must hold more than one piece of work on it."""

FOREIGN_PARAMETERS = frozenset({'use_sim_time', 'start_type_description_service'})
"""Parameters that rclpy declares itself."""


def flatten(tree: Mapping[str, Any], prefix: str = '') -> dict[str, Any]:
    """Turn nested groups into dotted names."""
    flat: dict[str, Any] = {}
    for name, value in tree.items():
        if isinstance(value, Mapping):
            flat.update(flatten(value, f'{prefix}{name}.'))
        else:
            flat[f'{prefix}{name}'] = value
    return flat


def _check_signal(name: str, values: Mapping[str, Any]) -> None:
    """Refuse what no message could ever be read by, before any is waited for or read."""
    if not values[f'{name}.topic'] and name != 'speed':
        raise ConfigurationError(f'parameter {name}.topic is empty: voltage and torque each need a topic')
    if not MESSAGE_TYPE.fullmatch(values[f'{name}.type']):
        raise ConfigurationError(
            f'parameter {name}.type must be a message type such as sensor_msgs/msg/JointState, '
            f'got {values[f"{name}.type"]!r}'
        )
    scale = values[f'{name}.scale']
    if not math.isfinite(scale) or scale == 0.0:
        raise ConfigurationError(f'parameter {name}.scale must be a finite number other than 0, got {scale!r}')
    try:
        FieldPath(values[f'{name}.field'])
    except ConfigurationError as error:
        raise ConfigurationError(f'parameter {name}.field: {error}') from error


def _motor(name: str, rest: dict[str, Any]) -> MotorConfiguration:
    """Take one motor's group out of the values that are left."""
    values = {
        spec.name: spec.check(rest.pop(f'{name}.{spec.name}', _default(spec)), f'{name}.') for spec in MOTOR_PARAMETERS
    }
    motor = MotorConfiguration(name, values)
    for node in values['context_nodes']:
        if values.get(f'known.{node}', 0.0) > 0.0:
            raise ConfigurationError(
                f'motor {name}: {node} is among context_nodes and has known.{node}: leave one of them out'
            )
    limits_v = values['voltage_limits']
    if len(limits_v) != 2 or limits_v[0] > limits_v[1]:
        raise ConfigurationError(f'parameter {name}.voltage_limits must be [lowest, highest] in V, got {limits_v}')
    try:
        motor.white_box(speed_measured=values['speed_source'] != 'torque_constant')
    except ConfigurationError as error:
        raise ConfigurationError(f'motor {name}: {error}') from error
    return motor


def _default(spec: ParameterSpec) -> Any:
    return (
        list(spec.default) if isinstance(spec.default, Sequence) and not isinstance(spec.default, str) else spec.default
    )
