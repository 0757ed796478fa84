"""Feeds the observer's core, without ROS, with messages that faults have been at.

    python tests/faults/core_campaign.py [--messages 1000000] [--share 0.3] [--seed 1] [--restarts
    20]

Messages are spoilt by `stream_faults` and taken by the same input that nodes and bags use. Now and
then the observer is thrown away and another goes on from its checkpoint, and the simulator starts
from rest with a clock that begins anywhere. At the end a minute of clean samples follows. Prints
every fault by kind, where every message went, a table, and one line of JSON; ends with 1 if a
figure is not reached.
"""

from __future__ import annotations

import argparse
import random
import tempfile
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import psutil
from figures import Figure, growth, tell
from stream_faults import CORE_WEIGHTS, FaultSettings, StreamFaults
from tqdm import tqdm

from dc_motor_sim.plant import PlantParameters
from dc_motor_sim.simulation import Simulation
from gray_box_observer.bag.joint_state import JointStateView
from gray_box_observer.checkpoints import checkpoint
from gray_box_observer.executables import settle_memory
from gray_box_observer.observer.message_input import MessageInput
from gray_box_observer.observer.observer import Observer
from gray_box_observer.settings.configuration import Configuration

MOTOR = 'motor'
TRUTH = np.array([0.5, 1.0, 10.0])
"""Of the thesis's motor: H, ohm, V s/(rad A)."""
CLEAN_SAMPLES = 6000
MEMORY_EVERY = 2000
"""Messages between two looks at the memory."""


class Source:
    """A simulated motor that can be started anew; its clock then begins anywhere.

    Args:
        seed: of motors and clocks.
    """

    def __init__(self, seed: int) -> None:
        self._random = random.Random(seed)
        self.restart()

    def restart(self) -> None:
        """Start from rest."""
        self._simulation = Simulation(
            {MOTOR: PlantParameters()},
            'R[5,15]D[0.1,1]',
            seed=self._random.randrange(2**31),
            torque_noise_std=1e-4,
            start_ns=self._random.randrange(10**15, 10**18),
        )

    def sample(self) -> Iterator[tuple[str, JointStateView]]:
        """Yield the two messages of one sample, voltage first."""
        sample = self._simulation.step()
        for signal, value in (('voltage', sample.voltage_v), ('torque', sample.torque_nm)):
            yield signal, JointStateView(sample.stamp_ns, (MOTOR,), (), (), (float(value[0]),))


class Account:
    """Where every message went, over several observers."""

    def __init__(self) -> None:
        self.counts: Counter[str] = Counter()
        self.unexplained = 0

    def close(
        self, delivered: Counter[str], message_input: MessageInput, observer: Observer
    ) -> None:
        """Add what one observer was given and what became of it."""
        assert not observer.incidents, observer.incidents[MOTOR].trace
        pairing = observer.counts(MOTOR)
        for signal, of_motor in (
            ('voltage', pairing.received_voltage),
            ('torque', pairing.received_torque),
        ):
            unreadable = message_input.rejection_counts[signal].total()
            strangers = message_input.others[signal]
            self.unexplained += abs(delivered[signal] - of_motor - unreadable - strangers)
            self.counts.update({'unreadable': unreadable, 'of no motor asked for': strangers})
            self.counts.update(
                {
                    f'refused: {reason.value}': n
                    for reason, n in pairing.refusal_counts[signal].items()
                }
            )
            self.counts['delivered'] += delivered[signal]
        kept_count = pairing.used_count + pairing.waiting_count
        self.unexplained += abs(
            pairing.received_torque - kept_count - pairing.refusal_counts['torque'].total()
        )
        self.unexplained += abs(
            pairing.received_voltage
            - pairing.taken_voltage
            - pairing.refusal_counts['voltage'].total()
        )
        self.counts.update(
            {
                'samples used': pairing.used_count,
                'waiting': pairing.waiting_count,
                'voltages taken': pairing.taken_voltage,
            }
        )


