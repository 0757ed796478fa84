"""Publishes a recorded motor at a steady rate, to relay and observer in turn, and notes when.

Everything is computed before the first sample and messages go out as bytes, so that the source
takes little of the machine. Stamps are those of the ideal grid; a device sees one signal without
gap though it is served by turns.
"""

from __future__ import annotations

import argparse
import gc
import struct
import time
from pathlib import Path

import numpy as np
import psutil
import rclpy
from numpy.typing import NDArray
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState

from common.live.processes import cpu_s, family
from common.live.topics import DEVICES, MOTOR, full_name, stamped
from dc_motor_sim.plant import PlantParameters
from dc_motor_sim.simulation import Simulation
from gray_box_observer.ros import topics

PATIENCE_S = 30.0
PAUSE_S = 0.2
"""Between turns: the one before has been answered to the end."""
START_NS = 1_000_000_000_000
_VALUE = struct.Struct('<d')


def recorded(
    rate_hz: float, count: int, seed: int
) -> tuple[int, NDArray[np.float64], NDArray[np.float64]]:
    """Simulate the thesis's motor with 1 % torque noise; return period (ns), voltages, torques."""
    simulation = Simulation(
        {MOTOR: PlantParameters()},
        'R[1,5]D[0.05,0.5]',
        sample_rate_hz=rate_hz,
        seed=seed,
        torque_noise_relative=0.01,
    )
    samples = [simulation.step() for _ in range(count)]
    voltage_v = np.array([sample.voltage_v[0] for sample in samples])
    return simulation.period_ns, voltage_v, np.array([sample.torque_nm[0] for sample in samples])


def template() -> tuple[bytearray, int]:
    """A serialised message of one motor, and where its only number stands."""
    mark = 1234.5678
    data = bytearray(serialize_message(JointState(name=[MOTOR], effort=[mark])))
    return data, data.index(_VALUE.pack(mark))


class Source(Node):
    """Voltage and torque publishers of both devices."""

    def __init__(self) -> None:
        super().__init__('source')
        self._senders = {
            device: [
                self.create_publisher(t.type, full_name(device, t), t.qos)
                for t in (topics.VOLTAGE, topics.TORQUE)
            ]
            for device in DEVICES
        }
        self._data, self._at = template()

    def wait_for_readers(self) -> None:
        """Return once both devices listen to both topics.

        Raises:
            TimeoutError: they do not.
        """
        until_s = time.monotonic() + PATIENCE_S
        publishers = [publisher for pair in self._senders.values() for publisher in pair]
        while not all(publisher.get_subscription_count() for publisher in publishers):
            if time.monotonic() > until_s:
                raise TimeoutError(f'the devices do not listen after {PATIENCE_S} s')
            time.sleep(0.05)

    def send(self, device: str, stamp_ns: int, *values: float) -> None:
        """Publish voltage in V and torque in N m of one stamp."""
        for publisher, value in zip(self._senders[device], values, strict=True):
            data = stamped(self._data, stamp_ns)
            _VALUE.pack_into(data, self._at, value)
            publisher.publish(bytes(data))

    def wait_for_acknowledgement(self) -> None:
        """Return once everything has been received, or after some seconds."""
        for publisher in (publisher for pair in self._senders.values() for publisher in pair):
            publisher.wait_for_all_acked(Duration(seconds=5.0))


def main() -> int:
    """Send turns by turns; write when each sample of each device went out."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--rate', type=float, required=True, help='samples a second')
    parser.add_argument('--turn', type=float, required=True, help='length of a turn in s')
    parser.add_argument('--turns', type=int, required=True, help='turns of each device')
    parser.add_argument('--seed', type=int, default=1)
    parser.add_argument(
        '--watch', type=int, nargs=len(DEVICES), required=True, help='process of each device'
    )
    parser.add_argument('--out', type=Path, required=True)
    options = parser.parse_args()
    per_turn = round(options.turn * options.rate)
    period_ns, voltage_v, torque_nm = recorded(options.rate, per_turn * options.turns, options.seed)
    rclpy.init()
    source = Source()
    source.wait_for_readers()
    time.sleep(1.0)  # a device that is matched here may not have matched us yet
    watched = [psutil.Process(number) for number in options.watch]
    before_s = [cpu_s(family(process)) for process in watched]
    sent_ns = {device: np.zeros(voltage_v.size, dtype=np.int64) for device in DEVICES}
    gc.disable()
    for turn in range(options.turns):
        for device in DEVICES:
            start_s = time.monotonic() + PAUSE_S
            for j in range(per_turn):
                k = turn * per_turn + j
                wait_s = start_s + j / options.rate - time.monotonic()
                if wait_s > 0.0:
                    time.sleep(wait_s)
                sent_ns[device][k] = time.time_ns()
                source.send(device, START_NS + k * period_ns, voltage_v[k], torque_nm[k])
    source.wait_for_acknowledgement()
    used_s = [
        cpu_s(family(process)) - before for process, before in zip(watched, before_s, strict=True)
    ]
    np.savez(options.out, period_ns=period_ns, cpu_s=used_s, **sent_ns)
    source.destroy_node()
    rclpy.shutdown()
    return 0


if __name__ == '__main__':
    raise SystemExit(main())
