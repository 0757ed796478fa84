"""What the observer makes of the ROS graph, without a node."""

from __future__ import annotations

from types import SimpleNamespace
from unittest.mock import Mock

from gray_box_observer.ros.observer import topic_inputs
from gray_box_observer.ros.observer.topic_inputs import ANSWER_AGE_S, Inputs
from gray_box_observer.settings.configuration import Configuration


def test_the_graph_is_asked_once_for_all_motors_of_a_round_and_anew_for_the_next(monkeypatch):
    now_s = 100.0
    monkeypatch.setattr(topic_inputs, 'time', SimpleNamespace(monotonic=lambda: now_s))
    node = Mock()
    node.resolve_topic_name = lambda name: f'/{name}'
    node.get_publishers_info_by_topic.return_value = []
    inputs = Inputs(node, Configuration.from_flat({}), Mock(), Mock(), writers=list)
    for _ in range(1000):
        trouble = inputs.trouble(['voltage'])
        assert trouble is not None
        assert trouble.message.startswith('nobody publishes /motor/voltage')
    assert node.get_publishers_info_by_topic.call_count == 1
    now_s += 2.0 * ANSWER_AGE_S
    inputs.trouble(['voltage'])
    assert node.get_publishers_info_by_topic.call_count == 2
