"""The benchmark of regimes that were left: its journeys and its scores."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import regimes
from regimes import MOTORS, journey, run

from gray_box_observer.predictor import TrainingSettings

PROGRAM = Path(__file__).resolve().parents[2] / 'benchmarks' / 'regimes.py'


def test_a_journey_leads_back_home_and_every_part_begins_anew() -> None:
    parts = journey(MOTORS[0], 1, 40.0, 20.0)
    for (low, high), part in zip(((5.0, 15.0), (1.0, 2.0), (5.0, 15.0)), parts, strict=True):
        voltage = np.array([sample.voltage_v[0] for sample in part])
        assert low <= voltage.min()
        assert voltage.max() <= high
        assert [sample.interval_s[0] for sample in part[:3]] == pytest.approx([0.0, 0.2, 0.2])
    assert [len(part) for part in parts] == [200, 100, 300]


def test_with_perfect_physics_and_nothing_learnt_the_white_box_is_met() -> None:
    parts = journey(MOTORS[-1], 2, 20.0, 20.0)
    outcome = run(MOTORS[-1], parts, 2, TrainingSettings(period=1000))
    assert outcome.home == pytest.approx(1.0, abs=0.02)
    assert outcome.back == pytest.approx(1.0, abs=0.02)


def test_the_score_is_of_the_end_and_not_of_the_first_second() -> None:
    missed = np.ones((1000, 2))
    missed[-600:] = (1.0, 4.0)
    assert regimes._relative(missed) == 0.25
    assert regimes._relative(np.concatenate([np.full((5, 2), np.nan), missed[-300:]])) == 0.25


def test_every_motor_but_the_last_lacks_something() -> None:
    plants = [replace(motor.plant) for motor in MOTORS]
    assert len(set(plants)) == len(plants)
    assert plants[-1] == regimes.THESIS_MOTOR


def test_fewer_seeds_than_none_are_refused() -> None:
    environment = {**os.environ, 'PYTHONPATH': os.pathsep.join(sys.path)}
    command = [sys.executable, PROGRAM, '--seeds', '-1']
    done = subprocess.run(
        command, capture_output=True, text=True, timeout=100, env=environment, check=False
    )
    assert done.returncode == 2
    assert done.stderr.splitlines()[-1].endswith('--seeds must be at least 1, got -1')
