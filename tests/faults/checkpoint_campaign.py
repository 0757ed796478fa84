"""Loads thousands of checkpoints with right checksums and wrong content, and runs on.

    python tests/faults/checkpoint_campaign.py [--cases 10000] [--seed 1] [--minutes M] [--only
    CASE]

Whatever a checkpoint holds, loading it must end in one clear line that leaves the observer as it
was, or in an observer that learns and predicts on: no exception, nothing that is not finite. Prints
a table of what happened and one line of JSON; ends with 1 if any case did anything else. ``--only``
repeats one case and shows its traceback.
"""

from __future__ import annotations

import argparse
import faulthandler
import signal
import sys
import tempfile
import time
import traceback
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np
from checkpoint_mutations import Content, mutated
from figures import Figure, tell
from numpy.typing import NDArray
from tally import Tally
from tqdm import tqdm

from dc_motor_sim.plant import PlantParameters
from dc_motor_sim.simulation import Recording, Simulation
from gray_box_observer.checkpoints.checkpoint import capture, decode, load
from gray_box_observer.checkpoints.checkpoint_format import encode_content
from gray_box_observer.errors import GrayBoxError
from gray_box_observer.observer.observer import Observer
from gray_box_observer.predictor import InlineTraining
from gray_box_observer.settings.configuration import Configuration

CPU_LIMIT_S = 60.0
"""Of one case; the thousand samples take a second or two where a network is taught."""

HANG_S = 900.0
"""By the clock: code that is not Python's hears no signal, so its hang ends the campaign."""

SMALL_TRAINING: Mapping[str, Any] = {
    'training.hidden': 4, 'training.steps': 2, 'training.minibatch': 4, 'training.period': 100,
    'training.context': 16,
}  # fmt: skip


@dataclass(frozen=True)
class Kind:
    """One configuration, and what is done before its checkpoint is taken.

    Attributes:
        options: parameters.
        motors: how many motors there are.
        before: samples that are learnt before.
        simulation: options of the simulated motors.
        delay_ns: by how much stamps of the voltage are early.
    """

    options: Mapping[str, Any]
    motors: int = 1
    before: int = 700
    simulation: Mapping[str, Any] = field(default_factory=dict)
    delay_ns: int = 0


KINDS: Mapping[str, Kind] = {
    'recursive': Kind({'predictor': False}),
    'gradient': Kind({'predictor': False, 'context_update': 'gradient'}),
    'young': Kind({'predictor': False}, before=20),
    'delay estimated': Kind({'predictor': False, 'm0.delay': 'estimate'}, before=1500,
        delay_ns=53_000_000),
    'speed measured': Kind(
        {'predictor': False,
            'm0.context_nodes': ['inductance', 'resistance', 'hysteresis', 'back_emf_constant']},
        simulation={'speed_mode': 'rotor'},
    ),
    'lagging': Kind({'predictor': False}, before=1500, simulation={'torque_lag_s': 0.01}),
    'predictor': Kind({**SMALL_TRAINING}),
    'residual': Kind(
        {**SMALL_TRAINING, 'training.start': 'fresh', 'training.replay_capacity': 1024,
            'training.segments': 2,
         'training.learning_rate': 0.02, 'horizon_s': 0.4, 'm0.voltage_limits': [-33.0, 33.0]},
        before=2210, simulation={'speed_mode': 'rotor'},
    ),
    'thesis': Kind({**SMALL_TRAINING, 'variant': 'main'}),
    'group': Kind({**SMALL_TRAINING, 'group_from': 2}, motors=4),
    'rotors': Kind(
        {'predictor': False, 'group_from': 2,
         **{f'm{k}.speed_source': 'rotor' for k in range(2)},
         **{f'm{k}.back_emf_constant': 0.01 for k in range(2)}},
        motors=2, before=700, simulation={'speed_mode': 'rotor'},
    ),
}  # fmt: skip


