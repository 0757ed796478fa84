"""A watcher takes one participant after another, until an observer has answered one."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import nullcontext
from types import SimpleNamespace
from typing import Any

import pytest
from rclpy.impl.implementation_singleton import rclpy_implementation

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
    """Stands in for a node of a participant, and for its context: some observers have answered."""

    def __init__(self, answers: tuple[str, ...], is_silent: bool = False) -> None:
        self.answers = answers
        self.is_silent = is_silent
        self.subscribed: list[str] = []
        self.is_destroyed = False
        self.is_shut_down = False

    @property
    def context(self) -> Participant:
        """Return what is shut down with it."""
        return self

    def try_shutdown(self) -> None:
        """Note that the context is shut down."""
        self.is_shut_down = True

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


Make = Callable[[Callable[[int], Participant]], list[Participant]]


@pytest.fixture
def participants(monkeypatch: pytest.MonkeyPatch) -> Make:
    """Return the list of the participants, each made by its number, in the order they are made."""

    def made_by(make: Callable[[int], Participant]) -> list[Participant]:
        made: list[Participant] = []

        def listening_node(_args: object) -> Participant:
            made.append(make(len(made)))
            return made[-1]

        monkeypatch.setattr(answered_participant, '_listening_node', listening_node)
        return made

    monkeypatch.setattr(answered_participant, 'ANSWER_S', 0.05)
    monkeypatch.setattr(answered_participant, 'PAUSE_S', 0.0)
    return made_by


def one_more_answer(number: int) -> Participant:
    """Return a participant that is answered by one more observer than the one before."""
    return Participant(('/a', '/b')[:number])


def found(observers: tuple[str, ...] = (), *, is_end_requested: bool = False) -> Any:
    """Find a participant."""
    return answered_participant.answered_participant(None, observers, lambda: is_end_requested)


def check_only(held: Participant, made: list[Participant]) -> None:
    """Check that all but one participant were given back."""
    assert [one for one in made if not one.is_destroyed] == [held]
    assert [one for one in made if not one.is_shut_down] == [held]


@pytest.mark.parametrize(
    ('observers', 'count', 'heard'),
    [((), 2, ('/a',)), (('/b',), 3, ('/b',)), (('/a', '/b'), 3, ('/a', '/b'))],
)
def test_the_first_participant_that_the_observers_have_answered_is_held(
    participants: Make, observers: tuple[str, ...], count: int, heard: tuple[str, ...]
) -> None:
    made = participants(one_more_answer)
    with found(observers) as context:
        assert len(made) == count
        assert context is made[-1]
        check_only(made[-1], made)
        assert made[-1].subscribed == [f'{name}/estimates' for name in heard]
    assert made[-1].is_destroyed
    assert not made[-1].is_shut_down, 'nodes were made in it'


def test_of_several_observers_all_must_have_answered_whom_any_participant_knows(
    participants: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(answered_participant, 'ANSWER_S', 60.0)
    answers = ('/a',), ('/b',), ('/a', '/b')
    made = participants(lambda number: Participant(answers[number], is_silent=number == 0))
    with found() as context:
        assert context is made[2]
        check_only(made[2], made)


def test_a_participant_may_be_answered_after_later_ones_were_made(
    participants: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(answered_participant, 'ANSWER_S', 60.0)
    made = participants(lambda _: Participant(()))

    def answer() -> bool:
        made[1 if len(made) > 3 else 0].answers = ('/a',) if len(made) > 3 else ()
        return False

    with answered_participant.answered_participant(None, (), answer) as context:
        assert context is made[1]
        check_only(made[1], made)


def test_one_that_takes_long_to_make_is_not_followed_by_a_crowd(
    participants: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    now_s = 0.0

    def sleep(duration_s: float) -> None:
        nonlocal now_s
        now_s += duration_s

    def make(number: int) -> Participant:
        sleep(1.0 if number == 0 else 0.01)
        return Participant(())

    monkeypatch.setattr(answered_participant, 'ANSWER_S', 0.3)
    monkeypatch.setattr(answered_participant, 'PAUSE_S', 0.1)
    clock = SimpleNamespace(monotonic=lambda: now_s, sleep=sleep)
    monkeypatch.setattr(answered_participant, 'time', clock)
    most = 0
    made = participants(make)

    def count_open() -> bool:
        nonlocal most
        most = max(most, sum(not one.is_destroyed for one in made))
        return False

    with answered_participant.answered_participant(None, (), count_open):
        assert len(made) == MOST_PARTICIPANTS
        assert most <= 5


def test_where_there_is_room_for_one_alone_that_one_is_held(participants: Make) -> None:
    def make(number: int) -> Participant:
        if number > 0:
            raise rclpy_implementation.RCLError('no more participants')
        return Participant(())

    made = participants(make)
    with found() as context:
        assert context is made[0]
        check_only(made[0], made)


def test_where_there_is_room_for_none_the_error_is_told(participants: Make) -> None:
    def make(_number: int) -> Participant:
        raise rclpy_implementation.RCLError('no participant')

    participants(make)
    with pytest.raises(rclpy_implementation.RCLError, match='no participant'), found():
        pass


def test_an_observer_with_nothing_to_tell_yet_is_waited_for_no_longer(participants: Make) -> None:
    made = participants(lambda number: Participant(('/a',)[:number], is_silent=True))
    with found() as context:
        assert context is made[1], 'the first that knows of it'
        check_only(made[1], made)
        assert len(made) < MOST_PARTICIPANTS


def test_a_crowd_of_observers_is_not_listened_to_in_full(participants: Make) -> None:
    made = participants(lambda _: Participant(tuple(f'/o{k}' for k in range(300))))
    with found():
        assert len(made[0].subscribed) == MOST_OBSERVERS


def test_what_fails_meanwhile_leaves_no_participant(participants: Make) -> None:
    made = participants(lambda _: Participant(()))
    with (
        pytest.raises(ZeroDivisionError),
        answered_participant.answered_participant(None, (), lambda: bool(1 // 0)),
    ):
        pass
    assert made[0].is_destroyed
    assert made[0].is_shut_down


def test_where_not_all_answer_the_one_that_most_have_answered_is_held(participants: Make) -> None:
    made = participants(one_more_answer)
    with found(('/a', '/b', '/c')) as context:
        assert context is made[2]
        check_only(made[2], made)


def test_where_nobody_answers_so_many_are_tried_and_one_is_held(participants: Make) -> None:
    made = participants(lambda _: Participant(()))
    with found():
        assert len(made) == MOST_PARTICIPANTS
        assert sum(not one.is_shut_down for one in made) == 1


def test_a_request_for_the_end_is_heard_meanwhile(participants: Make) -> None:
    made = participants(lambda _: Participant(()))
    with found(is_end_requested=True):
        assert len(made) == 1
        check_only(made[0], made)
