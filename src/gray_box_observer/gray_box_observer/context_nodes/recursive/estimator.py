"""The default rule: efficient recursive maximum likelihood with an honest covariance.

Route (docs/METHOD.md): a linear start on the integrated equation; Gauss-Newton on the prediction
error over everything remembered, repeated each time the data have doubled; in between, block by
block, a Kalman update of (state, coordinates) with exact zero-order-hold sensitivities. Repeating
the fit takes out what early linearisation had spoilt, so that the recursion stands where the batch
estimate stands; with white torque noise that is the Cramer-Rao bound.

Robust: outliers of torque are weighted out; a wrong voltage sample shows as a kick of the state and
is met by letting the state, not the parameters, go. A changed motor is detected
(:mod:`change_test`), the estimate settles on the new data; a winding that heats is given freedom to
walk (:mod:`random_walk`); a voltage held for long moves nothing else (:mod:`constant_voltage`).

:mod:`block_updater` does the work; here it is dealt out. Motors learn what each would learn alone,
from its own stream of samples; where many are due at once they take turns over the next samples, by
number of samples and never by a clock.
"""

from __future__ import annotations

from dataclasses import fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gray_box_observer.context_nodes.estimate import (
    Estimate,
    VerdictSettings,
    bounded,
    spread_of_values,
)
from gray_box_observer.context_nodes.native.regular_block import LEARNT, Turn
from gray_box_observer.context_nodes.native.regular_estimate import RegularEstimates
from gray_box_observer.context_nodes.recursive.belief import (
    Belief,
    Prior,
    check_belief,
    check_prior,
)
from gray_box_observer.context_nodes.recursive.block_updater import WALK_AGAIN, Learner
from gray_box_observer.context_nodes.recursive.change_test import MEMORIES_BLOCKS
from gray_box_observer.context_nodes.recursive.change_tracking import Following
from gray_box_observer.context_nodes.recursive.constant_voltage import HoldState, check_hold
from gray_box_observer.context_nodes.recursive.estimator_settings import RecursiveSettings
from gray_box_observer.context_nodes.recursive.estimator_state import Learnt, chosen, copied, put
from gray_box_observer.context_nodes.recursive.normal_equations import definite
from gray_box_observer.context_nodes.recursive.sample_windows import Motors
from gray_box_observer.context_nodes.recursive.trajectory import COORDINATES
from gray_box_observer.errors import CheckpointError, ConfigurationError
from gray_box_observer.safe_io.printable import printable
from gray_box_observer.safe_io.saved_state import (
    LARGEST_SIGNAL,
    LATEST_NS,
    MOST,
    ArrayRule,
    check_arrays,
    counts,
    flag,
    whole,
)
from gray_box_observer.samples.replay_buffer import ReplayBuffer, check_signals
from gray_box_observer.samples.sample import Sample
from gray_box_observer.white_box.flow import parameter_covariance, to_coordinates, to_parameters
from gray_box_observer.white_box.interface import Array, WhiteBox, bounds

CAREFUL = 128
"""Of these, motors at least whose blocks are no regular ones and are learnt with care; of many
motors a sixteenth."""

HEAVY = 4096
"""Samples, of one motor or of several together, that are fitted or examined at one sample of the
group."""

NEVER = np.iinfo(np.int64).max

FASTEST_WALK = 1.0
"""Rate of a walk, relative to one second: no winding gets there."""


