"""What a rotor that nobody measures would do to an estimate whose speed is taken for Kt i.

A rotor that begins to turn has the speed of all the charge that has flowed: ``w = Kt / J`` times
the integral of i. With friction it comes to a speed in proportion to the current, and a voltage
that moves slowly shows no more than that. Both look like resistance, and leave next to nothing. How
much of it there is, the data tell together with what is likely beforehand. Where they would show
one, and do not, little is left of the odds.

What is taken for the winding may be the rotor, too. A current that falls from what a step has left
to what friction asks for falls as that of a large inductance. But behind a winding no current jumps
with the voltage, and before a rotor it does.
"""

from __future__ import annotations

import numpy as np

from gray_box_observer.context_nodes.recursive.constant_voltage import FROM_REST
from gray_box_observer.context_nodes.recursive.trajectory import recurrence
from gray_box_observer.fit_test.effects import interval_means
from gray_box_observer.fit_test.free_run import FreeRun
from gray_box_observer.fit_test.projection import Doubt
from gray_box_observer.samples.order_statistics import median
from gray_box_observer.samples.voltage_level import is_held
from gray_box_observer.white_box.interface import Array, WhiteBox
from gray_box_observer.white_box.motor import MotorWhiteBox

LIKELY = 1.0
"""Standard deviation beforehand of the back-EMF, over the voltage, root mean squares."""

ODDS = 1.0
"""That a rotor turns, beforehand. With more of them motors without one are identified later."""

INDUCTANCE_STD = 0.25
"""Relative standard deviation of L below which L/R is one."""

SLOWER = 4.0
"""Times L/R that a rotor takes at least to come to its speed. One that is faster hardly leaves a
trace beside the winding: with it no motor without a rotor could be known."""

FEWEST_INTERVALS = 4.0
"""Sample intervals that it takes at least, for the same reason."""

NEXT = 4.0
"""Factor from one such time to the next."""

LONGEST = 0.5
"""Share of the samples' time up to which friction tells a rotor from one without any."""


def hidden_rotor_doubts(
    white_box: WhiteBox, run: FreeRun, theta: Array, inductance_std: float
) -> list[Doubt]:
    """Return what rotors would do that rest where the samples begin.

    Of a voltage and a current that are held nothing is believed anyway.

    Args:
        white_box: of a motor whose speed is taken for Kt i.
        run: its free run.
        theta: shape (parameter,): its values.
        inductance_std: relative standard deviation of L.
    """
    assert isinstance(white_box, MotorWhiteBox)
    stretch = run.stretch
    is_settled = is_held(stretch.voltage_v[0]) and is_held(stretch.state[0])
    if is_settled:
        return []
    resistance_ohm = white_box.values(theta).get('resistance', 0.0)
    winding_s = run.inductance_h / resistance_ohm if resistance_ohm > 0.0 else 0.0
    interval_s = float(median(stretch.interval_s[0]))
    slower_s = SLOWER * winding_s if inductance_std < INDUCTANCE_STD else 0.0
    doubts = _of_back_emf(run, max(slower_s, FEWEST_INTERVALS * interval_s))
    if winding_s > interval_s:
        doubts.append(_of_jumps(run, winding_s, theta.size))
    return doubts


def _of_back_emf(run: FreeRun, fastest_s: float) -> list[Doubt]:
    """Return what speeds would do that follow the current without friction, and with it.

    Args:
        run: free run.
        fastest_s: shortest time in which a rotor comes to its speed.
    """
    interval_s = run.stretch.interval_s[0]
    current_a = interval_means(run.stretch.state[0])
    speeds = [np.cumsum(current_a * interval_s)]
    mechanical_s = fastest_s
    while 0.0 < mechanical_s < LONGEST * float(interval_s.sum()):
        decay = np.exp(-interval_s / mechanical_s)
        inputs = (current_a * (1.0 - decay))[None, None]
        speeds.append(recurrence(decay[None], inputs, np.zeros((1, 1)))[0, 0, 1:])
        mechanical_s *= NEXT
    voltage_v = float(np.sqrt(np.mean(run.stretch.voltage_v[0] ** 2)))
    sizes = [float(np.sqrt(np.mean(speed**2))) for speed in speeds]
    back_emfs_v = [
        LIKELY * voltage_v / size * speed
        for speed, size in zip(speeds, sizes, strict=True)
        if size > 0.0
    ]
    odds = ODDS / max(len(back_emfs_v), 1)
    return [Doubt(run.response(-one[None])[0], odds=odds) for one in back_emfs_v]


def _of_jumps(run: FreeRun, winding_s: float, parameters: int) -> Doubt:
    """Return what it would do that the current jumps with the voltage, by as much as R lets it.

    Then none of the parameters is what it was taken for. Before a current that rises from rest
    there was no voltage.

    Args:
        run: free run.
        winding_s: L/R.
        parameters: how many there are.
    """
    voltage_v = run.stretch.voltage_v[0]
    size_a = np.abs(run.stretch.state[0])
    rises = size_a[0] < FROM_REST * size_a.max()
    moves_v = np.diff(voltage_v, prepend=0.0 if rises else voltage_v[0])
    jumps_a = run.pulse_response((winding_s * moves_v)[None])[0]
    return Doubt(jumps_a, odds=ODDS, exchange=np.ones(parameters))
