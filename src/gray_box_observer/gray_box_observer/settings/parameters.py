"""Every parameter of the observer, declared once for node, ``identify``, YAML, docs and tests.

Names are those of ROS parameters; each motor has a group of its own.
"""

from __future__ import annotations

from collections.abc import Iterator

from gray_box_observer.settings.parameter_spec import ParameterSpec
from gray_box_observer.settings.signal_parameters import SIGNALS, signal_parameters
from gray_box_observer.white_box import TERMS

__all__ = [
    'KNOWN_PARAMETERS',
    'MOTOR_PARAMETERS',
    'OBSERVER_PARAMETERS',
    'PHYSICS',
    'ROTOR_NODES',
    'SIGNALS',
    'ParameterSpec',
]

PHYSICS = 'physics'
"""The ``variant`` that is no variant of the thesis."""

OBSERVER_PARAMETERS: tuple[ParameterSpec, ...] = (
    ParameterSpec(
        'motors',
        ['motor'],
        "Names of the motors, as in JointState.name; 'm[1..9]', in quotes, stands for m1 to m9. At "
        'most 10,000.',
    ),
    ParameterSpec(
        'group_from',
        65,
        'From so many motors in the same messages on they are computed together, for far less '
        'work: no rotor and no effect is found by data, a measured speed is taken for exact, they '
        'share one network, and no residual is learnt.',
        2,
        1_000_000,
    ),
    ParameterSpec(
        'group_core_share',
        0.2,
        'Share of a core that fits and tests of motors with a rotor that are computed together '
        '(from group_from on, predictor: false) may take; more while they are new. What is left '
        'undone comes later.',
        0.01,
        64.0,
    ),
    ParameterSpec(
        'motor_topics',
        True,
        'Publish topics of every motor; false: ~/estimates and ~/predicted_torque only.',
    ),
    ParameterSpec(
        'estimates_period_s',
        1.0,
        'Time between two messages on ~/estimates, in s; 0: none.',
        0.0,
        1e6,
    ),
    ParameterSpec('autostart', True, 'Configure and activate the node by itself when it starts.'),
    ParameterSpec(
        'context_update',
        'recursive',
        'Rule that learns the context nodes: recursive maximum likelihood, or the gradient rule '
        'of the thesis.',
        choices=('recursive', 'gradient'),
    ),
    ParameterSpec(
        'predictor',
        True,
        'Train and run the LSTM predictor. Of motors with a rotor each then stays by itself, '
        'however many they are.',
    ),
    ParameterSpec(
        'variant',
        PHYSICS,
        'What the LSTM is taught on: physics over all the operating range, or a variant of the '
        'thesis (5.1).',
        choices=(PHYSICS, 'main', 'sees_data', 'supervised_with_parameters', 'supervised'),
    ),
    ParameterSpec(
        'horizon_s',
        0.0,
        'Horizon of ~/forecast_torque, in s (variant physics); 0: none.',
        0.0,
        1e6,
        live=True,
    ),
    ParameterSpec(
        'device',
        'cpu',
        'Where groups of 8192 motors or more are predicted, and taught: cpu, or by torch on cuda '
        'or cuda:N (experimental: never run on a GPU).',
    ),
    ParameterSpec('seed', 0, 'Seed of everything random.', 0, 2**62),
    ParameterSpec('freeze', False, 'Stop learning; the service ~/freeze sets it too.', live=True),
    ParameterSpec(
        'gap_s',
        0.5,
        'Silence of torque, in s, after which the signal history starts anew.',
        1e-6,
        1e6,
        live=True,
    ),
    ParameterSpec(
        'hold_s',
        0.25,
        'How far torque may run ahead of voltage, in s, before voltage is held; up to 5 s or '
        '1024 torques where it has always come, or never yet.',
        0.0,
        1e6,
        live=True,
    ),
    ParameterSpec(
        'jump_back_s',
        1.0,
        'Backward jump of a stamp, in s, that means a restarted clock.',
        0.0,
        1e6,
        live=True,
    ),
    ParameterSpec(
        'max_message_mb',
        4.0,
        'Larger messages are refused before they are read, in MB; of one topic 16 times as much '
        'may wait.',
        0.001,
        1e6,
    ),
    *signal_parameters('voltage', 'motor/voltage', 'effort', 'armature voltage', 'V; of mV: 0.001'),
    ParameterSpec(
        'voltage.gain_relative_std',
        0.0,
        'How well the scale of the voltage is known: standard deviation relative to it; widens '
        'covariance and verdicts.',
        0.0,
        1.0,
    ),
    *signal_parameters(
        'torque', 'motor/torque', 'effort', 'motor torque', 'N m; of a current in A: Kt'
    ),
    ParameterSpec(
        'torque.quantity',
        'torque',
        'What torque.field and torque.expression give: a torque in N m, or a current in A, which '
        'torque_constant makes a torque.',
        choices=('torque', 'current'),
    ),
    *signal_parameters(
        'speed', '', 'velocity', 'shaft speed', 'rad/s; of revolutions a minute: 0.10472'
    ),
    ParameterSpec(
        'recursive.block', 32, 'Samples between two updates of the context nodes.', 4, 100000
    ),
    ParameterSpec(
        'recursive.replay_capacity', 4096, 'Samples remembered for repeated fits.', 80, 10_000_000
    ),
    ParameterSpec(
        'recursive.prior_relative_std',
        2.0,
        "Std of initial values' logarithms where no std is given.",
        1e-6,
        100.0,
    ),
    ParameterSpec(
        'recursive.drift_relative_std', 0.4, 'Relative std after a detected change.', 1e-6, 100.0
    ),
    ParameterSpec(
        'recursive.drift_threshold', 60.0, 'Chi-square threshold of the change test.', 1.0, 1e9
    ),
    ParameterSpec(
        'recursive.long_hold_s',
        60.0,
        'In a longer hold of the voltage, in s, the level moves only what heats.',
        0.0,
        1e9,
    ),
    ParameterSpec(
        'gradient.batch_size',
        25,
        'New samples between two updates of the context nodes.',
        1,
        100000,
    ),
    ParameterSpec('gradient.window', 10, 'Samples between the two ends of a difference.', 1, 10000),
    ParameterSpec(
        'gradient.learning_rate', 0.02, 'Adam, on the logarithm of the parameters.', 1e-6, 1.0
    ),
    ParameterSpec(
        'gradient.replay_capacity',
        6000,
        'Samples remembered for the context nodes.',
        100,
        10_000_000,
    ),
    ParameterSpec('training.hidden', 12, 'Hidden units of the LSTM (thesis: 2).', 1, 1024),
    ParameterSpec(
        'training.context', 64, 'Past samples the LSTM warms up on (thesis: 64).', 2, 100000
    ),
    ParameterSpec('training.period', 100, 'Samples between two training jobs.', 1, 1_000_000),
    ParameterSpec('training.steps', 7, 'Adam steps of a training job.', 1, 100000),
    ParameterSpec('training.minibatch', 12, 'Windows of a training step.', 1, 100000),
    ParameterSpec(
        'training.learning_rate', 0.005, 'Adam, on the weights (thesis: 0.001).', 1e-7, 1.0
    ),
    ParameterSpec(
        'training.core_share',
        0.1,
        'Share of one core that background training of a motor may use; that of all takes one core '
        'at most.',
        1e-4,
        1.0,
        live=True,
    ),
    ParameterSpec(
        'training.start',
        'shipped',
        'What variant physics begins with: the network that comes with the package, or a fresh '
        'one.',
        choices=('shipped', 'fresh'),
    ),
    ParameterSpec(
        'training.residual', True, 'Learn what physics does not explain, if held-out samples gain.'
    ),
    ParameterSpec(
        'training.replay_capacity', 6000, 'Newest samples remembered for training.', 200, 10_000_000
    ),
    ParameterSpec(
        'training.segments',
        12,
        'Runs of 512 samples kept of regimes that were left; 0: none.',
        0,
        10_000,
    ),
    ParameterSpec(
        'verdict.identified_relative_std',
        0.02,
        'Largest relative std that is called identified.',
        1e-9,
        1.0,
        live=True,
    ),
    ParameterSpec(
        'verdict.excited_relative_std',
        0.3,
        'Relative std above which a parameter is unexcited.',
        1e-9,
        10.0,
        live=True,
    ),
    ParameterSpec(
        'alarm.false_a_day',
        0.1,
        'False alarms a day that are accepted of each motor.',
        1e-9,
        1e4,
        live=True,
    ),
    ParameterSpec(
        'alarm.memory',
        3000,
        'Samples over which the spread of the residual is followed.',
        2,
        10_000_000,
        live=True,
    ),
    ParameterSpec(
        'alarm.learn',
        1000,
        'Samples of an identified motor before the alarm is armed.',
        2,
        10_000_000,
        live=True,
    ),
    ParameterSpec(
        'checkpoint.folder',
        '',
        'Folder that checkpoints stay in; empty: that of an absolute checkpoint.path, else ~/.ros '
        'and the node name.',
    ),
    ParameterSpec(
        'checkpoint.path',
        'gray_box_observer.safetensors',
        'File in checkpoint.folder that save writes and load reads; ends in .safetensors.',
        live=True,
    ),
    ParameterSpec(
        'checkpoint.resume',
        False,
        'Continue from the checkpoint at the start, and keep it up to date from then on.',
    ),
    ParameterSpec(
        'checkpoint.period_s',
        30.0,
        'Time between two checkpoints, in s, where checkpoint.resume is true; 0: only when the '
        'node stops.',
        0.0,
        1e6,
        live=True,
    ),
    ParameterSpec(
        'dashboard.port',
        0,
        'Port of a page that shows the motors live in a browser; 0: none.',
        0,
        65_535,
    ),
    ParameterSpec(
        'dashboard.address',
        '127.0.0.1',
        'Address that this page is served on: this host only; whoever reaches another one may '
        'look.',
    ),
)
"""Parameters of the node as a whole."""

