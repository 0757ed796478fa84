from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
import yaml

from gray_box_observer.context_nodes import GradientSettings, VerdictSettings
from gray_box_observer.errors import ConfigurationError
from gray_box_observer.predictor import TrainingSettings, Variant
from gray_box_observer.samples.pairing import PairingSettings
from gray_box_observer.settings.configuration import RESERVED, Configuration
from gray_box_observer.settings.parameter_names import MOST_COMPARED
from gray_box_observer.settings.parameters import (
    KNOWN_PARAMETERS,
    MOTOR_PARAMETERS,
    OBSERVER_PARAMETERS,
)
from gray_box_observer.settings.ros_parameter_file import flatten
from gray_box_observer.white_box import TERMS

HEAD = '/**:\n  ros__parameters:\n'


def refuse(message: str, **given: Any) -> None:
    with pytest.raises(ConfigurationError, match=message) as caught:
        Configuration.from_flat({name.replace('__', '.'): value for name, value in given.items()})
    assert '\n' not in str(caught.value)


def test_everything_has_a_default() -> None:
    configuration = Configuration.from_flat({})
    assert list(configuration.motors) == ['motor']
    assert configuration.unknown == ()
    motor = configuration.motors['motor']
    assert motor.values['context_nodes'] == ['inductance', 'resistance', 'hysteresis']
    assert motor.initial() == [1.5, 3.0, 1.0]
    assert motor.white_box(speed_measured=False).to_dict() == {
        'context_nodes': ['inductance', 'resistance', 'hysteresis'],
        'torque_constant': 0.01,
        'known': {'back_emf_constant': 0.01},
        'speed_measured': False,
    }


@pytest.mark.parametrize(
    'spec', [*OBSERVER_PARAMETERS, *MOTOR_PARAMETERS], ids=lambda spec: spec.name
)
def test_every_parameter_is_described_and_accepts_its_own_default(spec: Any) -> None:
    assert len(spec.description) > 10
    assert spec.description.endswith('.')
    assert '\n' not in spec.description
    assert spec.check(spec.default) == spec.default
    assert spec.minimum is None or spec.maximum is None or spec.minimum < spec.maximum


def test_no_parameter_is_declared_twice() -> None:
    for specs in (OBSERVER_PARAMETERS, MOTOR_PARAMETERS):
        names = [spec.name for spec in specs]
        assert len(names) == len(set(names))


def test_every_term_has_an_initial_value_inside_its_bounds() -> None:
    specs = {spec.name: spec for spec in MOTOR_PARAMETERS}
    for name, term in TERMS.items():
        spec = specs[f'initial.{name}']
        bounds = (term.parameter.initial, term.parameter.lower, term.parameter.upper)
        if term.has_either_sign:
            bounds = (0.0, -term.parameter.upper, term.parameter.upper)
        assert (spec.default, spec.minimum, spec.maximum) == bounds
        assert term.parameter.unit in spec.description


@pytest.mark.parametrize(
    ('group', 'rules'),
    [
        ('gradient', GradientSettings()),
        ('training', TrainingSettings()),
        ('verdict', VerdictSettings()),
    ],
)
def test_declared_defaults_are_those_of_the_rules(group: str, rules: Any) -> None:
    declared = Configuration.from_flat({}).group(group)
    assert declared
    for name, value in declared.items():
        assert value == getattr(rules, name), name


def test_the_declared_recursive_defaults_are_those_of_the_rules() -> None:
    recursive = pytest.importorskip('gray_box_observer.context_nodes.recursive.estimator')
    declared = Configuration.from_flat({}).group('recursive')
    rules = recursive.RecursiveSettings()
    for name, value in declared.items():
        assert value == getattr(rules, name), name


def test_the_declared_pairing_defaults_are_those_of_the_rules() -> None:
    configuration = Configuration.from_flat({})
    rules = PairingSettings()
    for name in ('gap_s', 'hold_s', 'jump_back_s'):
        assert configuration[name] == getattr(rules, name)


