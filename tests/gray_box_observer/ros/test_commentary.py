"""What the log tells while the node runs: once in five seconds at most, whatever happens."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from itertools import pairwise

import pytest
from rclpy.impl.rcutils_logger import RcutilsLogger

from gray_box_observer.observer.motor_view import MotorView
from gray_box_observer.observer.observer import Observer
from gray_box_observer.ros.observer.commentary import PERIOD_S, Commentary
from gray_box_observer.ros.observer.traffic import MotorTraffic, Traffic
from gray_box_observer.settings.configuration import Configuration

WHY = 'nobody publishes'


@dataclass
class Run:
    """A commentary on an observer of its own, by a clock that is set by hand.

    Attributes:
        said: what was told: time, whether it was a warning, line.
    """

    motors: list[str] = field(default_factory=lambda: ['motor'])
    speed_has_topic: bool = False
    now_s: float = 0.0
    said: list[tuple[float, bool, str]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.observer = Observer(
            Configuration.from_flat({'predictor': False, 'motors': self.motors})
        )
        self.commentary = Commentary(
            self.motors,
            lambda line: self.said.append((self.now_s, False, line)),
            lambda line: self.said.append((self.now_s, True, line)),
            lambda signals: f'{WHY} {", ".join(signals)}',
            speed_has_topic=self.speed_has_topic,
            clock=lambda: self.now_s,
        )
        self.commentary.listen()

    def second(
        self, used: Iterable[str] = (), heard: Iterable[str] = (), messages: int = 0, more: str = ''
    ) -> None:
        """Let a second go by in which samples and other messages came of these motors."""
        self.now_s += 1.0
        used = set(used)
        heard = set(heard)
        motors = {
            motor: MotorTraffic(
                int(motor in used),
                Counter(),
                {
                    signal: int(motor in used or (motor in heard and signal == more))
                    for signal in ('voltage', 'torque')
                },
                0,
            )
            for motor in self.motors
        }
        traffic = Traffic(1.0, motors, {'voltage': 1, 'torque': 1, 'speed': messages}, 0.0, 0.0)
        self.commentary.look(self.observer, traffic)

    @property
    def lines(self) -> list[str]:
        """What was said."""
        return [line for _, _, line in self.said]


@pytest.mark.slow
def test_a_motor_that_is_found_and_what_is_learnt_of_it_are_told(record):
    recording = record('R[5,15]D[0.1,1]', 30.0, torque_noise_relative=0.01)
    run = Run()
    for second in range(30):
        for k in range(100 * second, 100 * second + 100):
            stamp_ns = 10**9 + int(recording.stamp_ns[k])
            run.observer.voltage('motor', stamp_ns, float(recording.voltage_v[0, k]))
            run.observer.torque('motor', stamp_ns, float(recording.torque_nm[0, k]))
        run.second(['motor'])
    times = [time_s for time_s, _, _ in run.said]
    assert times[0] == 1.0
    assert all(later - earlier >= PERIOD_S for earlier, later in pairwise(times))
    assert run.lines[0].startswith('found motor: samples come')
    told = ' '.join(run.lines)
    for name, unit in {'inductance': 'H', 'resistance': 'ohm', 'hysteresis': 'V s/(rad A)'}.items():
        assert f' {unit} identified' in told[told.index(name) :]
    assert len(run.lines) < 5, 'a verdict that stands is not repeated'
    summary = run.commentary.summary(run.observer)
    assert summary.startswith(
        '3000 samples of motor in 30.0 s, none rejected; motor: inductance 0.'
    )
    assert summary.count('identified') == 3
    assert '\n' not in summary
    lossy = run.commentary.summary(run.observer, missing_count=12)
    assert lossy == summary.replace('none rejected', 'none rejected, about 12 never came')


def test_a_signal_that_is_missing_for_five_seconds_is_told_once_and_so_is_its_return():
    run = Run()
    for _ in range(20):
        run.second(heard=['motor'], more='torque')
    assert run.said == [(5.0, True, f'no voltage of motor for 5 s: {WHY} voltage')]
    for _ in range(20):
        run.second(['motor'])
    assert [line for line in run.lines[1:] if 'motor: samples' in line or 'again' in line] == [
        'found motor: samples come'
    ]
    for _ in range(20):
        run.second()
    assert run.said[-1] == (
        45.0,
        True,
        f'no voltage and no torque of motor for 5 s: {WHY} voltage, torque',
    )
    run.second(['motor'])
    assert run.lines[-1] == 'voltage and torque of motor come again'


def test_speed_of_a_topic_of_its_own_is_missed_too_and_nobody_misses_what_is_not_listened_to():
    run = Run(speed_has_topic=True)
    for _ in range(6):
        run.second(['motor'])
    assert run.lines[-1] == f'no speed for 6 s: {WHY} speed'
    run.commentary.listen()
    run.said.clear()
    for _ in range(20):
        run.second(['motor'], messages=1)
    assert run.said == []


def test_whatever_flickers_the_log_gets_a_line_in_five_seconds():
    run = Run([f'm{k}' for k in range(30)])
    for second in range(200):
        run.second(run.motors[: second % 31] if (second // 7) % 2 else [])
    times = [time_s for time_s, _, _ in run.said]
    assert len(times) > 10
    assert min(later - earlier for earlier, later in pairwise(times)) >= PERIOD_S


def test_of_many_motors_a_line_names_some():
    run = Run([f'm{k}' for k in range(30)])
    run.second(run.motors)
    assert run.lines == ['found m0, m1, m2, m3, m4, m5, m6, m7, m8, m9 and 20 more: samples come']


def test_an_observer_that_begins_anew_finds_its_motors_anew():
    run = Run()
    run.second(['motor'])
    run.commentary.forget()
    for _ in range(6):
        run.second(['motor'])
    assert run.lines == ['found motor: samples come'] * 2


def test_a_logger_of_rclpy_takes_lines_and_warnings_of_the_same_commentary():
    logger = RcutilsLogger('commentary')
    tell: Callable[[str], object] = logger.info
    commentary = Commentary(
        ['motor'], tell, logger.warning, lambda _: '', clock=iter(range(0, 1000, 10)).__next__
    )
    observer = Observer(Configuration.from_flat({'predictor': False}))
    commentary.listen()
    for used in (1, 0, 0, 1, 0, 0):
        motors = {'motor': MotorTraffic(used, Counter(), {'voltage': used, 'torque': used}, 0)}
        commentary.look(observer, Traffic(1.0, motors, {}, 0.0, 0.0))


def test_a_defect_that_shows_while_choices_are_told_stops_its_motor_and_the_rest_is_told(
    monkeypatch,
):
    run = Run(['left', 'right'])
    for k in range(300):
        for name in ('left', 'right'):
            run.observer.voltage(name, k * 10_000_000, 5.0 + k // 7 % 3)
            run.observer.torque(name, k * 10_000_000, 0.01)
    broken = run.observer.motors['right'].observer
    real = MotorView.effects_reason
    monkeypatch.setattr(MotorView, 'added_effects', ('brush_drop',))

    def reason(self):
        if self.observer is broken:
            raise OverflowError('too large')
        return real.fget(self)

    monkeypatch.setattr(MotorView, 'effects_reason', property(reason))
    run.second(used=['left', 'right'])
    assert list(run.observer.incidents) == ['right']
    assert 'left: brush_drop added' in run.said[-1][2]
    assert 'right: brush_drop' not in run.said[-1][2]
