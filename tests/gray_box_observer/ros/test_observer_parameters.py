"""Parameters of the observer as a process: described, refused as a set, changed while it runs."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import pytest
import yaml
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import (
    DescribeParameters,
    GetParameters,
    ListParameters,
    SetParameters,
    SetParametersAtomically,
)
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool
from tests.ended_starts import parameter_words

from gray_box_observer.ros.topics import SIGNAL_QOS
from gray_box_observer.settings.parameters import MOTOR_PARAMETERS, OBSERVER_PARAMETERS
from gray_box_observer.settings.ros_parameter_file import NODE_NAME, flatten

pytestmark = pytest.mark.system

MODULE = 'gray_box_observer.ros.observer.observer_node'

EXCITATION = 'R[5,15]D[0.1,1]'
YAML = (
    Path(__file__).resolve().parents[3] / 'src' / 'gray_box_observer' / 'config' / 'observer.yaml'
)
SPECS = {spec.name: spec for spec in OBSERVER_PARAMETERS} | {
    f'motor.{spec.name}': spec for spec in MOTOR_PARAMETERS
}


def message(name: str, value: Any) -> Parameter:
    kinds = {
        bool: ('bool_value', ParameterType.PARAMETER_BOOL),
        int: ('integer_value', ParameterType.PARAMETER_INTEGER),
        float: ('double_value', ParameterType.PARAMETER_DOUBLE),
        str: ('string_value', ParameterType.PARAMETER_STRING),
    }
    field, kind = kinds[type(value)]
    return Parameter(name=name, value=ParameterValue(type=kind, **{field: value}))


def plain(value: ParameterValue) -> Any:
    fields = (
        'bool',
        'integer',
        'double',
        'string',
        'byte_array',
        'bool_array',
        'integer_array',
        'double_array',
    )
    found = getattr(value, f'{(*fields, "string_array")[value.type - 1]}_value')
    return list(found) if value.type > ParameterType.PARAMETER_STRING else found


def set_one(rig, name: str, value: Any) -> tuple[bool, str]:
    result = rig.call(SetParameters, 'set_parameters', parameters=[message(name, value)]).results[0]
    return result.successful, result.reason


def set_all(rig, **values: Any) -> tuple[bool, str]:
    parameters = [message(name.replace('__', '.'), value) for name, value in values.items()]
    result = rig.call(
        SetParametersAtomically, 'set_parameters_atomically', parameters=parameters
    ).result
    return result.successful, result.reason


def test_descriptors_values_file_and_declarations_agree(rig):
    rig.start('--ros-args', '--params-file', str(YAML))
    listed = rig.call(ListParameters, 'list_parameters').result.names
    foreign = {'use_sim_time', 'start_type_description_service'}
    own = [name for name in listed if name not in foreign and not name.startswith('qos_overrides.')]
    assert sorted(own) == sorted(SPECS)
    descriptors = rig.call(DescribeParameters, 'describe_parameters', names=own).descriptors
    for described in descriptors:
        spec = SPECS[described.name]
        assert (described.description, described.read_only) == (spec.description, not spec.live), (
            described.name
        )
        ranges = [*described.floating_point_range, *described.integer_range]
        if ranges:
            assert ranges[0].from_value == spec.minimum
            assert spec.maximum is None or ranges[0].to_value == spec.maximum
        else:
            assert spec.minimum is None or spec.words or isinstance(spec.default, list), (
                described.name
            )
    given = flatten(yaml.safe_load(YAML.read_text(encoding='utf-8'))['/**']['ros__parameters'])
    values = rig.call(GetParameters, 'get_parameters', names=own).values
    assert dict(zip(own, map(plain, values), strict=True)) == {
        **given,
        'predictor': False,
    }  # as the rig starts it


def test_what_may_change_while_it_runs_takes_effect_and_nothing_learnt_is_lost(rig, record):
    recording = record(EXCITATION, 12.0, torque_noise_relative=0.01)
    rig.start(predictor='true', training__period=100000)
    rig.send(recording, range(600))
    rig.wait_for(samples_used=600)
    before = rig.estimates()
    heard = rig.peer.listen(Bool, '/gray_box_observer/motor/identified', SIGNAL_QOS)
    assert set_one(rig, 'verdict.identified_relative_std', 1e-8) == (True, '')
    rig.peer.wait(lambda: heard, 'the verdict under the new rule')
    assert heard[-1].data is False
    rig.wait_for(resistance_verdict='converging')
    assert rig.estimates() == before
    assert set_one(rig, 'verdict.identified_relative_std', 0.02)[0]
    rig.wait_for(resistance_verdict='identified')
    assert rig.values()['residual alarm'] == 'learning the residual'
    assert set_one(rig, 'alarm.learn', 100) == (True, '')
    rig.wait_for(residual_alarm='armed')
    forecasts = rig.peer.listen(JointState, '/gray_box_observer/forecast_torque', SIGNAL_QOS)
    assert set_one(rig, 'horizon_s', 0.5) == (True, '')
    rig.send(recording, range(600, 700))
    rig.wait_for(samples_used=700)
    rig.peer.wait(lambda: forecasts, 'forecasts, though none were asked for at the start')
    for name, value in (('training.core_share', 0.5), ('gap_s', 0.2), ('checkpoint.period_s', 1.0)):
        assert set_one(rig, name, value) == (True, '')
    rig.send(
        recording, [*range(700, 800), *range(830, 1000)]
    )  # the hole is longer than the new gap_s
    rig.wait_for(samples_used=970, pauses=1)


UNUSABLE = [
    ('seed', 3, 'read-only'),
    ('motor.torque_constant', 0.02, 'read-only'),
    (
        'verdict.identified_relative_std',
        0.5,
        'must not be above verdict.excited_relative_std, got 0.5 and 0.3',
    ),
    ('verdict.identified_relative_std', 2.0, 'range'),
    ('alarm.learn', 0, 'range'),
    ('horizon_s', float('nan'), 'horizon_s'),
    ('gap_s', 'long', 'type'),
]


def test_what_cannot_be_used_is_refused_with_the_reason(rig):
    rig.start()
    for name, value, reason in UNUSABLE:
        before = rig.call(GetParameters, 'get_parameters', names=[name]).values
        successful, said = set_one(rig, name, value)
        assert not successful, name
        assert reason in said
        assert '\n' not in said
        assert rig.call(GetParameters, 'get_parameters', names=[name]).values == before


def test_what_is_set_together_is_judged_together_and_taken_whole_or_not_at_all(rig):
    rig.start()
    names = ['verdict.identified_relative_std', 'verdict.excited_relative_std', 'gap_s']

    def values() -> list[float]:
        return [
            v.double_value for v in rig.call(GetParameters, 'get_parameters', names=names).values
        ]

    successful, reason = set_all(
        rig, gap_s=2.0, verdict__identified_relative_std=0.5, verdict__excited_relative_std=0.4
    )
    assert not successful
    assert 'must not be above' in reason
    assert values() == [0.02, 0.3, 0.5]
    together = {
        'gap_s': 2.0,
        'verdict__identified_relative_std': 0.5,
        'verdict__excited_relative_std': 0.8,
    }
    assert set_all(rig, **together) == (True, '')
    assert values() == [0.5, 0.8, 2.0]


def test_a_horizon_that_the_variant_does_not_have_is_refused_while_it_runs_too(rig):
    rig.start(variant='main')
    successful, reason = set_one(rig, 'horizon_s', 1.0)
    assert not successful
    assert 'horizon_s must be 0 with variant main' in reason


HOSTILE = [
    Parameter(name='gap_s'),  # of no type: asks for it to be deleted
    Parameter(name='checkpoint.path'),
    Parameter(name='freeze'),
    Parameter(
        name='motor', value=ParameterValue(type=ParameterType.PARAMETER_BOOL, bool_value=True)
    ),
    Parameter(
        name='größe.🤖', value=ParameterValue(type=ParameterType.PARAMETER_BOOL, bool_value=True)
    ),
    Parameter(
        name='gap_s',
        value=ParameterValue(type=ParameterType.PARAMETER_DOUBLE_ARRAY, double_array_value=[1.0]),
    ),
    Parameter(
        name='gap_s', value=ParameterValue(type=ParameterType.PARAMETER_DOUBLE, double_value=-1e300)
    ),
    Parameter(
        name='alarm.learn',
        value=ParameterValue(type=ParameterType.PARAMETER_INTEGER, integer_value=-(2**63)),
    ),
    *(
        Parameter(
            name='checkpoint.path',
            value=ParameterValue(type=ParameterType.PARAMETER_STRING, string_value=text),
        )
        for text in ('a' * 5000, 'a/' * 5000 + 'b', '~root/x/..', '/', '.', ' /../x')
    ),
]


def test_nothing_that_is_set_from_outside_ends_the_node(rig, record):
    rig.start()
    before = rig.call(GetParameters, 'get_parameters', names=sorted(SPECS)).values
    for parameter in HOSTILE:
        for kind, service in (
            (SetParameters, 'set_parameters'),
            (SetParametersAtomically, 'set_parameters_atomically'),
        ):
            answer = rig.call(kind, service, parameters=[parameter])
            results = answer.results if kind is SetParameters else [answer.result]
            assert [result.successful for result in results] == [False], parameter
            assert results[0].reason, parameter
    assert rig.call(GetParameters, 'get_parameters', names=sorted(SPECS)).values == before
    rig.send(record(EXCITATION, 8.0), range(100))
    rig.wait_for(samples_used=100)


@pytest.mark.parametrize(
    ('given', 'meant'),
    [
        ('gap', 'gap (did you mean gap_s?)'),
        ('motor.torqe_constant', 'motor.torqe_constant (did you mean motor.torque_constant?)'),
        (
            'motor.initial.resistence',
            'motor.initial.resistence (did you mean motor.initial.resistance?)',
        ),
        ('motr.delay', 'motr.delay (did you mean motor.delay?)'),
        ('frobnicate', 'not a parameter of this node: frobnicate; --help lists them'),
    ],
)
def test_a_parameter_on_the_command_line_that_nobody_declared_is_refused_with_the_nearest(
    end_here, given, meant
):
    code, _, said = end_here(MODULE, *parameter_words(**{given: 1.0}, predictor='false'))
    (line,) = [line for line in said.splitlines() if 'error' in line]
    assert code == 2
    assert line.startswith('observer: error: not a parameter of this node: ')
    assert meant in line


def test_a_file_may_hold_parameters_of_other_nodes_and_motors_but_no_slip(rig, end_here, tmp_path):
    path = tmp_path / 'shared.yaml'
    own = '/**:\n  ros__parameters:\n    motors: [m_1]\n    m_1: {torque_constant: 0.02}\n'
    path.write_text(f'{own}    m_2: {{torque_constant: 0.03}}\n    robot_radius: 1.0\n')
    rig.start('--ros-args', '--params-file', str(path))
    rig.peer.wait(lambda: rig.status('m_1'), 'the diagnostics of m_1')
    code, _, said = rig.peer.end(rig.process)
    assert code == 0
    assert 'not of this node, ignored: m_2.torque_constant; --help' in said
    assert 'robot_radius' not in said  # another node's, by the wildcard
    many = "motors: ['m[1..2]']\n    'm[1..2]': {torque_constant: 0.02}\n    speed_source: rotor\n"
    path.write_text(f'/**:\n  ros__parameters:\n    {many}')
    rig.start('--ros-args', '--params-file', str(path))
    rig.peer.wait(lambda: rig.status('m2'), 'the diagnostics of m2')
    code, _, said = rig.peer.end(rig.process)
    assert code == 0
    assert 'm[1..2].torque_constant (did you mean defaults.torque_constant?)' in said
    assert 'speed_source (did you mean defaults.speed_source?); --help' in said
    path.write_text(f'{own}    checkpoint: {{resum: true}}\n')
    code, _, said = end_here(
        MODULE, '--ros-args', '--params-file', str(path), '-p', 'predictor:=false'
    )
    assert code == 2
    assert 'checkpoint.resum (did you mean checkpoint.resume?)' in said


def test_a_section_that_names_the_node_holds_nothing_but_its_parameters(rig, tmp_path):
    path = tmp_path / 'own.yaml'
    section = 'ros__parameters:\n    motors: [m_1]\n    robot_radius: 1.0\n'
    path.write_text(f'gray_box_observer:\n  {section}')
    rig.start('--ros-args', '--params-file', str(path))
    rig.peer.wait(lambda: rig.status('m_1'), 'the diagnostics of m_1')
    code, _, said = rig.peer.end(rig.process)
    assert code == 0
    assert 'not of this node, ignored: robot_radius; --help' in said


def test_help_lists_every_parameter(end_here):
    code, out, _ = end_here(MODULE, '--help')
    assert code == 0
    assert all(f'\n  {spec.name} ' in out for spec in (*OBSERVER_PARAMETERS, *MOTOR_PARAMETERS))


def test_a_node_of_very_many_motors_ends_soon_while_it_is_still_starting(peer):
    process = peer.start(MODULE, motors='["m[1..10000]"]')
    peer.wait(lambda: NODE_NAME in peer.node.get_node_names(), 'the node')
    began_s = time.monotonic()
    code, _, said = peer.end(process)
    assert code == 0
    assert time.monotonic() - began_s < 10.0
    assert 'active' not in said and 'rror' not in said
