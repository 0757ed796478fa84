"""Constant errors of the voltage's stamps: what they do to the current, and how much shows."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from gray_box_observer.context_nodes.measured_speed.late_instant import LateInstant
from gray_box_observer.fit_test.evidence import Evidence
from gray_box_observer.fit_test.free_run import FreeRun
from gray_box_observer.fit_test.input_noise_bias import InputNoiseBias
from gray_box_observer.fit_test.projection import UNKNOWN, Amount, Projection
from gray_box_observer.white_box.interface import Array

DELAY = 'delay'
LEAD = 'lead'
INSTANT = 'instant'
"""Names of what windows tell of such errors, in sample intervals."""

STAMP_STD = 0.05
"""Standard deviation of a constant error, in sample intervals, that the stamps of a driver are
thought to have: by how much a voltage acts later or earlier than they say."""

STAMP_STDS = 4.0
"""Standard deviations from which the data are thought to tell such an error."""

RARE = 0.05
"""Share of the samples at which a voltage moves below which no controller sets it."""


@dataclass(frozen=True, eq=False)
class StampError:
    """A constant error of the voltage's stamps.

    Attributes:
        shift: shape (parameter,): by how much the logarithms of the parameters would move by an
            error of one sample interval.
        amount: how much of it the data tell, in sample intervals, all parameters being free.
    """

    shift: Array
    amount: Amount

    @property
    def likely_amount(self) -> Amount:
        """The amount where it is known beforehand how exact the stamps of a driver are."""
        return self.amount.likely(STAMP_STD)

    @property
    def is_shown(self) -> bool:
        """Whether the data tell that there is such an error."""
        amount = self.likely_amount
        return abs(amount.mean) > STAMP_STDS * amount.std


@dataclass(frozen=True)
class StampErrors:
    """Constant errors of the voltage's stamps that the residual is asked for.

    Attributes:
        delay: the voltage acts later.
        lead: it acts earlier.
        instant: it acts later within its interval, to first order: a pulse is missing at the start
            of the interval. Where L/R is far below an interval, the current has forgotten it at the
            end, and only a rotor remembers it. What the current still shows looks like a larger
            inductance.
    """

    delay: StampError
    lead: StampError
    instant: StampError


def stamp_responses(run: FreeRun) -> dict[str, Array]:
    """Return how the current answers where the voltage acts later or earlier than it is stamped.

    By one sample interval each. Small parts of it do not only differ in sign: of a delay the
    interval in which the voltage has moved tells, of a lead the one before.

    Returns:
        Shape (k + 1,) each, in A, by the name of the error.
    """
    voltage_v = run.stretch.voltage_v[0]
    later_v = -np.diff(voltage_v, prepend=voltage_v[:1])
    earlier_v = np.diff(voltage_v, append=voltage_v[-1:])
    later_a, sooner_a = run.response(np.stack([later_v, earlier_v]))
    pulses_vs = later_v * run.stretch.interval_s[0]
    return {DELAY: later_a, LEAD: sooner_a, INSTANT: run.pulse_response(pulses_vs[None])[0]}


def stamp_amounts(
    run: FreeRun,
    projection: Projection,
    responses_a: Mapping[str, Array],
    noise_a: float,
    bias: InputNoiseBias | None = None,
    *,
    is_white: bool,
) -> dict[str, Amount]:
    """Return how much a window tells of every error, by name.

    Args:
        run: the free run.
        projection: of its residual on the parameters.
        responses_a: what :func:`stamp_responses` gives.
        noise_a: standard deviation of the residual in A.
        bias: what noise of voltage or speed does to products with the residual; None: there is
            none.
        is_white: whether it is white.
    """
    tools_a = _tools(run, responses_a)
    biases = np.zeros(len(tools_a))
    if bias is not None:
        biases, _ = bias.of_responses(
            projection.with_weight(np.stack([*tools_a.values()])),
            lambda noisy_run: np.stack([*_tools(noisy_run, stamp_responses(noisy_run)).values()]),
        )
    return {
        name: projection.amount(
            responses_a[name],
            noise_a,
            is_white=is_white,
            instrument_a=tool_a,
            bias=float(of_noise),
        )
        for (name, tool_a), of_noise in zip(tools_a.items(), biases, strict=True)
    }


def stamp_errors(
    projection: Projection, responses_a: Mapping[str, Array], evidence: Evidence
) -> StampErrors:
    """Return what errors of the stamps do to a window, and how much of them all windows tell.

    Args:
        projection: of the window's residual on the parameters.
        responses_a: what :func:`stamp_responses` gives.
        evidence: of all windows.
    """
    errors = {
        name: StampError(
            -projection.shift(projection.with_weight(response_a)), evidence.amount(name)
        )
        for name, response_a in responses_a.items()
    }
    return StampErrors(**errors)


def beside_measured_speed(errors: StampErrors, late_instant: LateInstant | None) -> StampErrors:
    """Return the errors where a speed is measured: the white box has no rotor that tells them.

    Args:
        errors: as the voltage balance has them.
        late_instant: as the fit of the whole motor has it; None: nothing is told, and the instant
            moves the parameters as a delay of a whole interval does.
    """
    if late_instant is None:
        return replace(errors, instant=StampError(errors.delay.shift, UNKNOWN))
    shift = late_instant.shift[: errors.delay.shift.size]
    amount = Amount(late_instant.mean, late_instant.std)
    return replace(errors, instant=StampError(shift, amount))


def _tools(run: FreeRun, responses_a: Mapping[str, Array]) -> dict[str, Array]:
    """Return what to look for every error with, shape (k + 1,): mostly its response itself.

    A controller answers the noise of a reading by its next voltage, and so seems to know it
    beforehand. A voltage that hardly ever moves answers none.
    """
    tools_a = dict(responses_a)
    voltage_v = run.stretch.voltage_v[0]
    if np.count_nonzero(np.diff(voltage_v)) >= RARE * voltage_v.size:
        tools_a[LEAD] = np.concatenate([[0.0], run.decay * responses_a[LEAD][:-1]])
    return tools_a
