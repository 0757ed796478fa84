"""The autocorrelation of the free run's residual, with the band that white noise stays in."""

from __future__ import annotations

import numpy as np

from gray_box_observer.report.figure_parts import Figure, axis, base_layout, line, numbers
from gray_box_observer.report.run.history import FitHistory

_HEIGHT = 260


def residual_figure(fit: FitHistory) -> Figure | None:
    """Draw a bar for every lag, and the band of 99 %.

    Returns:
        None where there is no autocorrelation.
    """
    if fit.autocorrelation is None:
        return None
    lags = np.arange(1, fit.autocorrelation.size + 1)
    ends = [0.5, float(lags[-1]) + 0.5]
    edges = {'line': {'width': 0}, 'hoverinfo': 'skip', 'showlegend': False}
    bars = {
        'type': 'bar',
        'x': lags.tolist(),
        'y': numbers(fit.autocorrelation, 4),
        'marker': {'color': '@free-run'},
        'name': 'autocorrelation',
        'showlegend': False,
        'hovertemplate': 'lag %{x}: %{y:.3f}<extra></extra>',
    }
    low = line(ends, [-fit.band, -fit.band], 'lower edge', '@band', **edges)
    edges = {'line': {'width': 0}, 'hoverinfo': 'skip'}
    high = line(
        ends,
        [fit.band, fit.band],
        '99 % of white noise',
        '@band',
        fill='tonexty',
        fillcolor='@band',
        **edges,
    )
    layout = base_layout(_HEIGHT, hovermode='closest', bargap=0.4)
    layout['xaxis'] = axis('lag (samples)', range=ends)
    layout['yaxis'] = axis('autocorrelation',
        range=[min(-0.25, 1.1 * float(fit.autocorrelation.min())), 1.05],
                           zeroline=True, zerolinecolor='@rule')  # fmt: skip
    outside = int(np.count_nonzero(np.abs(fit.autocorrelation) > fit.band))
    caption = (
        f'{outside} of {lags.size} lags lie outside the band. A residual that is not white holds '
        'what the white box '
        'leaves out, or noise with memory.'
    )
    return Figure([low, high, bars], layout, [], caption)
