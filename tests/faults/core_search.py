"""Searches for sequences that break the core: messages, gaps, repeats, resets, freezes.

    python tests/faults/core_search.py [--steps 1000000] [--seed 1] [--no-shrink]

Hypothesis draws what an observer is made of and what befalls it. Every sequence goes through the
core as live bytes, with forecasts asked for in between as a node does, and once more as plain
messages without. One that a bag can hold goes also through a bag and the offline command. Nothing
may be raised, every number must be finite, every message accounted for, and the bits must be the
same whichever door was taken. Steps are messages and operations, counted once for all doors. What
breaks is made as small as possible and printed; the command then ends with 1.
"""

from __future__ import annotations

import argparse
import itertools
import math
import random
import tempfile
import traceback
from array import array
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from absence_campaign import recording
from figures import Figure, tell
from hypothesis import HealthCheck, Phase, given, seed, settings
from hypothesis import strategies as st
from tqdm import tqdm
from watched_core import IdleTraining, WatchedCore

from gray_box_observer.bag.joint_state import TYPE_NAME, decode_joint_state, encode_joint_state
from gray_box_observer.bag.schemas import built_in_lookup, schema_text
from gray_box_observer.bag.writer import BagWriter
from gray_box_observer.errors import BagError, ConfigurationError
from gray_box_observer.identify.offline_run import run as run_offline
from gray_box_observer.predictor import InlineTraining
from gray_box_observer.settings.configuration import Configuration

MS = 1_000_000
MOST_STEPS = 6000
"""Of one sequence; what is drawn beyond is left out."""
EXAMPLES = 100
"""Sequences between two seeds of the search."""

Message = tuple[str, bytes]

MISSING = (('voltage',), ('torque',), ('speed',), ('voltage', 'speed'), ('torque', 'speed'))
KINDS = (
    'motor', 'zero', 'constant', 'huge', 'tiny', 'spikes', 'NaN', 'infinite', 'beyond', 'some NaN',
    'flicker',
)  # fmt: skip
ROTOR_NODES = ['inductance', 'resistance', 'inertia', 'viscous_friction', 'coulomb_friction']
ROTORS = tuple(
    ('rotor', {'*.context_nodes': ROTOR_NODES, '*.speed_source': source})
    for source in ('rotor', 'measured')
)
INPUTS = {
    'voltage.expression': {'raw.topic': 'motor/voltage', 'raw.field': 'effort'},
    'speed.expression': {'angle.topic': 'motor/speed', 'angle.field': 'velocity'},
}
"""What an expression is of: its input comes on the topic of its signal."""
GAPS_MS = (1, 5, 150, 210, 300, 499, 600, 3000, 10**8, -5, -300, -2000, -(10**8))


