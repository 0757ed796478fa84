"""Which effects a form may get for what the fit test suspects."""

from __future__ import annotations

from gray_box_observer.fit_test import FitAssessment
from gray_box_observer.fit_test.effects import HYSTERESIS, LOAD
from gray_box_observer.fit_test.twin_effects import LOAD_TORQUE, LOST_VOLTAGE, OFFSET
from gray_box_observer.observer.motor_forms.motor_form import QUADRATIC_FRICTION
from gray_box_observer.settings.motor_configuration import COASTING, CURRENT_LAG, DEAD_ZONE

NODES = {
    'lost_voltage': LOST_VOLTAGE,
    'dead_zone': DEAD_ZONE,
    'current_offset': OFFSET,
    'current_lag': CURRENT_LAG,
    'delay': CURRENT_LAG,
    LOAD: LOAD_TORQUE,
    HYSTERESIS: HYSTERESIS,
    COASTING: COASTING,
}
"""Effect that a form may have for a suspected one, by the name of that. What is late by a part of
a sample interval is a lag or a delay: a form knows the lag alone."""

OFFSET_OF_CURRENT = (LOAD_TORQUE, OFFSET)
"""Effects that an offset of the current is beside a rotor, where its speed is hidden: it drives the
shaft, too."""

BESIDE_A_ROTOR = {
    'lost_voltage': ((LOST_VOLTAGE,),),
    'dead_zone': ((LOST_VOLTAGE,), (DEAD_ZONE,)),
    'current_offset': (OFFSET_OF_CURRENT,),
    'sag': ((LOST_VOLTAGE,),),
    LOAD: ((QUADRATIC_FRICTION,), (LOAD_TORQUE,)),
    HYSTERESIS: ((HYSTERESIS,), (QUADRATIC_FRICTION,)),
}
"""Effects that leave what looks like a suspect where the speed is hidden, the likeliest first: the
rotor gives way to what is left out, so that several look alike."""

USUAL = (
    (LOST_VOLTAGE,),
    (LOAD_TORQUE,),
    (QUADRATIC_FRICTION,),
    (HYSTERESIS,),
    OFFSET_OF_CURRENT,
)
"""Effects that a rotor may need whatever it leaves, the commonest first."""

ON_THE_SHAFT = ((LOAD_TORQUE,), (QUADRATIC_FRICTION,), OFFSET_OF_CURRENT)
"""Those of them that a load which varies explains, too."""

BESIDE_A_LOAD = ((LOST_VOLTAGE,), (HYSTERESIS,))
"""Those of them that it leaves; only one of them shows beside it."""

FOLLOWED = 2
"""The likeliest suspects of a rotor that are followed."""


def suspected_beside_rotor(fit: FitAssessment) -> list[tuple[str, ...]]:
    """Return effects that leave what a rotor leaves, the likeliest first.

    Args:
        fit: what is known of that of the rotor.
    """
    suspects = [suspect.effect for suspect in fit.suspects[:FOLLOWED]]
    return [nodes for name in suspects for nodes in BESIDE_A_ROTOR.get(name, ())]
