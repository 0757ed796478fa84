"""Observers and their motors as a table, by `rich`: every parameter a row, or every motor.

Names and advice come from a network. They are shown as text, with what does not print escaped, and
never read as markup.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

from rich.box import ASCII, SIMPLE
from rich.console import Console, ConsoleOptions, RenderableType, RenderResult
from rich.padding import Padding
from rich.table import Table
from rich.text import Text

from gray_box_observer.safe_io.printable import printable
from gray_box_observer.watching.observer_state import (
    MotorState,
    ObserverState,
    ParameterState,
    WatchedState,
)
from gray_box_observer.watching.sparkline import BLOCKS, PLAIN, sparkline

CURVE_WIDTH = 20
LONGEST_NAME = 40
LONGEST_ADVICE = 400
VALUE = 1
"""Place of the value among the columns of a parameter: aligned to the right."""

LINES_OF_A_MOTOR = 3
"""Beside those of its parameters, where every parameter has a row: facts, advice, a blank."""

STYLES = {
    'ok': 'green',
    'warn': 'yellow',
    'error': 'bold red',
    'stale': 'magenta',
    'identified': 'green',
    'negligible': 'green',
    'converging': 'cyan',
    'unexcited': 'yellow',
    'misfit': 'red',
    'implausible': 'red',
    'frozen': 'blue',
    'warning': 'yellow',
    'untested': 'dim',
}
"""Colours of levels, of verdicts of parameters, and of the fit."""


class ObserverTables:
    """All observers, as they are now; rendered for the width and height that there is.

    Args:
        state: what was heard.
        now_s: the time, as the state counts it.
        most: motors of each observer that are shown; those that need attention come first.
        lines: height that there is; None: any.
    """

    def __init__(
        self, state: WatchedState, now_s: float, most: int = 20, lines: int | None = None
    ) -> None:
        self._state = state
        self._now_s = now_s
        self._most = most
        self._lines = lines

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        """Yield what is to be drawn."""
        observers = sorted(self._state.observers.values(), key=lambda observer: observer.name)
        plain = not options.encoding.startswith('utf')
        lines = None if self._lines is None else self._lines // max(1, len(observers))
        for observer in observers:
            motors = observer.worst_first(self._most)
            line_count = sum(len(motor.parameters) + LINES_OF_A_MOTOR for motor in motors) + 2
            yield _title(observer, len(motors), self._now_s, self._state.is_recorded)
            if lines is None or line_count <= lines:
                yield from _detailed(motors, plain=plain)
            else:
                yield _compact(motors[: max(1, lines - 5)], plain=plain)


def _title(observer: ObserverState, shown_count: int, now_s: float, is_recorded: bool) -> Text:
    """Name an observer, how many motors it has, and whether it is heard."""
    text = Text(printable(observer.name, LONGEST_NAME * 3), style='bold')
    count = len(observer.motors)
    identified_count = sum(_is_identified(motor) for motor in observer.motors.values())
    text.append(
        f'  {count} motor{"" if count == 1 else "s"}, {identified_count} identified', style='dim'
    )
    if shown_count < count:
        text.append(f', {shown_count} shown', style='dim')
    silent_s = observer.silence_s(now_s)
    if silent_s is not None:
        words = (
            f'silent in the last {silent_s:.0f} s'
            if is_recorded
            else f'silent for {silent_s:.0f} s: has it ended?'
        )
        text.append(f'  {words}', style=STYLES['error'])
    return text


def _is_identified(motor: MotorState) -> bool:
    return bool(motor.parameters) and all(p.is_believed for p in motor.parameters.values())


def _cells(motor: MotorState, *, plain: bool) -> list[tuple[Text, ...]]:
    """The row of every parameter."""
    return [
        (
            Text(f'  {printable(parameter.name, LONGEST_NAME)}'),
            Text(_number(parameter.value, '.5g')),
            Text(_deviation(parameter, plain=plain), style='dim'),
            Text(parameter.unit),
            _styled(parameter.verdict),
            Text(
                sparkline(
                    [value for _, value, _ in parameter.history],
                    CURVE_WIDTH,
                    PLAIN if plain else BLOCKS,
                ),
                style='cyan',
            ),
        )
        for parameter in motor.parameters.values()
    ]


def _detailed(motors: Sequence[MotorState], *, plain: bool) -> Iterable[RenderableType]:
    """Draw each motor with a row for every parameter, its facts above and the advice below.

    The columns of all motors stand below each other.
    """
    cells = [_cells(motor, plain=plain) for motor in motors]
    widths = [
        max(text.cell_len for text in column)
        for column in zip(*(row for rows in cells for row in rows), strict=True)
    ]
    for motor, rows in zip(motors, cells, strict=True):
        table = Table(box=None, pad_edge=False, show_header=False, padding=(0, 2, 0, 0))
        for place, width in enumerate(widths):
            table.add_column(justify='right' if place == VALUE else 'left', no_wrap=True)
            table.columns[place].min_width = width
        for row in rows:
            table.add_row(*row)
        yield _facts(motor)
        if rows:
            yield table
        if motor.advice:
            advice = Text(printable(motor.advice, LONGEST_ADVICE))
            yield Padding(advice, (0, 0, 0, 2), style=STYLES.get(motor.level, ''), expand=False)


def _facts(motor: MotorState) -> Text:
    """The line above the parameters: fit, rate, counts, speed."""
    text = Text(f' {printable(motor.name, LONGEST_NAME)}', style='bold')
    facts = motor.facts
    fit = facts.get('fit verdict', '')
    if fit:
        text.append('  fit ', style='dim')
        text.append_text(_styled(fit))
        if fit != 'untested':
            ratio = _short(facts.get('fit ratio', ''))
            text.append(f', residual {ratio} times the noise', style='not bold')
    phrases = _phrases(motor)
    if phrases:
        text.append('  ' + ', '.join(phrases), style='not bold dim')
    return text


def _phrases(motor: MotorState) -> list[str]:
    """What else diagnostics tell that fits into a line."""
    facts = motor.facts
    phrases = []
    if 'sample rate [1/s]' in facts:
        phrases.append(f'{_short(facts["sample rate [1/s]"])} samples/s')
    if 'samples used' in facts:
        phrases.append(f'{_short(facts["samples used"])} samples used')
    rejections = facts.get('rejected', 'none')
    if rejections != 'none':
        phrases.append(f'rejected {printable(rejections, LONGEST_NAME * 2)}')
    source = facts.get('speed source', '').partition(':')[0]
    if source:
        phrases.append(f'speed from {printable(source, LONGEST_NAME)}')
    if 'speed [rad/s]' in facts:
        phrases.append(f'{_short(facts["speed [rad/s]"])} rad/s')
    if facts.get('residual alarm') == 'raised':
        phrases.append('ALARM')
    return phrases


def _compact(motors: Sequence[MotorState], *, plain: bool) -> Table:
    """Draw every motor as one row."""
    names = list(dict.fromkeys(name for motor in motors for name in motor.parameters))
    table = Table(box=ASCII if plain else SIMPLE, pad_edge=False, header_style='dim')
    table.add_column('motor', no_wrap=True)
    for name in names:
        unit = next((p.unit for m in motors if (p := m.parameters.get(name)) is not None), '')
        table.add_column(Text(f'{printable(name, LONGEST_NAME)}\n{unit}'), no_wrap=True)
    table.add_column('fit', no_wrap=True)
    table.add_column('samples\nper s', no_wrap=True)
    table.add_column('advice', no_wrap=True, overflow='ellipsis')
    for motor in motors:
        table.add_row(
            Text(printable(motor.name, LONGEST_NAME), style='bold'),
            *(_cell(motor.parameters.get(name), plain=plain) for name in names),
            _styled(motor.facts.get('fit verdict', '')),
            Text(_short(motor.facts.get('sample rate [1/s]', ''))),
            Text(printable(motor.advice, LONGEST_ADVICE), style=STYLES.get(motor.level, '')),
        )
    return table


def _cell(parameter: ParameterState | None, *, plain: bool) -> Text:
    """Value and relative deviation of one parameter, in the colour of its verdict."""
    if parameter is None or not math.isfinite(parameter.value):
        return Text('-', style='dim')
    text = _number(parameter.value, '.4g')
    relative = abs(parameter.std / parameter.value) if parameter.value else math.inf
    if math.isfinite(relative):
        text += f' {"+-" if plain else "±"}{100.0 * relative:.2g}%'
    return Text(text, style=_style(parameter.verdict))


def _deviation(parameter: ParameterState, *, plain: bool) -> str:
    return f'{"+-" if plain else "±"} {_number(parameter.std, ".2g")}'


def _number(value: float, form: str) -> str:
    return format(value, form) if math.isfinite(value) else '-'


def _short(text: str) -> str:
    return printable(text, 16)


def _styled(verdict: str) -> Text:
    return Text(printable(verdict, LONGEST_NAME), style=_style(verdict))


def _style(verdict: str) -> str:
    return STYLES.get(verdict.partition(' ')[0], '')


def has_numbers(state: WatchedState) -> bool:
    """Whether any motor of any observer has a value."""
    return any(motor.has_numbers for motor in _motors(state))


def is_complete(state: WatchedState) -> bool:
    """Whether estimates and diagnostics of every motor have come."""
    motors = list(_motors(state))
    return bool(motors) and all(motor.level for motor in motors)


def _motors(state: WatchedState) -> Iterable[MotorState]:
    return (motor for observer in state.observers.values() for motor in observer.motors.values())
