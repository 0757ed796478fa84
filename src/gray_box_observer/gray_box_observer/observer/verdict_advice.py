"""What the verdicts of a motor ask its user to do, as one line."""

from __future__ import annotations

from gray_box_observer.context_nodes import Estimate, Verdict

ADVICE = {
    Verdict.IMPLAUSIBLE: 'check torque_constant, units and sign of voltage and torque',
    Verdict.UNEXCITED: 'not excited: vary the voltage',
}
"""By verdict, what matters most first."""


def verdict_advice(estimate: Estimate) -> str | None:
    """Return what to do about the verdicts of the first motor; None where nothing is asked for."""
    for verdict, advice in ADVICE.items():
        at = [j for j, own_verdict in enumerate(estimate.verdicts[0]) if own_verdict is verdict]
        if at:
            names = [
                f'{estimate.parameters[j].name} {estimate.bound_met(0, j)}'.rstrip() for j in at
            ]
            return f'{", ".join(names)}: {advice}'
    return None
