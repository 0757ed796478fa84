"""Bags of simulated motors, made when needed: seeded, so that a call repeats its bytes."""

from __future__ import annotations

from pathlib import Path

from dc_motor_sim.plant import PlantParameters
from dc_motor_sim.simulation import Simulation
from gray_box_observer.bag.joint_state import TYPE_NAME, encode_joint_state
from gray_box_observer.bag.schemas import built_in_lookup, schema_text
from gray_box_observer.bag.writer import BagOptions, BagWriter

MOTOR = 'motor'
SAMPLE_RATE_HZ = 100.0


def write_bag(
    folder: Path, seed: int, duration_s: float, *, start_ns: int, resistance: float = 1.0
) -> None:
    """Record the thesis's motor at 100 Hz with torque noise of 1 %, in chunks of one second.

    Args:
        folder: of the rosbag2 bag; must not exist.
        seed: of excitation and noise.
        duration_s: length of the recording.
        start_ns: its first stamp.
        resistance: of the motor in ohm, for a trend over several bags.
    """
    simulation = Simulation(
        {MOTOR: PlantParameters(resistance=resistance)},
        'R[5,15]D[1,20]',
        sample_rate_hz=SAMPLE_RATE_HZ,
        seed=seed,
        start_ns=start_ns,
        torque_noise_relative=0.01,
    )
    recording = simulation.record(duration_s)
    schema = schema_text(TYPE_NAME, built_in_lookup)
    with BagWriter(folder, BagOptions(flush_period_s=1e9, library='gray_box_observer')) as bag:
        for topic in ('/motor/voltage', '/motor/torque'):
            bag.add_topic(topic, TYPE_NAME, schema)
        signals = zip(
            recording.stamp_ns, recording.voltage_v[0], recording.torque_nm[0], strict=True
        )
        for k, (stamp, voltage_v, torque_nm) in enumerate(signals):
            stamp_ns = int(stamp)
            for topic, value in (('/motor/voltage', voltage_v), ('/motor/torque', torque_nm)):
                data = encode_joint_state(stamp_ns, [MOTOR], effort=[float(value)])
                bag.write(topic, data, stamp_ns, stamp_ns)
            if k % int(SAMPLE_RATE_HZ) == int(SAMPLE_RATE_HZ) - 1:
                bag.flush()
