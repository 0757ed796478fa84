"""From the stamp of a sample to its published prediction and estimate, beside a bare relay.

Source, relay, observer (with its training process) and listener are processes of their own on real
DDS. The source serves relay and observer by turns in one run, so that the machine's noise hits both
alike; the relay has the observer's executor, topics, message types and rhythm. Latency is the time
of receipt in the listener's middleware minus the time at which the source sent the sample.

What the relay counts: it reads the same two topics as messages, hands the voltage's message on as
the prediction without building one, and every ``--block`` torques publishes the five messages of an
estimate. So it is what rclpy, executor and middleware cost a node that computes nothing, and
everything the observer does more is in the ratio. Neither the observer's alarm and diagnostics nor
its lifecycle publishers have a counterpart in it. An estimate counts from the newest sample that it
has learnt, which is the one that completes its block.

Profile of a sample at 1 kHz in this benchmark, on two shared cores, in units of publishing one
message (0.045 ms there): the voltage's callback 2.4, of that reading and pairing 0.4, the forecast,
looked up, written and published 1.7; the torque's callback 1, and then, when all is out, 2.3 for
the next forecast, 0.6 for alarm, scores and memory. Of one sample in 32: a block, of which 1.7 are
learning, 0.6 working out the estimate and 2.5 the five messages. Of one in 1024: a search for a
delay, in some ten pieces of at most 20. Once a second: diagnostics, 20.

Stamps are even here, so that the next forecast is worked out before its voltage comes. Of a source
whose stamps jitter it cannot be, and a prediction takes 2 more.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from common.figures import Figure, figure_table, last_line, table
from common.live.processes import own_domain, running
from common.live.source import START_NS
from common.live.topics import DEVICES, LAST
from numpy.typing import NDArray

from gray_box_observer.settings.configuration import Configuration

RATES_HZ = (100.0, 500.0, 1000.0, 2000.0)
WARM_UP = 3000
"""Samples of each device that are not counted: the observer fits all it remembers each time that
has doubled, up to the 4096 samples it keeps, and that is done by then. The longest wait among them
is told apart."""

QUANTILES = (0.5, 0.99, 0.999)
GOAL_RATIO = 1.5
GOAL_RATE_HZ = 1000.0

Milliseconds = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Measured:
    """One device at one rate.

    Attributes:
        prediction_ms: latency of the prediction of each sample in order; NaN where none came.
        estimate_ms: latency of each estimate from the sample that led to it.
        turn: shape of ``prediction_ms``: the turn a sample belongs to.
        cores: CPU time as a share of the time in which it was served.
    """

    prediction_ms: Milliseconds
    estimate_ms: Milliseconds
    turn: NDArray[np.int64]
    cores: float

    @property
    def lost(self) -> int:
        """Samples, of those that count, whose prediction never came."""
        return int(np.sum(~np.isfinite(self.prediction_ms[WARM_UP:])))


def measure(
    rate_hz: float, turn_s: float, turns: int, seed: int, block: int, realtime: bool = False
) -> dict[str, Measured]:
    """Run everything at one rate."""
    own_domain()
    start = partial(running, realtime=realtime)
    with tempfile.TemporaryDirectory() as folder:
        sent = Path(folder) / 'sent.npz'
        heard = Path(folder) / 'heard.npz'
        in_namespace = [['--ros-args', '-r', f'__ns:=/{device}'] for device in DEVICES]
        in_namespace[1] += ['-p', f'recursive.block:={block}']
        with (
            start('common.live.relay', '--block', str(block), *in_namespace[0]) as relay,
            start('gray_box_observer.executables:observer', *in_namespace[1]) as observer,
            start('common.live.listener', '--out', str(heard)),
        ):
            arguments = [
                '--rate',
                str(rate_hz),
                '--turn',
                str(turn_s),
                '--turns',
                str(turns),
                '--seed',
                str(seed),
            ]
            pids = ['--watch', str(relay.pid), str(observer.pid)]
            with start('common.live.source', *arguments, *pids, '--out', str(sent)) as source:
                source.wait()
            if source.returncode:
                raise SystemExit(f'the source ended with {source.returncode}')
            time.sleep(1.0)  # what is under way arrives
        return gathered(sent, heard, turn_s, turns)


def gathered(sent_file: Path, heard_file: Path, turn_s: float, turns: int) -> dict[str, Measured]:
    """Join what the source noted with what the listener noted."""
    found = {}
    with np.load(sent_file) as sent, np.load(heard_file) as heard:
        for device, cpu_s in zip(DEVICES, sent['cpu_s'], strict=True):
            sent_ns = sent[device]
            index = (heard[f'{device}_prediction_stamps_ns'] - START_NS) // int(sent['period_ns'])
            prediction_ms = np.full(sent_ns.size, np.nan)
            prediction_ms[index] = (
                heard[f'{device}_prediction_received_ns'] - sent_ns[index]
            ) / 1e6
            # An estimate has no stamp, but the device publishes it between the prediction of the
            # sample that led to it and the next prediction, and says when it published either.
            published_ns = heard[f'{device}_prediction_published_ns']
            order = np.searchsorted(published_ns, heard[f'{device}_{LAST}_published_ns']) - 1
            ours = (order >= 0) & (index[np.maximum(order, 0)] >= WARM_UP)
            led = index[order[ours]]
            estimate_ms = (heard[f'{device}_{LAST}_received_ns'][ours] - sent_ns[led]) / 1e6
            turn = np.arange(sent_ns.size) // (sent_ns.size // turns)
            found[device] = Measured(
                prediction_ms, estimate_ms, turn, float(cpu_s) / (turn_s * turns)
            )
    return found


def quantiles(latency_ms: Milliseconds) -> list[float]:
    """Those of :data:`QUANTILES`, over what came."""
    came = latency_ms[np.isfinite(latency_ms)]
    return (
        [float('nan')] * len(QUANTILES)
        if came.size == 0
        else [float(q) for q in np.quantile(came, QUANTILES)]
    )


def paired_ratio(measured: dict[str, Measured]) -> float:
    """Median over the turns of the ratio of p99 of the prediction; robust against one turn."""
    relay, observer = (measured[device] for device in DEVICES)
    ratios = []
    for turn in np.unique(relay.turn[WARM_UP:]):
        both = [
            np.nanquantile(one.prediction_ms[WARM_UP:][one.turn[WARM_UP:] == turn], 0.99)
            for one in (relay, observer)
        ]
        ratios.append(both[1] / both[0])
    return float(np.median(ratios))


def figures_of(rate_hz: float, measured: dict[str, Measured], counts: bool) -> list[Figure]:
    """The figures of one rate."""
    relay, observer = (measured[device] for device in DEVICES)
    at = f'at {rate_hz:g} Hz'
    figures = []
    for what, name in (('prediction_ms', 'prediction'), ('estimate_ms', 'estimate')):
        both = [
            quantiles(getattr(one, what)[WARM_UP if name == 'prediction' else 0 :])
            for one in (relay, observer)
        ]
        for q, theirs, ours in zip(QUANTILES, *both, strict=True):
            goal = GOAL_RATIO if q == 0.99 and rate_hz == GOAL_RATE_HZ else None
            figures.append(
                Figure(f'p{100 * q:g} of {name} {at}, times the relay', ours / theirs, goal, counts)
            )
    figures.append(
        Figure(
            f'p99 of prediction {at}, median of turns, times the relay',
            paired_ratio(measured),
            None,
        )
    )
    figures.append(Figure(f'samples lost by the observer {at}', observer.lost, 0.0))
    figures.append(Figure(f'samples lost by the relay {at}', relay.lost, None))
    figures.append(
        Figure(f'CPU of the observer {at}, times the relay', observer.cores / relay.cores, None)
    )
    return figures


def rows_of(rate_hz: float, measured: dict[str, Measured]) -> list[list[str]]:
    """What this machine took, for the reader; never compared."""
    rows = []
    for device, one in measured.items():
        kinds = {'prediction': one.prediction_ms[WARM_UP:], 'estimate': one.estimate_ms}
        cells = [f'{value:.2f}' for kind in kinds.values() for value in quantiles(kind)]
        first = np.nanmax(one.prediction_ms[:WARM_UP])
        rows.append(
            [f'{rate_hz:g} Hz, {device}', *cells, str(one.lost), f'{one.cores:.2f}', f'{first:.0f}']
        )
    return rows


def plan(options: argparse.Namespace) -> dict[float, tuple[float, int]]:
    """Length of a turn in s and turns of each device, by rate."""
    rates = options.rate or ([GOAL_RATE_HZ, 2000.0] if options.quick else list(RATES_HZ))
    counted = 6000 if options.quick else options.samples
    return {
        rate: (
            turn_s := max(1.0, 2000.0 / rate),
            -(-(WARM_UP + min(counted, 60 * rate)) // (turn_s * rate)),
        )
        for rate in rates
    }


def main() -> int:
    """Print a table and one line of JSON."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        '--quick', action='store_true', help='1 and 2 kHz only, seconds instead of minutes'
    )
    parser.add_argument(
        '--rate', type=float, action='append', help='only this rate; may be given again'
    )
    parser.add_argument(
        '--samples', type=int, default=30_000, help='samples that count, at most those of a minute'
    )
    parser.add_argument('--seed', type=int, default=1)
    default = Configuration.from_flat({})['recursive.block']
    parser.add_argument(
        '--block', type=int, default=default, help='samples to one estimate, of both devices'
    )
    parser.add_argument(
        '--realtime',
        action='store_true',
        help='all at real-time priority, so that other programs count less',
    )
    options = parser.parse_args()
    figures = []
    rows = []
    for rate_hz, (turn_s, turns) in plan(options).items():
        print(f'{rate_hz:g} Hz: {2 * turns * turn_s:.0f} s', file=sys.stderr, flush=True)
        measured = measure(
            rate_hz, turn_s, int(turns), options.seed, options.block, options.realtime
        )
        figures += figures_of(rate_hz, measured, counts=not options.quick)
        rows += rows_of(rate_hz, measured)
    kinds = [f'{kind} p{100 * q:g}' for kind in ('prediction', 'estimate') for q in QUANTILES]
    print(
        table(['latency in ms on this machine', *kinds, 'lost', 'cores', 'worst in warm-up'], rows)
    )
    print(figure_table(figures))
    print(last_line('latency', 1, figures))
    return 0


if __name__ == '__main__':
    try:
        raise SystemExit(main())
    except subprocess.SubprocessError as error:
        raise SystemExit(f'latency: error: {error}') from error
