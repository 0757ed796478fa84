"""The picture of docs/RESULTS.md: error against time with the Cramer-Rao bound drawn in."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from common.cases import Case
from common.motion import FloatArray
from common.trace import Trace

Runs = Sequence[tuple[Trace, FloatArray, FloatArray]]

STYLES = {
    'recursive': ('#0b5fa5', '-', 2.2),
    'gradient': ('#6a994e', '-', 1.0),
    'batch': ('#d1495b', ':', 2.0),
    'ekf': ('#edae49', '-', 1.0),
    'ekf textbook': ('#edae49', '--', 1.0),
    'ukf': ('#8d6a9f', '-', 1.0),
    'rls': ('#8a8a8a', '-', 1.0),
    'rls integrated': ('#8a8a8a', '--', 1.0),
}


def draw(
    path: Path,
    cases: Sequence[Case],
    runs: Mapping[tuple[str, str], Runs],
    titles: Mapping[str, str],
) -> None:
    """Draw one panel a parameter and data set: root mean square over seeds, both axes logarithmic.

    Args:
        path: where to write; its ending chooses the format (svg, png).
        cases: the columns.
        runs: by method and case name.
        titles: of the methods, by name.
    """
    import matplotlib as mpl  # only a run with --plot needs it

    mpl.use('Agg')
    from matplotlib import pyplot as plt

    parameters = cases[0].parameters
    size = (4.2 * len(cases), 2.5 * len(parameters) + 0.8)
    figure, axes = plt.subplots(
        len(parameters), len(cases), figsize=size, sharex='col', sharey=True, squeeze=False
    )
    for column, case in enumerate(cases):
        for row, parameter in enumerate(parameters):
            axis = axes[row, column]
            drawn = [
                (name, runs[name, case.name]) for name in STYLES if runs.get((name, case.name))
            ]
            for name, traces in drawn:
                colour, line, width = STYLES[name]
                axis.plot(
                    *_error(traces, row),
                    line,
                    color=colour,
                    linewidth=width,
                    label=titles.get(name, name),
                )
            if drawn:
                bounds = np.array([bounds[:, row] for _, bounds, _ in drawn[0][1]])
                curve = 100.0 * np.sqrt(np.mean(bounds**2, axis=0))
                axis.plot(drawn[0][1][0][2], curve, 'k--', linewidth=1.2, label='Cramér-Rao bound')
            axis.set(xscale='log', yscale='log', ylim=(0.01, 300.0))
            axis.grid(visible=True, which='major', alpha=0.3)
            if column == 0:
                axis.set_ylabel(f'{parameter}\nRMS error in %')
            if row == 0:
                axis.set_title(case.excitation)
        axes[-1, column].set_xlabel('time in s')
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc='lower center', ncols=min(5, len(labels)), frameon=False)
    figure.tight_layout(rect=(0.0, 0.07, 1.0, 1.0))
    figure.savefig(path, dpi=150, metadata={'Date': None} if path.suffix == '.svg' else None)
    plt.close(figure)


def _error(traces: Runs, parameter: int) -> tuple[FloatArray, FloatArray]:
    """Time and root mean square error over seeds in %, infinite where a run failed."""
    errors = np.array([trace.error[:, parameter] for trace, _, _ in traces])
    return traces[0][2], 100.0 * np.sqrt(np.mean(np.nan_to_num(errors, nan=np.inf) ** 2, axis=0))
