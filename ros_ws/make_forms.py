"""Writes the declared motor as ``forms.py`` (numbers, arrays, tensors) and ``forms.h`` (C).

``whole_motor.h`` is for compiled trajectories of motors with a rotor.

    make physics        # ros_ws/run.sh python ros_ws/make_forms.py [--check]

sympy differentiates the formulas of ``white_box/declaration.py``. What is no formula but a function
of ``white_box/flow.py``, such as the rate and a Runge-Kutta step, is run once with
:class:`written_c.Written` in place of numbers, which writes down what it computes. The files are
committed, so that nothing but this needs sympy; a test fails until they are what this writes.
"""

from __future__ import annotations

import argparse
import hashlib
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import sympy
from sympy.printing.pycode import PythonCodePrinter
from written_c import Each, Loop, Written, braces, plain, sign, statements, wrapped

from gray_box_observer.white_box import declaration, flow
from gray_box_observer.white_box.balance import Balance, Form
from gray_box_observer.white_box.declaration import (
    COMPILED,
    CONSTANTS,
    DRIVES,
    SIGNALS,
    TERMS,
    State,
)
from gray_box_observer.white_box.motion import Interval, Linear, joined

WHITE_BOX = Path(declaration.__file__).resolve().parent

HEAD = 'Written by `make physics` from declaration.py: change that, not this.'

ARGUMENTS = (*SIGNALS, *CONSTANTS, 'voltage')
"""What every formula of an effect or a drive is a function of."""

CURRENT = SIGNALS[State.CURRENT]
FOLLOWING = SIGNALS[-1]
"""The signal that follows the current where it is neither a state nor measured."""

NUMBER = 'number '
"""What the name of a symbol begins with that stands for a number."""

Expression = Any

SYMBOLS: dict[str, Expression] = {
    name: sympy.Symbol(name, real=True) for name in ('torque', *ARGUMENTS)
}


class _Printer(PythonCodePrinter):  # type: ignore[misc]
    """Prints an expression in operators, ``abs`` and ``sign``."""

    def _print_sign(self, expression: Expression) -> str:
        return f'sign({self._print(expression.args[0])})'

    def _print_Symbol(self, symbol: Expression) -> str:  # noqa: N802
        return str(symbol).removeprefix(NUMBER)


def parsed(formula: str) -> Expression:
    """Turn a formula into an expression with symbols for fractions, which stay as written."""
    expression = sympy.sympify(formula, locals=SYMBOLS)
    strange = expression.free_symbols - set(SYMBOLS.values())
    if strange:
        known = ', '.join(SYMBOLS)
        raise SystemExit(f'make_forms: error: {formula!r} names {strange.pop()}; there are {known}')
    numbers = expression.atoms(sympy.Float)
    return expression.xreplace(
        {n: sympy.Symbol(f'{NUMBER}{float(n)!r}', positive=True) for n in numbers}
    )


def derivative(expression: Expression, by: str) -> Expression:
    """Differentiate; ``x sign(x)`` becomes ``|x|``, and what can be cancelled is."""
    slope = sympy.diff(expression, SYMBOLS[by])
    for symbol in SYMBOLS.values():
        slope = slope.subs(symbol * sympy.sign(symbol), sympy.Abs(symbol))
    return sympy.factor(slope)


def following(expression: Expression) -> Expression:
    """Differentiate by the current where the speed follows it."""
    through = derivative(parsed(declaration.FOLLOWING_SPEED), CURRENT) * derivative(
        expression, FOLLOWING
    )
    return derivative(expression, CURRENT) + through


def relations() -> Iterator[tuple[str, str, Expression, str]]:
    """Yield what else is declared: name, argument, expression and description of a function."""
    torque = parsed(declaration.TORQUE)
    (current,) = sympy.solve(torque - SYMBOLS['torque'], SYMBOLS[CURRENT])
    speed = parsed(declaration.FOLLOWING_SPEED)
    yield 'following_speed', CURRENT, speed, 'Speed in rad/s where it follows the current.'
    yield 'torque_of_current', CURRENT, torque, 'Torque in N m from current.'
    yield 'current_of_torque', 'torque', current, 'Current in A from torque.'