def test_the_declared_variants_are_those_there_are() -> None:
    spec = next(spec for spec in OBSERVER_PARAMETERS if spec.name == 'variant')
    assert spec.choices == tuple(variant.value for variant in Variant)
    assert Variant(spec.default) is TrainingSettings().variant


def test_a_whole_number_will_do_for_a_real_one_but_not_the_other_way_round() -> None:
    configuration = Configuration.from_flat({'gap_s': 2, 'motor.torque_constant': 1})
    assert configuration['gap_s'] == 2.0
    assert isinstance(configuration['gap_s'], float)
    assert isinstance(configuration.motors['motor'].values['torque_constant'], float)
    limits = (
        Configuration.from_flat({'motor.voltage_limits': [-12, 12]})
        .motors['motor']
        .values['voltage_limits']
    )
    assert limits == [-12.0, 12.0]
    assert all(isinstance(limit, float) for limit in limits)
    refuse(r'seed must be of type int, got 1\.0 \(float\)', seed=1.0)


@pytest.mark.parametrize(
    ('name', 'value', 'message'),
    [
        ('seed', True, 'seed must be of type int, got True'),
        ('predictor', 1, 'predictor must be of type bool, got 1'),
        ('gap_s', 'long', "gap_s must be of type float, got 'long'"),
        ('gap_s', None, 'gap_s must be of type float, got None'),
        ('gap_s', 0.0, r'gap_s must be in \[1e-06, 1e\+06\], got 0'),
        ('gap_s', float('nan'), 'gap_s must be in .* got nan'),
        ('gap_s', float('inf'), 'gap_s must be in .* got inf'),
        ('seed', -1, 'seed must be in .* got -1'),
        ('variant', 'best', "variant must be one of physics, main, .* got 'best'"),
        ('context_update', 'magic', 'context_update must be one of .*gradient'),
        ('motors', 'motor', "motors must be of type list, got 'motor'"),
        ('motors', [], 'motors must be distinct names'),
        ('motors', ['a', 'a'], 'motors must be distinct names'),
        ('motors', ['left wheel'], 'motors must be distinct names'),
        ('motors', ['1st'], 'motors must be distinct names'),
        (
            'motors',
            ['left', 'voltage'],
            'motors: voltage is the name of parameters of the observer itself',
        ),
        (
            'motors',
            ['training'],
            'motors: training is the name of parameters of the observer itself',
        ),
        ('motors', ['seed'], 'motors: seed is the name of parameters of the observer itself'),
        ('motors', ['qos_overrides'], 'motors: qos_overrides is the name of parameters'),
        ('motors', [3], r'motors must be a list of str, got \[3\]'),
        ('motors', [['a']], 'motors must be a list of str'),
        ('motor__torque_constant', -1.0, r'motor\.torque_constant must be in'),
        ('motor__context_nodes', ['inductance', 'mass'], "motor motor: no term named 'mass'"),
        ('motor__context_nodes', ['inductance', 5], r'motor\.context_nodes must be a list of str'),
        ('motor__context_nodes', ['resistance'], 'must begin with inductance'),
        ('motor__context_nodes', [['inductance']], r'motor\.context_nodes must be a list of str'),
        ('motor__initial__resistance', 1e9, r'motor\.initial\.resistance must be in'),
        ('motor__speed_source', 'guess', 'speed_source must be one of'),
        (
            'voltage__type',
            'JointState',
            r"voltage\.type must be a message type such as .*, got 'JointState'",
        ),
        ('speed__type', 'sensor_msgs.msg.JointState', r'speed\.type must be a message type'),
        ('torque__field', 'wrench..z', r"torque\.field: 'wrench\.\.z' is no field path"),
        (
            'torque__scale',
            float('nan'),
            r'torque\.scale must be a finite number other than 0, got nan',
        ),
        ('voltage__scale', 0, r'voltage\.scale must be a finite number other than 0'),
        ('voltage__topic', '', r'voltage\.topic is empty'),
        ('motor__known__resistance', -1.0, r'motor\.known\.resistance must be in'),
        (
            'motor__known__hysteresis',
            1.0,
            r'motor motor: hysteresis is among context_nodes and has known\.hysteresis',
        ),
        (
            'motor__voltage_limits',
            [12.0, -12.0],
            r'motor\.voltage_limits must be \[lowest, highest\] in V, got',
        ),
        (
            'motor__voltage_limits',
            [12.0],
            r'motor\.voltage_limits must be \[lowest, highest\] in V, got \[12',
        ),
        ('motor__voltage_limits', [0.0, 'high'], r'motor\.voltage_limits must be a list of float'),
        ('motor__voltage_limits', [True, 1.0], r'motor\.voltage_limits must be a list of float'),
        ('training__core_share', 0.0, r'training\.core_share must be in'),
        ('training__start', 'warm', r'training\.start must be one of shipped, fresh'),
        ('motor__delay', 'guess', r"motor\.delay must be a number or estimate, got 'guess'"),
        ('motor__delay', True, r'motor\.delay must be a number or estimate, got True'),
        ('motor__delay', [0.1], r'motor\.delay must be a number or estimate, got \[0\.1\]'),
        ('motor__delay', 1.5, r'motor\.delay must be in \[-1, 1\], got 1\.5'),
    ],
)
def test_what_cannot_be_used_is_refused_in_one_clear_line(
    name: str, value: Any, message: str
) -> None:
    refuse(message, **{name: value})


