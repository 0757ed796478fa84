"""The page is whole, safe and needs nothing from elsewhere."""

from __future__ import annotations

import dataclasses
import json
import re
import sys
from html.parser import HTMLParser

import numpy as np
import pytest

from gray_box_observer.report import (
    MotorHistory,
    ParameterHistory,
    ReportError,
    render,
    write_report,
)
from gray_box_observer.report.run.history import FitHistory
from gray_box_observer.report.run.page import embedded
from gray_box_observer.report.run.sections import sensitivity_table

pytest.importorskip('plotly', reason='the report needs plotly')

EVIL = '</script><b onclick="x">&<!--%{y}${z}'


class Elements(HTMLParser):
    """Every start tag with its attributes, and the text between tags outside scripts and styles."""

    def __init__(self, page):
        super().__init__()
        self.tags = []
        self.words = []
        self.scripts = []
        self._raw = False
        self.feed(page)

    def handle_starttag(self, tag, attrs):
        """Keep the tag."""
        self.tags.append((tag, dict(attrs)))
        self._raw = tag in ('script', 'style')
        if tag == 'script':
            self.scripts.append('')

    def handle_endtag(self, tag):
        """Leave a script or style."""
        self._raw = False

    def handle_data(self, data):
        """Keep text, apart from scripts."""
        if not self._raw:
            self.words.append(data)
        elif self.scripts:
            self.scripts[-1] += data


@pytest.fixture(scope='module')
def page(whole_run):
    return render(whole_run)


def figures_of(page):
    text = re.search(
        r'<script type="application/json" id="figures">(.*?)</script>', page, re.S
    ).group(1)
    return json.loads(text)


def test_the_page_refers_to_nothing_outside_itself(page):
    elements = Elements(page)
    for tag, attributes in elements.tags:
        assert tag not in {'link', 'img', 'iframe', 'object', 'embed', 'base'}
        assert not {'src', 'srcset', 'action', 'data', 'background'} & set(attributes), (
            tag,
            attributes,
        )
        assert attributes.get('href', '#').startswith('#')
    style = re.search(r'<style>(.*?)</style>', page, re.S).group(1)
    assert 'url(' not in style
    assert '@import' not in style


def test_the_page_forbids_the_browser_to_load_anything(page):
    policies = [
        a['content']
        for t, a in Elements(page).tags
        if a.get('http-equiv') == 'Content-Security-Policy'
    ]
    assert len(policies) == 1
    assert policies[0].startswith("default-src 'none'")
    assert 'http' not in policies[0]


def test_the_embedded_numbers_are_those_of_the_history(page, whole_run):
    figures = figures_of(page)
    motor = whole_run.motors[0]
    signals = {trace['name']: trace for trace in figures['motor-0-signals']['data']}
    assert signals['voltage']['x'] == pytest.approx(motor.time_s, rel=1e-9)
    assert signals['voltage']['y'] == pytest.approx(motor.voltage_v, rel=1e-6)
    assert signals['measured']['y'] == pytest.approx(motor.torque_nm * 1e3, rel=1e-6)
    missing = [value is None for value in signals['predicted']['y']]
    assert missing == np.isnan(motor.predicted_torque_nm).tolist()
    for number, parameter in enumerate(motor.parameters):
        traces = {trace['name']: trace for trace in figures[f'motor-0-parameter-{number}']['data']}
        factor = 1e3 if parameter.name == 'inductance' else 1.0
        assert traces['estimate']['y'] == pytest.approx(parameter.value * factor, rel=1e-6)


def test_the_cards_tell_value_deviation_verdict_truth_and_error(page, whole_run):
    text = ' '.join(Elements(page).words)
    resistance = whole_run.motors[0].parameters[1]
    assert f'{resistance.value[-1]:.5f}' in text
    assert f'± {resistance.std[-1]:.5f}' in text
    assert 'mH' in text and 'Ω' in text
    assert '1.08 Ω' in text
    assert page.count('class="card identified"') == 3
    assert whole_run.command in text
    assert whole_run.digest in text


def test_the_same_history_gives_the_same_page(page, whole_run):
    assert render(whole_run) == page


def test_names_from_outside_stay_text(make_motor, make_run):
    motor = make_motor(samples=200)
    evil = dataclasses.replace(
        motor,
        name=EVIL,
        parameters=tuple(
            dataclasses.replace(p, name=EVIL, unit=EVIL, verdict=[EVIL] * 200)
            for p in motor.parameters
        ),
        rejection_counts={EVIL: 3},
        rejected_time_s={EVIL: np.array([1.0])},
        scores={EVIL: 0.5},
        notes=(EVIL,),
        sensitivity={EVIL: {EVIL: 1.0}},
    )
    run = dataclasses.replace(
        make_run(evil, evil),
        title=EVIL,
        source=(EVIL,),
        creation_time=EVIL,
        command=EVIL,
        digest=EVIL,
        summary={EVIL: EVIL},
    )
    elements = Elements(render(run))
    assert not [
        attributes for tag, attributes in elements.tags if tag == 'b' or 'onclick' in attributes
    ]
    assert [tag for tag, _ in elements.tags].count('script') == 3
    assert EVIL in ' '.join(elements.words)
    figures = json.loads(elements.scripts[0])
    assert '<b' not in json.dumps(figures)
    assert '%{y}$' not in json.dumps(figures)