# --- for numbers, arrays and tensors


def in_python(expression: Expression) -> str:
    """Print an expression."""
    return repr(float(expression)) if expression.is_number else str(_Printer().doprint(expression))


def python_forms(fingerprint: int, whole_motor: int) -> str:
    """Return the text of ``forms.py``."""
    lines = [
        '"""Forms of the motor for numbers, arrays and tensors.',
        '',
        HEAD,
        '"""',
        '# fmt: off',
        '',
    ]
    lines += ['from __future__ import annotations', '', 'from typing import Any', '']
    lines += ['from gray_box_observer.white_box.balance import Form, sign']
    lines += ['from gray_box_observer.white_box.declaration import State', '']
    lines += [
        f'FINGERPRINT = {fingerprint}',
        '"""Of the compiled forms that were written with these."""',
        '',
        f'WHOLE_MOTOR_FINGERPRINT = {whole_motor}',
        '"""The same of a motor with a rotor."""',
        '',
    ]
    lines += ['EFFECTS: dict[str, Form] = {']
    for name, term in TERMS.items():
        lines += _form(f"'{name}'", term.formula) if term.formula else []
    lines += ['}', '"""Effects by the names of their coefficients."""', '']
    lines += ['SHARP_EFFECTS: dict[str, Form] = EFFECTS | {']
    for name, term in TERMS.items():
        lines += _form(f"'{name}'", term.sharp_formula) if term.sharp_formula else []
    lines += ['}', '"""The same where the speed is a signal or a state."""', '']
    lines += ['DRIVES: dict[State, Form | None] = {']
    for state, formula in DRIVES.items():
        key = f'State.{state.name}'
        lines += [f'    {key}: None,'] if formula == 'voltage' else _form(key, formula)
    lines += ['}', '"""What drives every state; ``None``: the voltage itself."""', '']
    for name, argument, expression, description in relations():
        lines += ['', f'def {name}({argument}: Any, torque_constant: Any) -> Any:']
        lines += [f'    """{description}"""', f'    return {in_python(expression)}', '']
    return '\n'.join(lines)


def _form(key: str, formula: str) -> list[str]:
    expression = parsed(formula)
    head = f'lambda {", ".join(ARGUMENTS)}: '
    value = in_python(expression)
    value += f' + 0.0 * {CURRENT}' if expression.is_number else ''  # one for every sample
    slopes = ',\n         '.join(
        head + in_python(derivative(expression, signal)) for signal in SIGNALS
    )
    total = in_python(following(expression))
    return [
        f'    {key}: Form(',
        f'        {head}{value},',
        f'        ({slopes}),',
        f'        {head}{total},',
        '    ),',
    ]


# --- for compiled code

_TERM = (
    f'const Term t = term(of.codes[{{}}], of.speed_measured, {", ".join(SIGNALS)}, '
    f'box->torque_constant, voltage);'
)
UNKNOWN = Loop('for (int j = 1; j < of.coordinates; j++)', _TERM.format('j - 1'))
KNOWN = Loop('for (int k = 0; k < of.known; k++)', _TERM.format('of.coordinates - 1 + k'))
COORDINATES = Loop('for (int j = 0; j < of.coordinates; j++)')
"""Loops over unknown terms, known terms and coordinates."""


class _WhiteBox:
    """A motor of any terms: the balances of every motor, with the terms in loops."""

    def balances(self, signal: Written) -> list[Balance]:
        """Return the balance of every state."""
        slopes = [f't.slope[{by.name}]' for by in COMPILED]
        return [
            Balance(
                storage=0,
                places=('j',),  # type: ignore[arg-type]
                unknown_effects=(_of_every(UNKNOWN, 't.value'),),
                unknown_slopes=tuple((_of_every(UNKNOWN, slope),) for slope in slopes),
                known_effects=(_constant('t.value'),),
                known_slopes=tuple((_constant(slope),) for slope in slopes),
                drive_form=_drive(DRIVES[state]),
                torque_constant=Written('box->torque_constant'),
                speed_measured=True,  # or worked out before
                following_speed=None,
            )
            for state in COMPILED
        ]


