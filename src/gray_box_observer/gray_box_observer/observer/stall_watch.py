"""Whether a driven rotor stands still: voltage and current are there, and no speed."""

from __future__ import annotations

LEAST_V = 0.25
"""Voltage that drives a motor, as a share of the largest one seen."""

LEAST_DROP = 0.7
"""Share of the voltage that the resistance takes of a rotor that stands still, at least."""

STILL = 0.03
"""Speed that is none, as a share of the no-load speed at the voltage in force."""

SHORTEST_S = 0.3
"""Time from which a rotor that stands still is stalled: one that turns round stands for less."""


class StallWatch:
    """Follows whether one motor stalls.

    Attributes:
        still_s: how long it has been driven without turning, in s.
        voltage_v, current_a: newest ones.
        count: stalls so far.
    """

    def __init__(self) -> None:
        self.still_s = 0.0
        self.voltage_v = 0.0
        self.current_a = 0.0
        self.count = 0
        self._largest_v = 0.0
        self._constants = 0.0, 0.0

    @property
    def is_stalled(self) -> bool:
        """Whether the rotor stands still now, though it is driven."""
        return self.still_s >= SHORTEST_S

    @property
    def sentence(self) -> str | None:
        """Say that the rotor stands still; None where it does not."""
        if not self.is_stalled:
            return None
        return (
            f'stalled: {self.voltage_v:.3g} V and {self.current_a:.3g} A for {self.still_s:.1f} s, '
            'and the rotor does not turn: is it blocked?'
        )

    def step(
        self,
        interval_s: float,
        voltage_v: float,
        current_a: float,
        speed_rad_s: float | None,
        constants: tuple[float, float],
    ) -> None:
        """Go on by one sample.

        Args:
            interval_s: time since the sample before; 0 where a signal history begins.
            voltage_v: mean voltage of that interval.
            current_a: at the sample.
            speed_rad_s: likewise; None where none may be believed: a stall then lasts as long as
                voltage and current are what they were in it.
            constants: R in ohm and Kb in V s/rad, which count with a speed.
        """
        if speed_rad_s is not None:
            self._constants = constants
        resistance, back_emf = self._constants
        self.voltage_v = voltage_v
        self.current_a = current_a
        self._largest_v = max(self._largest_v, abs(voltage_v))
        is_driven = (
            abs(voltage_v) >= LEAST_V * self._largest_v
            and resistance * current_a * voltage_v >= LEAST_DROP * voltage_v**2 > 0.0
        )
        is_still = self.is_stalled
        if speed_rad_s is not None:
            is_still = back_emf * abs(speed_rad_s) < STILL * abs(voltage_v)
        if interval_s <= 0.0 or not (is_driven and is_still):
            self.still_s = 0.0
            return
        was_stalled = self.is_stalled
        self.still_s += interval_s
        self.count += self.is_stalled and not was_stalled
