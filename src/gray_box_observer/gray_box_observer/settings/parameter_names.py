"""Names of parameters that nobody declared: whether they are slips of one that is, and of which."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from difflib import SequenceMatcher, get_close_matches

from gray_box_observer.errors import brief

ALIKE = 0.7
"""Share of letters that two parts of a name have in common where one may be a slip of the other."""

SUGGESTED = 0.5
"""The same of whole names, where there is none of which it may be a slip."""

MOST_TOLD = 8

MOST_COMPARED = 1000
"""Unknown names that are compared with the known ones; a file of more is none of slips."""


def slip_of(name: str, valid_names: Iterable[str]) -> str:
    """Return the known name that a name is a slip of: all parts but one are the same, one is alike.

    Args:
        name: parts joined by dots.
        valid_names: likewise.

    Returns:
        The name that is most alike; empty where there is none.
    """
    parts = name.split('.')
    best_name = ''
    alike = ALIKE
    for candidate in valid_names:
        candidate_parts = candidate.split('.')
        differing_parts = [
            pair for pair in zip(parts, candidate_parts, strict=False) if pair[0] != pair[1]
        ]
        if len(parts) == len(candidate_parts) and len(differing_parts) == 1:
            ratio = SequenceMatcher(None, *differing_parts[0]).ratio()
            if ratio >= alike and (not best_name or ratio > alike):
                best_name = candidate
                alike = ratio
    return best_name


def is_of_another_group(name: str, valid_names: Iterable[str]) -> bool:
    """Tell whether a name is a known one but for its first part, as that of another motor.

    Args:
        name: parts joined by dots.
        valid_names: likewise.
    """
    _, dot, rest = name.partition('.')
    return bool(dot) and any(candidate.partition('.')[2] == rest for candidate in valid_names)


def without_group(name: str, valid_names: Iterable[str]) -> str:
    """Return the known name that a name without a group may stand for; empty where it is none.

    Args:
        name: parts joined by dots, or the same below a range of motors, such as ``m[1..9]``.
        valid_names: parts joined by dots.
    """
    start, bracket, end = name.partition('].')
    own = end if bracket and '[' in start else name
    return next((valid for valid in valid_names if valid.partition('.')[2] == own), '')


def nearest(name: str, valid_names: Iterable[str]) -> str:
    """Return the known name that comes nearest to a name; empty where none is anything like it."""
    names = list(valid_names)
    return slip_of(name, names) or next(iter(get_close_matches(name, names, 1, SUGGESTED)), '')


def in_words(names: Mapping[str, str]) -> str:
    """Tell unknown names, each with the one that may have been meant.

    Args:
        names: by the unknown name, the known one; empty where there is none.
    """
    phrases = [
        f'{_short(name)} (did you mean {near}?)' if near else _short(name)
        for name, near in names.items()
    ]
    more = f' and {len(phrases) - MOST_TOLD} more' if len(phrases) > MOST_TOLD else ''
    return ', '.join(phrases[:MOST_TOLD]) + more


def _short(name: str) -> str:
    return brief(name)[1:-1]
