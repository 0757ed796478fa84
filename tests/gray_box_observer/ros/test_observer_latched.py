"""Latched values are true now, in every state of the life cycle, for late listeners too."""

from __future__ import annotations

import pytest
from lifecycle_msgs.msg import Transition
from std_msgs.msg import Bool, Float64MultiArray
from std_srvs.srv import Trigger

pytestmark = pytest.mark.system

EXCITATION = 'R[5,15]D[0.1,1]'
INITIAL = {'inductance': 1.5, 'resistance': 3.0, 'hysteresis': 1.0}
NUMBERS = (
    'motor/inductance',
    'motor/resistance',
    'motor/hysteresis',
    'motor/covariance',
    'estimates',
)
SAMPLES = 1000
CONFIGURE = Transition.TRANSITION_CONFIGURE
CLEANUP = Transition.TRANSITION_CLEANUP
ACTIVATE = Transition.TRANSITION_ACTIVATE
DEACTIVATE = Transition.TRANSITION_DEACTIVATE


@pytest.fixture
def identified(rig, record, tmp_path):
    """An observer that has identified its motor, and says so to whoever comes late."""
    rig.start(checkpoint__path=tmp_path / 'state.safetensors', estimates_period_s=0.2)
    rig.send(record(EXCITATION, 12.0), range(SAMPLES))
    rig.wait_for(samples_used=SAMPLES)
    assert rig.latched(Bool, 'motor/identified').data is True
    assert rig.latched(Float64MultiArray, 'estimates').data
    return rig


def told(rig) -> int:
    """How many of the latched numbers have a publisher."""
    return sum(rig.peer.node.count_publishers(f'/gray_box_observer/{name}') > 0 for name in NUMBERS)


def says_nothing(rig) -> bool:
    """Whether a late subscriber hears that nothing is identified, and no number."""
    rig.peer.wait(lambda: told(rig) == 0, 'the end of numbers that nobody knows')
    known = [rig.latched(Bool, f'motor/{name}').data for name in ('identified', 'alarm')]
    return known == [False, False]


def test_a_node_that_was_cleaned_up_tells_nothing_until_it_knows_something_again(identified):
    rig = identified
    learnt = identified.estimates()
    assert rig.change(DEACTIVATE)
    assert rig.latched(Bool, 'motor/identified').data is True, 'it still knows'
    assert rig.estimates() == learnt
    assert rig.change(CLEANUP)
    assert says_nothing(rig)
    assert rig.change(CONFIGURE)
    assert says_nothing(rig)
    assert rig.change(ACTIVATE)
    assert rig.estimates() == INITIAL
    assert rig.latched(Bool, 'motor/identified').data is False
    assert rig.peer.node.count_publishers('/gray_box_observer/estimates') == 0, 'nothing was learnt'


def test_a_node_that_was_shut_down_tells_nothing(identified):
    assert identified.change(Transition.TRANSITION_ACTIVE_SHUTDOWN)
    assert says_nothing(identified)


def test_a_reset_leaves_no_number_that_was_learnt_whatever_the_state(identified):
    rig = identified
    assert rig.call(Trigger, 'reset').success
    assert rig.estimates() == INITIAL
    assert rig.latched(Bool, 'motor/identified').data is False
    rig.peer.wait(
        lambda: not rig.peer.node.count_publishers('/gray_box_observer/estimates'),
        'the end of ~/estimates',
    )
    assert rig.change(DEACTIVATE)
    assert rig.call(Trigger, 'reset').success
    assert says_nothing(rig)


def test_what_is_loaded_while_the_node_rests_is_told_when_it_is_activated(identified):
    rig = identified
    learnt = identified.estimates()
    assert rig.call(Trigger, 'save').success
    assert rig.call(Trigger, 'reset').success
    assert rig.change(DEACTIVATE)
    assert rig.call(Trigger, 'load').success
    assert says_nothing(rig)
    assert rig.change(ACTIVATE)
    assert rig.estimates() == learnt
    assert rig.latched(Bool, 'motor/identified').data is True
