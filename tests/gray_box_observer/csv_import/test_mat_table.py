"""Logs that MATLAB or Octave has saved."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat

from dc_motor_sim.simulation import Recording
from gray_box_observer.bag.joint_state import decode_joint_state
from gray_box_observer.bag.reader import BagReader
from gray_box_observer.csv_import import mat_table
from gray_box_observer.csv_import.column_mapping import CsvMapping
from gray_box_observer.csv_import.log_conversion import csv_to_bag
from gray_box_observer.csv_import.log_table import look_at, read_columns
from gray_box_observer.errors import BagError
from gray_box_observer.identify.command import main

T = np.linspace(0.0, 0.9, 10)


def saved(folder: Path, **vectors: object) -> Path:
    path = folder / 'log.mat'
    savemat(path, vectors, do_compression=True)
    return path


@pytest.mark.parametrize('oned_as', ['row', 'column'])
def test_vectors_of_one_length_are_the_columns(tmp_path: Path, oned_as: str) -> None:
    path = tmp_path / 'log.mat'
    content = {
        't': T,
        'u': (10 * T).astype('float32'),
        'n': np.arange(10, dtype='int16'),
        'Kt': 0.05,
        'name': 'left',
        'short': [1.0, 2.0],
        'matrix': np.zeros((10, 3)),
    }
    savemat(path, content, oned_as=oned_as)
    shape = look_at(path)
    assert set(shape.names) == {'t', 'u', 'n'}
    columns = read_columns(path, shape, {shape.names.index('n') + 1, shape.names.index('t') + 1})
    assert columns.values[shape.names.index('t') + 1].tolist() == T.tolist()
    assert columns.values[shape.names.index('n') + 1].tolist() == list(range(10))
    assert columns.lines.tolist() == list(range(1, 11))


def test_a_bag_is_made_of_them(tmp_path: Path) -> None:
    path = saved(tmp_path, t=T, u=10 * T, i=T)
    mapping = CsvMapping.from_options(['time=t', 'voltage=u', 'current=i*2', 'torque_constant=0.5'])
    assert csv_to_bag(path, tmp_path / 'bag', mapping).messages == 20
    with BagReader(tmp_path / 'bag') as bag:
        views = [decode_joint_state(m.data) for m in bag.messages(['/motor/torque'])]
    assert [view.effort[0] for view in views] == pytest.approx(T.tolist())


@pytest.mark.slow
def test_a_motor_is_identified_from_one(
    tmp_path: Path, record: Callable[..., Recording], capsys: pytest.CaptureFixture[str]
) -> None:
    recording = record('R[5,15]D[0.2,2]', 20.0)
    path = saved(
        tmp_path,
        t=(recording.stamp_ns - recording.stamp_ns[0]) * 1e-9,
        u=recording.voltage_v[0],
        i=recording.torque_nm[0] / 0.01,
    )
    words = ['time=t', 'voltage=u', 'current=i', 'torque_constant=0.01']
    command = ['identify', str(tmp_path / 'bag'), '--skip-predictor', '--from-csv', str(path)]
    assert main([*command, '--columns', *words]) == 0
    assert capsys.readouterr().out.count('identified') >= 3


def refused(path: Path) -> str:
    with pytest.raises(BagError) as caught:
        shape = look_at(path)
        read_columns(path, shape, {1})
    assert str(path) in str(caught.value)
    return str(caught.value)


def test_what_is_no_table_of_vectors_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert 'no vectors of numbers' in refused(saved(tmp_path, Kt=0.05, name='left'))
    assert 'is complex' in refused(saved(tmp_path, z=T + 1j))
    path = saved(tmp_path, t=T)
    monkeypatch.setattr(mat_table, 'MOST_ROWS', 5)
    assert 'vectors of 10 numbers; expected at most' in refused(path)


def test_a_damaged_file_is_one_line(tmp_path: Path) -> None:
    whole = saved(tmp_path, t=T).read_bytes()
    path = tmp_path / 'damaged.mat'
    for content in (b'', b'time,voltage\n1,2\n', whole[:150], whole[:-20], b'\x00' * 500):
        path.write_bytes(content)
        assert '\n' not in refused(path)
    path.write_bytes(b'MATLAB 7.3 MAT-file'.ljust(124) + b'\x00\x02IM' + b'\x89HDF' + b'\0' * 600)
    assert 'save it with -v7' in refused(path)
    assert 'no such file' in refused(tmp_path / 'nothing.mat').lower()


def test_without_scipy_the_remedy_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = saved(tmp_path, t=T)
    monkeypatch.setitem(sys.modules, 'scipy', None)
    assert 'pip install scipy' in refused(path)
