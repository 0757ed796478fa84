"""A watcher takes another participant until an observer has answered."""

from __future__ import annotations

from contextlib import nullcontext
from typing import Any

import pytest

from gray_box_observer.ros.watching import answered_participant
from gray_box_observer.ros.watching.answered_participant import MOST_PARTICIPANTS
from gray_box_observer.watching.observer_state import MOST_OBSERVERS


class Handle(nullcontext):
    """The reader of latched estimates that came once."""

    def __init__(self, is_silent: bool) -> None:
        super().__init__()
        self.waiting = [] if is_silent else [(b'estimates', None)]

    def take_message(self, _kind: type, _raw: bool) -> tuple[bytes, None] | None:
        """Return what waits."""
        return self.waiting.pop() if self.waiting else None


class Reader:
    """A subscription."""

    msg_type = object

    def __init__(self, is_silent: bool) -> None:
        self.handle = Handle(is_silent)


class Participant:
    """Stands in for a node of a participant: some observers have answered it."""

    def __init__(self, answers: tuple[str, ...], is_silent: bool = False) -> None:
        self.answers = answers
        self.is_silent = is_silent
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
        return Reader(self.is_silent)

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


@pytest.mark.parametrize(
    ('observers', 'count', 'heard'),
    [((), 2, ('/a',)), (('/b',), 3, ('/b',)), (('/a', '/b'), 3, ('/a', '/b'))],
)
def test_a_participant_is_held_once_the_observers_have_answered(
    made: list[Participant], observers: tuple[str, ...], count: int, heard: tuple[str, ...]
) -> None:
    with answered_participant.answered_participant(observers, lambda: False):
        assert [one.is_destroyed for one in made] == [True] * (count - 1) + [False]
        assert made[-1].subscribed == [f'{name}/estimates' for name in heard]
    assert made[-1].is_destroyed


def test_an_observer_with_nothing_to_tell_yet_is_waited_for_with_two_participants(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    made: list[Participant] = []

    def make() -> Participant:
        made.append(Participant(('/a',), is_silent=True))
        return made[-1]

    monkeypatch.setattr(answered_participant, '_listening_node', make)
    monkeypatch.setattr(answered_participant, 'ANSWER_S', 0.05)
    with answered_participant.answered_participant((), lambda: False):
        assert [one.is_destroyed for one in made] == [True, False]


def test_a_crowd_of_observers_is_not_listened_to_in_full(monkeypatch: pytest.MonkeyPatch) -> None:
    crowd = Participant(tuple(f'/o{k}' for k in range(300)))
    monkeypatch.setattr(answered_participant, '_listening_node', lambda: crowd)
    with answered_participant.answered_participant((), lambda: False):
        assert len(crowd.subscribed) == MOST_OBSERVERS


def test_what_fails_meanwhile_leaves_no_participant(monkeypatch: pytest.MonkeyPatch) -> None:
    broken = Participant(())
    monkeypatch.setattr(answered_participant, '_listening_node', lambda: broken)
    with (
        pytest.raises(ZeroDivisionError),
        answered_participant.answered_participant((), lambda: bool(1 // 0)),
    ):
        pass
    assert broken.is_destroyed


def test_where_nobody_answers_the_last_one_is_held(made: list[Participant]) -> None:
    with answered_participant.answered_participant(('/c',), lambda: False):
        assert [one.is_destroyed for one in made] == [True] * (MOST_PARTICIPANTS - 1) + [False]


def test_a_request_for_the_end_is_heard_meanwhile(made: list[Participant]) -> None:
    with answered_participant.answered_participant(('/c',), lambda: True):
        assert [one.is_destroyed for one in made] == [False]
