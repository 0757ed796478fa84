"""The declared motor is the one in numpy, C, torch, parameters and documentation."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import gray_box_observer
from gray_box_observer.white_box import declaration

ROOT = Path(__file__).resolve().parents[3]
PACKAGE = Path(declaration.__file__).resolve().parents[1]
MAKE_FORMS = ROOT / 'ros_ws' / 'make_forms.py'

EFFECT = """\
    Term(
        Parameter('spread_drop', 'V/A^2', 0.2, 1e-6, 1e3, 'Square-law drop V_q, factor of |i| i.'),
        'abs(current) * current',
    ),
"""


@pytest.fixture
def copy(tmp_path: Path) -> Path:
    """A folder with a copy of the package, to declare something in."""
    ignored = shutil.ignore_patterns('__pycache__', '*.so')
    shutil.copytree(PACKAGE, tmp_path / 'gray_box_observer', ignore=ignored)
    return tmp_path


def declare(copy: Path, effects: str, **changes: str) -> None:
    """Declare further effects, change other lines, and have the forms made."""
    path = copy / 'gray_box_observer' / 'white_box' / 'declaration.py'
    text = path.read_text(encoding='utf-8')
    for old, new in {')\n\nTERMS:': f'{effects})\n\nTERMS:', **changes}.items():
        assert text.count(old) == 1, old
        text = text.replace(old, new)
    path.write_text(text, encoding='utf-8')
    run(copy, str(MAKE_FORMS))


def run(copy: Path, *arguments: str) -> str:
    """Run Python, which finds the copy before anything else; return what it prints."""
    path = os.pathsep.join([str(copy), str(ROOT / 'docs'), os.environ.get('PYTHONPATH', '')])
    done = subprocess.run(
        [sys.executable, *arguments],
        env=os.environ | {'PYTHONPATH': path},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def probe(copy: Path, text: str) -> Any:
    """Run lines of Python that print a value as JSON."""
    path = copy / 'probe.py'
    path.write_text(text, encoding='utf-8')
    return json.loads(run(copy, str(path)))


def compile_in(copy: Path) -> None:
    """Build compiled code from the sources in the copy, in seconds rather than a minute."""
    compiler = shutil.which('cc') or shutil.which('gcc')
    if compiler is None:
        pytest.skip('no C compiler')
    folder = copy / 'gray_box_observer' / 'context_nodes' / 'native'
    library = folder / f'_compiled{sysconfig.get_config_var("EXT_SUFFIX")}'
    sources = [str(path) for path in sorted(folder.glob('*.c'))]
    options = [
        '-O0',
        '-DQUICK_BUILD',
        '-w',
        '-std=gnu11',
        '-ffp-contract=off',
        '-fPIC',
        '-shared',
        f'-I{folder.parents[1]}',
    ]
    subprocess.run(
        [compiler, *options, *sources, '-o', str(library), '-lm'], check=True, capture_output=True
    )


def test_the_committed_forms_are_those_of_the_declaration() -> None:
    done = subprocess.run(
        [sys.executable, str(MAKE_FORMS), '--check'], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr


def test_nothing_that_runs_needs_sympy(tmp_path: Path) -> None:
    used = (
        'import sys, gray_box_observer.identify.command, gray_box_observer.observer.observer; '
        'assert "sympy" not in sys.modules'
    )
    run(tmp_path, '-c', used)


def test_forms_that_are_out_of_date_are_told(copy: Path) -> None:
    path = copy / 'gray_box_observer' / 'white_box' / 'forms.h'
    path.write_text(path.read_text(encoding='utf-8').replace('0.5 *', '0.25 *'), encoding='utf-8')
    with pytest.raises(AssertionError, match=r'forms.h is not what is declared; run make physics'):
        run(copy, str(MAKE_FORMS), '--check')


def test_an_effect_of_fifteen_lines_is_everywhere(copy: Path) -> None:
    assert len(EFFECT.splitlines()) <= 15
    declare(copy, EFFECT)
    compile_in(copy)
    found = probe(copy, PROBE)
    assert (
        Path(found['package'])
        == copy / 'gray_box_observer'
        != Path(gray_box_observer.__file__).parent
    )

    expected = [[abs(i) * i for i in (-2.0, 0.0, 3.0)], [2.0 * abs(i) for i in (-2.0, 0.0, 3.0)]]
    for language in ('numbers', 'numpy', 'torch', 'compiled'):
        np.testing.assert_allclose(found[language], expected, rtol=1e-14, err_msg=language)

    assert found['all blocks by compiled code']
    np.testing.assert_allclose(found['identified'], [[0.02, 1.5, 0.3]], rtol=2e-3)
    np.testing.assert_allclose(found['identified by numpy'], found['identified'], rtol=1e-9)
    for by_torch, by_numpy in zip(found['by torch'], found['by numpy'], strict=True):
        np.testing.assert_allclose(by_torch, by_numpy, rtol=1e-12)

    assert found['context nodes'] == ['inductance', 'resistance', 'spread_drop']
    assert found['known'] == {'spread_drop': 0.7, 'back_emf_constant': 0.01}
    assert found['parameters'] == {
        'known.spread_drop': [0.0, 0.0, 1000.0],
        'initial.spread_drop': [0.2, 1e-6, 1000.0],
        'initial_relative_std.spread_drop': [0.0, 0.0, 100.0],
    }
    assert (
        found['refused']
        == 'parameter motor.initial.spread_drop must be in [1e-06, 1000], got 2000.0'
    )
    assert [row[:5] for row in found['documented']] == [
        ['`<motor>.known.spread_drop`', 'double', 'V/A^2', '`0.0`', '0 to 1000'],
        ['`<motor>.initial.spread_drop`', 'double', 'V/A^2', '`0.2`', '1e-6 to 1000'],
        ['`<motor>.initial_relative_std.spread_drop`', 'double', '', '`0.0`', '0 to 100'],
    ]
    assert (
        found['documented'][0][6]
        == 'Square-law drop V_q in V/A^2; known unless among context_nodes.'
    )


PROBE = """
import ctypes, json
from pathlib import Path
import numpy as np, torch
import gray_box_observer
from api_tables import spec_rows
from gray_box_observer.settings.configuration import Configuration
from gray_box_observer.context_nodes import RecursiveEstimator
from gray_box_observer.context_nodes.native import regular_block
from gray_box_observer.errors import ConfigurationError
from gray_box_observer.settings.parameters import MOTOR_PARAMETERS
from gray_box_observer.samples import Sample
from gray_box_observer.white_box.torch_ops import TorchOps
from gray_box_observer.white_box import TERMS, MotorWhiteBox
from gray_box_observer.white_box.flow import flow, to_coordinates