def test_every_term_that_is_not_identified_can_be_known() -> None:
    assert set(KNOWN_PARAMETERS) == set(TERMS) - {'inductance', 'inertia'}
    given = {parameter: 0.5 + k for k, parameter in enumerate(KNOWN_PARAMETERS.values())}
    configuration = Configuration.from_flat(
        {
            'motor.speed_source': 'rotor',
            'motor.context_nodes': ['inductance', 'inertia'],
            **{f'motor.{name}': value for name, value in given.items()},
        }
    )
    known = configuration.motors['motor'].white_box(speed_measured=False).known
    assert known == {term: given[parameter] for term, parameter in KNOWN_PARAMETERS.items()}


def test_a_rotor_has_context_nodes_of_its_own() -> None:
    motor = Configuration.from_flat({'motor.speed_source': 'rotor'}).motors['motor']
    nodes = ['inductance', 'resistance', 'inertia', 'viscous_friction', 'coulomb_friction']
    assert motor.values['context_nodes'] == nodes
    assert motor.white_box(speed_measured=True).has_rotor


@pytest.mark.parametrize(
    ('changes', 'message'),
    [
        (
            {'motor__context_nodes': ['inductance', 'resistance']},
            'motor motor: speed_source is rotor, but inertia is not among context_nodes',
        ),
        (
            {'motor__delay': 'estimate', 'motor__known__dead_zone': 0.5},
            'behind a dead zone cannot be estimated; declare it with motor.delay',
        ),
        ({'motor__back_emf_constant': 0.0}, 'motor.back_emf_constant must be positive'),
        ({'context_update': 'gradient'}, 'speed_source rotor needs context_update recursive'),
        (
            {'motor__speed_source': 'auto', 'motor__context_nodes': ['inductance', 'inertia']},
            'inertia is among context_nodes; set motor.speed_source: rotor',
        ),
        (
            {'motor__speed_source': 'auto', 'motor__known__load_torque': 0.1},
            'load_torque belongs to the rotor',
        ),
    ],
)
def test_a_rotor_that_cannot_be_is_refused(changes: dict[str, Any], message: str) -> None:
    refuse(message, **{'motor__speed_source': 'rotor'} | changes)


