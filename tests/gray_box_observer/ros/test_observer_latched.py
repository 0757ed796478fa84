"""Latched values are true now, in every state of the life cycle, for late listeners too."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from lifecycle_msgs.msg import State, Transition
from std_msgs.msg import Bool, Float64, Float64MultiArray
from std_srvs.srv import SetBool, Trigger

from gray_box_observer.ros.topics import LATCHED_QOS

pytestmark = pytest.mark.system

EXCITATION = 'R[5,15]D[0.1,1]'
NUMBERS = (
    'motor/inductance',
    'motor/resistance',
    'motor/hysteresis',
    'motor/covariance',
    'motor/fit',
    'estimates',
)
FLAGS = (
    'motor/identified',
    'motor/alarm',
    'motor/inductance/identified',
    'motor/resistance/identified',
    'motor/hysteresis/identified',
)
SAMPLES = 1000
CONFIGURE, CLEANUP = Transition.TRANSITION_CONFIGURE, Transition.TRANSITION_CLEANUP
ACTIVATE, DEACTIVATE = Transition.TRANSITION_ACTIVATE, Transition.TRANSITION_DEACTIVATE


@pytest.fixture
def identified(rig, record, tmp_path, monkeypatch, request):
    """An observer that has identified its motor, and says so to whoever comes late.

    Indirect parameter: the defect of an observer that has one.
    """
    settings = {
        'checkpoint__path': tmp_path / 'state.safetensors',
        'estimates_period_s': 0.2,
        'predictor': 'false',
    }
    defect = getattr(request, 'param', None)
    if defect is None:
        rig.start(**settings)
    else:
        path = os.environ.get('PYTHONPATH', '')
        monkeypatch.setenv('PYTHONPATH', os.pathsep.join([str(Path(__file__).parent), path]))
        monkeypatch.setenv('FAULT', defect)
        rig.process = rig.peer.start('faulty_observer', **settings)
    rig.send(record(EXCITATION, 12.0), range(SAMPLES))
    rig.wait_for(samples_used=SAMPLES)
    assert rig.latched(Bool, 'motor/identified').data is True
    assert rig.latched(Float64MultiArray, 'estimates').data
    assert rig.latched(Float64, 'motor/fit').data > 0.0
    assert told(rig) == len(NUMBERS)
    return rig


def told(rig) -> int:
    """How many of the latched numbers have a publisher."""
    return sum(rig.peer.node.count_publishers(f'/gray_box_observer/{name}') > 0 for name in NUMBERS)


def says_nothing(rig) -> bool:
    """Whether a late subscriber hears that nothing is identified, and no number."""
    rig.peer.wait(lambda: told(rig) == 0, 'the end of numbers that nobody knows')
    return not any(rig.latched(Bool, name).data for name in FLAGS)


def test_a_node_that_was_cleaned_up_tells_nothing_until_it_knows_something_again(identified):
    rig, learnt = identified, identified.estimates()
    assert rig.change(DEACTIVATE)
    assert rig.latched(Bool, 'motor/identified').data is True, 'it still knows'
    assert rig.estimates() == learnt
    assert rig.change(CLEANUP)
    assert says_nothing(rig)
    assert rig.change(CONFIGURE)
    assert says_nothing(rig)
    assert rig.change(ACTIVATE)
    assert says_nothing(rig), 'nothing was learnt'


def test_a_node_that_was_shut_down_tells_nothing(identified):
    assert identified.change(Transition.TRANSITION_ACTIVE_SHUTDOWN)
    assert says_nothing(identified)


def test_a_reset_leaves_no_number_that_was_learnt_whatever_the_state(identified):
    rig = identified
    assert rig.call(Trigger, 'reset').success
    assert says_nothing(rig)
    assert rig.call(SetBool, 'freeze', data=True).success, 'which tells anew what is known'
    assert says_nothing(rig)
    assert rig.change(DEACTIVATE)
    assert rig.call(Trigger, 'reset').success
    assert says_nothing(rig)


def test_what_is_loaded_while_the_node_rests_is_told_when_it_is_activated(identified):
    rig, learnt = identified, identified.estimates()
    assert rig.call(Trigger, 'save').success
    assert rig.call(Trigger, 'reset').success
    assert rig.change(DEACTIVATE)
    assert rig.call(Trigger, 'load').success
    assert says_nothing(rig)
    assert rig.change(ACTIVATE)
    assert rig.estimates() == learnt
    assert rig.latched(Bool, 'motor/identified').data is True


@pytest.mark.parametrize('identified', ['deactivate'], indirect=True)
def test_a_node_whose_transition_has_failed_tells_nothing(identified):
    rig = identified
    assert not rig.change(DEACTIVATE)
    assert rig.lifecycle_state() == State.PRIMARY_STATE_UNCONFIGURED
    assert says_nothing(rig)
    assert rig.change(CONFIGURE)
    assert rig.change(ACTIVATE)
    assert says_nothing(rig)
    assert 'could not deactivate: Traceback' in rig.end()


def test_no_number_is_there_before_the_data_have_moved_one_and_then_it_is(rig, record):
    heard = {
        name: rig.peer.listen(kind, f'/gray_box_observer/{name}', LATCHED_QOS)
        for name, kind in (('motor/inductance', Float64), ('motor/covariance', Float64MultiArray))
    }
    rig.start()
    rig.send(record(EXCITATION, 12.0), range(2))
    rig.wait_for(samples_used=2)
    for is_frozen in (True, False):  # which tells anew what is known
        assert rig.call(SetBool, 'freeze', data=is_frozen).success
    assert rig.latched(Bool, 'motor/identified').data is False
    assert not any(heard.values())
    rig.send(record(EXCITATION, 12.0), range(2, 300))
    rig.peer.wait(lambda: all(heard.values()), 'the first numbers')


def test_values_given_so_surely_that_they_count_as_known_are_told_from_the_beginning(rig):
    rig.start(
        motor__initial_relative_std__inductance=0.01,
        motor__initial_relative_std__resistance=0.01,
        motor__initial_relative_std__hysteresis=0.01,
    )
    assert rig.estimates() == {'inductance': 1.5, 'resistance': 3.0, 'hysteresis': 1.0}
    assert rig.latched(Bool, 'motor/identified').data is True
