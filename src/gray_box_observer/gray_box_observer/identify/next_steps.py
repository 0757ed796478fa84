"""What the user of ``identify`` can do about parameters that its recording does not tell."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from typing import Any

from gray_box_observer.context_nodes import Verdict, VerdictSettings
from gray_box_observer.fit_test.policy import SHORT, SHORTEST
from gray_box_observer.observer.motor_forms.motor_form import MEASURED, ROTOR
from gray_box_observer.observer.verdict_advice import ADVICE, LOAD_ADVICE
from gray_box_observer.settings.motor_configuration import CURRENT_LAG, VARYING_LOAD, is_mechanical
from gray_box_observer.settings.parameters import MOTOR_PARAMETERS, OBSERVER_PARAMETERS

REMEDIES = {
    Verdict.IMPLAUSIBLE: ADVICE[Verdict.IMPLAUSIBLE],
    Verdict.UNEXCITED: 'the recording tells nothing of it: vary the voltage',
    Verdict.CONVERGING: 'not known to 2 % yet: record for longer, or vary the voltage more',
}
"""By verdict, what matters most first."""

UNSETTLED = 'not borne out by the newest samples yet: record for longer'
"""The same of what converges though its deviation is small enough."""

BEHIND_FILTER = 'a filter of the current hides it: take it off, or undo it, as effects added says'
"""The same of an inductance beside a measured speed whose current passes a filter."""

OPEN = (Verdict.UNEXCITED.value, Verdict.CONVERGING.value)
"""Verdicts of what is not known yet."""

KNOWN = VerdictSettings().identified_relative_std
"""Deviation, relative to the value, below which a parameter may be called identified."""

WORD = re.compile(r'[^\s(),;:]+')

OBSERVER_NAMES = {spec.name for spec in OBSERVER_PARAMETERS if {'.', '_'} & set(spec.name)}
"""Of its parameters, those whose names are no plain words."""

MOTOR_NAMES = {spec.name for spec in MOTOR_PARAMETERS}


def place_of_parameters(sentences: Iterable[str]) -> str | None:
    """Say where the parameters go that sentences name; None where they name none."""
    words = (word.strip('\'".') for sentence in sentences for word in WORD.findall(sentence))
    name = next(filter(_is_parameter, words), None)
    if name is None:
        return None
    return (
        f'Parameters such as {name} go below ros__parameters in the file that --params names '
        '(--ros-args --params-file for the node).'
    )


def _is_parameter(word: str) -> bool:
    return word in OBSERVER_NAMES or ('/' not in word and word.partition('.')[2] in MOTOR_NAMES)


def next_steps(name: str, motor: Mapping[str, Any], *, stamps_exact: bool = False) -> list[str]:
    """Return one line for each thing to do about a motor whose fit is no misfit.

    Args:
        name: of the motor.
        motor: its result, as :func:`~gray_box_observer.identify.result.describe` gives it.
        stamps_exact: whether the user has said that voltage acts at the instant of its stamp.
    """
    verdicts = {p: entry['verdict'] for p, entry in motor['parameters'].items()}
    steps = []
    is_open = verdicts.get('inductance') in OPEN
    if is_open and motor['speed_source'] == MEASURED and CURRENT_LAG in motor.get('effects', ()):
        steps.append(f'inductance: {BEHIND_FILTER}')
        del verdicts['inductance']
    elif is_open:
        step = _of_short_time_constant(name, motor, stamps_exact=stamps_exact)
        if step is not None:
            steps.append(step)
            del verdicts['inductance']
    remedies = {
        parameter: _remedy(parameter, motor['parameters'][parameter], is_loaded=_is_loaded(motor))
        for parameter in verdicts
    }
    for remedy in (*REMEDIES.values(), UNSETTLED, LOAD_ADVICE):
        names = [parameter for parameter, own in remedies.items() if own == remedy]
        if names:
            steps.append(f'{", ".join(names)}: {remedy}')
    return steps


def _is_loaded(motor: Mapping[str, Any]) -> bool:
    """Tell whether the form of a motor has a load that varies."""
    return VARYING_LOAD in motor.get('effects', ())


def _remedy(parameter: str, entry: Mapping[str, Any], *, is_loaded: bool) -> str | None:
    """Say what to do about one parameter; None where nothing is asked for."""
    verdict = Verdict(entry['verdict'])
    if is_loaded and verdict.value in OPEN and is_mechanical(parameter):
        return LOAD_ADVICE
    if verdict is Verdict.CONVERGING and _is_sharp(entry):
        return UNSETTLED
    return REMEDIES.get(verdict)


def _is_sharp(entry: Mapping[str, Any]) -> bool:
    """Tell whether the deviation alone would let a parameter be called identified."""
    value = entry.get('value') or 0.0
    std = entry.get('std')
    return std is not None and bool(std < KNOWN * abs(value))


def _of_short_time_constant(
    name: str, motor: Mapping[str, Any], *, stamps_exact: bool
) -> str | None:
    """Say what to do where L/R is shorter than a sample interval; None where it is not."""
    values = [motor['parameters'].get(p, {}).get('value') for p in ('inductance', 'resistance')]
    if not (motor['samples'] and all(value is not None and value > 0.0 for value in values)):
        return None
    interval_s = motor['duration_s'] / motor['samples']
    time_constant_s = values[0] / values[1]
    limits = SHORT if motor['speed_source'] == ROTOR else SHORTEST
    if not time_constant_s < max(limits) * interval_s:
        return None
    remedy = 'sample faster'
    if not (stamps_exact or _is_loaded(motor)):
        others = [
            parameter
            for parameter, entry in motor['parameters'].items()
            if parameter != 'inductance' and entry['verdict'] in OPEN
        ]
        also = f'; {" and ".join(others)} may depend on it too' if others else ''
        remedy += (
            f', or set {name}.stamps_exact: true if voltage acts at the instant of its stamp{also}'
        )
    return (
        f'inductance: L/R of about {1e3 * time_constant_s:.2g} ms is shorter than the sample '
        f'interval of {1e3 * interval_s:.2g} ms: {remedy}'
    )
