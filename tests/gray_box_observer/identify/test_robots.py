"""The parameter files of ``docs/ROBOTS.md``, each on a recording of the messages it is for."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from mcap_ros2._dynamic import serialize_dynamic

from dc_motor_sim.plant import PlantParameters
from dc_motor_sim.simulation import Recording, Simulation
from gray_box_observer.bag.writer import BagWriter
from gray_box_observer.fit_test import FitVerdict
from gray_box_observer.identify.offline_run import Outcome, run
from gray_box_observer.settings.configuration import Configuration
from gray_box_observer.settings.ros_parameter_file import flatten

PAGE = Path(__file__).resolve().parents[3] / 'docs' / 'ROBOTS.md'
RATE_HZ = 200.0
START_NS = 1_000_000_000
KT = 0.035

SEPARATOR = f'\n{"=" * 80}\n'
HEADER = (
    f'{SEPARATOR}MSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n'
    f'{SEPARATOR[1:]}MSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n'
)
LAYOUT = (
    f'{SEPARATOR}MSG: std_msgs/MultiArrayLayout\nMultiArrayDimension[] dim\nuint32 data_offset\n'
    f'{SEPARATOR[1:]}MSG: std_msgs/MultiArrayDimension\nstring label\nuint32 size\nuint32 stride\n'
)
DEFINITIONS = {
    'sensor_msgs/msg/JointState': 'std_msgs/Header header\nstring[] name\nfloat64[] position\n'
    f'float64[] velocity\nfloat64[] effort{HEADER}',
    'sensor_msgs/msg/BatteryState': f'std_msgs/Header header\nfloat32 voltage{HEADER}',
    'std_msgs/msg/Float64MultiArray': f'MultiArrayLayout layout\nfloat64[] data{LAYOUT}',
    'std_msgs/msg/Float32MultiArray': f'MultiArrayLayout layout\nfloat32[] data{LAYOUT}',
    'control_msgs/msg/DynamicJointState': 'std_msgs/Header header\nstring[] joint_names\n'
    f'InterfaceValue[] interface_values{HEADER}{SEPARATOR[1:]}'
    'MSG: control_msgs/InterfaceValue\nstring[] interface_names\nfloat64[] values\n',
    'vesc_msgs/msg/VescStateStamped': f'std_msgs/Header header\nVescState state{HEADER}'
    f'{SEPARATOR[1:]}MSG: vesc_msgs/VescState\nint32 FAULT_CODE_NONE=0\nfloat64 temp_motor\n'
    'float64 current_motor\nfloat64 duty_cycle\nfloat64 speed\nfloat64 voltage_input\n',
    'odrive_can/msg/ODriveStatus': 'float32 bus_voltage\nfloat32 bus_current\n'
    'float32 fet_temperature\nfloat32 motor_temperature\nuint32 active_errors\n'
    'uint32 disarm_reason\n',
    'odrive_can/msg/ControllerStatus': 'float32 pos_estimate\nfloat32 vel_estimate\n'
    'float32 torque_target\nfloat32 torque_estimate\nfloat32 iq_setpoint\n'
    'float32 iq_measured\nuint32 active_errors\nuint8 axis_state\nuint8 procedure_result\n'
    'bool trajectory_done_flag\n',
    'roboclaw_driver/msg/Status': 'std_msgs/Header header\nint32 m1_speed\nint16 m1_duty\n'
    f'int32 m1_current\nint32 main_battery{HEADER}',
}

Row = tuple[str, str, dict[str, Any]]
"""Topic, type and content of one message."""


def parameters(robot: str) -> dict[str, Any]:
    """The parameter file of a robot, as it stands on the page."""
    block = PAGE.read_text(encoding='utf-8').partition(f'<!-- robot: {robot} -->')[2]
    lines = []
    for line in block.strip('\n').splitlines():
        if line and not line.startswith('    '):
            break
        lines.append(line[4:])
    return flatten(yaml.safe_load('\n'.join(lines))['/**']['ros__parameters'])


def header(stamp_ns: int) -> dict[str, Any]:
    seconds, nanoseconds = divmod(stamp_ns, 1_000_000_000)
    return {'stamp': {'sec': seconds, 'nanosec': nanoseconds}, 'frame_id': ''}


class Moment:
    """What is true of the motor at one stamp."""

    def __init__(self, recording: Recording, k: int) -> None:
        self.k = k
        self.stamp_ns = START_NS + int(recording.stamp_ns[k])
        self.voltage_v = float(recording.voltage_v[0, k])
        self.current_a = float(recording.torque_nm[0, k]) / KT
        self.speed_rad_s = float(recording.speed_rad_s[0, k])
        self.angle_rad = float(recording.speed_rad_s[0, : k + 1].sum()) / RATE_HZ
        self.battery_v = 24.0 - 0.05 * int(k / RATE_HZ)

    @property
    def header(self) -> dict[str, Any]:
        """A header with this stamp."""
        return header(self.stamp_ns)


def joint_states(now: Moment) -> list[Row]:
    command = {'layout': {'dim': [], 'data_offset': 0}, 'data': [now.voltage_v]}
    state = {
        'header': now.header,
        'name': ['arm_joint', 'left_wheel_joint', 'right_wheel_joint'],
        'position': [0.0, now.angle_rad, 0.0],
        'velocity': [1.0, now.speed_rad_s, 0.0],
        'effort': [9.0, now.current_a, 0.0],
    }
    return [
        ('/wheel_controller/commands', 'std_msgs/msg/Float64MultiArray', command),
        ('/joint_states', 'sensor_msgs/msg/JointState', state),
    ]


def dynamic_joint_states(now: Moment) -> list[Row]:
    gripper = {'interface_names': ['position'], 'values': [0.5]}
    wheel = {
        'interface_names': ['velocity', 'current', 'voltage'],
        'values': [now.speed_rad_s, now.current_a, now.voltage_v],
    }
    state = {
        'header': now.header,
        'joint_names': ['gripper_joint', 'left_wheel_joint'],
        'interface_values': [gripper, wheel],
    }
    return [('/dynamic_joint_states', 'control_msgs/msg/DynamicJointState', state)]


def joint_state(now: Moment, effort: float, speed: list[float]) -> dict[str, Any]:
    return {
        'header': now.header,
        'name': ['wheel'],
        'position': [],
        'velocity': speed,
        'effort': [effort],
    }


def duty_and_battery(now: Moment) -> list[Row]:
    battery = {'header': now.header, 'voltage': now.battery_v}
    rows: list[Row] = []
    if now.k % RATE_HZ == 0:
        rows.append(('/battery_state', 'sensor_msgs/msg/BatteryState', battery))
    kind = 'sensor_msgs/msg/JointState'
    duty = float(np.float32(now.battery_v))
    rows.append(('/duty', kind, joint_state(now, now.voltage_v / duty, [])))
    rows.append(('/joint_states', kind, joint_state(now, now.current_a, [now.speed_rad_s])))
    return rows


def dead_zone(now: Moment) -> list[Row]:
    kind = 'sensor_msgs/msg/JointState'
    command_v = now.voltage_v + float(np.sign(now.voltage_v)) * 0.8
    return [
        ('/command', kind, joint_state(now, command_v, [])),
        ('/joint_states', kind, joint_state(now, now.current_a, [now.speed_rad_s])),
    ]


def coasting(now: Moment) -> list[Row]:
    kind = 'sensor_msgs/msg/JointState'
    return [
        ('/command', kind, joint_state(now, now.voltage_v, [])),
        ('/joint_states', kind, joint_state(now, now.current_a, [now.speed_rad_s])),
    ]


def vesc(now: Moment) -> list[Row]:
    state = {
        'temp_motor': 40.0,
        'current_motor': now.current_a,
        'duty_cycle': now.voltage_v / now.battery_v,
        'speed': now.speed_rad_s * 60.0 / (2.0 * np.pi) * 7.0,
        'voltage_input': now.battery_v,
    }
    content = {'header': now.header, 'state': state}
    return [('/sensors/core', 'vesc_msgs/msg/VescStateStamped', content)]


def odrive(now: Moment) -> list[Row]:
    status = {
        'bus_voltage': now.battery_v,
        'bus_current': 1.5 * now.voltage_v * now.current_a / now.battery_v,
        'fet_temperature': 35.0,
        'motor_temperature': 40.0,
        'active_errors': 0,
        'disarm_reason': 0,
    }
    controller = {
        'pos_estimate': now.angle_rad / (2.0 * np.pi),
        'vel_estimate': now.speed_rad_s / (2.0 * np.pi),
        'torque_target': 1.5 * KT * now.current_a,
        'torque_estimate': 1.5 * KT * now.current_a,
        'iq_setpoint': now.current_a,
        'iq_measured': now.current_a,
        'active_errors': 0,
        'axis_state': 8,
        'procedure_result': 0,
        'trajectory_done_flag': False,
    }
    return [
        ('/odrive_status', 'odrive_can/msg/ODriveStatus', status),
        ('/controller_status', 'odrive_can/msg/ControllerStatus', controller),
    ]


def roboclaw(now: Moment) -> list[Row]:
    content = {
        'header': now.header,
        'm1_speed': round(now.speed_rad_s / (2.0 * np.pi) * 2048),
        'm1_duty': round(now.voltage_v / 24.0 * 32767),
        'm1_current': round(now.current_a * 1000.0),
        'main_battery': 240,
    }
    return [('/roboclaw/status', 'roboclaw_driver/msg/Status', content)]


def micro_ros(now: Moment) -> list[Row]:
    data = [now.voltage_v * 1e3, now.current_a * 1e3, now.angle_rad]
    content = {'layout': {'dim': [], 'data_offset': 0}, 'data': data}
    return [('/motor_raw', 'std_msgs/msg/Float32MultiArray', content)]


ROBOTS: list[Callable[[Moment], list[Row]]] = [
    joint_states,
    dynamic_joint_states,
    duty_and_battery,
    dead_zone,
    coasting,
    vesc,
    odrive,
    roboclaw,
    micro_ros,
]


@pytest.fixture(scope='module')
def recording() -> Recording:
    plant = PlantParameters(
        inductance=0.05,
        resistance=1.0,
        hysteresis=0.0,
        torque_constant=KT,
        back_emf_constant=KT,
        inertia=1e-4,
        viscous_friction=1e-5,
    )
    simulation = Simulation(
        {'wheel': plant},
        'R[5,15]D[0.05,0.5]',
        seed=3,
        sample_rate_hz=RATE_HZ,
        solver_step_s=0.0025,
        speed_mode='rotor',
    )
    return simulation.record(10.0)


def record(
    folder: Path,
    rows_at: Callable[[Moment], list[Row]],
    recording: Recording,
    late_ns: Mapping[str, int] | None = None,
) -> Path:
    """Write what a robot says; messages of a topic arrive late by what is stated of it."""
    encoders: dict[str, Callable[[Any], bytes]] = {}
    topics: set[str] = set()
    with BagWriter(folder) as bag:
        for k in range(recording.stamp_ns.size):
            now = Moment(recording, k)
            for topic, kind, content in rows_at(now):
                if kind not in encoders:
                    encoders[kind] = serialize_dynamic(kind, DEFINITIONS[kind])[kind]
                if topic not in topics:
                    topics.add(topic)
                    bag.add_topic(topic, kind, DEFINITIONS[kind])
                arrival_ns = now.stamp_ns + (late_ns or {}).get(topic, 0)
                bag.write(topic, encoders[kind](content), arrival_ns, arrival_ns)
    return folder


def observe(bag: Path, robot: str) -> Outcome:
    flat = {**parameters(robot), 'predictor': False}
    return run([bag], Configuration.from_flat(flat), None)


@pytest.mark.parametrize('rows_at', ROBOTS, ids=lambda rows_at: rows_at.__name__)
def test_a_robot_is_identified_by_parameters_alone(
    tmp_path: Path, rows_at: Callable[[Moment], list[Row]], recording: Recording
) -> None:
    outcome = observe(record(tmp_path / 'bag', rows_at, recording), rows_at.__name__)
    assert outcome.warnings == []
    (motor,) = outcome.observer.configuration.motors
    assert outcome.observer.counts(motor).used_count >= 0.99 * recording.stamp_ns.size
    estimate = outcome.observer.estimates()[motor]
    values = dict(
        zip([p.name for p in estimate.parameters], estimate.value[0].tolist(), strict=True)
    )
    assert values['resistance'] == pytest.approx(1.0, rel=0.02)
    assert values['inductance'] == pytest.approx(0.05, rel=0.02)


def test_an_odrive_whose_bus_and_current_come_apart_is_a_misfit(
    tmp_path: Path, recording: Recording
) -> None:
    bag = record(tmp_path / 'bag', odrive, recording, late_ns={'/odrive_status': 300_000})
    estimate = observe(bag, 'odrive').observer.estimates()['wheel']
    assert {str(verdict.value) for verdict in estimate.verdicts[0]} == {'misfit'}


@pytest.mark.parametrize(
    ('known_v', 'effects'), [(0.0, ('dead_zone',)), (1.0, ())], ids=['found', 'stated']
)
def test_a_dead_zone_is_found_or_stated(
    tmp_path: Path, known_v: float, effects: tuple[str, ...]
) -> None:
    plant = PlantParameters(
        inductance=0.01,
        resistance=2.0,
        hysteresis=0.0,
        torque_constant=KT,
        back_emf_constant=0.0,
        dead_zone=1.0,
    )
    recording = Simulation(
        {'wheel': plant}, 'R[-12,12]D[0.05,0.5]', seed=1, sample_rate_hz=1000.0,
        torque_noise_std=1e-3,
    ).record(6.0)  # fmt: skip
    kind = 'sensor_msgs/msg/JointState'

    def said(now: Moment) -> list[Row]:
        return [
            ('/command', kind, joint_state(now, now.voltage_v, [])),
            ('/joint_states', kind, joint_state(now, now.current_a, [])),
        ]

    bag = record(tmp_path / 'bag', said, recording)
    flat = {
        **parameters('dead_zone'),
        'predictor': False,
        'wheel.back_emf_constant': 0.0,
        'wheel.context_nodes': ['inductance', 'resistance'],
        'wheel.known.dead_zone': known_v,
    }
    observer = run([bag], Configuration.from_flat(flat), None).observer
    assert observer.motors['wheel'].fit.verdict is FitVerdict.OK
    assert observer.motors['wheel'].added_effects == effects
    estimate = observer.estimates()['wheel']
    truth = [0.01, 2.0, 1.0][: 2 + len(effects)]
    assert estimate.value[0] == pytest.approx(truth, rel=0.01)
    assert np.all(abs(estimate.value[0] - truth) < 3.0 * estimate.std[0])
    assert {verdict.value for verdict in estimate.verdicts[0]} == {'identified'}


def test_every_file_of_the_page_is_tried() -> None:
    robots = re.findall(r'<!-- robot: (\w+) -->', PAGE.read_text(encoding='utf-8'))
    assert robots == [rows_at.__name__ for rows_at in ROBOTS]
    assert all(Configuration.from_flat(parameters(robot)).unknown == () for robot in robots)