found = {'package': str(Path(gray_box_observer.__file__).parent)}
nodes, currents = ('inductance', 'resistance', 'spread_drop'), (-2.0, 0.0, 3.0)
box = MotorWhiteBox(nodes, 0.5, {}, True)

def value_and_slope(current):
    balance = box.balances(current)[0]
    signals = balance.signals([current], 0.0 * current, 0.0)
    return [balance.basis(signals)[1], balance.basis_slope(0, signals)[1]]

found['numbers'] = [*zip(*map(value_and_slope, currents))]
found['numpy'] = [part.tolist() for part in value_and_slope(np.array(currents))]
tensors = torch.tensor(currents, dtype=torch.float64)
found['torch'] = [part.tolist() for part in value_and_slope(tensors)]
library = regular_block.library()
values = (ctypes.c_double * 2)()
code = list(TERMS).index('spread_drop')

def compiled(current):
    assert library.term_values(code, 1, current, 0.0, 0.5, 0.0, values)
    return list(values)

found['compiled'] = [*zip(*map(compiled, currents))]

theta, known = np.array([[0.02, 1.5, 0.3]]), {'back_emf_constant': np.array([0.01])}
box = MotorWhiteBox(nodes, np.array([0.5]), known)
random, state, one = np.random.default_rng(1), [np.zeros((1, 1))], np.ones((1, 1))
samples, level = [], 0.0
for k in range(1500):
    if k:
        signals = level * one, 0 * one, 0 * one, 2e-3 * one
        state = flow(box, to_coordinates(theta), state, *signals).value
    torque = box.output(state[0])[:, 0] + random.normal(0.0, 1e-4, 1)
    interval = np.full(1, 2e-3 * (k > 0))
    samples.append(Sample(k * 2_000_000, interval, np.full(1, level), torque, np.full(1, np.nan)))
    level = random.uniform(-12.0, 12.0) if random.random() < 0.1 else level

def learn():
    update = RecursiveEstimator(box, 3.0 * theta)
    within, told = update._updater.learn_due, []
    def learn_due(*arguments):
        known, turn = within(*arguments)
        told.extend(turn.status.tolist())
        return known, turn
    update._updater.learn_due = learn_due
    for sample in samples:
        update.learn(sample)
    return update.theta.tolist(), told

