"""What whoever looks at the observer's log alone learns of it."""

from __future__ import annotations

import re
from itertools import pairwise

import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from lifecycle_msgs.msg import Transition
from std_srvs.srv import SetBool, Trigger

pytestmark = pytest.mark.system

EXCITATION = 'R[5,15]D[0.1,1]'
LINE = re.compile(
    r'\[(?P<level>INFO|WARN|ERROR)\] \[(?P<time_s>[0-9.]+)\] \[gray_box_observer\]: (?P<text>.*)'
)


def said_until(rig, words: str) -> list[re.Match]:
    """Lines of the log up to the first with these words."""
    lines: list[re.Match] = []
    while not lines or words not in lines[-1]['text']:
        line = rig.process.stderr.readline()
        assert line, f'the end of the log before {words!r}: {[found["text"] for found in lines]}'
        lines += [found] if (found := LINE.match(line)) else []
    return lines


def test_a_missing_signal_a_motor_that_is_found_its_verdicts_and_the_end_are_told(rig, record):
    recording = record(EXCITATION, 20.0, torque_noise_relative=0.01)
    rig.start()
    lines = said_until(rig, 'no voltage and no torque of motor for ')
    assert (
        'nobody publishes /motor/voltage: start its driver, or set voltage.topic'
        in lines[-1]['text']
    )
    assert lines[-1]['level'] == 'WARN'
    rig.send(recording, range(1500))
    rig.wait_for(samples_used=1500)
    lines += said_until(rig, 'found motor: samples come')
    code, _, rest = rig.peer.end(rig.process)
    lines += [found for line in rest.splitlines() if (found := LINE.match(line))]
    assert code == 0
    told = [
        line for line in lines if re.match(r'no voltage|found|motor: |voltage|torque', line['text'])
    ]
    times = [float(line['time_s']) for line in told]
    assert all(later - earlier > 4.9 for earlier, later in pairwise(times))
    assert 'resistance' in ' '.join(line['text'] for line in told)
    (summary,) = [
        line['text'] for line in lines if line['text'].startswith('1500 samples of motor in ')
    ]
    assert re.search(
        r'none rejected; motor: inductance 0\.\d+ \+- \S+ H identified, resistance ', summary
    )
    assert lines[-1]['text'] == summary


def test_services_and_transitions_are_told(rig, record, tmp_path):
    path = tmp_path / 'learnt.safetensors'
    rig.start(checkpoint__path=path)
    rig.send(record(EXCITATION, 2.0), range(100))
    rig.wait_for(samples_used=100)
    for frozen in (True, False):
        assert rig.call(SetBool, 'freeze', data=frozen).success
    assert not rig.call(Trigger, 'load').success
    for service in ('save', 'load', 'reset'):
        assert rig.call(Trigger, service).success
    for transition in (
        Transition.TRANSITION_DEACTIVATE,
        Transition.TRANSITION_CLEANUP,
        Transition.TRANSITION_CONFIGURE,
        Transition.TRANSITION_ACTIVATE,
        Transition.TRANSITION_ACTIVE_SHUTDOWN,
    ):
        assert rig.change(transition)
    code, _, said = rig.peer.end(rig.process)
    assert code == 0
    texts = [found['text'] for line in said.splitlines() if (found := LINE.match(line))]
    wanted = [
        'active: listening for motor on /motor/voltage, /motor/torque',
        'frozen: nothing is learnt',
        'learning again',
        'not loaded: ',
        f'saved to {path}',
        f'loaded from {path}',
        '~/reset: everything learnt is forgotten; starting from the initial values',
        'inactive: listening no more; what was learnt stays',
        'unconfigured: what was learnt is forgotten',
        'active: listening for motor',
        '0 samples of motor in ',
        'finalized: the end',
    ]
    for words in wanted:
        assert any(text.startswith(words) for text in texts), (words, texts)
        del texts[: next(k for k, text in enumerate(texts) if text.startswith(words)) + 1]


def test_two_observers_of_one_name_are_told(rig, make_rig):
    words = 'another node is called /gray_box_observer too: '
    rig.start()
    said_until(rig, 'active: listening')
    second = make_rig()
    second.start()
    for one in (rig, second):
        assert said_until(one, words)[-1]['level'] == 'WARN'
    rig.wait_for_level(DiagnosticStatus.WARN, words)
    rig.peer.end(second.process)
    rig.wait_for_level(DiagnosticStatus.STALE, 'nothing received for this motor')
