"""What brushes or a driver that take some voltage would do to a rotor whose speed is hidden.

Where the current flows in the direction of a voltage of two levels, a loss is a share of it:
R, L and 1/J that are larger by ``V_b / V`` explain as much. The residual says nothing of it then,
nor does its derivative, for the motor that was found lies far from the true one.
"""

from __future__ import annotations

import numpy as np

from gray_box_observer.fit_test.effects import Scene, interval_means
from gray_box_observer.fit_test.evidence import Evidence
from gray_box_observer.fit_test.free_run import FreeRun
from gray_box_observer.fit_test.projection import Amount, Projection
from gray_box_observer.fit_test.rotor_free_run import RotorFreeRun
from gray_box_observer.fit_test.twin_effects import LOST_VOLTAGE
from gray_box_observer.settings.motor_configuration import DEAD_ZONE
from gray_box_observer.white_box.interface import Array, WhiteBox

LOSS_V = 0.5
"""Standard deviation of a voltage that may be lost."""

TELLING = 0.015
"""Share of the current's direction that the voltage must not explain: two levels leave up to 0.008,
for the current turns later than the voltage; levels in between, ramps and sines leave more."""

BOTH = 0.05
"""Share of the time in which the current has to flow either way, or it has one direction."""

EVIDENCE_OF_LOSS = 'loss_told'
"""Name of the evidence that a window has told of a loss."""


def loss_told(run: FreeRun) -> dict[str, Amount]:
    """Return evidence where the data of a window tell a loss; none where they do not.

    Args:
        run: free run of one motor.
    """
    direction = _direction(run)
    voltage_v = run.stretch.voltage_v[0]
    columns = [voltage_v]
    if BOTH < float(np.mean(direction > 0.0)) < 1.0 - BOTH:
        columns.append(np.ones_like(voltage_v))
    basis = np.column_stack(columns)
    weights = np.linalg.lstsq(basis, direction, rcond=1e-9)[0]
    rest = direction - basis @ weights
    is_told = float(rest @ rest) > TELLING * float(direction @ direction)
    return {EVIDENCE_OF_LOSS: Amount(0.0, 1.0)} if is_told else {}


def loss_shifts(
    white_box: WhiteBox, run: FreeRun, projection: Projection, evidence: Evidence
) -> Array:
    """Return by how much a loss leaves the log-parameters open, shape (1 or 0, parameter).

    Args:
        white_box: of one motor.
        run: its free run at the present values.
        projection: of its residual on the parameters.
        evidence: what this window and earlier ones tell.
    """
    names = [parameter.name for parameter in white_box.parameters]
    terms = {*names, *white_box.given}
    has_loss = not terms.isdisjoint((LOST_VOLTAGE, DEAD_ZONE))
    if not isinstance(run, RotorFreeRun) or has_loss or EVIDENCE_OF_LOSS in evidence.amounts:
        return np.empty((0, len(names)))
    response_a = run.response(-LOSS_V * _direction(run)[None])[0]
    return projection.shift(projection.with_weight(response_a))[None]


def _direction(run: FreeRun) -> Array:
    """Return the sign of the current, softened, shape (k,)."""
    return Scene(run.stretch.voltage_v[0], interval_means(run.current_a), None).direction
