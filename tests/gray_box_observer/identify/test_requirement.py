"""Exit codes for scripts: what is required of every motor, and what falls short."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from gray_box_observer.identify.command import main
from gray_box_observer.identify.requirement import EXIT_UNMET, FIT, IDENTIFIED, shortfalls


def motor(fit: str, **verdicts: str) -> dict[str, Any]:
    """Return what a result says of a motor."""
    return {
        'fit': {'verdict': fit},
        'parameters': {name: {'verdict': verdict} for name, verdict in verdicts.items()},
    }


def test_a_fit_is_enough_for_fit_and_not_for_identified() -> None:
    result = {'motors': {'m': motor('ok', resistance='converging', hysteresis='negligible')}}
    assert shortfalls(FIT, result, ['m']) == []
    assert shortfalls(IDENTIFIED, result, ['m']) == ['motor m: resistance is converging']


@pytest.mark.parametrize('fit', ['misfit', 'warning', 'untested'])
@pytest.mark.parametrize('requirement', [FIT, IDENTIFIED])
def test_nothing_but_a_fit_that_is_ok_meets_either(fit: str, requirement: str) -> None:
    result = {'motors': {'m': motor(fit, resistance='identified')}}
    assert shortfalls(requirement, result, ['m']) == [f'motor m: the fit is {fit}']


def test_a_motor_without_a_sample_meets_nothing() -> None:
    assert shortfalls(FIT, {'motors': {}}, ['m']) == ['motor m: no usable sample']


@pytest.fixture
def bag(
    tmp_path: Path, record: Callable[..., Any], messages_of: Any, write_bag: Callable[..., Path]
) -> Path:
    """Five seconds of a motor."""
    return write_bag(tmp_path / 'bag', messages_of(record('R[5,15]D[0.2,1]', 5.0)))


@pytest.mark.parametrize('options', [(), ('--each',)], ids=['one recording', 'each bag'])
@pytest.mark.parametrize('scale', [1.0, 1000.0])
def test_a_misfit_ends_with_its_own_code_where_more_is_required(
    bag: Path, capsys: pytest.CaptureFixture[str], options: tuple[str, ...], scale: float
) -> None:
    params = bag.parent / 'p.yaml'
    params.write_text(f'/**: {{ros__parameters: {{torque: {{scale: {scale}}}}}}}')
    words = ['identify', str(bag), '--params', str(params), '--skip-predictor', *options]
    falls_short = scale != 1.0
    assert main([*words, '--require', 'identified']) == (EXIT_UNMET if falls_short else 0)
    said = capsys.readouterr().err
    assert len(re.findall('not identified: .*motor motor: the fit is misfit', said)) == falls_short
    assert main(words) == 0  # it ran to the end


def test_help_names_every_exit_code(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(['identify', '--help'])
    said = ' '.join(capsys.readouterr().out.split())
    for code in (0, 1, 2, 3, EXIT_UNMET, 130):
        assert f' {code}: ' in said.partition('Exit codes:')[2]


@pytest.mark.parametrize('options', [(), ('--each',)], ids=['one recording', 'each bag'])
def test_a_motor_that_a_bag_says_nothing_of_meets_nothing(
    bag: Path, capsys: pytest.CaptureFixture[str], options: tuple[str, ...]
) -> None:
    params = bag.parent / 'p.yaml'
    params.write_text('/**: {ros__parameters: {motors: [motor, absent]}}')
    words = ['identify', str(bag), '--params', str(params), '--skip-predictor', *options]
    assert main([*words, '--require', 'fit']) == EXIT_UNMET
    assert 'motor absent: no usable sample' in capsys.readouterr().err