class RecursiveUpdate:
    """Context nodes learnt by recursive maximum likelihood.

    Args:
        white_box: the physics.
        initial: shape (motor, parameter): where to start, SI units.
        seed: unused; every rule takes one.
        rules: settings.
        verdict_rules: when a parameter counts as identified.
        initial_relative_std: shape (motor, parameter): how well the initial values are known,
            relative to them; 0: as vaguely as the rules say. None: all of them.
        device: torch's, that learns the blocks of very many motors (:mod:`device_blocks`); None:
            the processor does.
    """

    def __init__(
        self,
        white_box: WhiteBox,
        initial: Array,
        seed: int = 0,
        rules: RecursiveSettings | None = None,
        verdict_rules: VerdictSettings | None = None,
        initial_relative_std: Array | None = None,
        device: str | None = None,
    ) -> None:
        self._white_box = white_box
        self._rules = rules or RecursiveSettings()
        self.verdict_rules = verdict_rules or VerdictSettings()
        self._lower, self._upper = bounds(white_box.parameters)
        theta = np.clip(np.asarray(initial, dtype=float), self._lower, self._upper)
        motors = theta.shape[0]
        vague = np.full(theta.shape, self._rules.prior_relative_std)
        told = vague if initial_relative_std is None else initial_relative_std
        prior = Prior.of_parameters(to_coordinates(theta), np.where(told > 0.0, told, vague))
        self._learnt = Learnt.nothing(prior, self._rules.first_fit)
        self.replay = ReplayBuffer(
            motors, self._rules.replay_capacity, speed_measured=white_box.speed_measured
        )
        self._following = Following(white_box.parameters, self._rules)
        self._ordinary = RegularEstimates(white_box.parameters, motors)
        self._learner = Learner(white_box, self._rules, self.replay, self._following, device)
        self._nobody = np.zeros(motors, dtype=bool)
        self._changed = self._nobody
        self._due, self._plain = np.zeros(motors, dtype=int), self._nobody.copy()
        self._reckon(slice(None))
        self._wake = 0
        self._stamp_ns = 0
        self._frozen = False
        self._resumes: NDArray[np.bool_] | None = None
        self._speed = np.zeros(motors)

    @property
    def theta(self) -> Array:
        """Present values, shape (motor, parameter)."""
        return np.clip(to_parameters(self._learnt.belief.p), self._lower, self._upper)

    @property
    def changed(self) -> NDArray[np.bool_]:
        """Whose estimate the last sample has changed, shape (motor,)."""
        return self._changed

    @property
    def noise_std_nm(self) -> Array:
        """Estimated standard deviation of the torque noise in N m, shape (motor,)."""
        return self._white_box.output(self._learnt.belief.noise)

    @property
    def alarms(self) -> int:
        """How often a motor was found changed."""
        return int(self._learnt.alarms.sum())

    def counters(self, motor: int | None = None) -> dict[str, int]:
        """Samples left out, state kicks, changes, and drift, of one motor or of all."""
        which, known = slice(None) if motor is None else slice(motor, motor + 1), self._learnt
        return {
            'torque outliers': int(known.outliers[which].sum()),
            'state kicks': int(known.kicks[which].sum()),
            'motor changes': int(known.alarms[which].sum()),
            'motors that drift': int(np.sum(known.walk_rate[which] > 0.0)),
        }

    def is_drifting(self, motor: int) -> bool:
        """Tell whether one motor is known to drift."""
        return bool(self._learnt.walk_rate[motor] > 0.0)

    def voltage_shares(self, motor: int) -> tuple[Array, Array]:
        """Return one motor's voltage shares per unit of parameter, and their 3-sigma bound."""
        return self._learnt.share[motor], self._learnt.reach[motor]

    def freeze(self, frozen: bool) -> None:
        """Stop or resume learning; frozen samples are not kept, a new signal history follows."""
        if frozen == self._frozen:
            return
        self._frozen = frozen
        self._resumes = None if frozen else np.ones_like(self._nobody)

    def estimate(self, which: Any = slice(None)) -> Estimate:
        """Return the present values with covariance and verdicts, of all motors or of some."""
        belief, parameters = self._learnt.belief, self._white_box.parameters
        everyone = isinstance(which, slice) and which == slice(None)
        motors = None if everyone else np.arange(self._due.size)[which]
        told = None if self._frozen else self._told(motors)
        if told is not None:
            return Estimate(self._stamp_ns, parameters, *told)
        theta = to_parameters(belief.p[which])
        posterior = (
            belief.covariance[which, COORDINATES, COORDINATES]
            * belief.noise[which, None, None] ** 2
        )
        covariance, theta = (
            parameter_covariance(theta, posterior),
            theta.clip(self._lower, self._upper),
        )
        covariance = spread_of_values(theta, 0.5 * (covariance + covariance.swapaxes(1, 2)))
        covariance = definite(bounded(theta, covariance), theta)
        std = np.sqrt(covariance.diagonal(0, 1, 2))
        share = self._learnt.share[which]
        most = np.where(share > 0.0, theta * share + self._learnt.reach[which], np.inf)
        verdicts = self.verdict_rules.judge(parameters, theta, std, frozen=self._frozen, most=most)
        return Estimate(self._stamp_ns, parameters, theta, covariance, verdicts)

    def _told(self, motors: NDArray[np.intp] | None) -> tuple[Any, ...] | None:
        """What compiled code tells of some motors; None where it does not."""
        known = self._learnt
        return self._ordinary.of(known.belief, motors, self.verdict_rules, known.share, known.reach)

    def learn(self, sample: Sample) -> bool:
        """Take one sample and do what is due. Tell whether an estimate changed; see ``changed``."""
        if (
            self._white_box.speed_measured
        ):  # a torque that came without its speed: the speed before holds on
            told = np.isfinite(sample.speed_rad_s)
            told = told if sample.present is None else told & sample.present
            self._speed = np.where(told, sample.speed_rad_s, self._speed)
        self._stamp_ns = sample.stamp_ns
        self._changed = self._nobody
        if self._frozen:
            return False
        if self._resumes is not None:
            sample, self._resumes = sample.resuming(self._resumes)
        self.replay.append(sample, self._speed)
        if self.replay.total < self._wake:
            return False
        self.replay.settle()
        self._learnt, turn = self._learner.learn_due(self._learnt, self._due, self._plain)
        self._changed = turn.changed
        if turn.wait:
            self._wake = self.replay.total + turn.wait
        else:
            with np.errstate(
                over='ignore', invalid='ignore', divide='ignore'
            ):  # absurd samples; results are checked
                self._serve(turn)
        return bool(self._changed.any())

    def _serve(self, turn: Turn) -> None:
        """Do what is due and has not been done, as much of it as one sample's turn allows."""
        received = self.replay.received
        if turn.motors is None:
            due = ((received >= self._due) & self._plain).nonzero()[0]
            motors = self._first_in_line(due, received, self._learner.turn)
            self._learnt, told = self._learner.learn_ordinary(
                self._learnt, motors, self._due, self._plain
            )
        else:
            motors, told = turn.motors, turn.told
        self._changed[motors] = told > 0
        self._learner.attend(self._learnt, motors, told)
        if (more := motors[told > LEARNT]).size:
            self._reckon(more)
        if (others := motors[told == 0]).size:
            careful = self._first_in_line(others, received, max(CAREFUL, self._due.size // 16))
            self._work(careful, self._due[careful] - self._learnt.at[careful], self._learner.update)
        while (
            self._heavy(received) > self.replay.capacity // 4
        ):  # what is to be read must still be remembered
            pass
        self._wake = self.replay.total + max(1, int((self._due - received).min()))

    def _first_in_line(
        self, motors: NDArray[np.intp], received: NDArray[np.int_], most: int
    ) -> NDArray[np.intp]:  # fmt: skip
        """Those that have waited longest, in order of their places."""
        if motors.size <= most:
            return motors
        waited = received[motors] - self._due[motors]
        return np.sort(motors[np.argsort(-waited, kind='stable')[:most]])

    def _heavy(self, received: NDArray[np.int_]) -> int:
        """Fit or examine the motors that waited longest; return the remaining wait in samples."""
        motors = ((received >= self._due) & ~self._plain).nonzero()[0]
        if motors.size == 0:
            return 0
        asked = self._learnt.asked
        waited = received[motors] - self._due[motors]
        motors = motors[np.argsort(-waited, kind='stable')]
        remembered = self.replay.remembered(motors, self._due[motors])
        samples = np.where(asked[motors] > 0, np.minimum(asked[motors], remembered), remembered)
        kind = np.sign(asked[motors])
        alike = (samples == samples[0]) & (kind == kind[0])
        motors = np.sort(motors[alike][: max(1, HEAVY // int(samples[0]))])
        work = {0: self._learner.fit, 1: self._following.examine, WALK_AGAIN: self._walk_again}[
            int(kind[0])
        ]
        self._work(motors, np.full(motors.size, samples[0]), work)
        return int(np.max(received - self._due))

    def _walk_again(self, motors: Motors, samples: int) -> None:
        self._following.walk_again(motors)

    def _work(self, motors: NDArray[np.intp], samples: NDArray[np.int_], work: Any) -> None:
        """Do a piece of work for some motors, in order, by equal numbers of samples."""
        self._learnt.at[motors] = self._due[motors]
        counts = samples[:1] if (samples == samples[0]).all() else np.unique(samples)
        for count in counts.tolist():
            alike = motors if counts.size == 1 else motors[samples == count]
            if alike.size == self._due.size:
                work(Motors(self._white_box, self.replay, slice(None), self._learnt), count)
                if alike.size > 1:  # nothing that is written to later may be shared
                    self._learnt = copied(self._learnt)
            else:
                part = Motors.of(self._white_box, self.replay, self._learnt, alike)
                work(part, count)
                put(self._learnt, part.which, part.learnt)
        which: Any = slice(None) if motors.size == self._due.size else motors
        self._changed[which] = True
        self._reckon(which)

    def _reckon(self, which: Any) -> None:
        """Reckon where in its stream each motor's next work is due, and whether it is a block."""
        known = self._learnt
        at, started = known.at[which], known.started[which]
        still = known.walk_rate[which] == 0.0  # a fit takes the parameters for constant
        fits = still & (
            (known.next_fit[which] <= self._rules.replay_capacity) | ~known.hold.begun[which]
        )
        fit_at = np.where(
            fits, np.maximum(self.replay.begin(which) + known.next_fit[which], at + 1), NEVER
        )
        update_at = np.where(started, at + self._rules.block, NEVER)
        asked = known.asked[which] != 0
        self._due[which] = np.where(asked, at, np.minimum(fit_at, update_at))
        self._plain[which] = ~asked & (fit_at > update_at)

    def state(self, motor: int = 0) -> tuple[dict[str, Any], dict[str, Array]]:
        """Everything learnt of one motor, as plain values and arrays with a motor axis of one."""
        which = slice(motor, motor + 1)
        known = chosen(self._learnt, which)
        received = int(self.replay.received[motor])
        content = self.replay.content(which, more=received - int(known.at[0]))
        plain: dict[str, Any] = {
            'new': received - int(known.at[0]),
            'next_fit': int(known.next_fit[0]),
            'started': bool(known.started[0]),
            'stamp_ns': self._stamp_ns,
            'noise_count': int(known.noise_count[0]),
            'resumes': self._resumes is not None and bool(self._resumes[motor]),
            'parameters': [p.name for p in self._white_box.parameters],
            'anchored': int(known.anchored[0]) - received,
            'examined': int(known.examined[0]) - received,
            'gone': received - content.shape[2],
            'begin': int(self.replay.begin(which)[0]),
            'asked': int(known.asked[0]),
        }
        arrays = {name: getattr(known, name).copy() for name in _ARRAYS}
        arrays |= {
            'prior_p': known.prior.p.copy(),
            'prior_covariance': known.prior.covariance.copy(),
        }
        arrays |= {
            'drift_score': np.moveaxis(known.score, 1, 0).copy(),
            'drift_information': np.moveaxis(known.information, 1, 0).copy(),
        }
        arrays |= {'speed': self._speed[which].copy(), 'replay': content}
        parts: dict[str, Any] = {
            'belief': known.belief,
            'anchor': known.anchor,
            'holds': known.hold,
        }
        for part, content in parts.items():
            arrays |= {f'{part}.{f.name}': getattr(content, f.name).copy() for f in fields(content)}
        return plain, arrays

    def restore(
        self, plain: dict[str, Any], arrays: dict[str, Array], motor: int | slice = 0
    ) -> None:
        """Take back what :meth:`state` gave, for one motor, or for each of several.

        Raises:
            ConfigurationError: it was learnt of other parameters.
            CheckpointError: it is no state that could have been learnt.
        """
        names = [p.name for p in self._white_box.parameters]
        which = motor if isinstance(motor, slice) else slice(motor, motor + 1)
        if plain['parameters'] != names:
            raise ConfigurationError(
                f'the checkpoint holds {printable(plain["parameters"], 200)}, expected {names}'
            )
        _check(plain, arrays, len(names))
        content, begin, new = arrays['replay'], plain['begin'], plain['new']
        if new > min(
            content.shape[2], self.replay.capacity // 2
        ):  # they waited in a larger memory, for larger blocks
            new = 0
        if content.shape[2] - new < self.replay.capacity:  # less is there than may be remembered
            begin = max(begin, plain['gone'])
        self.replay.refill(content, which, plain['gone'], begin)
        received = self.replay.received[which]
        counts: dict[str, Any] = {
            name: np.array([plain[name]]) for name in ('next_fit', 'started', 'noise_count')
        }
        counts |= {name: arrays[name] for name in _ARRAYS}
        known = chosen(self._learnt, which)
        part = Learnt(
            Belief(**_below('belief', arrays)),
            Prior(arrays['prior_p'], arrays['prior_covariance']),
            Belief(**_below('anchor', arrays)),
            received + plain['anchored'],
            received - new,
            asked=np.array([plain['asked']]),
            score=np.moveaxis(arrays['drift_score'], 1, 0),
            information=np.moveaxis(arrays['drift_information'], 1, 0),
            hold=HoldState(**_below('holds', arrays)),
            examined=received + plain['examined'],
            outliers=known.outliers,
            kicks=known.kicks,
            alarms=known.alarms,
            **counts,
        )
        put(self._learnt, which, part)
        self._speed[which] = arrays['speed']
        self._stamp_ns = max(self._stamp_ns, plain['stamp_ns'])
        if plain['resumes']:
            self._resumes = np.zeros_like(self._nobody) if self._resumes is None else self._resumes
            self._resumes[which] = True
        self._reckon(which)
        self._wake = 0


def _below(part: str, arrays: dict[str, Array]) -> dict[str, Any]:
    return {
        name[len(part) + 1 :]: array
        for name, array in arrays.items()
        if name.startswith(f'{part}.')
    }


_ARRAYS = (
    'suspicion',
    'since',
    'left_out',
    'walk_rate',
    'least_noise',
    'share',
    'reach',
    'in_vain',
)


def _check(plain: dict[str, Any], arrays: dict[str, Array], coordinates: int) -> None:
    """Refuse a saved state that could not have been learnt.

    Raises:
        CheckpointError: something is missing, or no state of this rule.
    """
    n, memories = coordinates, len(MEMORIES_BLOCKS)
    check_belief('belief', arrays, n)
    check_belief('anchor', arrays, n)
    check_prior(arrays, n)
    check_hold('holds', arrays, n)
    check_signals('replay', arrays.get('replay'))
    rules = {
        'suspicion': ArrayRule((1,), 0.0),
        'since': counts(1),
        'left_out': ArrayRule((1,), 0.0),
        'walk_rate': ArrayRule((1,), 0.0, FASTEST_WALK),
        'least_noise': ArrayRule((1,), 0.0),
        'share': ArrayRule((1, n), 0.0),
        'reach': ArrayRule((1, n), 0.0, endless=True),
        'in_vain': counts(1),
        'drift_score': ArrayRule((memories, 1, n)),
        'drift_information': ArrayRule((memories, 1, n, n)),
        'speed': ArrayRule((1,), -LARGEST_SIGNAL, LARGEST_SIGNAL),
    }
    check_arrays(arrays, rules)
    remembered = arrays['replay'].shape[2]
    gone = whole(plain, 'gone')
    new = min(whole(plain, 'new'), remembered)
    whole(plain, 'next_fit', 1)
    whole(plain, 'stamp_ns', -LATEST_NS, LATEST_NS)
    whole(plain, 'noise_count')
    whole(plain, 'anchored', -MOST, -new)
    whole(plain, 'begin', 0, gone + remembered - new)
    whole(plain, 'examined', -MOST, 0)
    asked = whole(plain, 'asked', WALK_AGAIN)
    if not flag(plain, 'started') and asked:
        raise CheckpointError('asked: a motor of which nothing is known yet cannot have changed')
    flag(plain, 'resumes')