class Case:
    """A configuration with a good checkpoint, and how an observer goes on from it.

    Args:
        name: of the configuration.
        kind: what it is.
        samples: how many it goes on for.
    """

    def __init__(self, name: str, kind: Kind, samples: int) -> None:
        self.name = name
        self._kind = kind
        self._samples = samples
        self._names = tuple(f'm{k}' for k in range(kind.motors))
        self._configuration = Configuration.from_flat({'motors': list(self._names), **kind.options})
        self._recording = self._record()
        one = self.observer()
        self._feed(one, 0, kind.before)
        snapshot = capture(one)
        self.content: Content = decode(encode_content(snapshot.content, snapshot.arrays))
        self.silent: NDArray[np.bool_] | None = None

    def observer(self) -> Observer:
        """Return an observer that knows nothing."""
        return Observer(self._configuration, InlineTraining)

    def go_on(self, observer: Observer) -> tuple[int, NDArray[np.bool_]]:
        """Feed what follows; return the count of non-finite values, and failed predictions.

        The latter have shape (result, motor).
        """
        return self._feed(observer, self._kind.before, self._kind.before + self._samples)

    def _record(self) -> Recording:
        plants = {
            name: PlantParameters(resistance=1.0 + 0.5 * k) for k, name in enumerate(self._names)
        }
        options = {'torque_noise_relative': 0.001, **self._kind.simulation}
        simulation = Simulation(plants, 'R[5,15]D[0.2,2]', seed=1, start_ns=10**12, **options)
        return simulation.record(0.01 * (self._kind.before + self._samples))

    def _feed(self, observer: Observer, start: int, end: int) -> tuple[int, NDArray[np.bool_]]:
        bad = 0
        silent = []
        recording = self._recording
        speeds = self.name == 'speed measured'
        for k in range(start, end):
            stamp_ns = int(recording.stamp_ns[k])
            observer.ingest(
                'voltage', self._names, stamp_ns - self._kind.delay_ns, recording.voltage_v[:, k]
            )
            speed = recording.speed_rad_s[:, k] if speeds else None
            for group in observer.groups(self._names):
                forecast_nm = observer.forecast_group(group, stamp_ns)
                bad += 0 if forecast_nm is None else int(np.isinf(forecast_nm).sum())
            row = np.zeros(len(self._names), dtype=bool)
            for result in observer.ingest(
                'torque', self._names, stamp_ns, recording.torque_nm[:, k], speed
            ):
                if result.prediction is not None:
                    places = [self._names.index(name) for name in result.group.names]
                    row[places] = ~np.isfinite(result.prediction.torque_nm)
                if result.estimate is not None:
                    estimate = result.estimate
                    numbers = (estimate.value, estimate.std, estimate.covariance)
                    bad += sum(int((~np.isfinite(array)).sum()) for array in numbers)
            silent.append(row)
        for motor in self._names:
            delay = observer.delays()[motor]
            bad += not np.isfinite(delay.applied_s)
        return bad, np.array(silent, dtype=bool).reshape(len(silent), len(self._names))


class Hang(BaseException):
    """A case took longer than any may."""


@dataclass
class NumberTally(Tally):
    """What became of the cases, of their numbers, and how long they took.

    Attributes:
        blank: numbers that were not finite.
        longest_s: processor time of the longest case.
    """

    blank: int = 0
    longest_s: float = 0.0