def _of_every(loop: Loop, variable: str) -> Callable[..., Written]:
    """Return a function whose value stands in a variable of every round of a loop."""
    return lambda *signals: Written(variable, every=loop)


def _constant(variable: str) -> tuple[Written, Callable[..., Written]]:
    return Written('box->constant[k]', every=KNOWN), _of_every(KNOWN, variable)


def _drive(formula: str) -> Form | None:
    if formula == 'voltage':
        return None
    value, *slopes = [parsed(formula), *(derivative(parsed(formula), signal) for signal in SIGNALS)]
    total = following(parsed(formula))
    functions = [_function(ARGUMENTS, expression) for expression in (value, *slopes, total)]
    return Form(functions[0], tuple(functions[1:-1]), functions[-1])


def _function(names: Sequence[str], expression: Expression) -> Callable[..., Any]:
    """Return a function that evaluates an expression, for numbers and for traced symbols."""
    numbers = sorted((s for s in expression.free_symbols if str(s).startswith(NUMBER)), key=str)
    arguments = [*(SYMBOLS[name] for name in names), *numbers]
    made = sympy.lambdify(arguments, expression, [{'sign': sign}], _Printer, dummify=True)
    return lambda *signals: made(*signals, *(Written(in_python(number)) for number in numbers))


def in_c(expression: Expression) -> str:
    """Print an expression of the signals."""
    if expression.is_number:
        return f'all({float(expression)!r})'
    return plain(_function(list(SYMBOLS), expression)(*map(Written, SYMBOLS)))


def _code_question(name: str, description: str, codes: Iterable[str]) -> list[str]:
    """Write a function that tells whether a term's code is one of some."""
    is_any = ' || '.join(f'code == {code}' for code in codes)
    head = [f'/* {description} */', f'static inline int {name}(int64_t code)']
    return [*head, *braces([f'return {is_any};']), '']


def c_forms() -> str:
    """Return the text of ``forms.h`` but for its fingerprint."""
    compiled = {
        name: term for name, term in TERMS.items() if term.formula and term.state in COMPILED
    }
    effects = {name.upper(): parsed(term.formula) for name, term in compiled.items()}
    lines = [f'enum {{ {", ".join([*(state.name for state in COMPILED), "STATES"])} }};']
    lines += [*wrapped(f'enum {{ {", ".join(name.upper() for name in TERMS)} }};'), '']
    holding = [name.upper() for name, term in compiled.items() if term.holds_current]
    lines += ['#include "white_box/physics.h"', '']
    lines += _code_question('term_known', 'Whether there is a term of this code.', effects)
    lines += _code_question(
        'term_holds_current',
        'Whether a term may hold the current where it changes its sign.',
        holding,
    )
    for name, argument, expression, description in relations():
        lines += [f'/* {description} */']
        lines += [
            f'INLINE Real {name}(Real {argument}, Real torque_constant)',
            *braces([f'return {in_c(expression)};']),
            '',
        ]
    lines += ['/* A term for a coefficient of one, and its derivatives. */']
    signals = ', '.join(f'Real {name}' for name in ARGUMENTS)
    lines += wrapped(f'INLINE Term term(int64_t code, int speed_measured, {signals})')
    cases = [line for name, effect in effects.items() for line in _case(name, effect)]
    body = [
        'Term t = {{0}, {{0}}};',
        'switch (code) {',
        *cases,
        'default: break;',
        '}',
        'return t;',
    ]
    lines += [*braces(body), '', '/* Rates of the states and their derivatives: flow.py, rate. */']
    lines += ['INLINE Linear rate_of(']
    lines += [
        '    const Physics *box, const Terms of, const Real *state, Real voltage, Real measured)'
    ]
    lines += [*braces(['Linear linear;', *_signals(), *_rate(), 'return linear;']), '']
    lines += ['/* flow.py, runge_kutta_step. */', 'INLINE Linear runge_kutta_step(']
    lines += [
        '    const Physics *box, const Terms of, const Real *start, const Linear *here, const '
        'Interval *over)'
    ]
    lines += [
        *braces(['Linear linear;', *_runge_kutta_step(), 'return linear;']),
        '',
        '/* flow.py, _exponential_step. */',
        'INLINE Linear exponential_step(',
        '    const Terms of, const Real *start, const Linear *here, Real length)',
        *braces(['Linear linear;', *_exponential_step(), 'return linear;']),
        '',
        '/* motion.py, joined. */',
    ]
    lines += ['INLINE Linear joined(const Terms of, const Linear *first, const Linear *then)']
    return '\n'.join([*lines, *braces(['Linear linear;', *_joined(), 'return linear;'])])


