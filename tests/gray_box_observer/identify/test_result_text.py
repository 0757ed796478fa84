"""The text of a result: columns below each other, units, and no sentence twice."""

from __future__ import annotations

import io
import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import pytest

from gray_box_observer.fit_test import FitAssessment, FitVerdict
from gray_box_observer.identify.command import main
from gray_box_observer.identify.next_steps import place_of_parameters
from gray_box_observer.identify.result_text import write_text
from gray_box_observer.identify.text_table import aligned


def entry(value: float | None, std: float | None, unit: str) -> dict[str, object]:
    """Return a parameter as the JSON of a result holds it."""
    return {'value': value, 'std': std, 'unit': unit, 'verdict': 'identified'}


def text_of(
    fit: FitVerdict = FitVerdict.OK,
    *,
    stamps_exact: bool = False,
    warnings: Sequence[str] = (),
    **changed: object,
) -> list[str]:
    """Return the lines that are written of one motor."""
    motor = {
        'samples': 100,
        'duration_s': 1.0,
        'fit_percent': 99.0,
        'parameters': {'inductance': entry(0.00229577, 3.7e-6, 'H')},
        'derived': {'electrical_time_constant': entry(-1.5, None, 'V s/(rad A)')},
        'speed_source': 'measured',
        'speed_source_reason': 'it came',
        'alarms': None,
        'rejected': {'duplicate': 2, 'late': 0},
        **changed,
    }
    stream = io.StringIO()
    fits = {'m': FitAssessment(fit, 1.0, 1.0, (), 100)}
    write_text({'motors': {'m': motor}}, fits, stream, warnings, ['m'] if stamps_exact else ())
    return stream.getvalue().splitlines()


def test_the_columns_of_a_motor_stand_below_each_other() -> None:
    assert text_of()[2:] == [
        '  inductance                0.00229577  +- 3.7e-06    H            identified',
        '  electrical_time_constant        -1.5  +- not known  V s/(rad A)  identified',
        '  speed from                measured: it came',
        '  rejected                  2 messages: duplicate',
    ]


@pytest.mark.parametrize(
    ('fit', 'percent', 'is_told'),
    [
        (FitVerdict.OK, -9.0, True),
        (FitVerdict.OK, 60.0, False),
        (FitVerdict.MISFIT, -9.0, False),
    ],
)
def test_a_poor_free_run_of_what_is_explained_is_told_to_be_noise(
    fit: FitVerdict, percent: float, is_told: bool
) -> None:
    line = text_of(fit, fit_percent=percent)[1]
    assert f'fit of the free run {percent:.2f} %' in line
    assert ('noise' in line) is is_told


def test_what_is_scored_stands_in_columns_with_its_unit() -> None:
    score = {'rmse': 0.00123, 'nmae': 0.05, 'fit_percent': 98.0}
    validation = {'bag': 'b', 'samples': 9, 'white_box': score, 'persistence': score}
    fit = {'verdict': 'misfit', 'ratio': 3.21, 'whiteness': 82.6, 'suspects': []}
    lines = text_of(validation={**validation, 'predictor': None, 'fit': fit})[-3:]
    figures = 'RMSE 0.00123 N m  mean error 5 % of the spread  fit 98.00 %'
    assert lines == [
        f'    white box alone              {figures}',
        f'    static map, for persistence  {figures}',
        '    fit test there: misfit, residual 3.21 times the noise, whiteness 82.6; '
        'nothing known explains it',
    ]


def test_a_validation_that_could_not_be_tested_says_so() -> None:
    score = {'rmse': 0.00123, 'nmae': 0.05, 'fit_percent': 98.0}
    validation = {'bag': 'b', 'samples': 9, 'white_box': score, 'persistence': score}
    fit = {'verdict': 'untested', 'ratio': None, 'whiteness': None, 'suspects': []}
    lines = text_of(validation={**validation, 'predictor': None, 'fit': fit})
    assert lines[-1] == '    fit test there: untested'


def test_every_number_of_a_delay_has_its_unit() -> None:
    said = text_of(delay_s={'value': 0.05, 'std': 1e-4, 'applied': 0.0})
    assert '0.05 +- 0.0001 s found in the data; 0 s applied' in '\n'.join(said)


def steps_of(
    verdict: str = 'unexcited',
    fit: FitVerdict = FitVerdict.OK,
    *,
    stamps_exact: bool = False,
    effects: Sequence[str] = (),
) -> list[str]:
    """Return the next steps of a motor with L/R of 0.5 ms, sampled each 10 ms."""
    values = {'inductance': (1e-3, 'H'), 'resistance': (2.0, 'ohm'), 'hysteresis': (1.0, 'ohm')}
    if effects:
        values['inertia'] = (1e-4, 'kg m2')
    parameters = {
        name: {**entry(value, 0.1, unit), 'verdict': verdict}
        for name, (value, unit) in values.items()
    }
    reasons = {'effects': effects, 'effects_reason': 'they showed'}
    lines = text_of(fit, stamps_exact=stamps_exact, parameters=parameters, derived={}, **reasons)
    return [line.split(maxsplit=2)[2] for line in lines if line.startswith('  next step')]


def test_what_can_be_done_about_each_verdict_is_said() -> None:
    short, rest = steps_of()
    assert short.startswith(
        'inductance: L/R of about 0.5 ms is shorter than the sample interval of 10 ms'
    )
    assert 'm.stamps_exact: true' in short
    assert short.endswith('; resistance and hysteresis may depend on it too')
    assert steps_of(stamps_exact=True)[0].endswith(': sample faster')
    assert rest.startswith('resistance, hysteresis: the recording tells nothing of it')
    assert steps_of('converging')[1].startswith('resistance, hysteresis: not known to 2 % yet')
    assert steps_of('implausible')[0].startswith('inductance, resistance, hysteresis: check')


