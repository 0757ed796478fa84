"""What a test of a motor's fit must be like that comes from a checkpoint."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from gray_box_observer.errors import CheckpointError
from gray_box_observer.fit_test.assessment import FitVerdict
from gray_box_observer.fit_test.evidence import MOST as MOST_AMOUNT
from gray_box_observer.safe_io.printable import printable
from gray_box_observer.safe_io.saved_state import (
    LARGEST,
    MOST,
    ArrayRule,
    check_covariance,
    entry,
    flag,
    group,
    number,
    number_or_none,
    numbers,
    positive,
    whole,
)

LONGEST_WAIT = 2048
"""Samples between two tests of a motor, at most."""

MOST_SUSPECTS = 3
"""That are named of one motor."""

LONGEST_REMEDY = 500
"""Characters of a remedy."""

MOST_AMOUNTS = 32
"""Amounts that tests tell of one motor, at most."""

MOST_AHEAD = 65536
"""Samples, at most, by which a test may stand ahead of what is remembered: where the speed of the
whole motor is believed, that ends with its last fit."""


def check_saved_test(plain: dict[str, Any], parameters: int) -> None:
    """Refuse a saved state that no test could have left.

    Args:
        plain: it.
        parameters: how many the motor has.

    Raises:
        CheckpointError: something is missing, or out of its range.
    """
    whole(plain, 'due', -MOST, MOST)
    if plain.get('soon') is not None:
        whole(plain, 'soon', -MOST, MOST)
    if 'tested_at' in plain:
        whole(plain, 'tested_at', -MOST, MOST_AHEAD)
    if 'is_withheld' in plain:
        flag(plain, 'is_withheld')
    if 'untested_spread' in plain:
        spread = numbers(plain, 'untested_spread', ArrayRule((parameters, parameters)))
        check_covariance('fit.untested_spread', spread)
    if 'assessment' in plain:
        check_saved_result(plain, parameters)


def check_saved_result(plain: Mapping[str, Any], parameters: int) -> None:
    """Refuse a saved result that no test could have left; arguments are those above.

    Raises:
        CheckpointError: it is such.
    """
    assessment = group(plain, 'assessment')
    if entry(assessment, 'verdict') not in [verdict.value for verdict in FitVerdict]:
        raise CheckpointError('fit.verdict is none of those that there are')
    number_or_none(assessment, 'ratio', 0.0, LARGEST)
    number_or_none(assessment, 'whiteness', 0.0, LARGEST)
    whole(assessment, 'samples')
    suspects = entry(assessment, 'suspects')
    if not isinstance(suspects, list) or len(suspects) > MOST_SUSPECTS:
        raise CheckpointError(f'fit.suspects is no list of at most {MOST_SUSPECTS}')
    for suspect in suspects:
        number(suspect, 'evidence', -LARGEST, LARGEST)
        if set(suspect) != {'effect', 'evidence', 'remedy'}:
            raise CheckpointError(
                'a suspect of the fit has other entries than effect, evidence and remedy'
            )
        texts = [suspect[name] for name in ('effect', 'remedy')]
        if not all(
            isinstance(text, str) and text == printable(text, LONGEST_REMEDY) for text in texts
        ):
            raise CheckpointError(
                'a suspect of the fit has a name or a remedy that nobody can have written'
            )
    numbers(plain, 'factor', ArrayRule((parameters,), 1.0, LARGEST))
    check_covariance('fit.spread', numbers(plain, 'spread', ArrayRule((parameters, parameters))))
    numbers(plain, 'theta', positive(parameters))
    whole(plain, 'place', -MOST, MOST_AHEAD)
    whole(plain, 'begin', -MOST, MOST_AHEAD)
    whole(plain, 'wait', 1, LONGEST_WAIT)
    number(plain, 'range_v', 0.0, LARGEST)
    whole(plain, 'misfits')
    if 'noise_a' in plain:
        number(plain, 'noise_a', 0.0, LARGEST)
    if 'has_fitted' in plain:
        flag(plain, 'has_fitted')
    if 'doubts_speed' in plain:
        flag(plain, 'doubts_speed')
    if 'speed_is_fitted' in plain:
        flag(plain, 'speed_is_fitted')
    if 'evidence' in plain:
        check_evidence(group(plain, 'evidence'))
    if 'present_since' in plain:  # releases before kept none
        whole(plain, 'present_since', -MOST, MOST_AHEAD)
    if 'delay_s' in plain:
        number(plain, 'delay_s', -LARGEST, LARGEST)


def check_evidence(plain: Mapping[str, Any]) -> None:
    """Refuse evidence that no test could have left.

    Raises:
        CheckpointError: it is such.
    """
    number(plain, 'samples', 0.0, float(MOST))
    amounts = group(plain, 'amounts')
    if len(amounts) > MOST_AMOUNTS:
        raise CheckpointError(f'fit.evidence holds {len(amounts)} amounts, at most {MOST_AMOUNTS}')
    for name in amounts:
        if name != printable(name, LONGEST_REMEDY):
            raise CheckpointError('fit.evidence has a name that nobody can have written')
        pair = numbers(amounts, name, ArrayRule((2,), -MOST_AMOUNT, MOST_AMOUNT))
        if not pair[1] > 0.0:
            raise CheckpointError('fit.evidence has a standard deviation that is none')
