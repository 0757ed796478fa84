"""Pairing voltage and torque of one motor by stamp, whatever order their messages come in.

A voltage sample holds from its stamp to the stamp of the next one; a torque sample is the torque at
its stamp. A torque sample is therefore complete as soon as the voltage is known up to its stamp,
that is when a voltage stamped at or after it has come, or when so much torque has come since that
waiting makes no sense. The rule looks at stamps only, never at the wall clock, so that live topics
and a replayed bag make the same samples.

A voltage that is old while torque comes was not changed. But where both signals were silent far
longer than is their habit, or the voltage, which always came regularly, is overdue, nobody knows
what it did (:mod:`held_voltage`): the history begins anew with the next voltage, and torque before
that is refused. Where some samples of a periodic voltage were lost, and it came back far from where
it was, the history begins anew with every torque of that time.

Where voltage is known to act on torque later than it is stamped, its stamps are shifted by that
delay as they come in: all that follows sees signals that belong together.

Values are plain floats for one motor and arrays of shape (motor,) for a group that comes in the
same messages; stamps are shared. What stamps decide is decided here, what values decide in
:mod:`joining`.
"""

from __future__ import annotations

import math
from collections import Counter, deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gray_box_observer.samples.counts import PairingCounts, RefusalCounts
from gray_box_observer.samples.held_voltage import HeldVoltage
from gray_box_observer.samples.joining import Joining, ManyMotors, OneMotor
from gray_box_observer.samples.own_speed import OwnSpeed
from gray_box_observer.samples.raw_history import SLACK, RawHistory
from gray_box_observer.samples.rejection import Rejection
from gray_box_observer.samples.rhythm import Rhythm
from gray_box_observer.samples.sample import Sample, nanoseconds, seconds

PATIENCE_NS = 5_000_000_000
"""How far torque may run ahead of a voltage that has always come, or of the first one.

A reader that was busy finds the messages of one topic behind those of the other, and at the start
it may hear of one publisher later. Without the voltage torque would be refused.
"""

MOST_PATIENT = SLACK
"""Torques that may wait so: the raw history allows for as many in another order, and by default the
queue of a topic holds no more."""


@dataclass(frozen=True, slots=True)
class PairingSettings:
    """How patient pairing is.

    Attributes:
        gap_s: a longer silence of torque starts the signal history anew; it never becomes a
            derivative.
        hold_s: how far torque may run ahead of voltage before the last voltage is taken to hold on;
            further, up to PATIENCE_NS, where the voltage has always come or none has come yet.
        jump_back_s: a stamp that is earlier than the newest by more than this means that the clock
            was set back or a bag began again (the signal history restarts); by less, that the
            message was merely out of order.
    """

    gap_s: float = 0.5
    hold_s: float = 0.25
    jump_back_s: float = 1.0