def main() -> int:
    """Run the campaign."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument('--cases', type=int, default=10_000)
    parser.add_argument('--first', type=int, default=0, help='number of the first case')
    parser.add_argument('--seed', type=int, default=1)
    parser.add_argument(
        '--minutes', type=float, default=1e9, help='end after that, wherever it has come to'
    )
    parser.add_argument(
        '--samples', type=int, default=1000, help='learnt after a checkpoint that is accepted'
    )
    parser.add_argument('--kinds', nargs='+', choices=list(KINDS), default=list(KINDS))
    parser.add_argument('--only', type=int, metavar='CASE', help='repeat this one')
    options = parser.parse_args()
    warnings.simplefilter('ignore')
    numbers = (
        range(options.first, options.first + options.cases)
        if options.only is None
        else [options.only]
    )
    kinds = list(KINDS)
    tally = NumberTally()
    cases = {}
    for name in options.kinds:
        if options.only is None or name == kinds[options.only % len(kinds)]:
            cases[name] = Case(name, KINDS[name], options.samples)
            good = cases[name].observer()
            _load(good, cases[name].content)
            bad, cases[name].silent = cases[name].go_on(good)
            assert not bad, 'the good checkpoint'
    signal.signal(signal.SIGPROF, _expire)
    until_s = time.monotonic() + 60.0 * options.minutes
    for number in tqdm(numbers, 'mutated checkpoints', unit='file', mininterval=1.0, smoothing=0.0):
        name = kinds[number % len(kinds)]
        if name in cases and time.monotonic() < until_s:
            _run(number, options, cases[name], tally)
    return _print(tally, options, sum(tally.outcomes.values()) + len(tally.failures))


def _run(number: int, options: argparse.Namespace, case: Case, tally: NumberTally) -> None:
    text, arrays, what = mutated(case.content, f'{options.seed}:{number}')
    since_s = time.process_time()
    signal.setitimer(signal.ITIMER_PROF, CPU_LIMIT_S)
    faulthandler.dump_traceback_later(HANG_S, exit=True)
    try:
        observer = case.observer()
        try:
            _load_bytes(observer, encode_content(text, arrays))
        except GrayBoxError as error:
            assert str(error).isprintable(), f'no clear line: {str(error)!r}'
            assert not observer.motors, 'a refused checkpoint has left something'
            tally.outcomes['refused'] += 1
            if options.only is not None:
                print(error)
            return
        bad, silent = case.go_on(observer)
        assert case.silent is not None
        more = silent[: len(case.silent)] & ~case.silent[: len(silent)]
        tally.blank += bad + int(more.sum())
        assert not bad, f'{bad} numbers are not finite'
        assert not more.any(), (
            f'{int(more.sum())} predictions are none, the first after {np.argwhere(more)[0]}'
        )
        tally.outcomes['accepted'] += 1
    except KeyboardInterrupt:
        raise
    except BaseException as error:
        if options.only is not None:
            traceback.print_exc()
        complaint = f'{type(error).__name__}: {error}'
        tally.failures.append((number, f'{case.name}: {what}', complaint))
        print(f'case {number}, {case.name}: {what}: {complaint[:300]}', file=sys.stderr, flush=True)
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        faulthandler.cancel_dump_traceback_later()
        tally.longest_s = max(tally.longest_s, time.process_time() - since_s)


def _load(observer: Observer, content: Content) -> None:
    from gray_box_observer.checkpoints.checkpoint import encode

    _load_bytes(observer, encode(*content))


def _load_bytes(observer: Observer, data: bytes) -> None:
    with tempfile.NamedTemporaryFile(suffix='.safetensors') as file:
        file.write(data)
        file.flush()
        load(observer, Path(file.name))


def _expire(number: int, frame: FrameType | None) -> None:
    raise Hang(f'more than {CPU_LIMIT_S:g} s of CPU')


def _print(tally: NumberTally, options: argparse.Namespace, cases: int) -> int:
    for outcome, count in sorted(tally.outcomes.items()):
        print(f'{count:7d}  {outcome}')
    figures = [
        Figure('cases that ended otherwise than they may', len(tally.failures), 0),
        Figure('of these hangs', tally.hangs, 0),
        Figure('numbers that are not finite', tally.blank, 0),
        Figure('processor time of the longest case, s', tally.longest_s),
    ]
    return tell(
        'checkpoint_campaign', options.seed, figures, {'cases': cases, 'outcomes': tally.outcomes}
    )


if __name__ == '__main__':
    raise SystemExit(main())
