"""Makes the recorded runs of this folder: same command, same bytes.

    python bags/make_bags.py [--out FOLDER] [NAME ...]

Each is the motor of the thesis at 100 Hz with torque noise of 1 % of the torque's standard
deviation, as a rosbag2 folder with ``truth.yaml`` in it (times in s since the first sample).
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path

import yaml

from dc_motor_sim.plant import PlantParameters
from dc_motor_sim.simulation import Recording, Simulation
from gray_box_observer.bag.joint_state import TYPE_NAME, encode_joint_state
from gray_box_observer.bag.schemas import JOINT_STATE_HASH, built_in_lookup, schema_text
from gray_box_observer.bag.writer import BagOptions, BagWriter
from gray_box_observer.csv_import.log_conversion import SIGNAL_QOS

DURATION_S = 120.0
SAMPLE_RATE_HZ = 100.0
START_NS = 1_000_000_000
TORQUE_NOISE = 0.01
TRUTH = {'inductance': 0.5, 'resistance': 1.0, 'hysteresis': 10.0}
MOTOR = 'motor'


@dataclass(frozen=True)
class Run:
    """One run: its voltage, its seed, and what changes while it lasts."""

    excitation: str
    seed: int
    schedule: tuple[str, ...] = ()
    changed: tuple[tuple[str, float, float], ...] = ()


RUNS = {
    'training_set': Run('R[1,2]D[3,3]', seed=1),
    'moderate': Run('R[5,15]D[1,20]', seed=2),
    'drift': Run(
        'R[5,15]D[0.001,2]',
        seed=3,
        schedule=('motor.resistance=1.3@60',),
        changed=(('resistance', 60.0, 1.3),),
    ),
}


def main() -> int:
    """Make the runs that are named, or all."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        'names', nargs='*', metavar='NAME', help=f'among {", ".join(RUNS)}; all by default'
    )
    parser.add_argument(
        '--out', type=Path, default=Path(__file__).resolve().parent, help='folder to make them in'
    )
    options = parser.parse_args()
    unknown = [name for name in options.names if name not in RUNS]
    if unknown:
        parser.error(f'no run named {unknown[0]!r}; there are {", ".join(RUNS)}')
    for name in options.names or RUNS:
        make(RUNS[name], options.out / name)
        print(f'made {options.out / name}')
    return 0


def make(run: Run, folder: Path) -> None:
    """Simulate one run and write it, voltage before torque at each stamp."""
    simulation = Simulation(
        {MOTOR: PlantParameters(**TRUTH)},
        run.excitation,
        sample_rate_hz=SAMPLE_RATE_HZ,
        seed=run.seed,
        start_ns=START_NS,
        torque_noise_relative=TORQUE_NOISE,
        schedule=run.schedule,
    )
    write(simulation.record(DURATION_S), folder)
    truth: dict[str, object] = dict(TRUTH)
    for name, time_s, value in run.changed:
        truth[name] = [[0.0, TRUTH[name]], [time_s, value]]
    text = f'# {run.excitation}, seed {run.seed}, made by: python bags/make_bags.py {folder.name}\n'
    (folder / 'truth.yaml').write_text(
        text + yaml.safe_dump({'motors': {MOTOR: truth}}, sort_keys=False)
    )


def write(recording: Recording, folder: Path) -> None:
    """Write a recording of one motor as a compressed rosbag2 folder."""
    schema = schema_text(TYPE_NAME, built_in_lookup)
    # a name without version: the next release makes the same bytes
    options = BagOptions(compression='zstd', flush_period_s=1e9, library='gray_box_observer')
    with BagWriter(folder, options) as bag:
        for topic in ('/motor/voltage', '/motor/torque'):
            bag.add_topic(topic, TYPE_NAME, schema, [SIGNAL_QOS], JOINT_STATE_HASH)
        signals = zip(
            recording.stamp_ns, recording.voltage_v[0], recording.torque_nm[0], strict=True
        )
        for stamp, voltage_v, torque_nm in signals:
            stamp_ns = int(stamp)
            for topic, value in (('/motor/voltage', voltage_v), ('/motor/torque', torque_nm)):
                data = encode_joint_state(stamp_ns, [MOTOR], effort=[float(value)])
                bag.write(topic, data, stamp_ns, stamp_ns)


if __name__ == '__main__':
    raise SystemExit(main())
