"""Rotors that were recorded in the same messages are identified together, offline too."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from rotor_records import GEAR_MOTOR, LIVELY

from dc_motor_sim.simulation import Simulation
from gray_box_observer.identify.command import main

PLANTS = {'left': GEAR_MOTOR, 'right': replace(GEAR_MOTOR, resistance=3.0)}
FILE = """/**:
  ros__parameters:
    motors: [left, right]
    group_from: {group_from}
    left: {{speed_source: rotor, torque_constant: 0.02, back_emf_constant: 0.02, effects: none}}
    right: {{speed_source: rotor, torque_constant: 0.02, back_emf_constant: 0.02, effects: none}}
"""


@pytest.mark.slow
def test_they_are_the_same_together_and_one_by_one(
    tmp_path: Path,
    write_bag: Callable[..., Path],
    messages_of: Callable[..., Any],
    capsys: pytest.CaptureFixture[str],
) -> None:
    simulation = Simulation(
        PLANTS, LIVELY, seed=1, sample_rate_hz=1000.0, torque_noise_std=3e-4, speed_mode='rotor'
    )
    bag = write_bag(tmp_path / 'bag', messages_of(simulation.record(3.0)))
    found = []
    for group_from in (2, 100):
        params = tmp_path / f'{group_from}.yaml'
        params.write_text(FILE.format(group_from=group_from), encoding='utf-8')
        report = tmp_path / f'{group_from}.html'
        wanted = ('--params', params, '--json', '-', '--report', report, '--skip-predictor')
        code = main(['identify', str(bag), *map(str, wanted)])
        assert code == 0
        found.append(json.loads(capsys.readouterr().out)['motors'])
        assert report.stat().st_size > 10_000
    for name, plant in PLANTS.items():
        for motors in found:
            motor = motors[name]
            resistance = motor['parameters']['resistance']
            assert motor['speed_source'] == 'rotor'
            assert motor['fit']['verdict'] == 'ok'
            assert resistance['verdict'] == 'identified'
            assert resistance['value'] == pytest.approx(plant.resistance, rel=0.01)
        values = [motors[name]['parameters']['resistance']['value'] for motors in found]
        assert values[0] == pytest.approx(values[1], rel=1e-3)
