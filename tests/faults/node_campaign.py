"""A proxy on real DDS between simulator and observer that spoils what passes through it.

    python tests/faults/node_campaign.py [--messages 1000000] [--share 0.3] [--seed 1] [--restarts
    10]

Needs a sourced workspace. The simulator runs as fast as the proxy takes its messages, in simulated
time: 100 samples a simulated second. Faults are drawn by `stream_faults`. In the first half the
observer is killed and started again so many times, and goes on from its checkpoint, and as often
the simulator is, whose clock then begins anywhere; in the second half one observer lives on and its
memory is watched. At the end a minute of clean samples follows. Prints every fault by kind, where
every message went by the observer's own diagnostics, a table, and one line of JSON; ends with 1 if
a figure is not reached.
"""

from __future__ import annotations

import argparse
import random
import signal
import tempfile
import time
from collections import deque
from functools import partial
from pathlib import Path

from figures import Figure, growth, tell
from node_balance import Account, received
from observer_process import QUEUE, SIMULATOR, TOPICS, Bench
from rclpy.subscription import Subscription
from sensor_msgs.msg import JointState
from stream_faults import FaultSettings, StreamFaults
from tqdm import tqdm

from gray_box_observer.bag.joint_state import JointStateDecoder, JointStateView

WINDOW = QUEUE // 2
"""Messages that may be on their way; the observer tells once a second how many have come."""
CHUNK = 40
"""Messages sent at once: DDS keeps the order within a topic, but not between the two."""
CROWDED = 5_000
"""Samples of the simulator that wait in the proxy before the simulator is stopped for a while."""
CLEAN_MESSAGES = 12_000
"""The last minute, of 100 samples a second."""
SAMPLE_PERIOD_S = 1.0


class Proxy:
    """Stands between simulator and observer.

    Args:
        bench: feeds the observer.
        faults: what happens on the way.
        seed: of the simulators.
    """

    def __init__(self, bench: Bench, faults: StreamFaults, seed: int) -> None:
        self._bench = bench
        self._faults = faults
        self._random = random.Random(seed)
        self._waiting: dict[str, deque[bytes]] = {}
        self._subscriptions: list[Subscription] = []
        self._simulators = 0
        self._decode = JointStateDecoder()
        self._paused = False
        self.start_simulator()

    def start_simulator(self) -> None:
        """Start the simulator, from rest; its clock begins anywhere."""
        parameters = {
            'excitation': 'R[5,15]D[0.1,1]',
            'torque_noise_std': 1e-4,
            'publish_clock': True,
            'clock_speed_up': 50.0,
            'start_stamp_s': round(self._random.uniform(1e6, 1e9), 3),
            'seed': self._random.randrange(2**31),
            'wait_for_subscribers': 1,
        }
        self._simulators += 1
        remaps = []
        for name in TOPICS:  # topics of its own: what the one before had sent may still come
            topic = f'/driver_{self._simulators}/{name}'
            queue = deque[bytes]()
            callback = partial(_keep, queue)
            self._waiting[name] = queue
            self._subscriptions.append(
                self._bench.node.create_subscription(JointState, topic, callback, QUEUE, raw=True)
            )
            remaps.append(f'motor/{name}:={topic}')
        self._simulator = self._bench.start(SIMULATOR, parameters, *remaps)

    def restart_simulator(self) -> None:
        """Kill the simulator and start another; what waits here of the old one is forgotten."""
        self._resume()
        self._bench.kill(self._simulator)
        for subscription in self._subscriptions:
            self._bench.node.destroy_subscription(subscription)
        self._subscriptions.clear()
        self.start_simulator()

    def pump(self, most: int, *, clean: bool = False) -> int:
        """Pass on messages while few are on their way; return how many were taken."""
        on_the_way = self._bench.sent - received(self._bench.facts)
        room = min(most, WINDOW - on_the_way)
        taken = 0
        while taken < room and (sample := self._sample()) is not None:
            for name, message in sample:
                taken += 1
                if clean:
                    self._bench.send(name, message)
                    continue
                for delivery in self._faults.take(name, message):
                    self._bench.send(*delivery)
        self._throttle()
        return taken

    def _sample(self) -> list[tuple[str, JointStateView]] | None:
        """Take the voltage and the torque of one stamp; None where they have not both come.

        DDS keeps the order of each topic only, and the first messages may have missed us on one of
        them.
        """
        while all(self._waiting.values()):
            heads = [(name, self._decode(queue[0])) for name, queue in self._waiting.items()]
            oldest_ns = min(message.stamp_ns for _, message in heads)
            for name, message in heads:
                if message.stamp_ns == oldest_ns:
                    self._waiting[name].popleft()
            if all(message.stamp_ns == oldest_ns for _, message in heads):
                return heads
        return None

    def _throttle(self) -> None:
        crowd = len(self._waiting['torque'])
        if not self._paused and crowd > CROWDED:
            self._simulator.send_signal(signal.SIGSTOP)
            self._paused = True
        elif self._paused and crowd < CROWDED // 4:
            self._resume()

    def _resume(self) -> None:
        self._simulator.send_signal(signal.SIGCONT)
        self._paused = False


def _keep(queue: deque[bytes], data: bytes) -> None:
    queue.append(data)


