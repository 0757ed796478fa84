"""Data of a trend report: estimates of many recordings of the same motors, over time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from gray_box_observer.report.report_errors import ReportError
from gray_box_observer.report.run.history import FloatArray

FEWEST_FOR_A_LINE = 3
DAY_S = 86_400.0
MONTH_S = 30.0 * DAY_S


@dataclass(frozen=True)
class Drift:
    """A straight line through estimates over time.

    Attributes:
        mean_ns: weighted mean of the times, in ns since 1970.
        mean: value of the line there.
        per_s: its slope, in the parameter's unit per s.
        per_s_std: standard deviation of the slope.
        estimates: how many it goes through.
    """

    mean_ns: float
    mean: float
    per_s: float
    per_s_std: float
    estimates: int

    def at(self, time_ns: npt.NDArray[np.int64]) -> FloatArray:
        """Return the line's value at times in ns since 1970."""
        line: FloatArray = (
            self.mean + self.per_s * (time_ns.astype(np.float64) - self.mean_ns) * 1e-9
        )
        return line


@dataclass(frozen=True, eq=False)
class ParameterTrend:
    """The estimates of one parameter of one motor, one a bag.

    Attributes:
        name: the parameter.
        unit: SI unit.
        start_ns: stamp of the first sample of each bag, in ns since 1970. Shape ``(bag,)``,
            non-decreasing.
        value: the last estimate in each bag, in ``unit``. Shape ``(bag,)``.
        std: its standard deviation. Shape ``(bag,)``.
        verdict: its verdict. Length ``bag``.
        bags: what the bags are called. Length ``bag``.

    Raises:
        ReportError: lengths differ, or times run backwards.
    """

    name: str
    unit: str
    start_ns: npt.NDArray[np.int64]
    value: FloatArray
    std: FloatArray
    verdict: Sequence[str]
    bags: Sequence[str]

    def __post_init__(self) -> None:
        lengths = {
            len(part) for part in (self.start_ns, self.value, self.std, self.verdict, self.bags)
        }
        if len(lengths) != 1:
            raise ReportError(
                f'trend of {self.name!r}: its series have {sorted(lengths)} entries, expected one '
                'length'
            )
        if np.any(np.diff(self.start_ns) < 0):
            raise ReportError(
                f'trend of {self.name!r}: start_ns runs backwards; sort the bags by time'
            )

    @property
    def identified(self) -> npt.NDArray[np.bool_]:
        """Which estimates are called identified. Shape ``(bag,)``."""
        has_verdict = np.array([verdict == 'identified' for verdict in self.verdict], dtype=bool)
        finite: npt.NDArray[np.bool_] = (
            has_verdict & np.isfinite(self.value) & np.isfinite(self.std) & (self.std > 0.0)
        )
        return finite

    def drift(self) -> Drift | None:
        """Fit a line to the identified estimates; None if too few, or all of one time.

        Least squares, weighted with the stated variances. Where the estimates scatter more than
        these allow (load, temperature), the slope's standard deviation grows by the ratio (Birge,
        Physical Review 40, 1932, 207-227).
        """
        is_identified = self.identified
        count = int(np.count_nonzero(is_identified))
        if count < FEWEST_FOR_A_LINE:
            return None
        weight = self.std[is_identified] ** -2
        first_ns = int(self.start_ns[is_identified][0])
        since_s = (self.start_ns[is_identified] - first_ns) * 1e-9
        mean_s, mean = (
            np.average(since_s, weights=weight),
            np.average(self.value[is_identified], weights=weight),
        )
        spread = float(np.sum(weight * (since_s - mean_s) ** 2))
        if not spread > 0.0:
            return None
        slope = float(
            np.sum(weight * (since_s - mean_s) * (self.value[is_identified] - mean)) / spread
        )
        misfit = self.value[is_identified] - mean - slope * (since_s - mean_s)
        birge = max(1.0, float(np.sum(weight * misfit**2)) / (count - 2))
        return Drift(
            first_ns + mean_s * 1e9, float(mean), slope, float(np.sqrt(birge / spread)), count
        )


@dataclass(frozen=True, eq=False)
class MotorTrend:
    """One motor over all bags that speak of it.

    Attributes:
        name: the motor.
        parameters: one trend a context node.
    """

    name: str
    parameters: tuple[ParameterTrend, ...]


@dataclass(frozen=True, eq=False)
class ArchiveHistory:
    """Many bags, each identified by itself.

    Attributes:
        title: headline of the report.
        source: names of the places where the bags lie.
        creation_time: when the report was made, ISO 8601.
        motors: one trend a motor.
        failures: why a bag gave nothing, by bag.
        summary: facts of the archive; a key's unit suffix (``duration_s``) is shown as the unit.
        command: the command that makes this report again.
        digest: hexadecimal SHA-256 over the digests of the bags in order.
    """

    title: str
    source: Sequence[str]
    creation_time: str
    motors: tuple[MotorTrend, ...]
    failures: Mapping[str, str] = field(default_factory=dict)
    summary: Mapping[str, str | float | int] = field(default_factory=dict)
    command: str = ''
    digest: str = ''
