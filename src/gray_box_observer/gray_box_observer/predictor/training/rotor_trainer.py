"""Training for a motor with a rotor: its physics is integrated, only the residual is learnt."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np

from gray_box_observer.context_nodes.rotor.window import History as RotorHistory
from gray_box_observer.context_nodes.rotor.window import Window
from gray_box_observer.context_nodes.rotor.window_fit import settled_runs
from gray_box_observer.predictor.held_speed import held_speed_current
from gray_box_observer.predictor.predictor_settings import TrainingSettings
from gray_box_observer.predictor.training import random_state
from gray_box_observer.predictor.training.histories import History, histories
from gray_box_observer.predictor.training.residual_trainer import PhysicsRun, ResidualTrainer
from gray_box_observer.predictor.training.trainer import Message
from gray_box_observer.white_box import MotorWhiteBox
from gray_box_observer.white_box.declaration import State
from gray_box_observer.white_box.interface import Array


class RotorTrainer:
    """Holds the residual under training; there is no network of the physics.

    Args:
        configuration: that of :func:`~.trainer_choice.make_trainer`.
    """

    def __init__(self, configuration: Mapping[str, Any]) -> None:
        self._white_box = MotorWhiteBox.from_dict(configuration['white_box'], float)
        self._rules = TrainingSettings.from_dict(configuration['rules'])
        self._seed = int(configuration['seed'])
        self._random = np.random.default_rng([self._seed, 1])
        self._residual = ResidualTrainer(self._seed, self._rules.device)

    def train(self, job: Message) -> Message:
        """Run one job; see :meth:`~gray_box_observer.predictor.training.trainer.Trainer.train`.

        Raises:
            ImportError: there is something to learn, and no torch to learn it with.
        """
        prefix = 'start_learning_residual_'
        residual = {name[len(prefix) :]: job[name] for name in job if name.startswith(prefix)}
        if residual or job.get('residual_anew'):
            self._residual = ResidualTrainer(self._seed, self._rules.device)
        if residual and not job.get('residual_anew'):
            self._residual.restore(residual)
        answer: Message = {'windows': 0, 'settled': True}
        if job.get('residual') and not self._white_box.load_varies:
            physics = partial(rotor_run, self._white_box, np.asarray(job['theta'])[0])
            answer |= self._residual.learn_beside(physics, histories(self._white_box, job))
        state = {f'residual_{name}': array for name, array in self._residual.state().items()}
        state |= {'refused': np.array(0), 'random': random_state.pack(self._random)}
        return {**answer, **{f'learning_{name}': array for name, array in state.items()}}


def rotor_run(white_box: MotorWhiteBox, theta: Array, history: History) -> PhysicsRun | None:
    """Run freely through a history, its first states where they fit best; None: it cannot.

    Args:
        white_box: of one motor with a rotor.
        theta: shape (parameter,).
        history: signals with a motor axis of one.
    """
    sequences = history.sequences
    current_a = np.concatenate([sequences.start_a, history.current_a[0]])
    signals = RotorHistory(current_a, sequences.voltage_v[0], sequences.interval_s[0])
    runs = settled_runs(white_box, theta, Window((signals,)))
    if runs is None:
        return None
    states = runs.runs[0].states
    speed = states[None, :-1, State.SPEED]
    values = white_box.values(theta)
    steady_a = held_speed_current(values, sequences.voltage_v, speed)
    return PhysicsRun(states[None, 1:, State.CURRENT], steady_a, speed)
