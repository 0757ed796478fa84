from __future__ import annotations

import io

import pytest

from gray_box_observer.watching.motor_table import ObserverTables, has_numbers, is_complete
from gray_box_observer.watching.observer_state import WatchedState
from gray_box_observer.watching.table_display import TableDisplay, composed

FACTS = {
    'resistance verdict': 'identified',
    'fit verdict': 'ok',
    'fit ratio': '1.02',
    'sample rate [1/s]': '100.0',
    'samples used': '4200',
    'rejected': 'duplicate: 3',
    'speed source': 'rotor: the evidence asks for it',
}


def watched(motors: int = 1, *, is_recorded: bool = False) -> WatchedState:
    state = WatchedState(is_recorded=is_recorded)
    names = [f'm{k}' for k in range(motors)]
    for second in range(5):
        state.add_estimates(
            '/r1/observer',
            (','.join(names), 'resistance', 'value,std'),
            [2.0 - 0.1 * second, 0.01] * motors,
            float(second),
        )
    for name in names:
        state.add_status('/r1/observer', name, 1, f'look at {name}', FACTS, 4.0)
    return state


def test_a_motor_shows_value_deviation_verdict_fit_rate_advice_and_course() -> None:
    text = composed(ObserverTables(watched(), 4.0), width=120)
    for words in (
        *('/r1/observer', '1 motor, 1 identified', 'm0', 'resistance', '1.6', '± 0.01', 'ohm'),
        *('identified', 'fit ok, residual 1.02 times the noise', '100.0 samples/s'),
        *('4200 samples used', 'rejected duplicate: 3'),
        *('speed from rotor', 'look at m0', '█', '▁'),
    ):
        assert words in text


def test_the_columns_of_all_motors_stand_below_each_other_and_advice_is_indented() -> None:
    state = watched()
    name = ('m0', 'electrical_time_constant,b', 'value,std')
    state.add_estimates('/r1/observer', name, [1.5, 0.25, 12345.0, 1.0], 5.0)
    state.add_estimates('/r1/observer', ('m1', 'resistance', 'value,std'), [2.0, 0.01], 5.0)
    state.add_status('/r1/observer', 'm1', 1, 'word ' * 40, {}, 5.0)
    lines = composed(ObserverTables(state, 5.0), width=100).splitlines()
    assert len({line.index('±') for line in lines if '±' in line}) == 1
    assert len([line for line in lines if line.startswith('  word')]) > 1


def test_where_there_is_little_room_every_motor_is_one_row() -> None:
    text = composed(ObserverTables(watched(6), 4.0, lines=14), width=120)
    assert len(text.splitlines()) <= 14
    for k in range(6):
        assert sum(f'm{k} ' in line for line in text.splitlines()) == 1
    assert '1.6 ±0.62%' in text


def test_more_motors_than_are_wanted_are_counted() -> None:
    text = composed(ObserverTables(watched(6), 4.0, most=2), width=120)
    assert '6 motors, 6 identified, 2 shown' in text
    assert 'm3' not in text


def test_a_silent_observer_is_told() -> None:
    assert 'silent for 60 s: has it ended?' in composed(ObserverTables(watched(), 64.0))
    recorded = composed(ObserverTables(watched(is_recorded=True), 64.0))
    assert 'silent in the last 60 s' in recorded and 'has it ended?' not in recorded


def test_ascii_serves_where_there_is_nothing_else() -> None:
    for lines in (None, 4):
        text = composed(ObserverTables(watched(), 4.0, lines=lines), encoding='ascii', width=120)
        assert text.isascii()
        assert '+-' in text and '?' not in text


@pytest.mark.parametrize('lines', [None, 4])
def test_names_and_advice_of_a_network_are_shown_and_not_obeyed(lines: int | None) -> None:
    state = WatchedState()
    evil = '\x1b[31m[bold red]boo\n'
    state.add_status('/o', evil, 2, evil, {'resistance verdict': evil, 'fit verdict': evil}, 0.0)
    text = composed(ObserverTables(state, 0.0, lines=lines), width=200)
    assert '\x1b' not in text
    assert '[bold red]boo' in text


def test_complete_is_what_has_numbers_and_diagnostics() -> None:
    state = WatchedState()
    assert not is_complete(state) and not has_numbers(state)
    state.add_estimates('/o', ('motor', 'resistance', 'value,std'), [1.0, 0.1], 0.0)
    assert not is_complete(state) and has_numbers(state)
    state.add_status('/o', 'motor', 0, '', {}, 0.0)
    assert is_complete(state)


class Terminal(io.StringIO):
    """A stream that says it is one."""

    encoding = 'utf-8'

    def isatty(self) -> bool:
        """Say so."""
        return True


def test_a_pipe_gets_plain_tables_and_a_terminal_one_that_is_refreshed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv('TERM', 'xterm')
    pipe = io.StringIO()
    terminal = Terminal()
    for stream in (pipe, terminal):
        with TableDisplay(stream) as display:
            for second in (4.0, 5.0):
                display.show(watched(), second, 'heading')
    assert pipe.getvalue().count('look at m0') == 2
    assert '\x1b' not in pipe.getvalue()
    assert '\x1b[' in terminal.getvalue()
    assert terminal.getvalue().endswith('\x1b[?25h')  # the cursor is back