_EFFECTS = sorted(
    (term for term in TERMS.values() if term.formula), key=lambda term: not term.known_as
)
"""What has a place of its own among the parameters of a motor first."""

KNOWN_PARAMETERS = {
    term.parameter.name: term.known_as or f'known.{term.parameter.name}' for term in _EFFECTS
}
"""Where the value of a term stands that is not among the context nodes, by the term's name; all but
the inductance."""


def _known_values(*, own: bool) -> Iterator[ParameterSpec]:
    """Yield the parameters known unless identified: those with a place of their own, or others."""
    for term in _EFFECTS:
        parameter = term.parameter
        if bool(term.known_as) is own:
            description = (
                f'{parameter.description.partition(",")[0]} in {parameter.unit}; known unless '
                'among context_nodes.'
            )
            name = KNOWN_PARAMETERS[parameter.name]
            upper = term.known_upper or parameter.upper
            lower = -upper if term.has_either_sign else 0.0
            yield ParameterSpec(name, term.known_value, description, lower, upper)


ROTOR_NODES = (
    'inductance',
    'resistance',
    'inertia',
    'viscous_friction',
    'coulomb_friction',
)
"""What is identified of a motor with a rotor unless context_nodes is stated."""

MOTOR_PARAMETERS: tuple[ParameterSpec, ...] = (
    ParameterSpec('torque_constant', 0.01, 'Torque constant Kt in N m/A; known.', 1e-9, 1e6),
    ParameterSpec(
        'torque_constant_relative_std',
        0.0,
        'How well torque_constant is known: standard deviation relative to it; widens covariance '
        'and verdicts.',
        0.0,
        1.0,
    ),
    *_known_values(own=True),
    ParameterSpec(
        'context_nodes',
        ['inductance', 'resistance', 'hysteresis'],
        'Parameters to identify; inductance first. With speed_source rotor hysteresis gives way to '
        'inertia, viscous_friction and coulomb_friction unless it is stated. With speed_source '
        'measured these three may be added; beside them, with either, load_torque and '
        'quadratic_friction.',
    ),
    *_known_values(own=False),
    ParameterSpec(
        'speed_source',
        'auto',
        'measured: speed is a signal; torque_constant: w = Kt i (thesis); rotor: a hidden state '
        '(recursive rule); auto: measured where torque brings speed, '
        'else torque_constant until the data tell a rotor.',
        choices=('auto', 'measured', 'torque_constant', 'rotor'),
    ),
    ParameterSpec(
        'effects',
        'auto',
        'auto adds to context_nodes what the data show of driver and sensor (brush_drop, '
        'voltage_offset, dead_zone), of the iron (hysteresis) and on the shaft of a rotor '
        '(load_torque, quadratic_friction of a fan); a lag of the current sensor (current_lag), a '
        'driver that coasts (coasting) and a load that varies (varying_load) are added to the '
        'physics. none never adds anything.',
        choices=('auto', 'none'),
    ),
    ParameterSpec(
        'coasting',
        False,
        'A voltage of 0 (up to dead_zone) opens the winding, and the motor coasts; else the driver '
        'shorts it, and brakes. While it is open nothing is learnt.',
    ),
    ParameterSpec(
        'joint',
        '',
        'Name of the motor in messages, such as that of its joint; empty: its own name.',
    ),
    ParameterSpec(
        'voltage_limits',
        [0.0, 0.0],
        'Lowest and highest voltage in V that the predictor must be ready for; equal: learnt from '
        'what is seen.',
        -1e6,
        1e6,
    ),
    ParameterSpec(
        'stamps_exact',
        False,
        'Voltage acts at the very instant of its stamp, and the current is that of this instant, '
        'no moving average. Else the deviation of L contains 5 % of a sample interval in the long '
        'run, and L is not believed where L/R is below an interval.',
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
            0.0 if term.has_either_sign else term.parameter.initial,
            f'Where identification of {term.parameter.name} starts, in {term.parameter.unit}.',
            -term.parameter.upper if term.has_either_sign else term.parameter.lower,
            term.parameter.upper,
        )
        for term in TERMS.values()
    ),
    *(
        ParameterSpec(
            f'initial_relative_std.{term.parameter.name}',
            0.0,
            f'Relative std of initial.{term.parameter.name} (a data sheet); 0: '
            'recursive.prior_relative_std.',
            0.0,
            100.0,
        )
        for term in TERMS.values()
    ),
)
"""Parameters of one motor, in the group under its name."""
