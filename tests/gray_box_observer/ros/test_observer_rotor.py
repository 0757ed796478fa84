"""A rotor without speed, live: its context nodes are published and survive a restart."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, Float64, Float64MultiArray
from std_srvs.srv import Trigger

from dc_motor_sim.plant import PlantParameters
from dc_motor_sim.simulation import Simulation
from gray_box_observer.ros.topics import SIGNAL_QOS

pytestmark = pytest.mark.system

PLANT = PlantParameters(
    inductance=4e-3,
    resistance=2.0,
    hysteresis=0.0,
    torque_constant=0.02,
    back_emf_constant=0.02,
    inertia=1e-5,
    viscous_friction=1e-5,
    coulomb_friction=8.4e-3,
)
ROTOR = {
    'motor__speed_source': 'rotor',
    'motor__torque_constant': 0.02,
    'motor__back_emf_constant': 0.02,
    'motor__stamps_exact': 'true',
}
NODES = ('inductance', 'resistance', 'inertia', 'viscous_friction', 'coulomb_friction')


def test_the_nodes_of_a_rotor_are_published_and_survive_a_restart(rig, tmp_path):
    path = tmp_path / 'c.safetensors'
    simulation = Simulation(
        {'motor': PLANT}, 'R[-12,12]D[0.05,0.5]', seed=1, speed_mode='rotor',
        sample_rate_hz=1000.0, torque_noise_std=2e-4,
    )  # fmt: skip
    recording = simulation.record(2.3)
    resume = {'checkpoint__path': path, 'checkpoint__resume': 'true'}
    rig.start(**ROTOR, **resume, predictor='true')
    for first in range(0, 2000, 500):  # training keeps a busy machine: no topic overflows
        rig.send(recording, range(first, first + 500))
        rig.wait_for(samples_used=first + 500)
    rig.peer.wait(lambda: len(rig.predicted) > 100, 'predicted torques')
    assert rig.predicted[-1].name == ['motor']
    stamp = rig.predicted[-1].header.stamp
    k = int(np.flatnonzero(recording.stamp_ns == stamp.sec * 10**9 + stamp.nanosec - 10**9)[0])
    spread = recording.torque_nm[0].std()
    assert rig.predicted[-1].effort[0] == pytest.approx(recording.torque_nm[0, k], abs=0.1 * spread)
    learnt = {name: rig.latched(Float64, f'motor/{name}').data for name in NODES}
    for name in ('inductance', 'resistance', 'inertia'):
        assert learnt[name] == pytest.approx(getattr(PLANT, name), rel=0.02), name
    rig.wait_for(inertia_verdict='identified')
    assert rig.latched(Bool, 'motor/resistance/identified').data is True
    assert rig.peer.end(rig.process)[0] == 0

    rig.start(**ROTOR, **resume)
    rig.signals()
    again = {name: rig.latched(Float64, f'motor/{name}').data for name in NODES}
    assert again == learnt, 'told before any sample has come'
    rig.send(recording, range(2000, 2300))
    rig.wait_for(samples_used=300)
    assert rig.values()['resistance verdict'] == 'identified'


def test_the_topics_follow_the_form_that_is_chosen(rig):
    simulation = Simulation(
        {'motor': PLANT}, 'R[-12,12]D[0.05,0.5]', seed=1, speed_mode='rotor',
        sample_rate_hz=1000.0, torque_noise_std=2e-4,
    )  # fmt: skip
    recording = simulation.record(2.2)
    rig.start(motor__torque_constant=0.02, motor__back_emf_constant=0.02)
    rig.send(recording, range(10))
    rig.wait_for(samples_used=10)
    assert rig.latched(Float64, 'motor/hysteresis').data > 0.0
    rig.send(recording, range(10, 2000))
    rig.wait_for(samples_used=2000)
    rig.wait_for(resistance_verdict='identified')
    assert rig.values()['speed source'].startswith('rotor: a rotor explains the data')
    for name in NODES:
        value = rig.latched(Float64, f'motor/{name}').data
        assert value == pytest.approx(getattr(PLANT, name), rel=0.05), name
        assert rig.latched(Bool, f'motor/{name}/identified').data is True
    assert rig.latched(Bool, 'motor/identified').data is True
    assert len(rig.latched(Float64MultiArray, 'motor/covariance').data) == len(NODES) ** 2
    for name in ('motor/hysteresis', 'motor/hysteresis/identified'):
        topic = f'/gray_box_observer/{name}'
        rig.peer.wait(lambda topic=topic: not rig.peer.node.count_publishers(topic), f'no {topic}')
    speeds = rig.peer.listen(JointState, '/gray_box_observer/speed', SIGNAL_QOS)
    rig.peer.wait(
        lambda: rig.peer.node.count_subscribers('/gray_box_observer/speed'), 'the subscription'
    )
    rig.signals()
    rig.send(recording, range(2000, 2200))
    rig.wait_for(samples_used=2200)
    rig.peer.wait(lambda: len(speeds) > 100, 'speeds')
    assert speeds[-1].name == ['motor']
    stamp_ns = speeds[-1].header.stamp.sec * 10**9 + speeds[-1].header.stamp.nanosec
    k = int(np.flatnonzero(recording.stamp_ns == stamp_ns - 1_000_000_000)[0])
    spread = recording.speed_rad_s[0].std()
    assert speeds[-1].velocity[0] == pytest.approx(recording.speed_rad_s[0, k], abs=0.03 * spread)
    assert 0.0 < rig.latched(Float64, 'motor/speed_std').data < 0.05 * spread
    assert rig.call(Trigger, 'reset').success
    std = '/gray_box_observer/motor/speed_std'
    rig.peer.wait(lambda: not rig.peer.node.count_publishers(std), 'the end of its deviation')
    assert rig.latched(Float64, 'motor/hysteresis').data == 1.0
    gone = '/gray_box_observer/motor/inertia'
    rig.peer.wait(lambda: not rig.peer.node.count_publishers(gone), 'the end of the inertia')


def test_rotors_that_come_together_are_told_together(rig):
    motors = ('left', 'right')
    plants = {'left': PLANT, 'right': replace(PLANT, resistance=3.0)}
    simulation = Simulation(
        plants, 'R[-12,12]D[0.05,0.5]', seed=1, speed_mode='rotor', sample_rate_hz=1000.0,
        torque_noise_std=2e-4,
    )  # fmt: skip
    recording = simulation.record(2.0)
    own = {f'{m}__{name.removeprefix("motor__")}': v for m in motors for name, v in ROTOR.items()}
    speeds = rig.peer.listen(JointState, '/gray_box_observer/speed', SIGNAL_QOS)
    rig.start(motors='[left, right]', group_from=2, group_core_share=2.0, **own)
    rig.send(recording, range(2000))
    for motor, plant in plants.items():
        rig.wait_for(motor, samples_used=2000)
        rig.wait_for(motor, resistance_verdict='identified')
        resistance = rig.latched(Float64, f'{motor}/resistance').data
        assert resistance == pytest.approx(plant.resistance, rel=0.02)
        assert 0.0 < rig.latched(Float64, f'{motor}/speed_std').data < 20.0
    rig.peer.wait(lambda: len(speeds) > 300, 'speeds')
    assert speeds[-1].name == [*motors]
    stamp = speeds[-1].header.stamp
    k = int(np.flatnonzero(recording.stamp_ns == stamp.sec * 10**9 + stamp.nanosec - 10**9)[0])
    for motor in range(2):
        truth = recording.speed_rad_s[motor, k]
        assert speeds[-1].velocity[motor] == pytest.approx(truth, abs=20.0)
    assert rig.peer.end(rig.process)[0] == 0
