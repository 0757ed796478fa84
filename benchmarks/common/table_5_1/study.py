"""One piece of the experiment: one variant in one setting on the recordings of one run."""

from __future__ import annotations

from dataclasses import dataclass

from common.table_5_1 import online, thesis
from common.table_5_1.epochs import THETA_EPOCHS, EpochTraining
from common.table_5_1.recordings import Recordings, record_all
from common.table_5_1.scores import Score, constant, persistence, rollout, score
from common.table_5_1.settings import FAITHFUL, SETTINGS, Setting
from gray_box_observer.predictor import Variant
from gray_box_observer.white_box import MotorWhiteBox
from gray_box_observer.white_box.interface import Array

CONSTANT = 'constant'
PERSISTENCE = 'persistence'
WHITE_BOX = 'white_box'
WHITE_BOX_GRADIENT = 'white_box_gradient'


@dataclass(frozen=True, slots=True)
class Amount:
    """How much is trained on and judged by.

    Attributes:
        training_s: length of the training recording.
        test_s: length of each test recording.
        epochs: over the training recording, in the faithful setting.
        passes: of the training recording through the observer, in ours.
    """

    training_s: float
    test_s: float
    epochs: int
    passes: int


@dataclass(frozen=True, slots=True)
class Work:
    """A piece of work, small enough to be sent to another process."""

    setting: str
    variant: str
    run: int
    amount: Amount


@dataclass(frozen=True, slots=True)
class Outcome:
    """What one row scored in one run.

    Attributes:
        setting: its name.
        row: a variant, or a prediction that needs no training.
        run: counted from 0.
        score: set by set.
        theta: shape (parameter,): identified; None where there is none.
        settled: validation loss after half of the epochs over that at the end; None where there are
            no epochs.
    """

    setting: str
    row: str
    run: int
    score: Score
    theta: Array | None = None
    settled: float | None = None


def extra_variants() -> tuple[str, ...]:
    """Variants of the package that the thesis does not have."""
    return tuple(variant.value for variant in Variant if variant.value not in thesis.FOUR)


def carry_out(work: Work) -> list[Outcome]:
    """Train one variant and score it on the eight sets.

    With variant main come the rows that need no network; with a variant that the thesis does not
    have comes its control, the same with a network that has learnt nothing.
    """
    import torch

    torch.set_num_threads(1)
    setting = next(s for s in SETTINGS if s.name == work.setting)
    recordings = record_all(work.run, work.amount.training_s, work.amount.test_s, setting.every)
    if work.variant in extra_variants():
        return [_observed(setting, recordings, work), _untaught(setting, recordings, work)]
    found = (
        _observed(setting, recordings, work)
        if setting.online
        else _epochs(setting, recordings, work)
    )
    if work.variant == Variant.MAIN.value and found.theta is not None:
        return [found, *_untrained(setting, recordings, work, found.theta)]
    return [found]


def white_box(setting: Setting) -> MotorWhiteBox:
    """The physics that every variant of the setting is given."""
    return (
        setting.configuration(Variant.MAIN.value)
        .motors[online.MOTOR]
        .white_box(speed_measured=False)
    )


def untaught(variant: str) -> str:
    """Row of the variant with an untrained network: what it owes to the physics alone."""
    return f'{variant}_untrained'


def _epochs(setting: Setting, recordings: Recordings, work: Work) -> Outcome:
    trained = EpochTraining(setting, Variant(work.variant), recordings, work.run).train(
        work.amount.epochs
    )
    settled = float(trained.validation[work.amount.epochs // 2] / trained.validation[-1])
    found = score(recordings.tests, trained.predicted_nm)
    return Outcome(setting.name, work.variant, work.run, found, trained.theta, settled)


def _observed(setting: Setting, recordings: Recordings, work: Work) -> Outcome:
    passes = work.amount.passes if setting.online else THETA_EPOCHS
    observer = online.train(setting.configuration(work.variant), recordings.training, passes)
    found = score(recordings.tests, online.predict(observer, recordings.tests))
    return Outcome(setting.name, work.variant, work.run, found, online.theta(observer))


def _untaught(setting: Setting, recordings: Recordings, work: Work) -> Outcome:
    """The control; ``training.start`` names the network that a variant may begin with."""
    passes = work.amount.passes if setting.online else THETA_EPOCHS
    configuration = setting.configuration(work.variant, **{'training.start': 'fresh'})
    observer = online.train(configuration, recordings.training, passes, network=False)
    found = score(recordings.tests, online.predict(observer, recordings.tests))
    return Outcome(setting.name, untaught(work.variant), work.run, found, online.theta(observer))


def _untrained(setting: Setting, recordings: Recordings, work: Work, theta: Array) -> list[Outcome]:
    thetas = {WHITE_BOX: theta}
    if setting is not FAITHFUL:
        thetas[WHITE_BOX_GRADIENT] = _gradient_theta(setting, recordings, work.amount.passes)
    found = []
    for row, values in thetas.items():
        predicted = rollout(white_box(setting), values, recordings.tests)
        found.append(
            Outcome(setting.name, row, work.run, score(recordings.tests, predicted), values)
        )
    mean_nm = float(recordings.training.torque_nm.mean())
    free = {
        PERSISTENCE: persistence(recordings.tests),
        CONSTANT: constant(mean_nm, recordings.tests),
    }
    found += [
        Outcome(setting.name, row, work.run, score(recordings.tests, said))
        for row, said in free.items()
    ]
    return found


def _gradient_theta(setting: Setting, recordings: Recordings, passes: int) -> Array:
    """Theta of the same recording by the thesis's gradient rule."""
    configuration = setting.configuration(
        Variant.MAIN.value, context_update='gradient', predictor=False
    )
    return online.theta(online.train(configuration, recordings.training, passes))