def _case(name: str, effect: Expression) -> list[str]:
    value = f'{float(effect)!r} + 0.0 * {CURRENT}' if effect.is_number else in_c(effect)
    lines = [f'case {name}:', f'    t.value = {value};']
    for state in COMPILED:
        slope = in_c(derivative(effect, SIGNALS[state]))
        total = in_c(following(effect)) if state is State.CURRENT else slope
        text = slope if slope == total else f'speed_measured ? {slope} : {total}'
        lines += [f'    t.slope[{state.name}] = {text};'] if text != 'all(0.0)' else []
    return [*lines, '    break;']


class _Functions:
    """Of numpy's functions those that a rate and an exponential step need."""

    stack = Each

    @staticmethod
    def minimum(value: Written, other: float) -> Written:
        """Return the smaller one."""
        return Written('smaller({0}, {1})', (value, Written(f'all({other!r})')))

    @staticmethod
    def exp(value: Written) -> Written:
        """Return the exponential."""
        return Written('exponential({0})', (value,))


def _signals() -> list[str]:
    lines = [f'const Real {SIGNALS[state]} = state[{state.name}];' for state in COMPILED]
    if len(COMPILED) < len(SIGNALS):
        follows = f'following_speed({CURRENT}, box->torque_constant)'
        lines.append(f'const Real {FOLLOWING} = of.speed_measured ? measured : {follows};')
    return lines


def _rate() -> list[str]:
    coefficients: Any = {0: Written('box->p[0]'), 'j': Written('box->p[j]', every=UNKNOWN)}
    states = [Written(f'state[{state.name}]') for state in COMPILED]
    box: Any = _WhiteBox()
    rate = flow.rate(_Functions, box, coefficients, states, Written('voltage'), Written('speed'))
    return _stored(rate, list(coefficients))


def _runge_kutta_step() -> list[str]:
    names = ('voltage', 'speed', 'end_speed', 'length')
    interval = Interval(*(Written(f'over->{name}') for name in names))  # type: ignore[arg-type]
    number = iter(range(2, 5))

    def rate_at(states: Sequence[Written], speed: Written) -> Linear:
        name = f'r{next(number)}'
        places = ', '.join(f'{{{state}}}' for state in COMPILED)
        call = (
            f'const Linear {name} = rate_of(box, of, (Real[]){{{{{places}}}}}, over->voltage, '
            f'{{{len(COMPILED)}}});'
        )
        made = Written(name, (*states, speed), declared=call)
        return _linear('{0}.').mapped(
            lambda member: Written(member.text, (made,), every=member.every)
        )

    start = [Written(f'start[{state.name}]') for state in COMPILED]
    return _stored(flow.runge_kutta_step(rate_at, start, _linear('here->'), interval), ['j'])


def _exponential_step() -> list[str]:
    start: Any = [Written(f'start[{state.name}]') for state in COMPILED]
    none: Any = Written('0.0')
    length: Any = Written('length')
    interval = Interval(none, none, none, length)
    step = flow._exponential_step(_Functions, _no_rate, start, _linear('here->'), interval)
    return _stored(step, ['j'])


def _no_rate(states: Sequence[Any], speed: Any) -> Linear:
    raise NotImplementedError  # an exponential step asks for none but that at its start


def _joined() -> list[str]:
    return _stored(joined(_linear('first->'), _linear('then->')), ['j'])


