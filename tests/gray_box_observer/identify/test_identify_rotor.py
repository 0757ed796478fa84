"""A free rotor without measured speed: whatever the estimates, everybody can read the result."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from dc_motor_sim.plant import PlantParameters
from dc_motor_sim.simulation import Simulation
from gray_box_observer.context_nodes import Estimate
from gray_box_observer.identify.command import main
from gray_box_observer.observer.motor_view import MotorView

GEAR_MOTOR = PlantParameters(
    inductance=2.67e-3,
    resistance=4.0,
    hysteresis=0.0,
    torque_constant=0.3,
    back_emf_constant=0.3,
    inertia=2e-3,
    viscous_friction=2e-3,
    coulomb_friction=0.02,
)


@pytest.fixture
def free_rotor(
    tmp_path: Path, messages_of: Callable[..., Any], write_bag: Callable[..., Path]
) -> Path:
    """Record a gear motor that spins freely, without its speed."""
    simulation = Simulation(
        {'motor': GEAR_MOTOR},
        'R[-12,12]D[0.1,0.5]',
        speed_mode='rotor',
        sample_rate_hz=500.0,
        torque_noise_std=2e-3,
    )
    return write_bag(tmp_path / 'free', messages_of(simulation.record(1.5)))


def every_number(tree: Any) -> list[float]:
    """Return every number in plain values."""
    if isinstance(tree, dict):
        return [number for value in tree.values() for number in every_number(value)]
    if isinstance(tree, list):
        return [number for value in tree for number in every_number(value)]
    return [tree] if isinstance(tree, (int, float)) else []


@pytest.mark.slow
def test_a_free_rotor_gives_valid_json_and_a_report(
    free_rotor: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    params = tmp_path / 'p.yaml'
    report = tmp_path / 'r.html'
    params.write_text(
        '/**:\n  ros__parameters:\n    motor: {torque_constant: 0.3, back_emf_constant: 0.3}\n'
    )
    command = ['identify', str(free_rotor), '--params', str(params), '--skip-predictor']
    assert main([*command, '--json', '-', '--report', str(report)]) == 0
    result = json.loads(
        capsys.readouterr().out, parse_constant=lambda word: pytest.fail(f'{word} in JSON')
    )
    assert all(math.isfinite(number) for number in every_number(result))
    motor = result['motors']['motor']
    assert {entry['verdict'] for entry in motor['parameters'].values()} & {
        'identified',
        'negligible',
    } == set()
    assert motor['fit']['verdict'] == 'misfit'
    assert motor['fit']['suspects']
    page = report.read_text()
    assert 'class="fit misfit"' in page
    assert 'NaN' not in page.split('id="figures">')[1].split('</script>')[0]


@pytest.mark.slow
def test_what_an_estimate_cannot_say_is_null_in_json_and_not_known_in_text(
    free_rotor: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    sound = MotorView.estimate.fget
    assert sound is not None

    def broken(motor: MotorView) -> Estimate:
        found = sound(motor)
        found.covariance[0, 0, :] = math.nan
        return found

    monkeypatch.setattr(MotorView, 'estimate', property(broken))
    assert main(['identify', str(free_rotor), '--skip-predictor', '--json', '-']) == 0
    motor = json.loads(capsys.readouterr().out)['motors']['motor']
    assert motor['parameters']['inductance']['std'] is None
    assert motor['covariance'][0] == [None, None, None]
    assert main(['identify', str(free_rotor), '--skip-predictor']) == 0
    assert '+- not known  H ' in capsys.readouterr().out


@pytest.mark.slow
def test_with_a_rotor_as_a_hidden_state_the_same_motor_is_identified(
    free_rotor: Path, tmp_path: Path
) -> None:
    params, json_file, report = (tmp_path / name for name in ('p.yaml', 'r.json', 'r.html'))
    params.write_text(
        '/**:\n  ros__parameters:\n    motor:\n      torque_constant: 0.3\n'
        '      back_emf_constant: 0.3\n      speed_source: rotor\n      stamps_exact: true\n',
        encoding='utf-8',
    )
    arguments = ['identify', str(free_rotor), '--params', str(params), '--json', str(json_file)]
    assert main([*arguments, '--report', str(report)]) == 0
    found = json.loads(json_file.read_text(encoding='utf-8'))['motors']['motor']
    assert found['speed_source'] == 'rotor'
    assert found['fit']['verdict'] == 'ok'
    assert found['predictor']['nmae'] < 0.05
    for name in ('resistance', 'inertia'):
        parameter = found['parameters'][name]
        truth = getattr(GEAR_MOTOR, name)
        assert parameter['verdict'] == 'identified', name
        assert parameter['value'] == pytest.approx(truth, rel=0.02), name
    for name, parameter in found['parameters'].items():
        assert abs(parameter['value'] - getattr(GEAR_MOTOR, name)) < 4.0 * parameter['std'], name
    page = report.read_text(encoding='utf-8')
    assert 'the speed a hidden state' in page
    assert 'What follows from the parameters' in page
    assert found['speed_source_reason'] == 'as configured'
    assert 'Speed from rotor: as configured.' in page
    constants = {
        'electrical_time_constant': 2.67e-3 / 4.0,
        'mechanical_time_constant': 4.0 * 2e-3 / (0.3**2 + 4.0 * 2e-3),
        'kV': 0.3 + 4.0 * 2e-3 / 0.3,
        'kA': 4.0 * 2e-3 / 0.3,
    }
    for name, truth in constants.items():
        derived = found['derived'][name]
        assert derived['value'] == pytest.approx(truth, rel=0.03), name
        assert 0.0 < derived['std'] < 0.05 * truth, name


@pytest.mark.slow
def test_a_free_rotor_is_predicted_and_validated(
    tmp_path: Path,
    messages_of: Callable[..., Any],
    write_bag: Callable[..., Path],
    capsys: pytest.CaptureFixture[str],
) -> None:
    bags = []
    for seed, duration_s in ((1, 4.0), (2, 1.5)):
        simulation = Simulation(
            {'motor': GEAR_MOTOR}, 'R[-12,12]D[0.1,0.5]', seed=seed, speed_mode='rotor',
            sample_rate_hz=500.0, torque_noise_std=2e-3,
        )  # fmt: skip
        bags.append(write_bag(tmp_path / f'run{seed}', messages_of(simulation.record(duration_s))))
    params = tmp_path / 'p.yaml'
    constants = 'torque_constant: 0.3, back_emf_constant: 0.3, speed_source: rotor'
    params.write_text(f'/**:\n  ros__parameters:\n    motor: {{{constants}}}\n')
    known, asked = map(str, bags)
    command = ['identify', known, '--params', str(params), '--validate', asked, '--json', '-']
    assert main(command) == 0
    motor = json.loads(capsys.readouterr().out)['motors']['motor']
    assert motor['speed_source'] == 'rotor'
    assert motor['predictor']['nmae'] < 0.05
    assert motor['alarms'] == {'raised': 0, 'first_s': None}
    validation = motor['validation']
    assert validation['predictor'] is True
    assert validation['nmae'] < 0.05
    assert validation['persistence']['nmae'] > 10.0 * validation['nmae']