class Campaign:
    """One run.

    Args:
        bench: the nodes.
        options: of the command line.
        folder: for the checkpoint.
    """

    def __init__(self, bench: Bench, options: argparse.Namespace, folder: Path) -> None:
        self._bench = bench
        self._options = options
        self._checkpoint = folder / 'observer.safetensors'
        self.faults = StreamFaults(FaultSettings(share=options.share), options.seed)
        self.account = Account()
        self.memory_mb: list[float] = []
        self._start_observer()
        self._proxy = Proxy(bench, self.faults, options.seed)

    def run(self) -> None:
        """Send every message, with restarts in the first half."""
        options = self._options
        half = options.messages // 2
        restarts = [half * (k + 1) // (options.restarts + 1) for k in range(options.restarts)]
        sampled_s = 0.0
        with tqdm(total=options.messages, unit='message', smoothing=0.05, mininterval=1.0) as bar:
            while self.faults.seen < options.messages:
                self._bench.check_alive()
                bar.update(self._proxy.pump(min(CHUNK, options.messages - self.faults.seen)))
                self._bench.spin(0.002)
                if restarts and self.faults.seen >= restarts[0]:
                    restarts.pop(0)
                    self._restart()
                if time.monotonic() - sampled_s > SAMPLE_PERIOD_S and self.faults.seen > half:
                    sampled_s = time.monotonic()
                    self.memory_mb.append(self._bench.memory_mb())
        for delivery in self.faults.flush():
            self._bench.send(*delivery)
        self._bench.settle()

    def clean_minute(self) -> None:
        """Send a minute of samples without any fault."""
        left = CLEAN_MESSAGES
        while left:
            left -= self._proxy.pump(min(CHUNK, left), clean=True)
            self._bench.spin(0.002)
            self._bench.check_alive()
        self._bench.settle()

    def close_account(self) -> None:
        """Count what this observer was sent and what it says of it."""
        self.account.close(self._bench.sent, self._bench.facts)

    def _restart(self) -> None:
        """Kill both sides; the observer once it has told where every message went."""
        self._bench.settle()
        self.close_account()
        self._bench.kill_observer()
        self._proxy.restart_simulator()
        self._start_observer()

    def _start_observer(self) -> None:
        predictor = {'predictor': self._options.predictor}
        self._bench.start_observer(self._checkpoint, **{'checkpoint.period_s': 1.0}, **predictor)


def main() -> int:
    """Run the campaign; the exit code is 1 where a figure is not reached."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        '--messages', type=int, default=1_000_000, help='messages that the proxy takes'
    )
    parser.add_argument('--share', type=float, default=0.3, help='of them that a fault touches')
    parser.add_argument('--seed', type=int, default=1)
    parser.add_argument(
        '--restarts', type=int, default=10, help='of observer and simulator, in the first half'
    )
    parser.add_argument(
        '--predictor', action=argparse.BooleanOptionalAction, default=True, help='train and predict'
    )
    parser.add_argument(
        '--domain', type=int, default=80, help='ROS domain of everything that is started'
    )
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        log = Path(folder) / 'log'
        with log.open('w+', encoding='utf-8') as file:
            bench = Bench(options.domain, file)
            try:
                campaign = Campaign(bench, options, Path(folder))
                campaign.run()
                during = bench.deviations()
                campaign.clean_minute()
                after = bench.deviations()
                campaign.close_account()
            finally:
                bench.close()
                said = log.read_text(encoding='utf-8', errors='replace')
                print(
                    '\n'.join(
                        line
                        for line in said.splitlines()
                        if 'rror' in line and 'sequence size' not in line
                    )[-2000:]
                )
    return _report(options, campaign, during, after, said.count('Traceback'))


def _report(
    options: argparse.Namespace,
    campaign: Campaign,
    during: dict[str, float],
    after: dict[str, float],
    tracebacks: int,
) -> int:
    faults = campaign.faults
    account = campaign.account
    print(f'{faults.seen} messages of the simulator, of them')
    for kind, count in faults.counts.most_common():
        print(f'  {kind.value:<28} {count:>8}')
    print(f'{account.delivered} messages sent to observers, of them')
    rows = {
        'samples used': account.used,
        'voltages taken': account.taken,
        'waiting for voltage': account.waiting,
        'unreadable': account.unreadable,
        'of no motor asked for': account.strangers,
        **{f'refused: {reason}': count for reason, count in account.refused.most_common()},
        'unexplained': account.unexplained,
    }
    for name, count in rows.items():
        print(f'  {name:<28} {count:>8}')
    figures = [
        Figure('messages unexplained', account.unexplained, 0.0),
        Figure('tracebacks', tracebacks, 0.0),
        Figure('share of messages touched', faults.touched / faults.seen),
        Figure(
            'largest deviation right after the faults, own standard deviations',
            max(map(abs, during.values())),
        ),
        Figure(
            'largest deviation after a clean minute, own standard deviations',
            max(map(abs, after.values())),
            3.0,
        ),
        Figure('growth of memory in the second half, MB', growth(campaign.memory_mb), 5.0),
        Figure('largest memory, MB', max(campaign.memory_mb, default=0.0)),
    ]
    counts = {
        'messages': faults.seen,
        'faults': {kind.value: n for kind, n in faults.counts.items()},
        'account': rows,
    }
    return tell('node_campaign', options.seed, figures, counts)


if __name__ == '__main__':
    raise SystemExit(main())