found['identified'], told = learn()
found['all blocks by compiled code'] = len(told) > 20 and bool(np.mean(np.array(told) > 0) > 0.9)
regular_block.library = lambda *_: None
found['identified by numpy'], _ = learn()
ones = np.ones((1, 3))
many = [np.array([[-3.0, 0.1, 2.0]])], np.full((1, 3), 9.0), ones, ones, np.full((1, 3), 2e-3)
found['by numpy'] = [part.tolist() for part in flow(box, to_coordinates(theta), *many).of_state(0)]
tensor = lambda array: torch.as_tensor(array, dtype=torch.float64)
twin = MotorWhiteBox.from_dict(box.to_dict(), tensor)
start = [tensor(many[0][0])]
moved = flow(
    twin, tensor(to_coordinates(theta)), start, *map(tensor, many[1:]), TorchOps('cpu')
)
found['by torch'] = [part.tolist() for part in moved.of_state(0)]

motor = Configuration.from_flat({'motor.context_nodes': list(nodes)}).motors['motor']
box = motor.white_box(speed_measured=False)
found['context nodes'] = [parameter.name for parameter in box.parameters]
motor = Configuration.from_flat({'motor.known.spread_drop': 0.7}).motors['motor']
found['known'] = motor.white_box(speed_measured=False).known
own = [spec for spec in MOTOR_PARAMETERS if 'spread_drop' in spec.name]
found['parameters'] = {spec.name: [spec.default, spec.minimum, spec.maximum] for spec in own}
found['documented'] = list(spec_rows(own, '<motor>.'))
try:
    Configuration.from_flat({'motor.initial.spread_drop': 2000.0})
except ConfigurationError as error:
    found['refused'] = str(error)
print(json.dumps(found))
"""


def test_the_flow_moves_a_rotor(tmp_path: Path) -> None:
    found = probe(tmp_path, ROTOR_PROBE)
    assert found['states'] == ['CURRENT', 'SPEED']
    np.testing.assert_allclose(found['ends'], found['by scipy'], rtol=1e-5)
    np.testing.assert_allclose(
        found['by state'], found['by differences of states'], rtol=1e-5, atol=1e-8
    )
    np.testing.assert_allclose(
        found['by coordinate'], found['by differences of coordinates'], rtol=1e-4, atol=1e-7
    )
    assert not found['compiled']


ROTOR_PROBE = """
import json
import numpy as np
from scipy.integrate import solve_ivp
from gray_box_observer.context_nodes.native.regular_block import RegularBlocks
from gray_box_observer.context_nodes.recursive.estimator_settings import RecursiveSettings
from gray_box_observer.samples.replay_buffer import ReplayBuffer
from gray_box_observer.white_box import MotorWhiteBox
from gray_box_observer.white_box.flow import flow

L, R, K, Kt, Kb, J, B, T = 2e-3, 1.2, 0.01, 0.05, 0.05, 1e-4, 2e-3, 0.01
nodes = ('inductance', 'resistance', 'hysteresis', 'inertia', 'viscous_friction', 'load_torque')
box = MotorWhiteBox(nodes, Kt, {'back_emf_constant': Kb})
p = np.array([[1 / L, R / L, K / L, 1 / J, B / J, T / J]])
volt, none, lasting = np.full((1, 1), 9.0), np.full((1, 1), np.nan), np.full((1, 1), 4e-3)

def moved(p, *start):
    return flow(box, p, [np.array([[x]]) for x in start], volt, none, none, lasting)

def ends(p, *start):
    return np.array([x.item() for x in moved(p, *start).value])

def slope(time_s, state):
    i, w = state
    return [(9.0 - R * i - K * abs(w) * i - Kb * w) / L, (Kt * i - B * w - T) / J]

start = np.array([1.5, 20.0])
whole = moved(p, *start)
solved = solve_ivp(slope, (0.0, 4e-3), start, method='LSODA', rtol=1e-11, atol=1e-13)
bumps = [h * np.eye(2)[s] for s, h in enumerate((1e-5, 1e-4))]
by_states = [(ends(p, *(start + b)) - ends(p, *(start - b))) / (2 * b.sum()) for b in bumps]
coordinates = [1e-5 * p * np.eye(p.size)[j] for j in range(p.size)]
by_coordinates = [(ends(p + b, *start) - ends(p - b, *start)) / (2 * b.sum()) for b in coordinates]
print(json.dumps({
    'states': [state.name for state in box.states],
    'ends': [x.item() for x in whole.value],
    'by scipy': solved.y[:, -1].tolist(),
    'by state': [[x.item() for x in row] for row in whole.by_state],
    'by differences of states': np.array(by_states).T.tolist(),
    'by coordinate': [column[:, 0, 0].tolist() for column in whole.by_coordinate],
    'by differences of coordinates': np.array(by_coordinates).T.tolist(),
    'compiled': RegularBlocks(box, RecursiveSettings(), ReplayBuffer(1, 128)).compiled,
}))
"""