def test_a_delay_is_a_number_or_the_word_estimate() -> None:
    for given, delay_s, asked in ((0, 0.0, False), (-0.02, -0.02, False), ('estimate', 0.0, True)):
        motor = Configuration.from_flat({'motor.delay': given}).motors['motor']
        assert (motor.delay_s, motor.estimates_delay) == (delay_s, asked)
    assert Configuration.from_flat({}).motors['motor'].delay_s == 0.0


def test_back_emf_cannot_be_identified_where_speed_is_taken_from_torque() -> None:
    refuse(
        'motor motor: back_emf_constant cannot be told from resistance without measured speed',
        motor__context_nodes=['inductance', 'resistance', 'back_emf_constant'],
        motor__speed_source='torque_constant',
    )


def test_names_that_nobody_declared_are_reported_and_not_fatal() -> None:
    configuration = Configuration.from_flat(
        {'gap_z': 1.0, 'rotor.torque_constant': 0.2, 'use_sim_time': True}
    )
    assert configuration.unknown == ('gap_z', 'rotor.torque_constant')


def test_each_motor_has_a_group_of_its_own() -> None:
    configuration = Configuration.from_flat(
        {'motors': ['left', 'right'], 'left.torque_constant': 0.2, 'right.initial.inductance': 0.01}
    )
    assert configuration.motors['left'].values['torque_constant'] == 0.2
    assert configuration.motors['right'].values['torque_constant'] == 0.01
    assert configuration.motors['right'].initial()[0] == 0.01
    assert configuration.unknown == ()


def test_the_lists_of_one_motor_are_not_those_of_another() -> None:
    configuration = Configuration.from_flat({'motors': ['a', 'b']})
    configuration.motors['a'].values['context_nodes'].append('brush_drop')
    assert configuration.motors['b'].values['context_nodes'] == [
        'inductance',
        'resistance',
        'hysteresis',
    ]
    assert Configuration.from_flat({}).motors['motor'].values['context_nodes'][-1] == 'hysteresis'


@pytest.mark.parametrize(
    'node', ['/**', 'gray_box_observer', '/gray_box_observer', '/robot/gray_box_observer']
)
def test_a_parameter_file_is_that_of_the_node(tmp_path: Path, node: str) -> None:
    path = tmp_path / 'p.yaml'
    path.write_text(
        f'{node}:\n  ros__parameters:\n    motors: [m]\n    m:\n      torque_constant: 1\n'
        '      initial: {inductance: 0.3}\nother_node:\n  ros__parameters: {gap_s: 9.0}\n'
    )
    configuration = Configuration.from_yaml(path)
    assert configuration.motors['m'].values['torque_constant'] == 1.0
    assert configuration.motors['m'].initial() == [0.3, 3.0, 1.0]
    assert configuration['gap_s'] == 0.5


@pytest.mark.parametrize(
    ('text', 'message'),
    [
        ('/**: [1, 2', 'cannot be understood'),
        ('\tx: 1', 'cannot be understood'),
        ('', 'holds no parameters for gray_box_observer'),
        ('- 1\n- 2\n', 'holds no parameters for gray_box_observer'),
        ('other:\n  ros__parameters: {gap_s: 1.0}\n', 'holds no parameters for gray_box_observer'),
        ('/**:\n  gap_s: 1.0\n', 'expected ros__parameters below'),
        ('/**: 3\n', 'expected ros__parameters below'),
        ('1: {ros__parameters: {gap_s: 1.0}}\n', 'holds no parameters for gray_box_observer'),
        (f'{HEAD}    gap_s: soon\n', "gap_s must be of type float, got 'soon'"),
        (f'{HEAD}    motors: [true]\n', 'motors must be a list of str'),
        ('!!python/object/apply:os.getcwd []\n', 'cannot be understood'),
    ],
)
def test_a_file_that_is_no_parameter_file_is_refused_in_one_line(
    tmp_path: Path, text: str, message: str
) -> None:
    path = tmp_path / 'p.yaml'
    path.write_text(text)
    with pytest.raises(ConfigurationError, match=message) as caught:
        Configuration.from_yaml(path)
    assert '\n' not in str(caught.value)


