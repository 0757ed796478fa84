"""Messages of motors that come together, given to an observer one after another."""

from __future__ import annotations

import math

import numpy as np

from gray_box_observer.observer.observer import Observer, Result

Signals = dict[str, tuple[np.ndarray, np.ndarray]]
"""Voltage and torque of every motor, shape (sample,); infinite: absent from the message."""


def feed(
    one: Observer,
    said: Signals,
    names: tuple[str, ...],
    period_ns: int,
    first: int = 0,
    last: int | None = None,
) -> dict[str, list[Result]]:
    """Give messages of some motors to an observer; return what became of each.

    Args:
        one: the observer.
        said: the signals.
        names: which motors the messages speak of.
        period_ns: between two messages of a signal.
        first: place of the first message.
        last: place behind the last one; None: to the end.
    """
    results: dict[str, list[Result]] = {name: [] for name in names}
    count = said[names[0]][0].size
    for k in range(first, count if last is None else last):
        for signal, what in enumerate(('voltage', 'torque')):
            spoken = tuple(name for name in names if not math.isinf(said[name][signal][k]))
            if spoken:
                values = np.array([said[name][signal][k] for name in spoken])
                for group in one.ingest(what, spoken, k * period_ns, values):
                    for result in group:
                        results[result.motor].append(result)
    return results
