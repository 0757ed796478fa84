"""The thesis's motor, whose speed is Kt i: does leaving the form open cost anything?"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from common.cases import Record
from common.claims import claims
from common.cramer_rao import bound
from common.motion import FloatArray
from common.rotor.runs import MOTOR
from gray_box_observer.context_nodes.estimate import COUNTS_AS_KNOWN
from gray_box_observer.observer.observer import Observer
from gray_box_observer.settings.configuration import Configuration

NOISE = 0.01
"""Standard deviation of the torque noise, as a share of the torque's."""


@dataclass(frozen=True, slots=True)
class ThesisTrial:
    """What became of one record of a thesis set.

    Attributes:
        source: where the speed comes from at the end.
        over_bound: shape (parameter,): errors at the end, in standard deviations of the bound; NaN
            of what another form does not have.
        known_s: when all parameters were known for the first time; infinite where they never were.
        claims, false: identified parameters over all estimates, and those of them that were false.
    """

    source: str
    over_bound: FloatArray
    known_s: float
    claims: int
    false: int


def run_thesis_set(record: Record, source: str) -> ThesisTrial:
    """Run the observer over a record.

    Args:
        record: of a motor without a rotor.
        source: its ``speed_source``.
    """
    case = record.case
    constants = {
        'torque_constant': case.plant.torque_constant,
        'back_emf_constant': case.plant.back_emf_constant,
        'speed_source': source,
    }
    parameters = {f'{MOTOR}.{name}': value for name, value in constants.items()}
    observer = Observer(Configuration.from_flat(parameters), None)
    known_s = math.inf
    claim_counts = np.zeros(2, dtype=int)
    rows = zip(
        record.stamp_ns.tolist(), record.voltage_v.tolist(), record.torque_nm.tolist(), strict=True
    )
    for stamp_ns, volt, torque_nm in rows:
        observer.voltage(MOTOR, stamp_ns, volt)
        for result in observer.torque(MOTOR, stamp_ns, torque_nm):
            if result.estimate is None:
                continue
            names = [parameter.name for parameter in result.estimate.parameters]
            claim_counts += claims(result.estimate, case.plant, names)
            if set(result.estimate.verdicts[0]) <= set(COUNTS_AS_KNOWN):
                known_s = min(known_s, (stamp_ns - int(record.stamp_ns[0])) * 1e-9)
    observer.finish()
    last = observer.estimates()[MOTOR]
    values = dict(zip((p.name for p in last.parameters), last.value[0].tolist(), strict=True))
    found = np.array([values.get(name, math.nan) for name in case.parameters])
    return ThesisTrial(
        observer.motors[MOTOR].white_box.speed_source,
        (found / case.truth - 1.0) / bound(record),
        known_s,
        *claim_counts.tolist(),
    )
