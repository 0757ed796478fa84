from __future__ import annotations

import html
import json
import math
import re
from pathlib import Path

import pytest

from gray_box_observer.watching.dashboard import page_feed
from gray_box_observer.watching.dashboard.page_feed import PageFeed, PageSource
from gray_box_observer.watching.dashboard.signal_courses import SignalCourses
from gray_box_observer.watching.observer_state import WatchedState

SECOND_NS = 10**9


@pytest.fixture
def source() -> PageSource:
    return PageSource(WatchedState(), SignalCourses(), lambda: 3.0)


def fill(source: PageSource, second: int, motors: tuple[str, ...] = ('left', 'right')) -> None:
    labels = (','.join(motors), 'resistance', 'value,std')
    source.state.add_estimates('/o', labels, [1.0 + second, 0.1] * len(motors), float(second))
    for kind, value in (('voltage', 12.0), ('torque', 0.2)):
        source.signals.add('', kind, motors, (value,) * len(motors), second * SECOND_NS)
    source.signals.add('/o', 'predicted', motors, (0.3,) * len(motors), second * SECOND_NS)
    for motor in motors:
        facts = {'resistance verdict': 'identified', 'fit verdict': 'ok', 'secret': 'no'}
        source.state.add_status('/o', motor, 0, f'of {motor}', facts, float(second))


def test_nothing_is_told_where_nothing_was_heard(source: PageSource) -> None:
    assert PageFeed(source).update() == {'observers': []}


def test_a_page_is_told_everything_and_then_what_is_new(source: PageSource) -> None:
    fill(source, 0)
    fill(source, 1)
    feed = PageFeed(source, '/o', 'right')
    first = feed.update()
    assert first['begins'] is True
    assert [m['name'] for m in first['observers'][0]['motors']] == ['left', 'right']
    assert first['motor']['advice'] == 'of right'
    assert first['motor']['facts'] == [['fit verdict', 'ok']]
    assert first['courses'] == {'resistance': [[0.0, 1.0], [1.0, 2.0], [0.1, 0.1]]}
    assert first['signals']['torque'] == [[0.0, 1.0], [0.2, 0.2]]
    assert first['signals']['predicted'] == [[0.0, 1.0], [0.3, 0.3]]
    assert first['signals']['speed'] == [[], []]
    assert 'begins' not in feed.update()
    assert feed.update()['courses'] == {'resistance': [[], [], []]}
    fill(source, 2)
    assert feed.update()['courses'] == {'resistance': [[2.0], [3.0], [0.1]]}
    fill(source, 3)
    assert feed.update()['signals']['voltage'] == [[3.0], [12.0]]


def test_without_a_choice_the_first_motor_is_shown_and_stays(source: PageSource) -> None:
    fill(source, 0, ('left',))
    feed = PageFeed(source, '/gone', 'motor')
    assert feed.update()['motor']['name'] == 'left'
    fill(source, 1, ('other', 'left'))
    assert 'begins' not in feed.update()


def test_what_is_told_is_json_whatever_the_numbers_are(source: PageSource) -> None:
    source.state.add_estimates(
        '/o', ('motor', 'resistance', 'value,std'), [math.nan, math.inf], 0.0
    )
    source.signals.add('', 'voltage', ('motor',), (math.nan,), 0)
    told = json.loads(json.dumps(PageFeed(source).update(), allow_nan=False))
    assert told['motor']['parameters'][0]['value'] is None
    assert told['signals']['voltage'] == [[0.0], [None]]


def test_of_many_motors_those_with_trouble_can_be_chosen(source: PageSource) -> None:
    for k in range(500):
        source.state.add_status('/o', f'm{k}', 1 if k == 499 else 0, '', {}, 0.0)
    listed = PageFeed(source).update()['observers'][0]
    assert listed['count'] == 500
    assert len(listed['motors']) == 200 and listed['motors'][0]['name'] == 'm499'


@pytest.mark.parametrize(
    'name', ['<b>bold</b>', '<a href="http://evil.example">here</a>', 'a&lt;b']
)
def test_a_name_stands_in_a_plot_as_it_is_written(source: PageSource, name: str) -> None:
    source.state.add_estimates('/o', ('motor', name, 'value,std'), [1.0, 0.1], 0.0)
    (told,) = PageFeed(source).update()['motor']['parameters']
    assert told['name'] == name
    assert html.unescape(told['label']) == name
    assert not set('<>') & set(told['label'])
    long = 'n' * 10_000
    line_feed = 'two\nlines'
    source.state.add_estimates('/o', ('motor', f'{long},{line_feed}', 'value,std'), [1.0] * 4, 0.0)
    labels = [p['label'] for p in PageFeed(source).update()['motor']['parameters'][1:]]
    assert len(labels[0]) < 100 and '\n' not in labels[1]


def test_plots_are_given_labels_and_never_names() -> None:
    script = (Path(page_feed.__file__).parent / 'dashboard.js').read_text(encoding='utf-8')
    first_words = re.findall(r'\b(?:layout|line)\(([^,)]+)', script)
    from_outside = {words for words in first_words if '.' in words}
    assert from_outside == {'parameter.label'}
