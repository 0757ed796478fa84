"""What is not finite is not known, wherever it is written."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

from gray_box_observer.identify.output_files import write_json
from gray_box_observer.safe_io.finite import finite_or_none, plain, words_of


@pytest.mark.parametrize('value', [math.nan, math.inf, -math.inf, np.float64('nan'), None])
def test_what_is_not_finite_is_none_and_said_not_to_be_known(value: float | None) -> None:
    assert finite_or_none(value) is None
    assert words_of(value) == 'not known'


def test_numbers_arrays_and_text_become_plain_values() -> None:
    tree = {
        'a': np.array([[1.0, np.nan]]),
        'b': (np.int64(3), True, 'text', None),
        'c': np.float32(0.5),
    }
    assert plain(tree) == {'a': [[1.0, None]], 'b': [3, True, 'text', None], 'c': 0.5}


def test_json_holds_null_where_a_number_is_not_finite(tmp_path: Path) -> None:
    target = tmp_path / 'result.json'
    write_json({'std': math.nan, 'covariance': [[math.inf, 1.0]]}, str(target))
    assert json.loads(target.read_text()) == {'std': None, 'covariance': [[None, 1.0]]}
