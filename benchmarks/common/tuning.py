"""Tuning of the peers: a grid over held-out seeds, separately for each data set.

For every data set the setting wins whose error at the end of the recording, in multiples of the
Cramer-Rao bound and averaged over seeds on a logarithmic scale (so that one diverged run does not
decide), is smallest. The starts are two to three times off either way, because a user does not know
the direction; the winner then runs from every start. The winners stand in ``tuned_peers.json``;
``identification.py --tune`` makes it anew. Nothing of this project's own is tuned: its defaults run
everywhere.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from common.cases import CASES, Case, Record, simulate
from common.cramer_rao import bound
from common.estimator import OWN_RULES, Online, OwnRule
from common.kalman import Extended, KalmanSettings, Unscented
from common.least_squares import Recursive, RecursiveSettings
from common.moving_horizon import HorizonSettings, MovingHorizon
from common.trace import follow

TUNED = Path(__file__).with_name('tuned_peers.json')
FIRST_SEED = 1000
NOISE = 0.01
WORST_MULTIPLE = 1e6


@dataclass(frozen=True, slots=True)
class Peer:
    """One online method that users might pick.

    Attributes:
        title: for tables.
        build: makes it for a recording.
        settings: the class of its settings.
        grid: values to try, by field.
        seeds: number of held-out seeds to tune on; 0 leaves the defaults.
        part: fraction of each recording that is used.
    """

    title: str
    build: Callable[[Record, Any], Online]
    settings: type
    grid: dict[str, Sequence[Any]]
    seeds: int
    part: float = 1.0


PEERS = {
    'rls': Peer(
        'RLS on differences (padasip)',
        Recursive,
        RecursiveSettings,
        {
            'stride': (1, 2, 5, 10, 20, 50),
            'forgetting': (1.0, 0.9999, 0.999),
            'initial': (1e-3, 1e-6),
        },
        4,
    ),
    'rls integrated': Peer(
        'RLS, integrated equation (padasip)',
        Recursive,
        RecursiveSettings,
        {
            'stride': (3, 5, 10, 20, 50, 100, 200),
            'integrated': (True,),
            'forgetting': (1.0, 0.9999, 0.999),
            'initial': (1e-3, 1e-6),
        },
        4,
    ),
    'ekf textbook': Peer('EKF, logarithms, untuned (filterpy)', Extended, KalmanSettings, {}, 0),
    'ekf': Peer(
        'EKF, tuned (filterpy)',
        Extended,
        KalmanSettings,
        {
            'coordinates': ('log', 'linear'),
            'initial_std': (0.1, 0.3, 1.0, 3.0),
            'walk_std': (0.0, 1e-4),
            'current_std': (0.0, 1e-2),
        },
        6,
    ),
    'ukf': Peer(
        'UKF, tuned (filterpy)',
        Unscented,
        KalmanSettings,
        {
            'coordinates': ('log', 'linear'),
            'initial_std': (0.1, 0.3, 1.0),
            'current_std': (0.0, 1e-2),
            'alpha': (0.1, 1.0),
        },
        3,
    ),
    'mhe': Peer(
        'MHE (do-mpc)',
        MovingHorizon,
        HorizonSettings,
        {'horizon': (20, 40, 80), 'memory': (1.0, 1e1, 1e2, 1e3, 1e4, 1e5)},
        1,
        0.2,
    ),
}


def estimators(case: Case) -> dict[str, Callable[[Record], Online]]:
    """Everything that runs online on a case, by name: the package's rules, then the tuned peers."""
    made: dict[str, Callable[[Record], Online]] = {
        name: partial(OwnRule, name) for name in OWN_RULES
    }
    for name, peer in PEERS.items():
        made[name] = partial(peer.build, settings=tuned(name, case))
    return made


def tuned(name: str, case: Case) -> Any:
    """Settings of a peer on a case; its defaults where it was never tuned."""
    table = json.loads(TUNED.read_text()) if TUNED.exists() else {}
    return PEERS[name].settings(**table.get(_key(name, case), {}))


def _key(name: str, case: Case) -> str:
    return f'{name} / {case.name}'


def jobs() -> list[tuple[str, Case]]:
    """Everything there is to tune, the slowest first."""
    return [(name, case) for name in reversed(PEERS) for case in CASES if PEERS[name].seeds]


def tune(name: str, case: Case) -> tuple[str, dict[str, Any], float]:
    """Find the best settings of a peer; return key, values and error in multiples of the bound."""
    peer = PEERS[name]
    seeds = range(FIRST_SEED, FIRST_SEED + peer.seeds)
    clean = simulate(case, seeds, peer.part * case.duration_s)
    records = [clean.record(seed, NOISE, either_way=True) for seed in seeds]
    bounds = [bound(record) for record in records]
    best: tuple[float, dict[str, Any]] = (np.inf, {})
    for values in product(*peer.grid.values()):
        settings = peer.settings(**dict(zip(peer.grid, values, strict=True)))
        score = 0.0
        for record, limit in zip(records, bounds, strict=True):
            end = follow(
                partial(peer.build, settings=settings), record, np.array([record.stamp_ns.size - 1])
            )
            multiple = float(np.sqrt(np.mean((end.error[-1] / limit) ** 2)))
            score += np.log(
                min(multiple, WORST_MULTIPLE) if np.isfinite(multiple) else WORST_MULTIPLE
            )
        best = min(best, (score / len(records), asdict(settings)), key=lambda pair: pair[0])
    return _key(name, case), best[1], float(np.exp(best[0]))
