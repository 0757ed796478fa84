"""A watcher takes another participant until an observer has answered."""

from __future__ import annotations

from contextlib import nullcontext
from typing import Any

import pytest

from gray_box_observer.ros.watching import answered_participant
from gray_box_observer.ros.watching.answered_participant import MOST_PARTICIPANTS


class Handle(nullcontext):
    """The reader of latched estimates that came once."""

    def __init__(self) -> None:
        super().__init__()
        self.waiting = [(b'estimates', None)]

    def take_message(self, _kind: type, _raw: bool) -> tuple[bytes, None] | None:
        """Return what waits."""
        return self.waiting.pop() if self.waiting else None


class Reader:
    """A subscription."""

    msg_type = object

    def __init__(self) -> None:
        self.handle = Handle()


class Participant:
    """Stands in for a node of a participant: some observers have answered it."""

    def __init__(self, answers: tuple[str, ...]) -> None:
        self.answers = answers
        self.subscribed: list[str] = []
        self.is_destroyed = False

    def get_topic_names_and_types(self) -> list[tuple[str, list[str]]]:
        """Return the topics of observers that have answered, and one that is of nobody."""
        kinds = ['std_msgs/msg/Float64MultiArray']
        topics = [(f'{name}/estimates', kinds) for name in self.answers]
        return [('/other/estimates', ['std_msgs/msg/String']), *topics]

    def create_subscription(self, _kind: type, topic: str, *_: Any) -> Reader:
        """Note that a topic is read."""
        self.subscribed.append(topic)
        return Reader()

    def destroy_node(self) -> None:
        """Note that the participant is gone."""
        self.is_destroyed = True


@pytest.fixture
def made(monkeypatch: pytest.MonkeyPatch) -> list[Participant]:
    """Participants in the order in which they are made: each is answered by one more observer."""
    participants: list[Participant] = []

    def make() -> Participant:
        names = ('/a', '/b')[: len(participants)]
        participants.append(Participant(names))
        return participants[-1]

    monkeypatch.setattr(answered_participant, '_listening_node', make)
    monkeypatch.setattr(answered_participant, 'ANSWER_S', 0.05)
    return participants


@pytest.mark.parametrize(('observers', 'count'), [((), 2), (('/b',), 3), (('/a', '/b'), 3)])
def test_a_participant_is_held_once_the_observers_have_answered(
    made: list[Participant], observers: tuple[str, ...], count: int
) -> None:
    with answered_participant.answered_participant(observers, lambda: False):
        assert [one.is_destroyed for one in made] == [True] * (count - 1) + [False]
        assert made[-1].subscribed == [f'{name}/estimates' for name in made[-1].answers]
    assert made[-1].is_destroyed


def test_where_nobody_answers_the_last_one_is_held(made: list[Participant]) -> None:
    with answered_participant.answered_participant(('/c',), lambda: False):
        assert [one.is_destroyed for one in made] == [True] * (MOST_PARTICIPANTS - 1) + [False]


def test_a_request_for_the_end_is_heard_meanwhile(made: list[Participant]) -> None:
    with answered_participant.answered_participant(('/c',), lambda: True):
        assert [one.is_destroyed for one in made] == [False]
