"""What the demo observes: the simulator with a known truth, or a replayed bag."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml
from demo_processes import DemoError

FIRST_GUESS_FACTOR = 3.0
READERS_OF_TORQUE = 2
"""Observer and recorder; the source waits for both, so that neither misses the first sample."""
START_PATIENCE_S = 60.0
USUAL_RATE_HZ = 100.0
"""Of the simulator, where a motor says no other."""
HISTORY_S = 60.0
"""So much of both signals may wait on its way, so that a busy machine loses nothing of a run."""


@dataclass(frozen=True)
class DemoMotor:
    """A motor that the demo simulates.

    Attributes:
        truth: its parameters that are to be found, in SI units.
        known: what the observer is told of it.
        simulated: further parameters of the simulator's motor.
        node: parameters of the simulator.
        excitation: voltage unless the user says another; it moves within the first seconds.
        guess_factor: how far off the observer starts; 0: from its defaults.
        torque_spread_nm: standard deviation of its torque, where a dry run of the simulator would
            take long to find it; 0: found so.
    """

    truth: Mapping[str, float]
    known: Mapping[str, Any]
    simulated: Mapping[str, Any]
    node: Mapping[str, Any]
    excitation: str
    guess_factor: float
    torque_spread_nm: float = 0.0


_GEARED_CONSTANTS = {'torque_constant': 0.03, 'back_emf_constant': 0.03}

MOTORS = {
    'thesis': DemoMotor(
        truth={'inductance': 0.5, 'resistance': 1.0, 'hysteresis': 10.0},
        known={
            'torque_constant': 0.01,
            'back_emf_constant': 0.01,
            'speed_source': 'torque_constant',
        },
        simulated={},
        node={},
        excitation='R[5,15]D[0.3,3]',
        guess_factor=FIRST_GUESS_FACTOR,
    ),
    'geared': DemoMotor(
        truth={
            'inductance': 0.006,
            'resistance': 2.0,
            'inertia': 2.7e-5,
            'viscous_friction': 2.25e-5,
            'coulomb_friction': 0.009,
        },
        known={**_GEARED_CONSTANTS, 'speed_source': 'auto'},
        simulated={**_GEARED_CONSTANTS, 'hysteresis': 0.0},
        node={'speed_mode': 'rotor', 'speed_hidden': True, 'sample_rate_hz': 500.0},
        excitation='R[-12,12]D[0.05,0.5]',
        guess_factor=0.0,
        torque_spread_nm=0.04,
    ),
}
"""By the name that ``--motor`` gives: the thesis's, whose speed follows the current, and one with a
free rotor that nobody measures."""


@dataclass(frozen=True, slots=True)
class Source:
    """A process that publishes samples.

    Attributes:
        name: what it is called in messages.
        command: how it is started.
        duration_s: how long it takes.
        samples: torques that it publishes; None where that is not known.
        params: the observer's parameter file; None for its defaults.
        truth: file of the true parameters, where they are known.
        record_all: whether the recorder cannot know the topics by their names.
    """

    name: str
    command: tuple[str | Path, ...]
    duration_s: float
    samples: int | None
    params: Path | None
    truth: Path | None
    record_all: bool


def simulator(
    run: Path,
    params: Path | None,
    *,
    motor: DemoMotor,
    excitation: str | None,
    duration_s: float,
    seed: int,
    torque_noise: float,
) -> Source:
    """A simulated motor; without a parameter file the observer is told its constants.

    Args:
        run: folder for the files that it needs.
        params: the observer's parameter file, if the user has one.
        motor: which one.
        excitation: voltage signal in the language of the simulator; None for the motor's own.
        duration_s: simulated and real seconds.
        seed: of everything random.
        torque_noise: as a fraction of the standard deviation of the torque.
    """
    truth = run / 'truth.yaml'
    truth.write_text(
        yaml.safe_dump({'motors': {'motor': dict(motor.truth)}}, sort_keys=False), encoding='utf-8'
    )
    rate_hz = motor.node.get('sample_rate_hz', USUAL_RATE_HZ)
    parameters = {
        **motor.node,
        'sample_rate_hz': rate_hz,
        **_history('publisher', rate_hz),
        'excitation': excitation or motor.excitation,
        'duration_s': duration_s,
        'seed': seed,
        **_noise(motor, torque_noise),
        'wait_for_subscribers': READERS_OF_TORQUE,
        'wait_timeout_s': START_PATIENCE_S,
        'motors': ['motor'],
        'motor': {**motor.truth, **motor.simulated},
    }
    if params is None:
        known = dict(motor.known)
        if motor.guess_factor:
            known['initial'] = {
                name: motor.guess_factor * value for name, value in motor.truth.items()
            }
        observer = {'motors': ['motor'], 'motor': known, **_history('subscription', rate_hz)}
        params = write_parameters(run / 'observer.yaml', observer)
    file = write_parameters(run / 'simulator.yaml', parameters)
    command = (executable('dc_motor_sim', 'motor_sim'), '--ros-args', '--params-file', file)
    samples = round(duration_s * rate_hz)
    return Source('simulator', command, duration_s, samples, params, truth, record_all=False)


def _history(end: str, rate_hz: float) -> dict[str, int]:
    """Return the parameters that make one end of both signals keep a minute of them."""
    return {
        f'qos_overrides./motor/{signal}.{end}.depth': round(HISTORY_S * rate_hz)
        for signal in ('voltage', 'torque')
    }


def _noise(motor: DemoMotor, fraction: float) -> dict[str, float]:
    """Return the simulator's parameter of the torque noise."""
    if motor.torque_spread_nm:
        return {'torque_noise_std': fraction * motor.torque_spread_nm}
    return {'torque_noise_relative': fraction}