def _linear(name: str, states: Sequence[State] = COMPILED, every: Loop = COORDINATES) -> Linear:
    """A rate or a motion that stands in a variable."""
    return Linear(
        [Written(f'{name}value[{s.name}]') for s in states],
        [[Written(f'{name}by_state[{s.name}][{r.name}]') for r in states] for s in states],
        [Written(f'{name}by_coordinate[{s.name}][j]', every=every) for s in states],
    )


def _stored(
    linear: Linear, places: Sequence[int | str], states: Sequence[State] = COMPILED
) -> list[str]:
    """Statements that work out a rate or a motion."""
    results = []
    for s in states:
        results += [(f'linear.value[{s.name}]', linear.value[s])]
        results += [(f'linear.by_state[{s.name}][{r.name}]', linear.by_state[s][r]) for r in states]
        forced = linear.by_coordinate[s]
        entries = forced.entries if isinstance(forced, Each) else [forced]
        results += [
            (f'linear.by_coordinate[{s.name}][{p}]', slope)
            for p, slope in zip(places, entries, strict=True)
        ]
    return statements(results)


# --- for compiled code, of a motor with a rotor

EVERY_TERM = Loop('for (int j = 0; j < COORDINATES; j++)')
"""Loop over the coordinates of a motor that has every term."""


class _WholeMotor:
    """A motor that has every term, each with a coordinate of its own."""

    def balances(self, signal: Written) -> list[Balance]:
        """Return the balance of every state."""
        return [self._balance(state) for state in State]

    @staticmethod
    def _balance(state: State) -> Balance:
        terms = [(place, term) for place, term in enumerate(TERMS.values()) if term.state is state]
        effects = [
            (place, parsed(term.whole_motor_formula)) for place, term in terms if term.formula
        ]
        (storage,) = (place for place, term in terms if not term.formula)
        return Balance(
            storage=storage,
            places=tuple(place for place, _ in effects),
            unknown_effects=tuple(_function(ARGUMENTS, effect) for _, effect in effects),
            unknown_slopes=tuple(
                tuple(
                    _function(ARGUMENTS, derivative(effect, SIGNALS[by])) for _, effect in effects
                )
                for by in State
            ),
            known_effects=(),
            known_slopes=tuple(() for _ in State),
            drive_form=_drive(DRIVES[state]),
            torque_constant=Written('torque_constant'),
            speed_measured=False,
            following_speed=None,
        )


def _written_out(name: str, *made: Written) -> Linear:
    """A rate whose derivatives by coordinates are written out: each stands in one balance only."""
    forced: list[Any] = [
        Each(
            Written(f'{name}by_coordinate[{state.name}][{place}]', made)
            if term.state is state
            else Written('0.0')
            for place, term in enumerate(TERMS.values())
        )
        for state in State
    ]
    rate = _linear(name, tuple(State), EVERY_TERM)
    return Linear(
        [Written(entry.text, made) for entry in rate.value],
        [[Written(entry.text, made) for entry in row] for row in rate.by_state],
        forced,
    )


