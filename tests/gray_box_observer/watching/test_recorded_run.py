"""``watch BAG``: the table of a recorded observer, or of one that runs over the bag now."""

from __future__ import annotations

import io
from array import array
from pathlib import Path
from types import SimpleNamespace
from typing import ClassVar

import pytest

from gray_box_observer.bag.joint_state import TYPE_NAME, encode_joint_state
from gray_box_observer.bag.schemas import built_in_lookup, schema_text
from gray_box_observer.bag.writer import BagWriter
from gray_box_observer.errors import BagError
from gray_box_observer.watching import recorded_run
from gray_box_observer.watching.recorded_run import Playback, watch_bag
from gray_box_observer.watching.table_display import TableDisplay

MS_10 = 10_000_000
MODERATE = Path(__file__).resolve().parents[3] / 'bags' / 'moderate'


def shown(bag: Path, playback: Playback | None = None) -> str:
    stream = io.StringIO()
    assert watch_bag(bag, {}, playback or Playback(), TableDisplay(stream)) == []
    return stream.getvalue()


def test_a_bag_of_voltage_and_torque_is_observed_to_its_end_and_shown_once() -> None:
    text = shown(MODERATE)
    assert text.count('moderate  1 motor, 1 identified') == 1
    assert 'fit ok' in text and '100.0 samples/s' in text
    assert text.count('identified  ') >= 3


def test_the_rate_is_that_of_the_bag(monkeypatch: pytest.MonkeyPatch) -> None:
    waited_ns: list[int] = []

    class Pacer:
        def __init__(self, rate: float) -> None:
            assert rate == 5.0

        def restart(self, at_ns: int) -> None:
            self.start_ns = at_ns

        def wait(self, at_ns: int) -> None:
            waited_ns.append(at_ns - self.start_ns)

    monkeypatch.setattr(recorded_run, 'Pacer', Pacer)
    shown(MODERATE, Playback(rate=5.0, period_s=0.0))
    assert waited_ns == sorted(waited_ns)
    assert waited_ns[-1] > 5e9


def test_a_recorded_observer_is_shown_as_it_was(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Messages stand in for decoded ones: another test reads what the recorder has written."""
    labels = [
        SimpleNamespace(label=text) for text in ('motor', 'inductance,resistance', 'value,std')
    ]
    messages = [
        (
            '/r1/o/estimates',
            k,
            SimpleNamespace(
                layout=SimpleNamespace(dim=labels), data=array('d', [0.5, 0.1, 1.0 + k, 0.2])
            ),
        )
        for k in range(3)
    ]
    status = SimpleNamespace(
        name='r1/o: motor',
        level=2,
        message='mend it',
        values=[SimpleNamespace(key='resistance verdict', value='misfit')],
    )
    other = SimpleNamespace(name='camera: driver', level=0, message='', values=[])
    messages.append(('/diagnostics', 3, SimpleNamespace(status=[status, other])))

    class Reader:
        loss = None
        start_ns = 0
        topics: ClassVar = {
            '/r1/o/estimates': SimpleNamespace(type_name='std_msgs/msg/Float64MultiArray'),
            '/other/estimates': SimpleNamespace(type_name='std_msgs/msg/String'),
            '/diagnostics': SimpleNamespace(type_name='diagnostic_msgs/msg/DiagnosticArray'),
        }

        def __init__(self, path: Path) -> None:
            pass

        def __enter__(self) -> Reader:
            return self

        def __exit__(self, *_: object) -> None:
            pass

        def decoded_messages(self, topics: set[str]) -> list[tuple[SimpleNamespace, object]]:
            assert topics == {'/r1/o/estimates', '/diagnostics'}
            return [
                (SimpleNamespace(topic=topic, log_time_ns=k * 10**9), message)
                for topic, k, message in messages
            ]

    monkeypatch.setattr(recorded_run, 'BagReader', Reader)
    text = shown(tmp_path / 'bag')
    assert 'bag  3.0 s' in text and '/r1/o  1 motor, 0 identified' in text
    assert '3  ± 0.2' in text and 'misfit' in text and 'mend it' in text
    with pytest.raises(BagError, match='holds no estimates of /r2/o'):
        shown(tmp_path / 'bag', Playback(observers=('/r2/o',)))


def shifted_bag(folder: Path, shift_s: int, stamps_ns: list[int]) -> Path:
    """Voltage and torque of these stamps, recorded so many seconds later: a replay of another."""
    bag = folder / 'again'
    with BagWriter(bag) as writer:
        for topic in ('/motor/voltage', '/motor/torque'):
            writer.add_topic(topic, TYPE_NAME, schema_text(TYPE_NAME, built_in_lookup))
        for k, stamp_ns in enumerate(stamps_ns):
            log_time_ns = stamps_ns[0] + shift_s * 10**9 + k * MS_10
            for topic in ('/motor/voltage', '/motor/torque'):
                data = encode_joint_state(stamp_ns, ['motor'], effort=[float(k // 20 % 2)])
                writer.write(topic, data, log_time_ns, log_time_ns)
    return bag


@pytest.mark.parametrize('shift_s', [0, 1_795_538_704, -1000])
@pytest.mark.parametrize('rate', [0.0, 1e6])
def test_the_time_is_that_of_the_samples_whenever_they_were_recorded(
    tmp_path: Path, shift_s: int, rate: float
) -> None:
    bag = shifted_bag(tmp_path, shift_s, [10**13 + k * MS_10 for k in range(401)])
    assert 'again  4.0 s' in shown(bag, Playback(rate=rate))


def test_the_time_goes_on_where_stamps_begin_anew(tmp_path: Path) -> None:
    first = [10**13 + k * MS_10 for k in range(401)]
    later = [10**12 + k * MS_10 for k in range(301)]
    assert 'again  7.0 s' in shown(shifted_bag(tmp_path, 0, first + later))


def test_a_bag_without_a_usable_sample_is_refused(tmp_path: Path) -> None:
    with pytest.raises(BagError, match='no such bag'):
        shown(tmp_path / 'missing')
