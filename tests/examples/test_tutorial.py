"""What docs/TUTORIAL.md says of its log and of each mistake is what `identify` does."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from gray_box_observer.identify import command

TUTORIAL = Path(__file__).resolve().parents[2] / 'docs' / 'TUTORIAL.md'
RIGHT = {
    'motor': 'wheel',
    'time': 't_s',
    'voltage': 'duty*battery_V',
    'current': 'i_A',
    'torque_constant': '0.022',
    'speed': 'speed_rpm*30*0.104719755',
}
TRUTH = {'inductance': 2.3e-3, 'resistance': 2.1}


@pytest.fixture(scope='module')
def log(example, tmp_path_factory) -> Path:
    """Two seconds of the tutorial's log."""
    path = tmp_path_factory.mktemp('tutorial') / 'log.csv'
    example('simulated_log').write_log(path, duration_s=2.0, rate_hz=1000.0, seed=1)
    return path


@pytest.fixture
def parameters(tmp_path: Path) -> Path:
    """The parameter file as the tutorial writes it."""
    text = TUTORIAL.read_text(encoding='utf-8')
    block = re.search(r'^    /\*\*:\n(?:    .*\n)+', text, re.MULTILINE).group()
    path = tmp_path / 'wheel.yaml'
    path.write_text(re.sub(r'^    ', '', block, flags=re.MULTILINE), encoding='utf-8')
    return path


@pytest.fixture
def run(log: Path, parameters: Path, tmp_path: Path, capsys) -> Callable[..., tuple[int, Any, str]]:
    """Run `identify` over the log; return its code, the motor in its JSON, and what it said."""

    def identify_log(source: Path = log, **changed: str) -> tuple[int, Any, str]:
        columns = {key: value for key, value in {**RIGHT, **changed}.items() if value}
        code = command.main(
            [
                *('identify', str(tmp_path / 'bag'), '--from-csv', str(source)),
                *('--params', str(parameters), '--skip-predictor', '--json', '-', '--columns'),
                *(f'{key}={value}' for key, value in columns.items()),
            ]
        )
        said = capsys.readouterr()
        motor = json.loads(said.out)['motors']['wheel'] if code == 0 else None
        return code, motor, said.err

    return identify_log


def test_the_mapping_of_the_tutorial_is_the_one_that_is_tried_here():
    text = re.sub(r'\\\n +', '', TUTORIAL.read_text(encoding='utf-8')).replace("'", '')
    assert all(f'{key}={value}' in text for key, value in RIGHT.items())


@pytest.mark.parametrize('page', ['docs/TUTORIAL.md', 'examples/README.md'])
def test_what_the_commands_of_a_page_write_is_ignored_by_git(page: str):
    root = TUTORIAL.parents[1]
    text = (root / page).read_text(encoding='utf-8')
    assert '/trial/' in (root / '.gitignore').read_text(encoding='utf-8').splitlines()
    assert 'mkdir -p trial' in text
    written = re.findall(r'\S*(?:\w\.(?:csv|html|yaml)|wheel_bag)\b', text)
    assert len(written) > 3
    assert [path for path in written if not path.strip('`(').startswith('trial/')] == []


@pytest.mark.slow
def test_the_log_of_the_tutorial_is_identified(run):
    code, motor, said = run()
    assert code == 0
    assert 'warning' not in said
    assert motor['fit']['verdict'] == 'ok'
    for name, truth in TRUTH.items():
        found = motor['parameters'][name]
        assert found['verdict'] == 'identified', name
        assert abs(found['value'] - truth) < 4.0 * found['std'], name


@pytest.mark.slow
@pytest.mark.parametrize(
    ('changed', 'named', 'remedy'),
    [
        ({'current': 'i_A*1000'}, 'units_of_current', r'current=NAME\*1e-3'),
        ({'speed': '-1*speed_rpm*30*0.104719755'}, 'speed_sign', r'speed=-1\*NAME'),
        ({'voltage': 'duty'}, 'units_of_voltage', r'by the Kb given that is near 12(\.\d)? V'),
        ({'speed': 'speed_rpm*0.104719755'}, 'back_emf_constant', r'back_emf_constant: 0\.6[56]'),
    ],
    ids=['mA for A', 'speed sign', 'duty for volts', 'no gear ratio'],
)
def test_a_mistake_makes_a_misfit_that_the_tutorial_names(
    run,
    changed: dict[str, str],
    named: str,
    remedy: str,
):
    code, motor, said = run(**changed)
    assert code == 0
    assert motor['fit']['verdict'] == 'misfit'
    suspects = {suspect['effect']: suspect['remedy'] for suspect in motor['fit']['suspects']}
    assert next(iter(suspects)) == named
    assert re.search(remedy, suspects[named])
    believed = {'identified', 'negligible'} & {p['verdict'] for p in motor['parameters'].values()}
    assert not believed
    assert 'Believe none of the parameters' in said
    assert f'likely cause: {named}' in TUTORIAL.read_text(encoding='utf-8')


def test_without_speed_the_rotor_is_found(run):
    _, motor, said = run(speed='')
    assert 'warning' not in said
    assert motor['speed_source'] == 'rotor'
    assert motor['speed_source_reason'].startswith('a rotor explains the data')
    for name, truth in {**TRUTH, 'inertia': 1.2e-5}.items():
        entry = motor['parameters'][name]
        assert entry['verdict'] == 'identified', name
        assert entry['value'] == pytest.approx(truth, rel=0.01), name
    assert 'rotor: a rotor explains the data' in TUTORIAL.read_text(encoding='utf-8')


def test_milliseconds_for_seconds_are_refused_with_the_remedy(run, tmp_path: Path):
    code, _, said = run(time='t_s*1000')
    assert code == 2
    assert said.count('\n') == 1
    assert 'if the time is in ms, write time=(t_s*1000)*1e-3' in said
    assert said.partition(': its rows')[2].split()[:3] == ['are', '1', 's']
    assert 'if the time is in ms, write time=(t_s*1000)*1e-3' in ' '.join(
        TUTORIAL.read_text(encoding='utf-8').split()
    )
    assert not (tmp_path / 'bag').exists()


@pytest.mark.slow
def test_a_voltage_that_reads_low_is_not_noticed_where_kb_is_identified(run, parameters: Path):
    text = re.sub(r'.*back_emf_constant: .*\n', '', parameters.read_text(encoding='utf-8'))
    text = text.replace('resistance]', 'resistance, back_emf_constant]')
    parameters.write_text(text, encoding='utf-8')
    _, motor, _ = run(voltage='duty*battery_V*0.9')
    assert motor['fit']['verdict'] == 'ok'
    assert motor['parameters']['resistance']['verdict'] == 'identified'
    assert motor['parameters']['resistance']['value'] == pytest.approx(0.9 * 2.1, rel=0.005)


@pytest.mark.slow
def test_a_column_whose_name_says_another_unit_is_warned_of(run, log: Path, tmp_path: Path):
    renamed = tmp_path / 'renamed.csv'
    renamed.write_text(log.read_text(encoding='utf-8').replace('i_A', 'i_mA', 1), encoding='utf-8')
    _, _, said = run(renamed, current='i_mA')
    assert "current is in A, but column 'i_mA' says mA" in said
    assert "current is in A, but column 'i_mA' says mA" in TUTORIAL.read_text(encoding='utf-8')
