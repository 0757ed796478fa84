from __future__ import annotations

import pytest

from gray_box_observer.safe_io.printable import printable


@pytest.mark.parametrize(
    'text', ['left_wheel', 'Motor links, größer als 1 Ω', "it's '/motor/voltage'", '', '日本']
)
def test_what_is_printable_stays_what_it_is(text: str) -> None:
    assert printable(text) is text


@pytest.mark.parametrize(
    ('text', 'shown'),
    [
        ('\x1b[2Jgone', r'\x1b[2Jgone'),
        ('one\nidentify: error: two', r'one\nidentify: error: two'),
        ('a\rb\tc\0', r'a\rb\tc\x00'),
        ('\x9b31m', r'\x9b31m'),
        ('evil\u202egnp.exe', r'evil\u202egnp.exe'),
        ('no \udcff UTF-8', r'no \udcff UTF-8'),
    ],
)
def test_what_a_terminal_or_a_log_would_obey_is_shown(text: str, shown: str) -> None:
    assert printable(text) == shown
    printable(text).encode()


def test_a_long_text_is_cut_and_anything_has_words() -> None:
    assert printable('a' * 100, 3) == 'aaa...'
    assert printable(['\n']) == r"['\n']"