@dataclass(frozen=True)
class Setup:
    """What an observer is made of."""

    motors: int = 1
    speed: str = 'none'
    predictor: bool = True
    taught: bool = False
    changes: tuple[tuple[str, Any], ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        """Of the motors."""
        return tuple(f'm{k}' for k in range(self.motors))

    @property
    def settings(self) -> dict[str, Any]:
        """Flat parameters; those of a motor are for all of them."""
        is_plain = self.speed == 'own topic' and 'speed.expression' not in dict(self.changes)
        own = {'speed.topic': 'motor/speed'} if is_plain else {}
        changed: dict[str, Any] = {}
        for name, value in self.changes:
            values = value if name == 'rotor' else {name: value}
            for key, one in values.items():
                changed |= {key.replace('*', motor): one for motor in self.names}
            if name.endswith('.expression'):
                changed |= INPUTS[name]
        fixed = {'motors': list(self.names), 'predictor': self.predictor, 'training.steps': 1}
        return {**fixed, **own, **changed}

    def is_allowed(self) -> bool:
        """Tell whether the parameters go together."""
        try:
            Configuration.from_flat(self.settings)
        except ConfigurationError:
            return False
        return True


@dataclass(frozen=True)
class Regular:
    """Samples that come regularly, as far as they are not missing."""

    count: int
    period_ms: int = 10
    rates: tuple[int, int] = (1, 1)
    missing: tuple[str, ...] = ()
    kind: str = 'motor'
    spoilt: str = 'torque'
    lead: int = 0
    spoken_of: str = 'all'


@dataclass(frozen=True)
class Gap:
    """Time without any message; back where it is negative."""

    length_ms: int


@dataclass(frozen=True)
class Repeat:
    """The newest messages once more."""

    count: int


@dataclass(frozen=True)
class Operation:
    """What is done to the observer."""

    name: str
    argument: Any = None


Action = Regular | Gap | Repeat | Operation


def setups() -> st.SearchStrategy[Setup]:
    """Draw what an observer is made of."""
    changes = st.lists(
        st.sampled_from(
            (
                ('group_from', 2),
                ('horizon_s', 0.05),
                ('*.delay', 'estimate'),
                ('*.delay', 0.013),
                ('*.delay', -0.02),
                ('context_update', 'gradient'),
                ('variant', 'main'),
                ('gap_s', 5.0),
                ('hold_s', 0.0),
                ('*.speed_source', 'torque_constant'),
                *ROTORS,
                ('torque.quantity', 'current'),
                ('voltage.expression', '0.5 * raw'),
                ('speed.expression', 'diff(angle)'),
                ('*.context_nodes', ['inductance', 'resistance']),
                ('*.context_nodes', ['inductance', 'resistance', 'hysteresis', 'brush_drop']),
            )
        ),
        max_size=3,
        unique_by=lambda change: change[0],
    ).map(tuple)
    return st.builds(
        Setup,
        motors=st.sampled_from((1, 1, 1, 2, 9)),
        speed=st.sampled_from(('none', 'own topic', 'in torque')),
        predictor=st.booleans(),
        taught=st.sampled_from((False,) * 15 + (True,)),
        changes=changes,
    ).filter(Setup.is_allowed)


def actions() -> st.SearchStrategy[Action]:
    """Draw what befalls an observer."""
    counts = st.one_of(st.integers(1, 80), st.sampled_from((130, 300, 1000, 1021, 1100, 3000)))
    regular = st.builds(
        Regular,
        count=counts,
        period_ms=st.sampled_from((10, 10, 10, 1, 4, 30, 200)),
        rates=st.sampled_from(((1, 1), (1, 1), (1, 3), (3, 1))),
        missing=st.sampled_from(((), (), (), *MISSING)),
        kind=st.sampled_from(('motor',) * 8 + KINDS),
        spoilt=st.sampled_from(('voltage', 'torque', 'speed', 'all')),
        lead=st.sampled_from((0, 0, 0, 1, -1, 20, -20, 70, -70)),
        spoken_of=st.sampled_from(('all', 'all', 'all', 'some', 'each alone')),
    )
    gaps = st.builds(Gap, st.sampled_from(GAPS_MS))
    changes = st.sampled_from(
        (
            {'gap_s': 0.1},
            {'gap_s': 2.0},
            {'hold_s': 0.0},
            {'hold_s': 1.0},
            {'jump_back_s': 0.0},
            {'alarm.learn': 10, 'alarm.memory': 50},
            {'alarm.false_a_day': 1e4},
            {'horizon_s': 0.2},
            {'freeze': True},
            {'freeze': False},
            {'verdict.identified_relative_std': 1.0},
        )
    )
    operations = st.one_of(
        st.sampled_from((Operation('reset'), Operation('restart'), Operation('flush'))),
        st.builds(Operation, st.just('freeze'), st.booleans()),
        st.builds(Operation, st.just('reconfigure'), changes),
    )
    repeats = st.builds(Repeat, st.integers(1, 40))
    return st.one_of(regular, regular, regular, gaps, repeats, operations)


class Script:
    """Turns actions into messages and operations; one seed, one clock.

    Args:
        setup: of the observer that they are for.
    """

    def __init__(self, setup: Setup) -> None:
        self._setup = setup
        self._now_ns = 10**18
        self._at = 0
        self._sent: list[Message] = []
        self._random = random.Random(1)

    def steps(self, whole: list[Action]) -> Iterator[Message | Operation]:
        """Yield every step, at most MOST_STEPS."""
        every = (step for action in whole for step in self._of(action))
        return itertools.islice(every, MOST_STEPS)

    def _of(self, action: Action) -> Iterator[Message | Operation]:
        if isinstance(action, Operation):
            yield action
        elif isinstance(action, Gap):
            self._now_ns = max(0, self._now_ns + action.length_ms * MS)
        elif isinstance(action, Repeat):
            yield from self._sent[-action.count :]
        else:
            sent = self._regular(action)
            self._sent = sent[-50:]
            yield from sent

    def _regular(self, action: Regular) -> list[Message]:
        """Messages in the order of delivery: voltage earlier by the periods that it leads."""
        timed: list[tuple[int, int, Message]] = []
        for k in range(action.count):
            stamp_ns = self._now_ns + k * action.period_ms * MS
            self._at = self._at + 1
            for order, signal in enumerate(('voltage', 'speed', 'torque')):
                every = {'voltage': action.rates[1], 'torque': action.rates[0]}.get(signal, 1)
                absent = signal in action.missing or (
                    signal == 'speed' and self._setup.speed != 'own topic'
                )
                if k % every or absent:
                    continue
                delivered = k - action.lead if signal == 'voltage' else k
                messages = self._messages(signal, stamp_ns, action)
                timed += [(delivered, order, (signal, message)) for message in messages]
        self._now_ns += action.count * action.period_ms * MS
        timed.sort(key=lambda entry: entry[:2])
        return [message for _, _, message in timed]

    def _messages(self, signal: str, stamp_ns: int, action: Regular) -> Iterator[bytes]:
        names = self._setup.names
        each_alone = [(name,) for name in names]
        spoken_of = {'all': [names], 'some': [names[::2]], 'each alone': each_alone}
        for some in spoken_of[action.spoken_of]:
            value = self._value(signal, action)
            effort = [value] * len(some)
            if action.kind == 'some NaN' and self._spoils(signal, action):
                effort = [math.nan if k % 2 else value for k in range(len(some))]
            in_torque = signal == 'torque' and self._setup.speed == 'in torque'
            lost = signal == 'torque' and 'speed' in action.missing
            speed = math.nan if lost else self._value('speed', action)
            velocity = [speed] * len(some) if in_torque or signal == 'speed' else []
            yield encode_joint_state(stamp_ns, some, velocity=velocity, effort=effort)

    def _spoils(self, signal: str, action: Regular) -> bool:
        return action.spoilt in (signal, 'all')

    def _value(self, signal: str, action: Regular) -> float:
        data = recording()
        series = {'voltage': data.voltage_v, 'torque': data.torque_nm, 'speed': data.speed_rad_s}[
            signal
        ]
        value = float(series[0, self._at % data.stamp_ns.size])
        if not self._spoils(signal, action):
            return value
        spikes = (
            value if self._random.random() < 0.9 else self._random.choice((1e9, -1e9, 1e-300, 0.0))
        )
        spoilt = {
            'zero': 0.0,
            'constant': 3.0,
            'huge': 1e9 if self._at % 2 else -1e9,
            'tiny': 5e-324 * (self._at % 3),
            'spikes': spikes,
            'NaN': math.nan,
            'flicker': value if self._random.random() < 0.7 else math.nan,
            'infinite': math.inf,
            'beyond': 1e300,
        }
        return spoilt.get(action.kind, value)


def as_message(data: bytes) -> SimpleNamespace:
    """Return a message as the client library gives it, with arrays of its own."""
    view = decode_joint_state(data)
    seconds, nanoseconds = divmod(view.stamp_ns, 1_000_000_000)
    header = SimpleNamespace(stamp=SimpleNamespace(sec=seconds, nanosec=nanoseconds))
    velocity = array('d', view.velocity)
    effort = array('d', view.effort)
    return SimpleNamespace(header=header, name=list(view.names), velocity=velocity, effort=effort)


def examine(
    setup: Setup, whole: list[Action], count: Callable[[int], object] = lambda steps: None
) -> None:
    """Take a sequence through every door.

    Args:
        setup: of the observer.
        whole: what befalls it.
        count: is told how many steps were taken.

    Raises:
        AssertionError: something is not as it must be.
    """
    training = InlineTraining if setup.taught else IdleTraining
    live = WatchedCore(setup.settings, training)
    plain = WatchedCore(setup.settings, training, asks=False)
    steps = list(Script(setup).steps(whole))
    try:
        for step in steps:
            _take(live, step)
            _take(plain, step, as_message)
        live.balance()
        live.flush()
        plain.flush()
    finally:
        live.close()
        plain.close()
    count(len(steps))
    assert live.non_finite == 0, f'{live.non_finite} numbers are not finite'
    assert live.unbalanced == 0, f'{live.unbalanced} messages are not accounted for'
    assert live.digest == plain.digest, 'estimates depend on the door or on what is asked'
    assert live.forecast_digest == plain.forecast_digest, (
        'predictions depend on the door or on what is asked'
    )
    if not any(isinstance(step, Operation) for step in steps):
        _compare_with_bag(setup, [step for step in steps if not isinstance(step, Operation)], live)


def _take(
    core: WatchedCore, step: Message | Operation, form: Callable[[bytes], Any] | None = None
) -> None:
    if isinstance(step, Operation):
        method = getattr(core, step.name)
        method() if step.argument is None else method(step.argument)
    elif form is None:
        core.feed(*step)
    else:
        core.feed_view(step[0], form(step[1]))


def _compare_with_bag(setup: Setup, messages: list[Message], live: WatchedCore) -> None:
    """Run the offline command over a bag of the same messages, in the order of their delivery."""
    schema = schema_text(TYPE_NAME, built_in_lookup)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / 'bag'
        with BagWriter(path) as bag:
            for signal in ('voltage', 'torque', 'speed'):
                bag.add_topic(f'/motor/{signal}', TYPE_NAME, schema)
            for at, (signal, data) in enumerate(messages):
                bag.write(f'/motor/{signal}', data, at, at)
        training = InlineTraining if setup.taught else IdleTraining
        try:
            outcome = run_offline([path], Configuration.from_flat(setup.settings), training)
        except BagError:
            used = sum(live.observer.counts(name).used_count for name in setup.names)
            assert used == 0, 'the offline command finds nothing to use where the live core does'
            return
    assert outcome.digest == live.digest, 'estimates of the offline command are others'


SEQUENCES = st.lists(actions(), min_size=1, max_size=9)


def search(
    number: int, examples: int, count: Callable[[int], object], *, shrink: bool = True
) -> None:
    """Draw and examine sequences; raises what the smallest of those that break something raises."""
    phases = (Phase.generate, Phase.shrink) if shrink else (Phase.generate,)

    @seed(number)
    @settings(
        max_examples=examples,
        deadline=None,
        database=None,
        phases=phases,
        suppress_health_check=list(HealthCheck),
        print_blob=False,
    )
    @given(setups(), SEQUENCES)
    def every_property_holds(setup: Setup, whole: list[Action]) -> None:
        examine(setup, whole, count)

    every_property_holds()


def main() -> int:
    """Run the search; the exit code is 1 where something broke."""
    form = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=form)
    parser.add_argument('--steps', type=int, default=1_000_000)
    parser.add_argument('--seed', type=int, default=1)
    no_shrink = 'print what breaks as it was drawn'
    parser.add_argument('--no-shrink', action='store_true', help=no_shrink)
    options = parser.parse_args()
    taken = 0
    broken = 0
    with tqdm(total=options.steps, unit='step', mininterval=1.0) as bar:

        def count(steps: int) -> None:
            nonlocal taken
            taken += steps
            bar.update(steps)

        for number in itertools.count(options.seed * 1_000_000):
            try:
                search(number, EXAMPLES, count, shrink=not options.no_shrink)
            except Exception as error:
                broken += 1
                print(
                    f'seed {number}:\n{traceback.format_exc()}',
                    *getattr(error, '__notes__', ()),
                    flush=True,
                )
            if taken >= options.steps or broken >= 10:
                break
    figures = [Figure('sequences that break something', broken, 0.0), Figure('steps', taken)]
    return tell('core_search', options.seed, figures)


if __name__ == '__main__':
    raise SystemExit(main())