def test_a_file_that_cannot_be_read_is_named(tmp_path: Path) -> None:
    for path in (tmp_path / 'none.yaml', tmp_path):
        with pytest.raises(ConfigurationError, match=r'parameter file .*cannot be read: '):
            Configuration.from_yaml(path)
    binary = tmp_path / 'b.yaml'
    binary.write_bytes(b'\xff\xfe\x00\x80')
    with pytest.raises(ConfigurationError, match='byte 0 is no UTF-8'):
        Configuration.from_yaml(binary)


def test_the_example_file_holds_every_parameter_with_its_default_and_its_description() -> None:
    path = (
        Path(__file__).resolve().parents[3]
        / 'src'
        / 'gray_box_observer'
        / 'config'
        / 'observer.yaml'
    )
    specs = {spec.name: spec for spec in OBSERVER_PARAMETERS}
    specs |= {f'motor.{spec.name}': spec for spec in MOTOR_PARAMETERS}
    given = flatten(yaml.safe_load(path.read_text(encoding='utf-8'))['/**']['ros__parameters'])
    assert list(given) == sorted(given, key=list(specs).index)
    assert given == {name: spec.default for name, spec in specs.items()}
    said = re.findall(r'^ +(\w+): .*?  # (.+)$', path.read_text(encoding='utf-8'), re.MULTILINE)
    assert said == [(name.rpartition('.')[2], specs[name].description) for name in given]


def test_each_signal_is_described_in_its_own_unit_and_fields_with_an_index() -> None:
    said = {spec.name: spec.description for spec in OBSERVER_PARAMETERS}
    units = {'voltage': 'V', 'torque': 'N m', 'speed': 'rad/s'}
    for signal, unit in units.items():
        assert f' in {unit}; ' in said[f'{signal}.scale']
        assert ('Kt' in said[f'{signal}.scale']) == (signal == 'torque')
        assert 'data[0]' in said[f'{signal}.field']


def test_groups_become_dotted_names() -> None:
    assert flatten({'a': {'b': {'c': 1}, 'd': [1]}, 'e.f': 2}) == {'a.b.c': 1, 'a.d': [1], 'e.f': 2}


def test_a_horizon_is_refused_where_the_network_goes_from_sample_to_sample_only() -> None:
    assert Configuration.from_flat({'horizon_s': 0.5})['horizon_s'] == 0.5
    with pytest.raises(
        ConfigurationError, match=r'horizon_s must be 0 with variant main, got 0\.5'
    ):
        Configuration.from_flat({'horizon_s': 0.5, 'variant': 'main'})


def test_a_thousand_motors_need_one_line_and_one_group() -> None:
    given = {
        'motors': ['m[1..1000]', 'spare'],
        'defaults.torque_constant': 0.02,
        'm7.torque_constant': 0.03,
    }
    configuration = Configuration.from_flat(given)
    assert list(configuration.motors)[:2] + list(configuration.motors)[-2:] == [
        'm1',
        'm2',
        'm1000',
        'spare',
    ]
    constants = {
        name: motor.values['torque_constant'] for name, motor in configuration.motors.items()
    }
    assert (constants['m1'], constants['m7'], constants['spare']) == (0.02, 0.03, 0.02)
    assert configuration.unknown == ()
    first, second = (configuration.motors[name].values['context_nodes'] for name in ('m1', 'm2'))
    assert first == second
    assert first is not second


@pytest.mark.parametrize(
    'motors', [['m[1..3]', 'm2'], ['defaults'], ['m[3..1]'], ['m[1..2000000]'], ['m[a..b]']]
)
def test_a_range_that_makes_no_names_is_refused(motors: list[str]) -> None:
    with pytest.raises(ConfigurationError, match='motors'):
        Configuration.from_flat({'motors': motors})


