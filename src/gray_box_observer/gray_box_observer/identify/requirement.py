"""What ``identify --require`` asks of every motor, for scripts that read an exit code."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from gray_box_observer.context_nodes.estimate import COUNTS_AS_KNOWN
from gray_box_observer.fit_test import FitVerdict

EXIT_UNMET = 4

FIT = 'fit'
IDENTIFIED = 'identified'

REQUIREMENTS = (FIT, IDENTIFIED)
"""The white box explains the data; and every parameter is known besides."""


def shortfalls(
    requirement: str, result: Mapping[str, Any], configured_motors: Iterable[str]
) -> list[str]:
    """Return what keeps a requirement from being met, one phrase a motor; empty where it is met.

    Args:
        requirement: one of :data:`REQUIREMENTS`.
        result: as :func:`~gray_box_observer.identify.result.describe` gives it.
        configured_motors: names; one without a usable sample meets nothing.
    """
    motors = result['motors']
    phrases = [
        f'motor {name}: no usable sample' for name in configured_motors if name not in motors
    ]
    for name, motor in motors.items():
        verdict = motor['fit']['verdict']
        findings = [] if verdict == FitVerdict.OK.value else [f'the fit is {verdict}']
        if requirement == IDENTIFIED:
            findings += [
                f'{parameter} is {entry["verdict"]}'
                for parameter, entry in motor['parameters'].items()
                if entry['verdict'] not in {one.value for one in COUNTS_AS_KNOWN}
            ]
        if findings:
            phrases.append(f'motor {name}: {", ".join(findings)}')
    return phrases
