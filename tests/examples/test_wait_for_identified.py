"""The example controller beside a real observer, and beside one that goes away."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
from rcl_interfaces.msg import Log
from std_msgs.msg import Bool, Float64, Float64MultiArray
from std_srvs.srv import Trigger

from gray_box_observer.ros.topics import LATCHED_QOS

EXAMPLE = str(Path(__file__).resolve().parents[2] / 'examples' / 'wait_for_identified.py')
GAINS = '/current_tuner/motor/current_gains'
BANDWIDTH_HZ = 20.0
TRUTH = {'inductance': 0.5, 'resistance': 1.0}


@pytest.fixture
def gains(peer):
    """Gains that the example publishes, in the order in which they come."""
    heard = peer.listen(Float64MultiArray, GAINS, LATCHED_QOS)
    peer.start(EXAMPLE, '--bandwidth-hz', str(BANDWIDTH_HZ))
    peer.wait(lambda: heard, 'the first word of the example')
    assert list(heard[0].data) == []  # nothing is known yet
    return heard


def expected(inductance: float, resistance: float) -> list[float]:
    crossover_rad_s = 2.0 * math.pi * BANDWIDTH_HZ
    return [crossover_rad_s * inductance, crossover_rad_s * resistance]


@pytest.mark.parametrize('frequency_hz', [0.1, 20.0, 500.0])
def test_the_gains_leave_an_integrator_that_closes_at_the_bandwidth(example, frequency_hz: float):
    made = example('wait_for_identified').cancel_pole(2.1, 2.3e-3, BANDWIDTH_HZ)
    s = 2.0j * math.pi * frequency_hz
    loop = (made.proportional + made.integral / s) / (2.3e-3 * s + 2.1)
    assert loop == pytest.approx(2.0 * math.pi * BANDWIDTH_HZ / s)


@pytest.mark.slow
@pytest.mark.system
def test_gains_come_when_the_motor_is_identified_and_go_when_it_is_not(peer, gains):
    peer.start('gray_box_observer.ros.observer.observer_node', predictor='false')
    peer.start(
        'dc_motor_sim.ros.motor_sim',
        sample_rate_hz=500.0,
        excitation='R[5,15]D[0.1,0.5]',
        wait_for_subscribers=1,
    )
    peer.wait(lambda: gains[-1].data, 'gains')
    assert gains[-1].layout.dim[0].label == 'proportional,integral'
    assert list(gains[-1].data) == pytest.approx(expected(**TRUTH), rel=0.05)
    gains.clear()
    peer.call(Trigger, '/gray_box_observer/reset')
    peer.wait(lambda: [message for message in gains if not message.data], 'gains taken back')
    peer.wait(lambda: gains[-1].data, 'gains again')


@pytest.mark.system
def test_a_motor_that_nobody_knows_is_named(peer):
    heard = peer.listen(Log, '/rosout')
    peer.start(EXAMPLE, '--motor', 'left_wheel')
    topic = '/gray_box_observer/left_wheel/resistance/identified'
    words = f'nobody publishes {topic} yet'
    peer.wait(lambda: [log for log in heard if words in log.msg], 'the warning')


@pytest.mark.system
def test_gains_need_both_verdicts_and_go_with_the_observer(peer, gains):
    publishers = {}
    for name, value in TRUTH.items():
        topic = f'/gray_box_observer/motor/{name}'
        publishers[name] = peer.publisher(Float64, topic, LATCHED_QOS, readers=1)
        publishers[name].publish(Float64(data=value))
        verdict = peer.publisher(Bool, f'{topic}/identified', LATCHED_QOS, readers=1)
        publishers[f'{name}/identified'] = verdict
        verdict.publish(Bool(data=True))
    peer.wait(lambda: gains[-1].data, 'gains')
    assert list(gains[-1].data) == pytest.approx(expected(**TRUTH))
    publishers['inductance/identified'].publish(Bool(data=False))
    peer.wait(lambda: not gains[-1].data, 'the gains to be taken back')
    publishers['inductance'].publish(Float64(data=0.7))
    publishers['inductance/identified'].publish(Bool(data=True))
    newest = pytest.approx(expected(0.7, TRUTH['resistance']))
    peer.wait(lambda: list(gains[-1].data) == newest, 'the gains of the newest value')
    for publisher in publishers.values():  # nobody says that the verdict has changed
        peer.node.destroy_publisher(publisher)
    peer.wait(lambda: not gains[-1].data, 'the gains to be taken back')
