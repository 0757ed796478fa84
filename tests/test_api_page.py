"""docs/API.md is what the code says."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from dc_motor_sim.plant import PlantParameters
from dc_motor_sim.ros.parameters import NodeParameters
from gray_box_observer.settings.parameters import MOTOR_PARAMETERS, OBSERVER_PARAMETERS

ROOT = Path(__file__).resolve().parent.parent
MAKE = ROOT / 'docs' / 'make_api.py'
PAGE = (ROOT / 'docs' / 'API.md').read_text(encoding='utf-8')


def section(name: str) -> str:
    return PAGE.partition(f'\n## {name}\n')[2].partition('\n## ')[0]


@pytest.mark.system
def test_the_page_is_what_the_code_says():
    done = subprocess.run(
        [sys.executable, str(MAKE), '--check'], capture_output=True, text=True, timeout=100
    )
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.system
def test_a_page_that_says_something_else_is_found(tmp_path: Path):
    """The check itself is tried on a copy of the script whose page was changed by hand."""
    wrong = PAGE.replace('| `gap_s` | double | s | `0.5`', '| `gap_s` | double | s | `5.0`')
    assert wrong != PAGE
    (tmp_path / 'API.md').write_text(wrong, encoding='utf-8')
    script = (
        f'import sys; sys.path.insert(0, {str(MAKE.parent)!r}); import make_api; from pathlib '
        'import Path; '
    )
    script += (
        f'make_api.PAGE = Path({str(tmp_path / "API.md")!r}); sys.exit(make_api.main(["--check"]))'
    )
    done = subprocess.run(
        [sys.executable, '-c', script], capture_output=True, text=True, timeout=100
    )
    assert done.returncode == 1
    assert '-| `gap_s` | double | s | `5.0`' in done.stdout + done.stderr
    assert '+| `gap_s` | double | s | `0.5`' in done.stdout + done.stderr


@pytest.mark.parametrize(
    'name',
    ['observer', 'recorder', 'player', 'identify', 'watch', 'dashboard', 'motor_sim'],
)
def test_every_executable_has_a_section_with_its_options(name: str):
    assert '| `-h`, `--help` |' in section(name)


def test_every_declared_parameter_has_a_line():
    for spec in OBSERVER_PARAMETERS:
        assert f'| `{spec.name}` |' in section('observer'), spec.name
    for spec in MOTOR_PARAMETERS:
        assert f'| `<motor>.{spec.name}` |' in section('observer'), spec.name
    for name in NodeParameters.__dataclass_fields__:
        assert f'| `{name}` |' in section('motor_sim'), name
    for name in PlantParameters.__dataclass_fields__:
        assert f'| `<motor>.{name}` |' in section('motor_sim'), name


def test_a_quantity_with_a_unit_in_its_name_has_that_unit_in_its_line():
    lines = [
        line.split(' | ')
        for line in PAGE.splitlines()
        if line.startswith('| `') and line.count(' | ') == 6
    ]
    of_time = [line for line in lines if line[0].endswith('_s`') and '_per_s' not in line[0]]
    assert len(of_time) > 10
    assert {line[0]: line[2] for line in of_time if line[2] != 's'} == {}