def whole_motor_form() -> str:
    """Return the text of ``whole_motor.h`` but for its fingerprint."""
    every = range(len(TERMS))
    states = [Written(f'state[{state.name}]') for state in State]
    box: Any = _WholeMotor()
    coefficients: Any = {place: Written(f'p[{place}]') for place in every}
    rate = flow.rate(_Functions, box, coefficients, states, Written('voltage'), None)
    names = ('voltage', '0.0', '0.0', 'length')
    interval = Interval(*map(Written, names))  # type: ignore[arg-type]
    number = iter(range(2, 5))

    def rate_at(at: Sequence[Written], speed: Written) -> Linear:
        name = f'r{next(number)}'
        places = ', '.join(f'{{{state}}}' for state in State)
        call = (
            f'const Linear {name} = rate_of(p, torque_constant, (Real[]){{{{{places}}}}}, voltage);'
        )
        return _written_out('{0}.', Written(name, tuple(at), declared=call))

    start = [Written(f'start[{state.name}]') for state in State]
    here = _linear('here->', tuple(State), EVERY_TERM)
    by_runge_kutta = flow.runge_kutta_step(rate_at, start, _written_out('here->'), interval)
    begin: Any = start
    exponential = flow._exponential_step(_Functions, rate_at, begin, here, interval)
    both = joined(*(_linear(f'{name}->', tuple(State), EVERY_TERM) for name in ('first', 'then')))
    step = (
        'const Real *p, Real torque_constant, const Real *start, const Linear *here,\n'
        '    Real voltage, Real length'
    )
    functions = {
        'rate_of': ('const Real *p, Real torque_constant, const Real *state, Real voltage', rate),
        'runge_kutta_step': (step, by_runge_kutta),
        'exponential_step': (
            'const Real *start, const Linear *here, Real length',
            exponential,
        ),
        'joined': ('const Linear *first, const Linear *then', both),
    }
    lines = [f'enum {{ {", ".join([*(state.name for state in State), "STATES"])} }};']
    lines += wrapped(f'enum {{ {", ".join([*(name.upper() for name in TERMS), "COORDINATES"])} }};')
    balances = ', '.join(term.state.name for term in TERMS.values())
    lines += wrapped(f'static const int BALANCE_OF[COORDINATES] = {{{balances}}};')
    lines += ['']
    lines += ['typedef struct {']
    lines += [
        '    Real value[STATES], by_state[STATES][STATES], by_coordinate[STATES][COORDINATES];'
    ]
    lines += ['} Linear;']
    for name, (arguments, made) in functions.items():
        places = list(coefficients) if isinstance(made.by_coordinate[0], Each) else ['j']
        body = _stored(made, places, tuple(State))
        lines += ['', f'/* {FUNCTIONS[name]}. */', f'INLINE Linear {name}(']
        lines += [f'    {arguments})']
        lines += braces(['Linear linear;', *body, 'return linear;'])
    return '\n'.join(lines)


FUNCTIONS = {
    'rate_of': 'flow.py, rate',
    'runge_kutta_step': 'flow.py, runge_kutta_step',
    'exponential_step': 'flow.py, _exponential_step',
    'joined': 'motion.py, joined',
}
"""Functions of ``white_box/`` by their names in compiled code."""


def _header(name: str, what: str, numbers: str, fingerprint: int, body: str) -> str:
    """Return the text of a header."""
    guard = f'GRAY_BOX_OBSERVER_WHITE_BOX_{name}_H'
    lines = [f'/* {what}.', f' * {HEAD} */', f'#ifndef {guard}', f'#define {guard}', '']
    lines += [f'#include "white_box/{numbers}"', '']
    lines += [f'#define {name}_FINGERPRINT {fingerprint}', '', body, '', '#endif', '']
    return '\n'.join(lines)


def _fingerprint(body: str) -> int:
    return int(hashlib.sha256(body.encode()).hexdigest()[:15], 16)


def forms() -> dict[Path, str]:
    """Return what the files should hold."""
    blocks = c_forms()
    whole = whole_motor_form()
    of_blocks = _fingerprint(blocks)
    of_whole = _fingerprint(whole)
    what = 'Forms of the motor for compiled code, LANES motors at a time'
    of_one = 'Forms of a motor with a rotor for compiled code, one motor at a time'
    return {
        WHITE_BOX / 'forms.py': python_forms(of_blocks, of_whole),
        WHITE_BOX / 'forms.h': _header('FORMS', what, 'lanes.h', of_blocks, blocks),
        WHITE_BOX / 'whole_motor.h': _header('WHOLE_MOTOR', of_one, 'scalar.h', of_whole, whole),
    }


def main(arguments: Sequence[str] | None = None) -> int:
    """Write the files, or say which differs."""
    parser = argparse.ArgumentParser(
        prog='make_forms', description=(__doc__ or '').split('\n', 1)[0]
    )
    parser.add_argument(
        '--check',
        action='store_true',
        help='write nothing; fail if a file is not what it should be',
    )
    options = parser.parse_args(arguments)
    for path, text in forms().items():
        if not options.check:
            path.write_text(text, encoding='utf-8')
        elif path.read_text(encoding='utf-8') != text:
            print(
                f'make_forms: error: {path.name} is not what is declared; run make physics',
                file=sys.stderr,
            )
            return 1
    return 0


if __name__ == '__main__':
    raise SystemExit(main())