class Campaign:
    """One run.

    Args:
        options: of the command line.
        folder: for the checkpoint.

    Attributes:
        faults: what has been done to the messages.
        account: where they went.
        memory_mb: resident memory over time.
        restored: checkpoints taken up again, all of them bit for bit.
    """

    def __init__(self, options: argparse.Namespace, folder: Path) -> None:
        self.faults = StreamFaults(FaultSettings(options.share, CORE_WEIGHTS), options.seed)
        self.account = Account()
        self.memory_mb: list[float] = []
        self.restored = 0
        self._options = options
        self._path = folder / 'observer.safetensors'
        self._source = Source(options.seed)
        self._begin()

    def run(self) -> None:
        """Feed every message, with restarts."""
        options = self._options
        every = options.messages // (options.restarts + 1)
        with tqdm(total=options.messages, unit='message', mininterval=1.0) as bar:
            while self.faults.seen < options.messages:
                for signal, message in self._source.sample():
                    for delivery in self.faults.take(signal, message):
                        self._take(*delivery)
                bar.update(2)
                if self.faults.seen % MEMORY_EVERY == 0:
                    self.memory_mb.append(psutil.Process().memory_info().rss / 1e6)
                if self.faults.seen % (every + every % 2) == 0:
                    self._restart_observer()
                    self._source.restart()
        for delivery in self.faults.flush():
            self._take(*delivery)

    def clean_minute(self) -> None:
        """Feed a minute of samples without any fault."""
        for _ in range(CLEAN_SAMPLES):
            for signal, message in self._source.sample():
                self._take(signal, message)

    def close_account(self) -> None:
        """Count what the present observer was given and what became of it."""
        self.account.close(self._delivered, self._message_input, self._observer)

    def deviation(self) -> float:
        """The largest deviation from the truth, in the estimate's own standard deviations."""
        estimate = self._observer.estimates()[MOTOR]
        return float(np.max(np.abs(estimate.value[0] - TRUTH) / estimate.std[0]))

    def counters(self) -> dict[str, int]:
        """Outliers, kicks and changes that the present observer has seen."""
        return self._observer.motors[MOTOR].counters

    def _take(self, signal: str, message: JointStateView | bytes) -> None:
        self._delivered[signal] += 1
        self._message_input.ingest(signal, message, 0)

    def _begin(self) -> None:
        configuration = Configuration.from_flat({'predictor': False})
        self._observer = Observer(configuration)
        self._message_input = MessageInput(self._observer, configuration)
        self._delivered: Counter[str] = Counter()

    def _restart_observer(self) -> None:
        self.close_account()
        before = self._observer.estimates()[MOTOR]
        checkpoint.save(self._observer, self._path)
        self._begin()
        checkpoint.load(self._observer, self._path)
        after = self._observer.estimates()[MOTOR]
        assert before.value.tobytes() == after.value.tobytes()
        assert before.covariance.tobytes() == after.covariance.tobytes()
        self.restored += 1


def main() -> int:
    """Run the campaign; the exit code is 1 where a figure is not reached."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument('--messages', type=int, default=1_000_000)
    parser.add_argument(
        '--share', type=float, default=0.3, help='of the messages that a fault touches'
    )
    parser.add_argument('--seed', type=int, default=1)
    parser.add_argument('--restarts', type=int, default=20, help='of observer and simulator')
    options = parser.parse_args()
    settle_memory()
    with tempfile.TemporaryDirectory() as folder:
        campaign = Campaign(options, Path(folder))
        campaign.run()
        during = campaign.deviation()
        campaign.clean_minute()
        campaign.close_account()
    faults = campaign.faults
    account = campaign.account
    print(f'{faults.seen} messages, of them')
    for kind, count in faults.counts.most_common():
        print(f'  {kind.value:<28} {count:>8}')
    print('became')
    for name, count in account.counts.most_common():
        print(f'  {name:<28} {count:>8}')
    figures = [
        Figure('messages unexplained', account.unexplained, 0.0),
        Figure('share of messages touched', faults.touched / faults.seen),
        Figure('largest deviation right after the faults, own standard deviations', during),
        Figure(
            'largest deviation after a clean minute, own standard deviations',
            campaign.deviation(),
            3.0,
        ),
        Figure('growth of memory in the second half, MB', growth(campaign.memory_mb), 5.0),
        Figure('largest memory, MB', max(campaign.memory_mb, default=0.0)),
        Figure('observers restored from a checkpoint, bit for bit', campaign.restored),
    ]
    counts = {kind.value: count for kind, count in faults.counts.items()}
    return tell(
        'core_campaign',
        options.seed,
        figures,
        {
            'messages': faults.seen,
            'faults': counts,
            'account': dict(account.counts),
            'counters': campaign.counters(),
        },
    )


if __name__ == '__main__':
    raise SystemExit(main())
