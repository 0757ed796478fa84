"""What a run over bags has found, as plain values: the same words wherever it is told."""

from __future__ import annotations

import math
from typing import Any

from gray_box_observer.data_sheet import contradiction
from gray_box_observer.offline import Outcome
from gray_box_observer.predictor.alarm import REMEDY
from gray_box_observer.samples import Rejection


def warnings_of(outcome: Outcome) -> list[str]:
    """Return everything that the user should know of a run, one sentence each."""
    observer = outcome.observer
    unseen = [name for name in observer.configuration.motors if name not in observer.motors]
    motors = observer.configuration.motors
    doubts = {name: contradiction(motors[name], estimate) for name, estimate in observer.estimates().items()}
    complaints = [delay.complaint(name) for name, delay in observer.delays().items()]
    return [
        *outcome.warnings,
        *(f'no usable sample of motor {name}; it is not in the result' for name in unseen),
        *(
            f'{counts.total()} messages of {name} could not be read'
            for name, counts in outcome.intake.rejected.items()
            if counts
        ),
        *(
            f'motor {name}: alarm at {course.alarms_s[0]:.2f} s, {len(course.alarms_s)} in all: {REMEDY}'
            for name, course in outcome.courses.items()
            if course.alarms_s
        ),
        *(complaint for complaint in complaints if complaint is not None),
        *(f'motor {name}: {doubt}' for name, doubt in doubts.items() if doubt is not None),
    ]


def describe(outcome: Outcome) -> dict[str, Any]:
    """Return the result as plain values: what ``--json`` writes."""
    motors: dict[str, dict[str, Any]] = {}
    delays = outcome.observer.delays()
    for name, estimate in outcome.observer.estimates().items():
        pairing = outcome.observer.counts(name)
        rejected = {reason.value: pairing.rejected[reason] for reason in Rejection}
        skill = outcome.observer.skill(name)
        motors[name] = {
            'samples': pairing.used,
            'duration_s': round(outcome.courses[name].duration_s, 6),
            'rejected': rejected,
            'parameters': {
                p.name: {
                    'value': float(estimate.value[0, j]),
                    'std': float(estimate.std[0, j]),
                    'unit': p.unit,
                    'verdict': estimate.verdicts[0][j].value,
                }
                for j, p in enumerate(estimate.parameters)
            },
            'covariance': estimate.covariance[0].tolist(),
            'predictor': None if skill is None else skill.to_dict(),
            'alarms': None,
        }
        if outcome.observer.motors[name].alarm is not None:
            times_s = [round(time_s, 6) for time_s in outcome.courses[name].alarms_s]
            motors[name]['alarms'] = {'raised': len(times_s), 'first_s': times_s[0] if times_s else None}
        delay = delays[name]
        if delay.asked or delay.complaint(name) is not None:
            found = [None if math.isnan(number) else number for number in (delay.value_s, delay.std_s)]
            motors[name]['delay_s'] = {'value': found[0], 'std': found[1], 'applied': delay.applied_s}
    return {'motors': motors, 'digest': outcome.digest}