def test_json_in_a_script_element_cannot_end_it_and_reads_back():
    content = {'name': EVIL, 'line separator': '\u2028', 'none': None}
    text = embedded(content)
    assert '<' not in text and '>' not in text and '\u2028' not in text
    assert json.loads(text) == content
    with pytest.raises(ValueError, match='not JSON compliant'):
        embedded({'value': float('nan')})


def test_a_run_without_motors_samples_or_estimates_still_has_a_page(make_run):
    none = np.empty(0)
    parameter = ParameterHistory('inductance', 'H', none, none, none, [])
    empty = MotorHistory(
        'm', none, none, none, none, none, (parameter,), rejection_counts={'late': 0}
    )
    text = ' '.join(Elements(render(make_run(empty))).words)
    assert 'No estimate was made.' in text
    assert 'No sample was used.' in text
    assert 'Checked: late.' in text
    nothing = dataclasses.replace(make_run(), motors=())
    assert 'holds no motor' in render(nothing)


def test_values_that_are_not_finite_are_drawn_as_gaps(make_motor, make_run):
    motor = make_motor(samples=100)
    bad = np.full(100, np.inf)
    parameters = tuple(dataclasses.replace(p, value=bad, std=bad) for p in motor.parameters)
    figures = figures_of(
        render(make_run(dataclasses.replace(motor, torque_nm=bad, parameters=parameters)))
    )
    assert set(figures['motor-0-parameter-0']['data'][2]['y']) == {None}


def test_writing_makes_folders_replaces_an_older_report_and_leaves_nothing_else(
    tmp_path, whole_run, page
):
    path = tmp_path / 'new' / 'report.html'
    path.parent.mkdir()
    path.write_text('old')
    write_report(whole_run, path)
    assert path.read_text(encoding='utf-8') == page
    assert [entry.name for entry in path.parent.iterdir()] == ['report.html']
    write_report(whole_run, tmp_path / 'other' / 'folder' / 'report.html')


def test_a_report_that_cannot_be_written_is_one_clear_line(tmp_path, whole_run):
    (tmp_path / 'file').write_text('')
    with pytest.raises(ReportError, match='cannot write the report') as failure:
        write_report(whole_run, tmp_path / 'file' / 'report.html')
    assert '\n' not in str(failure.value)
    (tmp_path / 'folder.html').mkdir()
    with pytest.raises(ReportError, match=r'folder\.html'):
        write_report(whole_run, tmp_path / 'folder.html')
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ['file', 'folder.html']


def test_without_plotly_the_error_names_the_remedy(monkeypatch, make_run):
    monkeypatch.setitem(sys.modules, 'plotly', None)
    with pytest.raises(ReportError, match='pip install plotly'):
        render(make_run())


def test_a_change_that_is_rounding_is_shown_as_none():
    table = sensitivity_table({'back_emf_constant': {'inductance': -7.4e-12, 'resistance': -0.01}})
    cells = re.findall(r'<td class="number">(.*?)</td>', table)
    assert cells == ['0\N{NO-BREAK SPACE}%', '\N{MINUS SIGN}0.010\N{NO-BREAK SPACE}%']


def test_the_page_says_at_the_top_whether_the_white_box_explains_the_data(
    make_run, make_motor
) -> None:
    for verdict, style in (
        ('ok', 'identified'),
        ('warning', 'doubtful'),
        ('misfit', 'misfit'),
        ('untested', 'other'),
    ):
        fit = FitHistory(verdict, f'It is <{verdict}>.', 98.765)
        page = render(make_run(dataclasses.replace(make_motor(samples=50), fit=fit)))
        banner = page.split(f'class="fit {style}"')[1].split('</p>')[0]
        assert f'It is &lt;{verdict}&gt;.' in banner
        assert '98.77' in banner
        assert page.index('class="fit') < page.index('class="cards"')
        assert ('settled, and the data bear it out' in page) == (verdict == 'ok')


def test_the_page_prints_parameters_and_validation_and_marks_constants_that_estimates_lean_on(
    make_run, make_motor
) -> None:
    score = {'rmse': 0.001, 'nmae': 0.02, 'fit_percent': 97.5}
    test = {'verdict': 'ok', 'ratio': None, 'whiteness': None, 'suspects': []}
    validation = {'bag': 'b<1>', 'samples': 7, 'predictor': True, **score, 'fit': test}
    validation |= {'white_box': score, 'persistence': {**score, 'rmse': None}}
    sensitivity = {
        'back_emf_constant': {'resistance': -4.0},
        'torque_constant': {'resistance': 1.0},
    }
    motor = dataclasses.replace(
        make_motor(samples=50), validation=validation, sensitivity=sensitivity
    )
    page = render(dataclasses.replace(make_run(motor), parameters={'motor.torque_constant': 0.01}))
    assert '<code>motor.torque_constant: 0.01</code>' in page
    assert 'b&lt;1&gt;: 7 samples, nothing learnt from them' in page
    assert page.count('<td class="number">97.5</td>') == 3
    assert 'resistance moves by' in page
    assert page.count('number strong') == 1
