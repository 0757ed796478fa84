"""The observer of motors sampled together: white box, context nodes and predictor."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from gray_box_observer.context_nodes import (
    ContextUpdate,
    Estimate,
    MeasuredSpeedUpdate,
    RotorGroup,
    RotorUpdate,
    VerdictSettings,
)
from gray_box_observer.context_nodes.pieces import completed
from gray_box_observer.context_nodes.rotor.speed_filter import SpeedEstimate, SpeedEstimates
from gray_box_observer.context_nodes.update_rule import learn_at_once
from gray_box_observer.delay import DelayEstimate, DelayRound, DelayWatch
from gray_box_observer.errors import CheckpointError, ConfigurationError
from gray_box_observer.fit_test import FitAssessment, FitVerdict
from gray_box_observer.observer.group_speeds import GroupSpeeds
from gray_box_observer.observer.group_tests import RotorGroupTests
from gray_box_observer.observer.motor_forms.form_choice import FormChoice
from gray_box_observer.observer.motor_forms.motor_form import MotorForm
from gray_box_observer.observer.parameter_belief import ParameterBelief
from gray_box_observer.observer.pending_tests import PendingTests
from gray_box_observer.observer.speed_tracking import SpeedTracking
from gray_box_observer.observer.stall_watch import StallWatch
from gray_box_observer.safe_io.saved_state import entry, flag, group
from gray_box_observer.samples import ReplayBuffer, Sample
from gray_box_observer.samples.raw_history import RawHistory
from gray_box_observer.samples.sample import passed_seconds
from gray_box_observer.settings.motor_configuration import MotorConfiguration
from gray_box_observer.white_box import MotorWhiteBox
from gray_box_observer.white_box.interface import Array

if TYPE_CHECKING:  # loaded where something is predicted
    from gray_box_observer.predictor import AlarmSettings, Forecasting, Prediction, ResidualAlarm


MOST_AT_ONCE = 2048
"""Newest samples that a rotor is learnt of anew, at once, where its delay was found."""


@dataclass(slots=True, eq=False)
class DeferredUpdate:
    """Work left over by a sample after its estimates; see :meth:`MotorObserver.run_deferred`.

    Attributes:
        sample: the sample.
        prediction: what had been predicted of it; None without predictor.
        theta, covariance, is_identified: what was believed before it was learnt.
        is_followed: whether the predictor has gone on from it.
        speed: of a motor with a rotor, at the sample; None where none may be believed.
        followed_speed: the same, believed or not: where a prediction may begin.
        speeds: of motors with rotors that are sampled together; None of all others.
        alarm: shape (motor,): whether the alarm on the prediction's residual stands after the
            sample; None: to be done.
    """

    sample: Sample
    prediction: Prediction | None
    theta: Array
    covariance: Array
    is_identified: NDArray[np.bool_]
    speed: SpeedEstimate | None = None
    followed_speed: SpeedEstimate | None = None
    speeds: SpeedEstimates | None = None
    is_followed: bool = False
    alarm: NDArray[np.bool_] | None = None


class MotorObserver:
    """White box, context nodes and predictor of motors that are sampled together.

    Whoever waits for a sample's prediction and estimates gets them first: alarm, scores and
    training follow when something of them is asked for (:attr:`forecasting`, :attr:`alarm`), with
    :meth:`run_deferred`, or before the next sample. What comes of it is the same whenever that is.

    Args:
        form: what the motors are observed by.
        form_choice: says which form their physics takes, and tries another one where that of one
            motor does not explain its data.

    Attributes:
        motors: how many they are.
        changed_motors: whose estimates the last sample has changed, by places on the motor axis.
    """

    def __init__(self, form: MotorForm, form_choice: FormChoice) -> None:
        self.form_choice = form_choice
        self._retests: dict[int, bool] = {}
        self._deferred_update: DeferredUpdate | None = None
        self._is_frozen = False
        self._stamp_ns = 0  # of the newest sample
        self._live_settings: tuple[VerdictSettings, AlarmSettings, float] | None = None
        self._intervals_s = np.full(1, np.nan), np.full(1, np.nan)  # of the last two samples
        self.motors = form.context_nodes.theta.shape[0]
        self._nobody = np.zeros(self.motors, dtype=bool)
        self.changed_motors: NDArray[np.intp] = _NOBODY
        self._use(form)

    def _use(self, form: MotorForm) -> None:
        """Observe the motors by a form from now on."""
        self.white_box = form.white_box
        self.context_nodes = nodes = form.context_nodes
        self.delay = form.delay
        self._fit = form.fit
        self._belief = ParameterBelief(form)
        tests_type = RotorGroupTests if isinstance(nodes, RotorGroup) else PendingTests
        self._tests = tests_type(
            self._belief, form.fit.schedule, form.delay, self._know, self._note_test
        )
        self._forecasting = form.make_forecasting()
        self._forecast_ahead: tuple[bytes, Prediction] | None = None
        self._voltage_path = form.voltage_path
        self._speed = self._new_speed_tracking()
        self._know(self._believed())

    def _new_speed_tracking(self) -> SpeedTracking | GroupSpeeds | None:
        """Return what follows the speed of motors with a rotor; None of others."""
        nodes = self.context_nodes
        if isinstance(nodes, RotorGroup):
            boxes = [self.white_box_of(motor) for motor in range(self.motors)]
            return GroupSpeeds(boxes, nodes)
        if not isinstance(nodes, RotorUpdate):
            return None
        is_late = self._voltage_path is not None and self._voltage_path.has_lag
        return SpeedTracking(self.white_box, nodes, is_late=is_late)

    def predict(self, interval_s: Array, voltage_v: Array) -> Prediction | None:
        """Forecast the torque at the end of an interval; changes nothing. Shapes (motor,)."""
        path = self._voltage_path
        if path is None:
            return self._predict(interval_s, voltage_v)
        known_interval_s = path.known_interval(interval_s, voltage_v)
        return self._predict(known_interval_s, path.voltage(interval_s, voltage_v))

    def _predict(self, interval_s: Array, voltage_v: Array) -> Prediction | None:
        """Forecast the torque after a voltage as the white box takes it; changes nothing."""
        if self._forecasting is None:
            return None
        if self._forecasting.training.due_next:
            self.run_deferred()
        self._follow()
        theta = self._belief.theta  # a fit or test may have changed it since the last sample
        request = interval_s.tobytes() + voltage_v.tobytes() + theta.tobytes()
        if self._forecast_ahead is None or self._forecast_ahead[0] != request:
            prediction = self._forecasting.predict(interval_s, voltage_v, theta)
            self._forecast_ahead = request, prediction
        return self._forecast_ahead[1]

    def precompute_forecast(self, voltage_v: Any) -> None:
        """Work out the next prediction while nobody waits for it; changes only its timing.

        What will be asked is known where samples come evenly: the interval is that of the last two
        once more. Where it is not, this does nothing.

        Args:
            voltage_v: voltage in force from the last sample on.
        """
        before_s, interval_s = self._intervals_s
        if np.array_equal(before_s, interval_s):
            self.predict(interval_s, np.atleast_1d(voltage_v))

    def forecast_held(
        self, ahead: tuple[Any, Any] | None, horizon_s: float, voltage_v: Any
    ) -> Array | None:
        """Forecast the torque after a voltage has been held for a while; changes nothing.

        Args:
            ahead: interval in s and mean voltage in V from the last sample to where the voltage
                begins to act; None where it begins with the last sample.
            horizon_s: how long it is held.
            voltage_v: the voltage.
        """
        if self.forecasting is None:
            return None
        held_v = np.full(self.motors, voltage_v)
        if self._voltage_path is not None and self._voltage_path.opens(held_v):
            return np.zeros(self.motors)  # no current flows
        before = None
        if ahead is not None:
            before = np.full(self.motors, ahead[0]), np.full(self.motors, ahead[1])
        since = None if before is None else self.predict(*before)
        if self._voltage_path is not None:
            held_s = np.full(self.motors, horizon_s)
            held_v = self._voltage_path.voltage_after(before, held_s, held_v)
        return self.forecasting.forecast(horizon_s, held_v, self._belief.theta, since)

    def step(self, sample: Sample) -> tuple[DeferredUpdate, Estimate | None]:
        """Predict the sample, then learn it.

        Returns:
            What is left to be done, the prediction among it, and, where they have changed, the
            estimates.
        """
        if self._deferred_update is not None or self._tests.is_waiting:
            self.run_deferred()
        self._tests.begin_sample(passed_seconds(self._stamp_ns, sample))
        self._stamp_ns = sample.stamp_ns
        sample = self._follow_path(sample)
        prediction = self._predict(sample.interval_s, sample.voltage_v)
        belief = self._belief
        update = DeferredUpdate(
            sample, prediction, belief.theta, belief.covariance, belief.is_identified
        )
        estimate = self.update_parameters(sample)
        if isinstance(self._speed, SpeedTracking):
            update.speed = self._speed.step(sample, self._belief.theta[0])
            update.followed_speed = self._speed.estimate
        elif self._speed is not None:
            update.speeds = self._speed.step(sample, self._belief.theta)
        if self._forecasting is None and self.form_choice.is_idle:
            update.alarm = self.alarmed  # nothing is left to be done
        else:
            self._deferred_update = update
        return update, estimate

    def run_deferred(self) -> None:
        """Do what the last sample has left, where that is still to be done.

        Its prediction is judged and learnt, and a test of the fit gets on by a piece.
        """
        self._tests.run()
        update = self._deferred_update
        if update is None:
            return
        self._judge_prediction(update)
        if not (self.form_choice.is_idle or self._is_frozen):
            self._try_other_form(update.sample)

    def _judge_prediction(self, update: DeferredUpdate) -> None:
        """Judge and learn the prediction of a sample."""
        self._follow()
        self._deferred_update = None
        sample = update.sample
        prediction = update.prediction
        forecasting = self._forecasting
        if forecasting is None or prediction is None:
            update.alarm = self.alarmed
            return
        if forecasting.alarm is not None:
            forecasting.alarm.update(
                sample.torque_nm - prediction.torque_nm, sample.interval_s, update.is_identified
            )
        update.alarm = self.alarmed
        forecasting.score_and_train(sample, prediction, update.theta, update.covariance)

    def _try_other_form(self, sample: Sample) -> None:
        """Go over to another form of the physics where the choice of the speed asks for it."""
        fit = self._fit.assessment(0)
        path = self._voltage_path
        form = self.form_choice.step(self.white_box, self.context_nodes, path, fit, sample)
        self._go_over(form)

    def finish(self) -> bool:
        """Do what is left of fits, tests and a trial of another form: no samples will come.

        Returns:
            Whether an estimate has changed.
        """
        self.run_deferred()
        has_changed = self._tests.end(is_out=True)
        if has_changed:
            self.changed_motors = _FIRST
        if self._is_frozen:
            return has_changed
        has_changed |= self._finish_fits()
        if self.form_choice.is_open:
            nodes = self.context_nodes
            fit = self._fit.assessment(0)
            self._go_over(self.form_choice.finish(nodes, fit, nodes.estimate().stamp_ns))
            if self.context_nodes is not nodes:
                has_changed = True
                self._finish_fits()
        return has_changed

    def _finish_fits(self) -> bool:
        """Do what is left of fits that go on piece by piece, and test what comes of them."""
        nodes = self.context_nodes
        changed_motors: list[int] = []
        if isinstance(nodes, RotorGroup):
            changed_motors = nodes.finish()
        elif isinstance(nodes, RotorUpdate | MeasuredSpeedUpdate):
            changed_motors = [0] if nodes.finish() else []
        for motor in changed_motors:
            self._know(self._tests.test(motor, is_out=True), slice(motor, motor + 1))
        tested_motors = self._tests.finish()
        changed_motors += [motor for motor in tested_motors if self._retests.get(motor)]
        if changed_motors:
            self.changed_motors = np.array(sorted({*changed_motors}))
        return bool(changed_motors)

    def _go_over(self, form: MotorForm | None) -> None:
        """Observe the motor by another form, where there is one."""
        if form is None:
            return
        self.close()
        if isinstance(form.delay, DelayWatch) and isinstance(self.delay, DelayWatch):
            form.delay.take_over(self.delay)
        self._use(form)
        self._retests[0] = True
        if self._live_settings is not None:
            self.reconfigure(*self._live_settings)

    def _follow(self) -> None:
        """Let the predictor go on from the last sample, where that is still to be done."""
        update = self._deferred_update
        if update is None or update.is_followed:
            return
        update.is_followed = True
        if self._forecasting is not None and update.prediction is not None:
            try:
                self._forecasting.predictor.advance(
                    update.sample, update.prediction, update.followed_speed
                )
            except (
                ConfigurationError
            ):  # what a device has failed at is not tried again: a checkpoint is to be kept
                self._deferred_update = None
                raise

    @property
    def forecasting(self) -> Forecasting | None:
        """Forecasts torque, all samples learnt; None where nothing does."""
        self.run_deferred()
        return self._forecasting

    @property
    def alarm(self) -> ResidualAlarm | None:
        """Watches the prediction's residual; None where no prediction is good enough."""
        forecasting = self.forecasting
        return None if forecasting is None else forecasting.alarm

    def learn_again(self, sample: Sample) -> Estimate | None:
        """Learn a sample that was predicted and scored before; return what has changed."""
        return self.update_parameters(self._follow_path(sample))

    def update_parameters(self, sample: Sample) -> Estimate | None:
        """Learn a predicted and scored sample; return the estimates that have changed.

        Args:
            sample: with the voltage that the white box takes.
        """
        self._tests.complete_due()  # of samples that are learnt again nothing else is deferred
        has_changed = self.context_nodes.learn(sample)
        if self._forecasting is not None:
            self._forecast_ahead = None
            self._intervals_s = self._intervals_s[1], sample.interval_s
        if self._speed is not None and not (has_changed and self.motors == 1):
            self._tests.schedule_newest()
        if not has_changed:
            self.changed_motors = _NOBODY
            return None
        self.changed_motors = (
            _FIRST if self.motors == 1 else np.flatnonzero(self.context_nodes.changed)
        )
        motors: Any = (
            slice(None) if self.changed_motors.size == self.motors else self.changed_motors
        )
        estimate = self.context_nodes.estimate(motors)
        self._tests.begin_estimate(estimate, self.changed_motors)
        estimate = self._fit.judged(self.context_nodes, estimate, self.changed_motors)
        return self._know(estimate, motors)

    def estimate(self, motors: Any = slice(None)) -> Estimate:
        """Return the present values of all or some motors, as far as fit and scales allow.

        Raises:
            ArithmeticError: they are not finite.
        """
        return self._belief.published(self._believed(motors), motors).checked()

    def _believed(self, motors: Any = slice(None)) -> Estimate:
        """Return the present values of all or some motors, believed as far as the fit allows."""
        self.run_deferred()
        return self._belief.present(motors)

    def retested(self) -> dict[int, bool]:
        """Return whose fit was tested since the last call, and whether their belief has changed.

        A belief that has not gone out yet does not count as changed.
        """
        self.run_deferred()
        retests, self._retests = self._retests, {}
        return dict(sorted(retests.items()))

    def _note_test(self, motor: int, has_news: bool) -> None:
        """Note that a motor was tested, for whoever publishes and for the choice of the form.

        Args:
            motor: its place on the motor axis.
            has_news: whether its belief is another than has gone out.
        """
        self.form_choice.wake()
        self._retests[motor] = self._retests.get(motor, False) or has_news

    def _know(
        self, estimate: Estimate, motors: Any = slice(None), *, follows_level: bool = True
    ) -> Estimate:
        """Keep the beliefs of all or some motors; return what is published of them."""
        belief = self._belief
        public_estimate = belief.keep(
            estimate, motors, is_frozen=self._is_frozen, follows_level=follows_level
        )
        if isinstance(self._speed, SpeedTracking):
            self._speed.believe(belief.theta[0], belief.covariance[0], self._fit.assessment(0))
        elif self._speed is not None:
            for motor in np.arange(self.motors)[motors].tolist():
                fit = self._fit.assessment(motor)
                self._speed.believe(motor, belief.theta[motor], belief.covariance[motor], fit)
        return public_estimate

    def freeze(self, is_frozen: bool) -> None:
        """Stop or resume learning of nodes and predictor; predictions and the alarm go on."""
        self.run_deferred()
        self._tests.end(is_out=True)
        self._is_frozen = is_frozen
        self.context_nodes.freeze(is_frozen)
        if self._forecasting is not None:
            self._forecasting.training.freeze(is_frozen)

    @property
    def identified(self) -> bool:
        """Whether every parameter was identified when learning last went on, before a freeze."""
        return bool(self._belief.known_flags.all())

    def identified_of(self, motor: int) -> bool:
        """The same of one motor."""
        return bool(self._belief.known_flags[motor].all())

    def parameters_identified_of(self, motor: int) -> tuple[bool, ...]:
        """The same of every parameter of one motor."""
        return tuple(self._belief.known_flags[motor].tolist())

    def speed_of(self, motor: int) -> SpeedEstimate | None:
        """Speed of one motor with a rotor at the newest sample; None where none may be believed."""
        if isinstance(self._speed, SpeedTracking):
            return self._speed.newest
        return None if self._speed is None else self._speed.speed_of(motor)

    def stall_of(self, motor: int) -> StallWatch | None:
        """Whether one rotor stands still though it is driven; None of a motor without rotor."""
        if isinstance(self._speed, SpeedTracking):
            return self._speed.stall
        return None if self._speed is None else self._speed.stall_of(motor)

    def late_counts(self, motor: int) -> dict[str, int]:
        """Return how many samples ago fit and test of a motor were due that wait for their turn.

        Empty of motors that are not in a group of rotors.
        """
        nodes = self.context_nodes
        if not isinstance(nodes, RotorGroup):
            return {}
        return {
            'samples since a fit was due': nodes.late_count(motor),
            'samples since a test was due': self._tests.late_count(motor),
        }

    def fit_of(self, motor: int) -> FitAssessment:
        """How well the white box explains the data of one motor."""
        self.run_deferred()
        return self._fit.assessment(motor)

    def configuration_of(self, motor: int) -> MotorConfiguration:
        """Return what is known of one motor beforehand, in the form that it has now."""
        return self._fit.configuration(motor)

    def delay_of(self, motor: int) -> DelayEstimate:
        """What is known of the delay of one motor."""
        return self.delay.estimate_of(motor)

    def watch_delay(self, history: RawHistory, stamp_ns: int, *, is_awaited: bool) -> float | None:
        """Go on with the question of the delay; see :meth:`DelayWatch.update`.

        Args:
            history: raw measurements of the motors.
            stamp_ns: of the newest sample.
            is_awaited: whether somebody waits for what that has led to.
        """
        delay = self.delay
        nodes = self.context_nodes
        if isinstance(delay, DelayRound):
            delay.update(history, stamp_ns, is_awaited=is_awaited)
            return None
        late_instant = None
        if isinstance(nodes, MeasuredSpeedUpdate) and nodes.is_noisy:
            late_instant = nodes.late_instant
        return delay.update(
            history,
            stamp_ns,
            is_awaited=is_awaited,
            late_instant=late_instant,
            is_misfit=self._fit.assessment(0).verdict is FitVerdict.MISFIT,
        )

    def reconfigure(
        self, verdicts: VerdictSettings, alarm: AlarmSettings, core_share: float
    ) -> None:
        """Take over settings that may change at any time; what was learnt stays."""
        self._live_settings = verdicts, alarm, core_share
        self.context_nodes.verdict_rules = verdicts
        self._know(self._believed())
        if self.alarm is not None:
            self.alarm.rules = alarm
        if self.forecasting is not None:
            self.forecasting.training.share(core_share)

    @property
    def alarmed(self) -> NDArray[np.bool_]:
        """For which of these motors the alarm stands, shape (motor,)."""
        alarm = None if self._forecasting is None else self._forecasting.alarm
        if alarm is None:
            return self._nobody
        self.run_deferred()
        return alarm.is_raised

    def relearn(self, context_nodes: ContextUpdate, samples: list[Sample]) -> None:
        """Restart with new context nodes from samples paired anew; the network trains on."""
        if not samples:
            return
        self.run_deferred()
        self._tests.give_up()
        samples = [self._follow_path(sample) for sample in samples]
        content = ReplayBuffer.from_samples(samples).content()
        if isinstance(context_nodes, RotorUpdate):
            if self._fit.assessment(0).verdict is not FitVerdict.MISFIT:
                context_nodes.begin_at(self._belief.theta)
            newest = content[:, :, -MOST_AT_ONCE:]
            completed(context_nodes.learn_remembered(newest, samples[-1].stamp_ns))
        else:
            learn_at_once(context_nodes, content, samples[-1])
        self.context_nodes = self._belief.context_nodes = context_nodes
        self.form_choice.begin_anew(context_nodes)
        self._speed = self._new_speed_tracking()
        forecasting = self._forecasting
        if forecasting is not None:
            forecasting.training.refill(content)
            if forecasting.alarm is not None:  # it has learnt residuals of the delay before
                forecasting.alarm.relearn()
        self._fit.forget()
        self._retests.update(dict.fromkeys(range(self.motors), True))
        self._know(self._believed())
        self._forecast_ahead = None

    def _follow_path(self, sample: Sample) -> Sample:
        """Go on by a sample; return it with the voltage that the white box takes."""
        if self._voltage_path is None:
            return sample
        return self._voltage_path.follow(sample, is_kept=not self._is_frozen)

    def white_box_of(self, motor: int) -> MotorWhiteBox:
        """Return the physics of one motor, its constants plain numbers."""
        if self.motors == 1:
            return self.white_box
        constants = {name: float(value[motor]) for name, value in self.white_box.known.items()}
        return replace(
            self.white_box,
            torque_constant=float(self.white_box.torque_constant[motor]),
            known=constants,
        )

    def state(self, motor: int = 0) -> tuple[dict[str, Any], dict[str, Array]]:
        """Everything learnt of one motor, as plain values and arrays, for a checkpoint."""
        self.run_deferred()
        plain, arrays = self.context_nodes.state(motor)
        network = {} if self._forecasting is None else self._forecasting.state(motor)
        place = int(self.context_nodes.replay.received[motor])
        speed, trial = self.form_choice.state(place)
        mechanics = self._belief.mechanics
        path, commands = ({}, {}) if self._voltage_path is None else self._voltage_path.state(motor)
        content = {
            'white_box': self.white_box_of(motor).to_dict(),
            'context_nodes': plain,
            **({'mechanics': list(mechanics)} if mechanics else {}),
            **({'voltage_path': path} if path else {}),
            'delay': self.delay.state(motor),
            'fit': self._fit.state(motor, place, self._tests.later_result()),
            'speed': speed,
            'identified': self.identified_of(motor),
            'identified_parameters': list(self.parameters_identified_of(motor)),
        }
        if self._belief.level is not None:
            content['level'] = self._belief.level.state(place)
        alarm = {} if self.alarm is None else self.alarm.state(motor)
        groups = {
            'nodes': arrays,
            'network': network,
            'alarm': alarm,
            'speed': trial,
            'voltage_path': commands,
        }
        return content, {
            f'{group}/{name}': array
            for group, part in groups.items()
            for name, array in part.items()
        }

    def close(self) -> None:
        """Stop training."""
        if self._forecasting is not None:
            self._forecasting.training.close()

    def restore(self, plain: dict[str, Any], arrays: dict[str, Array], motor: int = 0) -> None:
        """Take back what :meth:`state` gave, for one motor.

        Raises:
            ConfigurationError: it was learnt of other parameters, or by other rules.
            CheckpointError: it is no state that could have been learnt.
        """
        motor_slice = slice(motor, motor + 1)
        if plain.get('mechanics', []) != list(self._belief.mechanics):
            raise ConfigurationError(
                'the checkpoint was learnt with other parameters of the rotor among context_nodes'
            )
        flag(plain, 'identified')
        flags = entry(plain, 'identified_parameters')
        self._belief.check_flags(flags)
        self.context_nodes.restore(
            dict(group(plain, 'context_nodes')), _group(arrays, 'nodes'), motor
        )
        lag = self.form_choice.kind.lag
        count = len(self.white_box.parameters)
        if lag is not None and any(len(shift) != count for shift in lag.rivals):
            raise CheckpointError('speed.current_lag holds changes of other parameters')
        estimate = self.context_nodes.estimate(motor_slice)
        if not (np.isfinite(estimate.value).all() and np.isfinite(estimate.std).all()):
            raise CheckpointError('what is believed is no estimate: it is not finite')
        place = int(self.context_nodes.replay.received[motor])
        if self._belief.level is not None and 'level' in plain:
            self._belief.level.restore(group(plain, 'level'), place)
        path = self._voltage_path
        if path is not None and ('voltage_path' in plain or path.has_filter):
            replay = self.context_nodes.replay
            count = min(replay.stored(motor), replay.capacity)
            saved_path = group(plain, 'voltage_path')
            path.restore(saved_path, _group(arrays, 'voltage_path'), motor, count)
        later_result = self._fit.restore(dict(group(plain, 'fit')), motor, place)
        self._tests.restore(later_result, motor)
        if self._is_frozen:  # no estimate will follow
            self._tests.end(is_out=False)
        if 'speed' in plain:  # not in files of releases that knew no choice
            self.form_choice.restore(
                group(plain, 'speed'), _group(arrays, 'speed'), self.white_box, place
            )
        self._know(self._believed(motor_slice), motor_slice, follows_level='level' not in plain)
        if self._is_frozen:  # verdicts tell it no more
            self._belief.restore_flags(motor, plain['identified'], flags)
        if self.forecasting is not None:
            self.forecasting.restore(_group(arrays, 'network'), motor)
        alarm = _group(arrays, 'alarm')
        if self.alarm is not None and alarm:
            self.alarm.restore(alarm, motor)
        self.delay.restore(dict(group(plain, 'delay')), motor)
        self._forecast_ahead = None


_NOBODY = np.arange(0)
_FIRST = np.arange(1)


def _group(arrays: dict[str, Array], group: str) -> dict[str, Array]:
    """Take one group out of what :meth:`MotorObserver.state` named."""
    return {
        name.removeprefix(f'{group}/'): array
        for name, array in arrays.items()
        if name.startswith(f'{group}/')
    }
