"""Settings of the recursive rule."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class RecursiveSettings:
    """Settings of the recursive rule.

    Attributes:
        block: samples between two updates.
        first_fit: samples before the first fit.
        replay_capacity: samples remembered for repeated fits; beyond, linearisation errors no
            longer matter.
        prior_relative_std: of the initial guess, in every coordinate.
        drift_relative_std: how far a coordinate may have gone when the motor has changed.
        drift_threshold: of the chi-square statistic; 60 is passed by chance once in 1e11 for four
            parameters.
        noise_floor: smallest noise of the current that is believed, as a fraction of its size.
        noise_memory: samples over which the noise level is followed.
        long_hold_s: in a longer hold of the voltage the winding warms, and its level moves only
            what heats.
    """

    block: int = 32
    first_fit: int = 40
    replay_capacity: int = 4096
    prior_relative_std: float = 2.0
    drift_relative_std: float = 0.4
    drift_threshold: float = 60.0
    noise_floor: float = 1e-5
    noise_memory: int = 3000
    long_hold_s: float = 60.0