@pytest.mark.parametrize('device', ['gpu', 'cuda:', 'cuda:-1', 'cuda:01', 'CPU', ''])
def test_what_names_no_device_is_refused(device: str) -> None:
    refuse(f'parameter device must be cpu, cuda or cuda:N .*, got {device!r}', device=device)


@pytest.mark.parametrize(
    'motors', [['m[1..1000000]'], ['a[1..60000]', 'b[1..60000]'], ['m[0..999999999]'] * 1000]
)
def test_ranges_of_more_motors_than_a_node_bears_are_refused_before_they_are_written_out(
    motors: list[str],
) -> None:
    refuse('motors: .* stands for .* motors, expected 10000 at most', motors=motors)


def test_a_whole_number_beyond_every_float_is_out_of_range() -> None:
    for number in (10**400, -(10**400)):
        refuse('gap_s must be in .*, got -?inf', gap_s=number)


def test_what_is_given_is_said_in_short_however_long_it_is() -> None:
    for name, value in (
        ('motors', ['1'] * 10**5),
        ('gap_s', 'x' * 10**6),
        ('variant', 'y' * 10**6),
    ):
        with pytest.raises(ConfigurationError) as caught:
            Configuration.from_flat({name: value})
        assert len(str(caught.value)) < 400


@pytest.mark.parametrize(
    ('text', 'message'),
    [
        (f'{HEAD}    gap_s: 0.5\n    gap_s: 0.6\n', 'line 4: the key gap_s stands twice'),
        (
            f'{HEAD}    recursive.block: 8\n    recursive: {{block: 16}}\n',
            "parameter 'recursive.block' stands twice",
        ),
        (f'{HEAD}    a: &a [*a]\n', 'line 3: an anchor'),
        (f'{HEAD}    gap_s: 2024-99-99\n', "gap_s must be of type float, got '2024-99-99'"),
        (f'{HEAD}    gap_s: {"9" * 5000}\n', 'line 3: the number 9+... has more than 64 bits'),
        (f'{HEAD}    gap_s: 1e400\n', 'line 3: the number 1e400 is too large'),
        (f'{HEAD}    gap_s: 1_0\n', "gap_s must be of type float, got '1_0'"),
        (f'{HEAD}    gap_s: {"[" * 5000}{"]" * 5000}\n', 'line 3: more than 32 levels'),
    ],
)
def test_a_parameter_file_that_could_mean_something_else_is_refused_by_name(
    tmp_path: Path, text: str, message: str
) -> None:
    path = tmp_path / 'p.yaml'
    path.write_text(text)
    with pytest.raises(ConfigurationError, match=message) as caught:
        Configuration.from_yaml(path)
    assert '\n' not in str(caught.value)


def test_no_parameter_of_the_observer_can_be_one_of_a_motor() -> None:
    groups = {spec.name.partition('.')[0] for spec in OBSERVER_PARAMETERS}
    assert groups <= RESERVED
    for name in sorted(RESERVED):
        with pytest.raises(ConfigurationError, match='give the motor another one'):
            Configuration.from_flat({'motors': ['left', name]})


def test_a_file_of_very_many_strange_names_is_answered_at_once() -> None:
    strange = {f'robot_{k}.strange.name': 1.0 for k in range(50_000)}
    compared: list[str] = []

    class Watched(Configuration):
        """Notes which names are compared."""

        def alike(self, name: str) -> list[str]:
            compared.append(name)
            return super().alike(name)

    Watched.from_flat(strange).require_no_slips()
    assert len(compared) == MOST_COMPARED


def test_a_change_of_what_is_not_the_observers_leaves_the_same_object() -> None:
    before = Configuration.from_flat({'motors': ['m[1..50]'], 'm7.torque_constant': 0.02})
    assert before.with_values({}) is before
    foreign = {'qos_overrides./x.publisher.depth': 5, 'm51.delay': 1.0, 'm7.nothing': 1.0}
    assert before.with_values(foreign) is before
    after = before.with_values({'m7.delay': 0.1, **foreign})
    assert after.motors['m7'].delay_s == 0.1