class Pairing:
    """Turns stamped voltages and torques into samples, counting what cannot be used.

    Everything that comes in is used or counted under its reason. Of torque, ``received = used +
    refused + waiting``; of voltage, ``received = taken + refused``. Of a group :meth:`counts_for`
    tells what became of each motor's.

    Args:
        rules: how patient it is.
        motors: how many come together.
        own_speed: whether speed comes as a signal of its own; it is joined by stamp too, linear
            between its samples.
        uses_speed: whether the motor is observed with the speed that its first sample brings, if it
            brings one.
        needs_speed: whether nothing can be learnt of the motor without speed.
        delay_s: voltage acts that much later than its stamp says; negative where its stamp comes
            late.
        tells_moves: whether samples tell how the voltage moves within their interval.

    Attributes:
        history: what came in and was taken, to be paired anew.
        held_count: samples completed by patience running out, their voltage held on; many of them
            mean late voltages.
        refusal_counts: what could not be used of a single motor, by signal and reason; of one of a
            group see :meth:`counts_for`.
        taken_voltage: voltages that have come into force, or will.
        needs_speed: whether a torque sample without speed is refused; None until the first sample
            has settled it.
        take: what takes a signal, by its name: :meth:`voltage`, :meth:`torque`, :meth:`speed`.
    """

    def __init__(
        self, rules: PairingSettings | None = None, motors: int = 1, *, own_speed: bool = False,
        uses_speed: bool = True, needs_speed: bool = False, delay_s: float = 0.0,
        tells_moves: bool = True,
    ) -> None:  # fmt: skip
        self.motors = motors
        self._tells_moves = tells_moves
        self._own_speed = own_speed
        self._uses_speed = uses_speed
        self._always_needs_speed = own_speed or needs_speed
        self.needs_speed: bool | None = True if self._always_needs_speed else None
        self._delay_ns = 0
        self.reconfigure(rules or PairingSettings())
        self.refusal_counts: RefusalCounts = {
            signal: Counter() for signal in ('voltage', 'torque', 'speed')
        }
        self._joining: Joining = (
            OneMotor(self.refusal_counts) if motors == 1 else ManyMotors(motors)
        )
        self.received_torque = 0
        self.received_voltage = 0
        self.taken_voltage = 0
        self.used_count = 0
        self.restarts = 0
        self.held_count = 0
        self.history = RawHistory(motors)
        self._speeds = OwnSpeed()
        self._learn_habits()
        self.ingest_signal: dict[str, Callable[..., list[Sample]]] = {
            'voltage': self.voltage,
            'torque': self.torque,
            'speed': self.speed,
        }
        self._set_delay(delay_s)
        self._restart()

    def reconfigure(self, rules: PairingSettings) -> None:
        """Be as patient as other rules say, from the next message on."""
        self._rules = rules
        self._gap_ns = round(rules.gap_s * 1e9)
        self._jump_ns = round(rules.jump_back_s * 1e9)
        # a voltage that is stamped late comes late, and torque has to wait for it that much longer
        late_ns = max(0, -self._delay_ns)
        self._hold_ns = round(rules.hold_s * 1e9) + late_ns
        self._patience_ns = max(self._hold_ns, PATIENCE_NS + late_ns)

    def _set_delay(self, delay_s: float) -> None:
        self._delay_ns = nanoseconds(delay_s)
        self.reconfigure(self._rules)

    def _learn_habits(self) -> None:
        """Know nothing of how regularly the signals come."""
        self._voltages = HeldVoltage(self._joining.blank)
        self._torque_rhythm = Rhythm()

    def _restart(self) -> None:
        self._repeated_until_ns: int | None = None
        self._is_patient = True
        self._awaits_first_speed = True
        self._voltages.restart()
        self._torques: deque[tuple[int, Any, Any]] = deque()
        self._speeds.restart()
        self._joining.restart()
        self._newest_torque_ns: int | None = None
        self._previous_ns: int | None = None

    @property
    def delay_ns(self) -> int:
        """By how much voltage is taken to act later than it is stamped."""
        return self._delay_ns

    @property
    def rejected(self) -> Counter[Rejection]:
        """What could not be used of a single motor, by reason, whatever signal it was of."""
        return sum(self.refusal_counts.values(), Counter())

    @property
    def waiting_count(self) -> int:
        """Number of torque samples that wait for their voltage."""
        return len(self._torques)

    def restart(self, delay_s: float | None = None) -> list[Sample]:
        """Begin a new signal history (clock set back); complete and return what waited.

        Args:
            delay_s: by how much voltage acts later from now on; None: as before.
        """
        last_samples = self.flush()
        if delay_s is not None:
            self._set_delay(delay_s)
        self._restart()
        self.history.restart()
        self.restarts += 1
        return last_samples

    def redelay(self, delay_s: float, until_ns: int) -> tuple[list[Sample], list[Sample]]:
        """Pair everything remembered anew under another delay.

        It has been counted, so counts stay as they are; a torque that waited and is now complete is
        used.

        Args:
            delay_s: the delay from now on.
            until_ns: stamp of the last sample that was learnt.

        Returns:
            The samples that are complete by now whatever came first, voltage or torque, and those
            beyond. Among the latter, and among what the next messages complete, some are repeated;
            see :meth:`repeats`.
        """
        certain_ns = until_ns + min(0, nanoseconds(delay_s) - self._delay_ns)
        events = list(self.history.events(nanoseconds(delay_s)))
        counts = self.counts_for(0)
        waiting_before = self.waiting_count
        self._set_delay(delay_s)
        self._learn_habits()
        self._restart()
        self.history.clear()
        samples: list[Sample] = []
        for signal, stamp_ns, values in events:
            samples += self.ingest_signal[signal](stamp_ns, *values)
        self.count_as([counts])
        self.used_count += waiting_before - self.waiting_count
        self._repeated_until_ns = until_ns
        certain = [sample for sample in samples if sample.stamp_ns <= certain_ns]
        return certain, samples[len(certain) :]

    def part(self, motors: Sequence[int]) -> Pairing:
        """Return the pairing of some motors of a group that has made no sample yet.

        What came is gone through again without the others; what was counted of these motors stays
        counted.
        """
        delay_s = seconds(self._delay_ns)
        pairing = Pairing(
            self._rules,
            len(motors),
            own_speed=self._own_speed,
            uses_speed=self._uses_speed,
            needs_speed=self._always_needs_speed,
            delay_s=delay_s,
            tells_moves=self._tells_moves,
        )
        index = motors[0] if len(motors) == 1 else list(motors)
        for signal, stamp_ns, values in self.history.events(self._delay_ns):
            own_values: list[Any] = [
                np.asarray(value)[index] if np.ndim(value) else value for value in values
            ]
            pairing.ingest_signal[signal](stamp_ns, *own_values)
        still_waiting = {stamp_ns for stamp_ns, _, _ in self._torques}  # others were refused
        pairing._torques = deque(one for one in pairing._torques if one[0] in still_waiting)
        pairing.count_as([self.counts_for(motor) for motor in motors])
        return pairing

    def count_as(self, counts: Sequence[PairingCounts]) -> None:
        """Count on from what had become of every motor's messages."""
        self.received_torque = max(of.received_torque for of in counts)
        self.received_voltage = max(of.received_voltage for of in counts)
        self.taken_voltage = max(of.taken_voltage for of in counts)
        self.used_count = max(of.used_count for of in counts)
        self.restarts = counts[0].restarts
        self.held_count = counts[0].held_count
        self._joining.count_as(counts)

    def repeats(self, sample: Sample) -> bool:
        """Whether a sample was given out before, paired under another delay."""
        return self._repeated_until_ns is not None and sample.stamp_ns <= self._repeated_until_ns

    def voltage(
        self, stamp_ns: int, voltage_v: Any, absent: NDArray[np.bool_] | None = None
    ) -> list[Sample]:
        """Take one voltage sample in V; return the samples it completes, oldest first.

        Args:
            stamp_ns: its stamp.
            voltage_v: the voltage; of a group an array of shape (motor,).
            absent: which motors of the group the message does not speak of; None: none.
        """
        self.received_voltage += 1
        voltage_v = self._joining.voltage(voltage_v, absent)
        if voltage_v is None:
            return []
        raw_ns, stamp_ns = stamp_ns, stamp_ns + self._delay_ns
        samples = self._order('voltage', stamp_ns, self._voltages.newest_ns, voltage_v)
        if samples is None:
            return []
        self.taken_voltage += 1
        self._is_patient = True
        self.history.voltage(raw_ns, voltage_v)
        filled_v = self._joining.filled(stamp_ns, voltage_v, self._voltages)
        is_missing = None if filled_v is voltage_v else np.isnan(voltage_v)
        self._voltages.update(stamp_ns, filled_v, is_missing)
        return samples + self._complete(self._known_ns()) if self._torques else samples

    def speed(self, stamp_ns: int, speed_rad_s: float) -> list[Sample]:
        """Take one sample of a separate speed signal, rad/s; return the completed samples."""
        if not self._joining.usable('speed', speed_rad_s):
            return []
        samples = self._order('speed', stamp_ns, self._speeds.newest_ns, speed_rad_s)
        if samples is None:
            return []
        self.history.speed(stamp_ns, speed_rad_s)
        self._speeds.update(stamp_ns, speed_rad_s)
        return samples + self._complete(self._known_ns())

    def torque(
        self,
        stamp_ns: int,
        torque_nm: Any,
        speed_rad_s: Any = math.nan,
        absent: NDArray[np.bool_] | None = None,
    ) -> list[Sample]:
        """Take one torque sample (N m), with speed (rad/s) if measured; return the completed ones.

        The arguments are as in :meth:`voltage`.
        """
        self.received_torque += 1
        torque_nm = self._joining.torque(torque_nm, speed_rad_s, absent)
        if torque_nm is None:
            return []
        samples = self._order('torque', stamp_ns, self._newest_torque_ns, torque_nm)
        if samples is None:
            return []
        self.history.torque(stamp_ns, torque_nm, speed_rad_s)
        if self._newest_torque_ns is not None:
            self._torque_rhythm.update(seconds(stamp_ns - self._newest_torque_ns))
        self._newest_torque_ns = stamp_ns
        self._torques.append((stamp_ns, torque_nm, speed_rad_s))
        samples += self._complete(self._known_ns())
        if self._torques:
            held_samples = self._complete(stamp_ns - self._hold_limit_ns(stamp_ns))
            self.held_count += len(held_samples)
            samples += held_samples
        return samples

    def _hold_limit_ns(self, stamp_ns: int) -> int:
        """Return how far torque may run ahead of what it waits for; its newest stamp is given."""
        oldest_ns = self._torques[0][0]
        voltage_ns = self._voltages.newest_ns
        awaits_speed = self._own_speed and self._speeds.newest_ns is None
        if voltage_ns is None:  # without it torque is lost in any case
            is_awaited = self._is_patient
        elif awaits_speed:  # so it is without that
            is_awaited = self._awaits_first_speed
        else:
            is_late = voltage_ns < oldest_ns and self._voltages.is_regular
            is_awaited = self._is_patient and is_late
        if not is_awaited:
            return self._hold_ns
        if stamp_ns - oldest_ns < self._patience_ns and len(self._torques) <= MOST_PATIENT:
            return self._patience_ns
        if voltage_ns is not None and awaits_speed:
            self._awaits_first_speed = False  # it does not come: waiting on would only be late
        else:
            self._is_patient = False  # nor does this
        return self._hold_ns

    def _known_ns(self) -> int | None:
        """Up to where every signal that belongs to torque is known; None: nowhere."""
        known_ns = self._voltages.newest_ns
        speed_ns = self._speeds.newest_ns
        if known_ns is None or not self._own_speed:
            return known_ns
        return None if speed_ns is None else min(known_ns, speed_ns)

    @property
    def newest_voltage(self) -> tuple[int, Any] | None:
        """Instant in ns from which the newest voltage acts, and that voltage in V, or None."""
        newest_ns = self._voltages.newest_ns
        return (
            None
            if newest_ns is None or not self._voltages.is_known
            else (newest_ns, self._voltages.newest_v)
        )

    @property
    def newest_sample_ns(self) -> int | None:
        """Stamp of the last sample of the signal history; None before the first."""
        return self._previous_ns

    def ahead(self, stamp_ns: int) -> tuple[Any, Any] | None:
        """Return interval in s and mean voltage in V from the last sample to a stamp to come.

        None where torque before that stamp still waits, where the voltage is not known up to it
        (with a negative delay it comes too late), or where no signal history leads there.
        """
        start_ns = self._previous_ns
        known_ns = self._voltages.newest_ns
        if (
            start_ns is None
            or known_ns is None
            or not start_ns < stamp_ns <= known_ns
            or self._torques
        ):
            return None
        voltages = self._voltages
        if not voltages.known_at(start_ns) or stamp_ns - start_ns > self._gap_ns:
            return None
        if voltages.unknown_until_ns(start_ns, stamp_ns, self._torque_rhythm) is not None:
            return None
        mean_v = voltages.mean(start_ns, stamp_ns)
        if self.motors == 1 and math.isnan(mean_v):  # of a group each is looked at by itself
            return None
        return self._joining.ahead(stamp_ns - start_ns, mean_v, self._gap_ns)

    def counts_for(self, motor: int) -> PairingCounts:
        """Return what became of one motor's messages."""
        missed_counts = self._joining.missed_counts(motor)
        lost_count = self._joining.lost_count(motor)
        received_voltage = self.received_voltage - missed_counts['voltage']
        refusal_counts = self._joining.refusal_counts(motor)
        return PairingCounts(
            refusal_counts=refusal_counts,
            received_torque=self.received_torque - missed_counts['torque'],
            received_voltage=received_voltage,
            taken_voltage=received_voltage - refusal_counts['voltage'].total(),
            used_count=self.used_count - lost_count,
            waiting_count=self._joining.count_known([one[1] for one in self._torques], motor),
            restarts=self.restarts,
            held_count=self.held_count,
            delay_ns=self._delay_ns,
        )

    def flush(self) -> list[Sample]:
        """Complete every waiting torque sample with the last voltage (end of a bag)."""
        return self._complete(self._newest_torque_ns)

    def _order(
        self, signal: str, stamp_ns: int, newest_ns: int | None, values: Any
    ) -> list[Sample] | None:
        """Judge a stamp: None if refused, else the samples that a restart has completed."""
        if newest_ns is None or stamp_ns > newest_ns:
            return []
        if newest_ns - stamp_ns > self._jump_ns:
            return self.restart()
        reason = Rejection.DUPLICATE if stamp_ns == newest_ns else Rejection.OUT_OF_ORDER
        self._joining.refuse(signal, reason, values)
        return None

    def _complete(self, known_until_ns: int | None) -> list[Sample]:
        samples: list[Sample] = []
        if known_until_ns is None:
            return samples
        torques = self._torques
        while torques and torques[0][0] <= known_until_ns:
            sample = self._pair(*torques.popleft())
            if sample is not None:
                samples.append(sample)
                self.used_count += 1
                if self.needs_speed is None:  # before the next of those that waited together
                    self.needs_speed = self._uses_speed and bool(
                        np.isfinite(sample.speed_rad_s).any()
                    )
        return samples

    def _pair(self, stamp_ns: int, torque_nm: Any, speed_rad_s: Any) -> Sample | None:
        """Join a torque sample with the voltage held since the previous one, and the speed."""
        if self._own_speed:
            speed_rad_s = self._speeds.at(stamp_ns, self._gap_ns)
        if self.needs_speed:
            torque_nm = self._joining.with_speed(torque_nm, speed_rad_s)
            if torque_nm is None:
                return None
        start_ns = self._previous_ns
        known_ns = None
        passed_ns = None
        mean_v = self._joining.blank
        moment_v: Any = 0.0 if self._tells_moves else None
        if start_ns is not None:
            known_ns = self._voltages.unknown_until_ns(start_ns, stamp_ns, self._torque_rhythm)
            if known_ns is None and stamp_ns - start_ns <= self._gap_ns:
                passed_ns = stamp_ns - start_ns
                mean_v = self._voltages.mean(start_ns, stamp_ns)
                if self._tells_moves:
                    moment_v = self._voltages.moment(start_ns, stamp_ns)
        first_v = self._voltages.step_to(
            stamp_ns, is_lost=known_ns is not None and known_ns >= stamp_ns
        )
        sample = self._joining.join(
            stamp_ns, passed_ns, mean_v, first_v, torque_nm, speed_rad_s, self._gap_ns, moment_v
        )
        if sample is not None or passed_ns is not None:
            self._previous_ns = stamp_ns
        return sample