def test_beside_a_load_that_varies_no_voltage_is_asked_for_to_tell_the_rotor() -> None:
    short, rest, of_rotor = steps_of(effects=['varying_load'])
    assert short.endswith(': sample faster')
    assert rest.startswith('resistance, hysteresis: the recording tells nothing of it')
    assert of_rotor.startswith('inertia: a load that varies hides it')
    assert of_rotor.endswith('publish the speed')


@pytest.mark.parametrize(('source', 'step'), [('rotor', True), ('torque_constant', False)])
def test_beside_a_rotor_an_l_over_r_of_a_sample_asks_for_exact_stamps(
    source: str, step: bool
) -> None:
    """A current that is smoothed, or late by half an interval, looks like as much inductance."""
    values = {'inductance': (18e-3, 'H'), 'resistance': (2.0, 'ohm')}
    parameters = {
        name: {**entry(value, 0.1, unit), 'verdict': 'unexcited'}
        for name, (value, unit) in values.items()
    }
    lines = text_of(parameters=parameters, derived={}, speed_source=source)
    assert ('m.stamps_exact: true' in '\n'.join(lines)) is step


def test_the_parameter_that_is_named_is_that_of_what_was_found() -> None:
    inductance = {**entry(1e-3, 0.1, 'H'), 'verdict': 'unexcited'}
    resistance = entry(2.0, 0.1, 'ohm')
    parameters = {'inductance': inductance, 'resistance': resistance}
    lines = text_of(parameters=parameters, derived={}, warnings=['set m.initial.resistance'])
    assert lines[-1] == PLACE


def test_what_the_newest_samples_do_not_bear_out_is_not_called_imprecise() -> None:
    stds = {'resistance': 0.001, 'hysteresis': 0.1}
    parameters = {
        name: {**entry(2.0, std, 'ohm'), 'verdict': 'converging'} for name, std in stds.items()
    }
    lines = text_of(FitVerdict.OK, parameters=parameters, derived={})
    steps = [line.split(maxsplit=2)[2] for line in lines if line.startswith('  next step')]
    assert steps[0].startswith('hysteresis: not known to 2 % yet')
    assert steps[1].startswith('resistance: not borne out by the newest samples yet')


def test_nothing_is_to_be_done_about_what_is_known_or_a_misfit() -> None:
    assert steps_of('identified') == steps_of('negligible') == []
    assert steps_of('unexcited', FitVerdict.MISFIT) == []


PLACE = (
    'Parameters such as m.stamps_exact go below ros__parameters in the file that --params names '
    '(--ros-args --params-file for the node).'
)


def test_where_a_parameter_goes_that_is_named_is_said_once_at_the_end() -> None:
    parameters = {
        name: {**entry(value, 0.1, unit), 'verdict': 'unexcited'}
        for name, value, unit in (('inductance', 1e-3, 'H'), ('resistance', 2.0, 'ohm'))
    }
    lines = text_of(parameters=parameters, derived={})
    assert [line for line in lines if 'ros__parameters' in line] == lines[-1:] == [PLACE]
    assert 'ros__parameters' not in '\n'.join(text_of())


@pytest.mark.parametrize(
    ('sentence', 'name'),
    [
        ('likely left out: rotor (wheel.speed_source: rotor, or publish it)', 'wheel.speed_source'),
        ('set motor.initial.resistance, or not', 'motor.initial.resistance'),
        ('if they are right, set gap_s to more than 1', 'gap_s'),
        ("trial/log.csv: 1.04 times; see e.g. motor/torque's velocity, or delay. Believe it", ''),
    ],
)
def test_a_parameter_is_told_from_a_number_and_a_topic(sentence: str, name: str) -> None:
    place = place_of_parameters(['nothing', sentence])
    assert (place is None) == (not name)
    assert place is None or f'such as {name} go' in place


def test_the_last_cell_of_a_row_widens_no_column() -> None:
    assert aligned([['a', 'a long sentence'], ['b', '1', 'c']]) == ['a  a long sentence', 'b  1  c']


@pytest.mark.parametrize('options', [(), ('--json', '-')], ids=['text', 'json'])
def test_what_the_fit_test_says_stands_once(
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    record: Callable[..., Any],
    messages_of: Any,
    write_bag: Callable[..., Path],
    options: tuple[str, ...],
) -> None:
    bag = write_bag(tmp_path / 'bag', messages_of(record('R[5,15]D[0.2,1]', 5.0)))
    params = tmp_path / 'p.yaml'
    params.write_text('/**: {ros__parameters: {torque: {scale: 1000.0}}}')
    words = ['identify', str(bag), '--params', str(params), '--skip-predictor', *options]
    assert main(words) == 0
    out, err = capsys.readouterr()
    assert len(re.findall('Believe none of the parameters', out + err)) == 1
    assert ('Believe none' in err) == bool(options)


def test_an_inductance_behind_a_filter_asks_for_the_filter_and_not_for_more_voltage() -> None:
    inductance = {**entry(0.01, 0.03, 'H'), 'verdict': 'unexcited'}
    behind = {'effects': ['current_lag'], 'effects_reason': 'it is late'}
    lines = text_of(parameters={'inductance': inductance}, **behind)
    steps = [line for line in lines if 'next step' in line]
    assert len(steps) == 1
    assert 'a filter of the current hides it' in steps[0]
