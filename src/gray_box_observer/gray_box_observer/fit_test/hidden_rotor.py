"""What a rotor that nobody measures would do to an estimate whose speed is taken for Kt i.

A rotor that begins to turn has the speed of all the charge that has flowed: ``w = Kt / J`` times
the integral of i. In the first moves of a voltage that looks like resistance, and leaves next to
nothing. How much of it there is, the data tell together with what is likely beforehand. Where they
would show one, and do not, little is left of the odds.
"""

from __future__ import annotations

import numpy as np

from gray_box_observer.fit_test.effects import interval_means
from gray_box_observer.fit_test.free_run import FreeRun
from gray_box_observer.fit_test.projection import Doubt
from gray_box_observer.samples.voltage_level import is_held

LIKELY = 1.0
"""Standard deviation beforehand of the back-EMF, over the voltage, root mean squares."""

ODDS = 1.0
"""That a rotor turns, beforehand. With more of them motors without one are identified later."""


def hidden_rotor_doubts(run: FreeRun) -> list[Doubt]:
    """Return what a rotor without friction would do that rests where the samples begin.

    Of a voltage and a current that are held nothing is believed anyway.

    Args:
        run: free run of a motor whose speed is taken for Kt i.
    """
    stretch = run.stretch
    charge = np.cumsum(interval_means(stretch.state[0]) * stretch.interval_s[0])
    size = float(np.sqrt(np.mean(charge**2)))
    is_settled = is_held(stretch.voltage_v[0]) and is_held(stretch.state[0])
    if not size > 0.0 or is_settled:
        return []
    voltage_v = float(np.sqrt(np.mean(stretch.voltage_v[0] ** 2)))
    back_emf_v = LIKELY * voltage_v / size * charge
    return [Doubt(run.response(-back_emf_v[None])[0], odds=ODDS)]
