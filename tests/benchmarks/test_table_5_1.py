"""Table 5.1 made again: scores by closed forms, data apart, the thesis's numbers, a tiny run."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from common.table_5_1 import online, report, thesis
from common.table_5_1.recordings import (
    PLAIN_SETS_OUT_OF_RANGE,
    SETS,
    TRAINING_SET,
    Recordings,
    Role,
    Series,
    record,
    record_all,
    seed_of,
)
from common.table_5_1.scores import WARM_UP, Score, constant, persistence, rollout, score
from common.table_5_1.settings import FAITHFUL, OURS, SETTINGS
from common.table_5_1.study import (
    CONSTANT,
    PERSISTENCE,
    WHITE_BOX,
    WHITE_BOX_GRADIENT,
    Amount,
    Outcome,
    Work,
    carry_out,
    extra_variants,
    white_box,
)

PROGRAM = Path(__file__).resolve().parents[2] / 'benchmarks' / 'table_5_1.py'
TINY = Amount(training_s=24.0, test_s=12.0, epochs=2, passes=1)


def ramp(slope_nm: float, samples: int = 500) -> Series:
    """One set whose torque rises by the same amount every sample."""
    torque = slope_nm * np.arange(samples)[None, :]
    return Series(
        ('ramp',), 0, np.arange(samples, dtype=np.int64) * 10_000_000, np.ones_like(torque), torque
    )


@pytest.fixture(scope='module')
def recordings() -> Recordings:
    return record_all(0, TINY.training_s, TINY.test_s, FAITHFUL.every)


def test_persistence_on_a_ramp_is_one_step_late_and_has_every_difference_right() -> None:
    series = ramp(2e-3)
    found = score(series, persistence(series))
    judged = series.torque_nm.shape[1] - WARM_UP
    spread = 2e-3 * np.sqrt((judged**2 - 1) / 12.0)  # standard deviation of equally spaced values
    assert found.difference_nm == pytest.approx([0.0], abs=1e-15)
    assert found.error_percent == pytest.approx([100.0 * 2e-3 / spread])


def test_a_constant_on_a_ramp_misses_every_difference_by_the_slope() -> None:
    series = ramp(2e-3)
    assert score(series, constant(0.3, series)).difference_nm == pytest.approx([2e-3])


def test_a_shifted_prediction_has_a_perfect_difference_score_and_a_wrong_torque() -> None:
    series = ramp(1e-3)
    found = score(series, series.torque_nm + 0.5)
    assert found.difference_nm == pytest.approx([0.0], abs=1e-15)
    assert found.error_percent[0] == pytest.approx(
        100.0 * 0.5 / series.torque_nm[:, WARM_UP:].std()
    )


def test_a_prediction_missing_where_it_is_judged_is_infinitely_wrong_but_not_before() -> None:
    series = ramp(1e-3)
    late = series.torque_nm.copy()
    early = series.torque_nm.copy()
    late[0, WARM_UP + 3] = early[0, WARM_UP - 1] = np.nan
    assert score(series, late).error_percent[0] == np.inf
    assert score(series, early).error_percent[0] == 0.0


def test_the_white_box_with_the_true_parameters_repeats_the_simulator() -> None:
    true = np.array([0.5, 1.0, 10.0])
    series = record(SETS, 2, 12.0, 1)
    assert np.all(score(series, rollout(white_box(OURS), true, series)).error_percent < 1e-3)


def test_no_two_recordings_of_any_two_runs_share_a_seed() -> None:
    seeds = [seed_of(run, role) for run in range(50) for role in Role]
    assert len(set(seeds)) == len(seeds)


def test_training_validation_and_the_test_on_the_same_excitation_hold_other_voltages(
    recordings: Recordings,
) -> None:
    series = (recordings.training, recordings.validation, recordings.tests)
    assert [s.seed for s in series] == [seed_of(0, role) for role in Role]
    levels = [set(np.round(np.unique(s.voltage_v[0]), 9)) for s in series]
    assert recordings.tests.names[0] == TRAINING_SET == recordings.training.names[0]
    assert not levels[0] & levels[1] and not levels[0] & levels[2] and not levels[1] & levels[2]


def test_noise_is_on_the_voltage_and_the_torque_follows_it() -> None:
    noisy = record(['R[5,15]D[1,20]+v(t)'], 4, 12.0, 1)
    calm = record(['R[5,15]D[1,20]'], 4, 12.0, 1)
    assert np.std(noisy.voltage_v - calm.voltage_v) == pytest.approx(0.5, rel=0.1)
    assert np.std(noisy.torque_nm - calm.torque_nm) > 0.0
    fitted = rollout(white_box(OURS), np.array([0.5, 1.0, 10.0]), noisy)
    assert (
        np.abs(fitted - noisy.torque_nm).max() < 1e-6
    )  # all of its torque comes from the voltage that was recorded


def test_a_decimated_voltage_is_the_mean_over_the_interval_before_the_sample() -> None:
    whole = record([TRAINING_SET], 7, 12.0, 1)
    thin = record([TRAINING_SET], 7, 12.0, 10)
    assert thin.interval_s == pytest.approx(0.1)
    assert thin.torque_nm == pytest.approx(whole.torque_nm[:, ::10])
    assert thin.voltage_v[0, 5] == pytest.approx(whole.voltage_v[0, 41:51].mean())


def test_the_numbers_of_the_thesis_stand_in_its_own_order_of_sets() -> None:
    assert len(SETS) == len(thesis.BASELINE_ERROR) == 8
    assert SETS[0] == TRAINING_SET and SETS[5] == 'R[0,33]D[1,20]' and SETS[7].endswith('+v(t)')
    assert all(min(row[j] for row in thesis.EXCESS.values()) == 0.0 for j in range(8))
    assert thesis.EXCESS['main'] == (1.26, 0.021, 1.78, 0.0, 0.0, 0.207, 0.0, 0.0)
    assert thesis.BASELINE_ERROR[4] == 20867.5
    assert len(PLAIN_SETS_OUT_OF_RANGE) == 4


def test_every_claim_is_counted_on_the_numbers_of_the_thesis_as_its_text_says() -> None:
    counted = {
        claim.text: (claim.count(thesis.ratios()), len(claim.columns)) for claim in thesis.CLAIMS
    }
    assert counted == {
        'main is last on the training set and the one like it': (2, 2),
        'main leads on the complex sets': (4, 4),
        'main beats "sees the data"': (6, 8),
        'theta as input helps the supervised one': (5, 8),
    }


def of_the_thesis(runs: int = 3) -> dict[str, np.ndarray]:
    return {
        row: np.tile(1.0 + np.array(excess), (runs, 1)) for row, excess in thesis.EXCESS.items()
    }


def test_the_ranking_of_the_thesis_agrees_with_itself_and_its_reverse_does_not() -> None:
    same = report.agreement(of_the_thesis(), 3)
    assert (same.same_best, same.agree, same.opposite, same.open) == (True, 6, 0, 0)
    turned = report.agreement({row: 2.0 - errors for row, errors in of_the_thesis().items()}, 3)
    assert (turned.same_best, turned.agree, turned.opposite) == (False, 0, 6)


def test_tied_errors_and_runs_that_disagree_decide_nothing() -> None:
    tied = report.agreement({row: np.ones((3, 8)) for row in thesis.FOUR}, 3)
    assert (tied.same_best, tied.open) == (None, 6)
    errors = of_the_thesis()
    errors['main'][2] = 9.0  # one run of three has it last
    assert report.agreement(errors, 3).open == 3


def made_up(setting: str, physics: bool) -> list[Outcome]:
    rows = [*thesis.FOUR, WHITE_BOX, PERSISTENCE, CONSTANT, *(['physics'] if physics else [])]
    theta = np.array([0.5, 1.0, 10.0])
    percent = dict.fromkeys(rows, 300.0) | {'physics': 0.5}
    return [
        Outcome(
            setting, row, run, Score(np.full(8, 1.0 + k), np.full(8, percent[row] + run)), theta
        )
        for k, row in enumerate(rows)
        for run in range(2)
    ]


def test_the_fifth_variant_is_judged_by_its_worst_run_and_only_where_it_was_run(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(report, 'extra_variants', lambda: ('physics',))
    with_it = report.figures(report.Results(OURS, made_up('ours', physics=True), counts=True))
    goals = {figure.name: figure for figure in with_it if figure.goal is not None}
    worst = next(figure for name, figure in goals.items() if name.startswith('physics: worst'))
    ratio = next(figure for name, figure in goals.items() if name.startswith('physics / variant 4'))
    assert worst.value == pytest.approx(1.5) and worst.met is False
    assert ratio.value == pytest.approx(1.5 / 301.0) and ratio.met is True
    without = report.figures(report.Results(OURS, made_up('ours', physics=False), counts=True))
    assert [figure.value for figure in without if figure.name.startswith('physics')] == [None] * 4


def test_a_variant_of_the_thesis_is_trained_and_scored_in_the_faithful_setting() -> None:
    pytest.importorskip('torch')
    found = {outcome.row: outcome for outcome in carry_out(Work('faithful', 'main', 0, TINY))}
    assert set(found) == {'main', WHITE_BOX, PERSISTENCE, CONSTANT}
    assert all(np.all(np.isfinite(outcome.score.difference_nm)) for outcome in found.values())
    assert found['main'].settled is not None
    again = carry_out(Work('faithful', 'main', 0, TINY))[0]
    assert np.array_equal(again.score.error_percent, found['main'].score.error_percent)


def test_validation_and_test_data_never_reach_the_weights() -> None:
    pytest.importorskip('torch')
    from common.table_5_1.epochs import EpochTraining

    from gray_box_observer.predictor import Variant

    data = record_all(0, TINY.training_s, TINY.test_s, FAITHFUL.every)
    wrong = replace(data.validation, torque_nm=-data.validation.torque_nm)
    other = replace(data, validation=wrong, tests=record(SETS, 99, TINY.test_s, FAITHFUL.every))
    trained = []
    for seen in (data, other):
        training = EpochTraining(FAITHFUL, Variant.SUPERVISED, seen, 0)
        result = training.train(2)  # too short for a plateau to cut the rate
        trained.append((result, training.predict(data.tests)))
    assert np.array_equal(trained[0][1], trained[1][1], equal_nan=True)
    assert not np.array_equal(trained[0][0].validation, trained[1][0].validation)


def test_further_variants_go_through_the_observer_which_learns_nothing_from_the_tests() -> None:
    pytest.importorskip('torch')
    tests = record(SETS[5:], seed_of(0, Role.TEST), 3.0, OURS.every)
    data = replace(record_all(0, 10.0, 3.0, OURS.every), tests=tests)
    for variant in ('supervised', *extra_variants()):
        trained = online.train(OURS.configuration(variant), data.training, 1)
        before = online.theta(trained).copy()
        first = online.predict(trained, data.tests)
        second = online.predict(trained, data.tests)
        assert np.array_equal(first, second, equal_nan=True)
        assert np.array_equal(online.theta(trained), before)
        assert np.all(np.isfinite(first[:, WARM_UP:]))
        trained.close()


def test_the_control_whose_network_learns_nothing_still_identifies_the_motor() -> None:
    data = record_all(0, 30.0, 3.0, OURS.every)
    control = online.train(OURS.configuration('main'), data.training, 1, network=False)
    assert online.theta(control) == pytest.approx([0.5, 1.0, 10.0], rel=1e-3)
    assert np.all(
        np.isnan(online.predict(control, data.tests))
    )  # variant main has nothing to say before it has learnt


def test_ours_keeps_the_defaults_and_the_faithful_setting_the_sizes_of_the_thesis() -> None:
    ours = OURS.configuration('main')
    faithful = FAITHFUL.configuration('main')
    assert ours['training.hidden'] == type(ours).from_flat({})['training.hidden']
    assert (faithful['training.hidden'], faithful['training.context']) == (2, 64)
    assert (faithful['training.learning_rate'], faithful['gradient.learning_rate']) == (0.001, 0.01)
    assert faithful['context_update'] == 'gradient'


def test_the_report_says_all_rows_and_quotes_the_thesis() -> None:
    outcomes = made_up('ours', physics=False)
    outcomes += [
        replace(outcome, row=WHITE_BOX_GRADIENT) for outcome in outcomes if outcome.row == WHITE_BOX
    ]
    text = report.tables(report.Results(OURS, outcomes, counts=False))
    assert '(1.26)' in text and '20867.5' in text and 'page 42' in text
    assert all(
        report.title(row) in text for row in (*thesis.FOUR, WHITE_BOX, PERSISTENCE, CONSTANT)
    )
    assert 'thesis 1 < 2 < 3 < 4, here 1 < 2 < 3 < 4' in text


def run(*arguments: str) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, 'PYTHONPATH': os.pathsep.join(sys.path)}
    command = [sys.executable, str(PROGRAM), *arguments]
    return subprocess.run(
        command, capture_output=True, text=True, timeout=600, env=environment, check=False
    )


def test_the_smallest_run_ends_with_one_line_of_json_that_judges_nothing() -> None:
    pytest.importorskip('torch')
    lengths = ('--training-s', '20', '--test-s', '20')
    done = run('--quick', '--epochs', '1', *lengths, '--setting', 'faithful', '--workers', '1')
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout.splitlines()[-1])
    assert (told['benchmark'], told['seeds']) == ('table_5_1', 1)
    assert all(figure['met'] is None for figure in told['figures'])
    assert any(figure['value'] is not None for figure in told['figures'])
    assert 'Traceback' not in done.stderr


def test_a_run_of_no_seeds_is_refused_in_one_line() -> None:
    done = run('--seeds', '0')
    assert done.returncode == 2
    assert '--seeds must be from 1 to 1000, got 0' in done.stderr
    assert 'Traceback' not in done.stderr


def test_the_settings_have_distinct_names_that_the_program_offers() -> None:
    sys.path.insert(0, str(PROGRAM.parent))
    import table_5_1

    assert tuple(setting.name for setting in SETTINGS) == table_5_1.SETTING_NAMES
