"""From traces to the numbers of a row: RMS over seeds, multiples of the bound, settling, NEES."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from common.motion import FloatArray
from common.settling import settled_s
from common.trace import Trace

DIVERGED = 0.1
"""A run whose final error exceeds this fraction of any parameter, or that failed, has diverged."""

SETTLED = 0.01


@dataclass(frozen=True, slots=True)
class Summary:
    """One method on one case at one noise.

    Attributes:
        runs: number of seeds.
        error: shape (parameter,): root mean square over seeds of the final error, as a fraction.
        worst: largest final error of any parameter and seed, as a fraction.
        multiple: shape (parameter,): the same in units of each seed's bound; NaN without noise.
        overall: root mean square of the multiples over the parameters.
        diverged: runs that ended far off.
        settle_s: median time from which every parameter stays within 1 %.
        nees: mean over seeds; NaN where no covariance is stated.
        identified: parameters called identified, over all marks.
        overconfident: those of them beyond three stated standard deviations.
        alarms: drifts announced.
    """

    runs: int
    error: FloatArray
    worst: float
    multiple: FloatArray
    overall: float
    diverged: int
    settle_s: float
    nees: float
    identified: int
    overconfident: int
    alarms: int


def summarise(runs: Sequence[tuple[Trace, FloatArray, FloatArray]], noise: float) -> Summary:
    """Put the seeds together; a failed run counts as infinitely wrong, it is never left out."""
    final = np.nan_to_num(
        np.abs([trace.error[-1] for trace, _, _ in runs]), nan=np.inf, posinf=np.inf
    )
    limits = np.array([bounds[-1] for _, bounds, _ in runs])
    multiples = final / limits if noise > 0.0 else np.full_like(final, np.nan)
    settle = [
        settled_s(np.max(np.abs(trace.error), axis=1), time_s, SETTLED) for trace, _, time_s in runs
    ]
    squares = np.mean(multiples**2, axis=0)
    return Summary(
        runs=len(runs),
        error=np.sqrt(np.mean(final**2, axis=0)),
        worst=float(final.max()),
        multiple=np.sqrt(squares),
        overall=float(np.sqrt(np.mean(squares))),
        diverged=int(np.sum(np.any(final > DIVERGED, axis=1))),
        settle_s=float(np.median(settle)),
        nees=float(np.mean([trace.nees for trace, _, _ in runs])),
        identified=sum(trace.identified for trace, _, _ in runs),
        overconfident=sum(trace.overconfident for trace, _, _ in runs),
        alarms=sum(trace.alarms for trace, _, _ in runs),
    )


def nees_band(parameters: int, runs: int) -> tuple[float, float]:
    """The 95 % band of a consistent estimator's mean NEES (Bar-Shalom, Li, Kirubarajan 2001)."""
    low, high = chi2.ppf([0.025, 0.975], parameters * runs) / runs
    return float(low), float(high)