def replay(run: Path, params: Path | None, *, bag: Path, rate: float) -> Source:
    """A recorded bag, less what an observer said then: the running one says it anew.

    Args:
        run: folder for the files that it needs.
        params: the observer's parameter file, if it needs one.
        bag: rosbag2 folder or bare MCAP file; a ``truth.yaml`` in or beside it holds the true
            parameters.
        rate: recorded seconds per second.

    Raises:
        DemoError: The bag cannot be used.
    """
    from gray_box_observer.bag.reader import BagReader
    from gray_box_observer.errors import BagError
    from gray_box_observer.report.run.truth import find_truth

    try:
        reader = BagReader(bag)
    except BagError as error:
        raise DemoError(str(error)) from error
    topics = [
        name
        for name in reader.topics
        if not name.startswith('/gray_box_observer/') and name != '/diagnostics'
    ]
    duration_s = reader.duration_ns * 1e-9 / rate
    reader.close()
    if not topics:
        raise DemoError(
            f'{bag} holds nothing but what an observer said; expected voltage and torque'
        )
    parameters = {
        'bag': str(bag.resolve()),
        'topics': topics,
        'rate': rate,
        'wait_for_subscribers': READERS_OF_TORQUE,
        'wait_timeout_s': START_PATIENCE_S,
    }
    file = write_parameters(run / 'player.yaml', parameters)
    command = (executable('gray_box_observer', 'player'), '--ros-args', '--params-file', file)
    return Source('player', command, duration_s, None, params, find_truth(bag), record_all=True)


def executable(package: str, name: str) -> Path:
    """The path of an executable of the sourced workspace."""
    from ament_index_python.packages import PackageNotFoundError, get_package_prefix

    try:
        path = Path(get_package_prefix(package)) / 'lib' / package / name
    except PackageNotFoundError as error:
        raise DemoError(f'{package} is not in the sourced workspace; run make demo') from error
    if not path.is_file():
        raise DemoError(f'{path} is missing; run make setup')
    return path


def write_parameters(path: Path, parameters: Mapping[str, Any]) -> Path:
    """Write a ROS parameter file that serves whichever node reads it."""
    path.write_text(
        yaml.safe_dump({'/**': {'ros__parameters': dict(parameters)}}, sort_keys=False),
        encoding='utf-8',
    )
    return path
