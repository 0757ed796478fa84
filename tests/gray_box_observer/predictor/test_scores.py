from __future__ import annotations

import numpy as np
import pytest

from gray_box_observer.predictor.scores import Scores

TORQUE = [1.0, 3.0, 2.0, 6.0]
SAID = {
    'predictor': [1.5, 2.0, 2.0, 7.0],
    'persistence': [0.0, 1.0, 3.0, 2.0],
    'white_box': [1.1, 3.0, 2.3, 5.6],
}


def scored(torque: list[float], said: dict[str, list[float]], window: int = 100) -> Scores:
    scores = Scores(1, window)
    for k, value in enumerate(torque):
        scores.add(
            np.array([value]), {rival: np.array([series[k]]) for rival, series in said.items()}
        )
    return scores


def test_scores_follow_their_formulas() -> None:
    skill = scored(TORQUE, SAID).skill(0)
    assert skill.samples == 4
    assert skill.nmae == pytest.approx((0.5 + 1.0 + 0.0 + 1.0) / 4 / np.std(TORQUE))
    assert skill.skill_vs_persistence == pytest.approx(1.0 - 2.5 / (1.0 + 2.0 + 1.0 + 4.0))
    assert skill.skill_vs_white_box == pytest.approx(1.0 - 2.5 / (0.1 + 0.0 + 0.3 + 0.4))
    assert skill.to_dict() == {
        'samples': 4,
        'nmae': skill.nmae,
        'skill_vs_persistence': skill.skill_vs_persistence,
        'skill_vs_white_box': skill.skill_vs_white_box,
    }


@pytest.mark.parametrize('silent', ['predictor', 'persistence', 'white_box'])
def test_only_samples_that_every_rival_predicted_are_compared(silent: str) -> None:
    said = {rival: list(series) for rival, series in SAID.items()}
    said[silent][3] = np.nan
    skill = scored(TORQUE, said).skill(0)
    assert skill.samples == 3
    assert skill.skill_vs_persistence == pytest.approx(1.0 - 1.5 / 4.0)


def test_too_few_predictions_have_no_score() -> None:
    skill = scored(TORQUE[:1], SAID).skill(0)
    assert (skill.samples, skill.nmae, skill.skill_vs_persistence, skill.skill_vs_white_box) == (
        1,
        None,
        None,
        None,
    )


def test_a_rival_without_error_cannot_be_beaten_and_gives_no_number() -> None:
    skill = scored(
        [2.0, 2.0], {'predictor': [2.0, 2.1], 'persistence': [2.0, 2.0], 'white_box': [2.0, 2.0]}
    ).skill(0)
    assert (skill.nmae, skill.skill_vs_persistence, skill.skill_vs_white_box) == (None, None, None)


def test_old_predictions_are_forgotten() -> None:
    torque = [100.0, 200.0, *TORQUE]
    said = {rival: [0.0, 0.0, *series] for rival, series in SAID.items()}
    assert scored(torque, said, window=4).skill(0).skill_vs_persistence == pytest.approx(
        1.0 - 2.5 / 8.0
    )


def test_motors_are_scored_apart() -> None:
    scores = Scores(2)
    for k, value in enumerate(TORQUE):
        scores.add(
            np.array([value, value]), {r: np.array([s[k], value + 1.0]) for r, s in SAID.items()}
        )
    assert scores.skill(0).skill_vs_persistence == pytest.approx(1.0 - 2.5 / 8.0)
    assert scores.skill(1).skill_vs_persistence == pytest.approx(0.0)


def test_a_torque_that_does_not_vary_gives_no_error_relative_to_its_spread() -> None:
    torque = [0.1] * 101
    said = {name: [0.2] * 101 for name in ('predictor', 'persistence', 'white_box')}
    skill = scored(torque, said, window=101).skill(0)
    assert skill.samples == 101
    assert skill.nmae is None
