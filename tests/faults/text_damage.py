"""Seeded damage to texts that people hand on: parameters, truths, metadata of bags."""

from __future__ import annotations

import random
import re
from collections.abc import Callable

TOKENS = (
    *(
        '&a ',
        '*a',
        '<<: *a\n',
        '<<: ',
        '!!python/object/apply:os.system ',
        '!!set ',
        '!!binary ',
        '!!float ',
        '! ',
    ),
    *(
        '? ',
        '- ',
        '{',
        '[',
        '}',
        ']',
        ': ',
        ', ',
        '"',
        "'",
        '|\n',
        '>-\n',
        '%YAML 9.9\n',
        '%TAG ! x\n',
        '--- \n',
        '...\n',
    ),
    *(
        '\t',
        '\x00',
        '\ufeff',
        '\x1b[31m',
        '\u2028',
        '\r',
        '~',
        '@',
        '`',
        '#',
        '\\',
        '\ud7ff',
        '\U0010ffff',
    ),
)
SCALARS = (
    *(
        '9' * 30,
        '-' + '9' * 30,
        '9' * 5000,
        '1' + '0' * 400,
        '9223372036854775808',
        '18446744073709551616',
    ),
    *(
        '1e400',
        '-1e400',
        '1e308',
        '-1e308',
        '1e-400',
        '4.9e-324',
        '.nan',
        '.inf',
        '-.Inf',
        'nan',
        'inf',
        '-0.0',
    ),
    *(
        '2024-99-99',
        '2024-01-01T25:61:61Z',
        '1_000',
        '0x7f',
        '0o17',
        '017',
        '0b1',
        '1:30:00',
        '1,5',
        '\uff11',
        '1e5f',
    ),
    *(
        'true',
        'no',
        'null',
        '',
        '""',
        '=',
        '<<',
        '"text"',
        '[]',
        '{}',
        '[[]]',
        '{a: 1}',
        '[1, a]',
        '-1',
        '0',
        '1.5',
    ),
    *(
        '["m[1..999999999]"]',
        '["a[1..60000]", "b[1..60000]"]',
        '[m, m]',
        '["", "a b", "../x"]',
        '[[0, 1], [1]]',
    ),
)
_VALUE = re.compile(r'(?<=[:\-] )[^\n\[{]*')
_NUMBER = re.compile(r'-?[0-9]+(?:\.[0-9]+)?')


def damaged(text: str, seed: str) -> tuple[bytes, str]:
    """Damage a text in one to three ways.

    Args:
        text: of a good file.
        seed: of everything drawn.

    Returns:
        The content of the file, and what was done to it.
    """
    draw = random.Random(seed)
    names = [draw.choice(list(WAYS)) for _ in range(draw.choice((1, 1, 2, 3)))]
    for name in names:
        text = WAYS[name](text, draw)
    content = text.encode('utf-8', 'surrogatepass')
    if draw.random() < 0.15:
        names.append(way := draw.choice(list(ENDS)))
        content = ENDS[way](content, draw)
    return content, ', '.join(names)


def _splice(text: str, draw: random.Random, piece: str) -> str:
    at = draw.randrange(len(text) + 1)
    return text[:at] + piece + text[at:]


def _replaced(pattern: re.Pattern[str], text: str, draw: random.Random, new: str) -> str:
    """Put something else in the place of one of the parts that match."""
    found = list(pattern.finditer(text))
    if not found:
        return text + new
    part = draw.choice(found)
    return text[: part.start()] + new + text[part.end() :]


def _token(text: str, draw: random.Random) -> str:
    for _ in range(draw.choice((1, 2, 5))):
        text = _splice(text, draw, draw.choice(TOKENS))
    return text


def _nesting(_: str, draw: random.Random) -> str:
    depth = draw.choice((5, 40, 1000, 20_000))
    opening, closing = draw.choice(
        (('[', ']'), ('{a: ', '}'), ('- ', ''), ('[{a: ', '}]'), ('? ', ''), ('(', ')'))
    )
    return opening * depth + draw.choice(('1', '')) + closing * draw.choice((depth, depth - 1))


def _bomb(text: str, draw: random.Random) -> str:
    """Anchors and merge keys of which every level stands for nine of the one before."""
    levels = draw.randrange(2, 12)
    form = draw.choice(('&a{} [{}]', '&a{}\n  <<: [{}]'))
    lines = ['a0: &a0 {k: v}\n']
    lines += [f'a{k}: {form.format(k, ", ".join([f"*a{k - 1}"] * 9))}\n' for k in range(1, levels)]
    return ''.join(lines) + text if draw.random() < 0.5 else text + '\n' + ''.join(lines)


def _repeated_line(text: str, draw: random.Random) -> str:
    lines = text.splitlines(keepends=True)
    at = draw.randrange(len(lines)) if lines else 0
    return ''.join([*lines[:at], *lines[at : at + 1], *lines[at:]])


def _indented_line(text: str, draw: random.Random) -> str:
    lines = text.splitlines(keepends=True) or ['']
    at = draw.randrange(len(lines))
    lines[at] = draw.choice((' ', '    ', '\t', '')) + lines[at].lstrip()
    return ''.join(lines)


def _removed_range(text: str, draw: random.Random) -> str:
    at = draw.randrange(len(text) + 1)
    return text[:at] + text[at + draw.randrange(1, 100) :]


def _repeated_range(text: str, draw: random.Random) -> str:
    at = draw.randrange(len(text) + 1)
    size = draw.randrange(1, 200)
    return text[:at] + text[at : at + size] * draw.choice((2, 3, 500)) + text[at + size :]


def _large(text: str, draw: random.Random) -> str:
    """A text near the bound of its size, or beyond it."""
    if draw.random() < 0.9:  # now and then only: it takes long
        return text
    unit = draw.choice((text or 'a', '- a\n', 'a: b\n', '[a, ', 'a ', '"a" ', '#', '\n', 'a\n'))
    return unit * (draw.choice((1 << 20, 4 << 20, 5 << 20)) // len(unit))


WAYS: dict[str, Callable[[str, random.Random], str]] = {
    'tokens': _token,
    'another scalar': lambda text, draw: _replaced(_VALUE, text, draw, draw.choice(SCALARS)),
    'another number': lambda text, draw: _replaced(_NUMBER, text, draw, draw.choice(SCALARS)),
    'nesting as a value': lambda text, draw: _replaced(_VALUE, text, draw, _nesting(text, draw)),
    'nesting anywhere': lambda text, draw: _splice(text, draw, _nesting(text, draw)),
    'merge keys': _bomb,
    'a line twice': _repeated_line,
    'a line indented': _indented_line,
    'a range removed': _removed_range,
    'a range repeated': _repeated_range,
    'truncated': lambda text, draw: text[: draw.randrange(len(text) + 1)],
    'large': _large,
}


def _flipped(content: bytes, draw: random.Random) -> bytes:
    flipped = bytearray(content or b'\x00')
    for _ in range(draw.choice((1, 3, 20))):
        flipped[draw.randrange(len(flipped))] ^= 1 << draw.randrange(8)
    return bytes(flipped)


ENDS: dict[str, Callable[[bytes, random.Random], bytes]] = {
    'bits flipped': _flipped,
    'bytes at random': lambda content, draw: draw.randbytes(draw.randrange(5000)),
    'another encoding': lambda content, draw: content.decode('utf-8', 'replace').encode(
        draw.choice(('utf-16', 'utf-32', 'utf-8-sig', 'cp037')), 'replace'
    ),
}
"""What is done to the bytes, behind the text."""
