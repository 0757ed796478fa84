"""The free run of a motor with a rotor: its derivatives, its two implementations, and the plant."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import numpy as np
import pytest

from dc_motor_sim.plant import PlantParameters
from dc_motor_sim.simulation import Simulation
from gray_box_observer.context_nodes.native import whole_motor
from gray_box_observer.context_nodes.rotor import held_state, rotor_trajectory
from gray_box_observer.context_nodes.rotor.coordinates import WholeMotor, coordinates, slopes
from gray_box_observer.context_nodes.rotor.rotor_trajectory import (
    OneInterval,
    Run,
    by_knot,
    run,
    state_response,
)
from gray_box_observer.context_nodes.rotor.straight_motion import StraightMotion
from gray_box_observer.white_box import MotorWhiteBox, forms
from gray_box_observer.white_box.declaration import TERMS
from gray_box_observer.white_box.flow import rate

NODES = ('inductance', 'resistance', 'inertia', 'viscous_friction', 'coulomb_friction')
KT = KB = 0.02
THETA = np.array([4e-3, 2.0, 1e-5, 1e-5, 8.4e-3])
LIMITS = np.array([1e3, 1e6])
BOX = MotorWhiteBox(NODES, KT, {'back_emf_constant': KB})


def steps(count: int, seed: int = 0, hold: int = 80) -> np.ndarray:
    """Voltages that are held for a while each."""
    rng = np.random.default_rng(seed)
    return np.repeat(rng.uniform(-12.0, 12.0, count // hold + 1), hold)[:count]


def free_run(
    theta: np.ndarray, volts: np.ndarray, interval_s: float = 1e-3, **options: bool
) -> Run:
    p = coordinates(BOX, theta)
    start = np.array([0.1, 3.0])
    return run(KT, p, start, volts, np.full(volts.size, interval_s), LIMITS, **options)


def differentiated(
    p: np.ndarray,
    start: np.ndarray,
    volts: np.ndarray,
    interval_s: np.ndarray,
    place: int,
    *,
    is_compiled: bool,
) -> tuple[Run, np.ndarray]:
    """Return a run, and the differences of its states by a coordinate, shape (k + 1, state)."""

    def ends(bump: float) -> Run:
        moved = p.copy()
        moved[place] += bump
        return run(KT, moved, start, volts, interval_s, LIMITS, is_compiled=is_compiled)

    bump = 1e-4 * max(abs(p[place]), 1.0)
    return ends(0.0), (ends(bump).states - ends(-bump).states) / (2.0 * bump)


def test_where_there_is_a_compiler_there_is_a_compiled_trajectory() -> None:
    if shutil.which('cc') is None and shutil.which('gcc') is None:
        pytest.skip('no C compiler')
    assert whole_motor.library() is not None, 'ros_ws/setup.sh builds it'


def test_what_was_compiled_of_another_motor_is_not_used(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(forms, 'WHOLE_MOTOR_FINGERPRINT', 1)
    whole_motor.library.cache_clear()
    assert whole_motor.library() is None
    whole_motor.library.cache_clear()


@pytest.mark.slow
@pytest.mark.parametrize('interval_s', [1e-3, 1e-2, 0.3])
def test_compiled_code_and_python_give_the_same(interval_s: float) -> None:
    if whole_motor.library() is None:
        pytest.skip('no compiled code')
    volts = steps(160, hold=20)[: 30 if interval_s > 0.1 else 160]
    fast = free_run(THETA, volts, interval_s)
    slow = free_run(THETA, volts, interval_s, is_compiled=False)
    assert fast.is_bounded
    assert slow.is_bounded
    assert fast.steps == slow.steps
    # a rotor that changes its direction makes much of rounding
    np.testing.assert_allclose(fast.states, slow.states, rtol=1e-9, atol=1e-10)
    np.testing.assert_allclose(fast.transitions, slow.transitions, rtol=1e-9, atol=1e-10)
    scale = np.abs(slow.slopes).max(axis=0)
    assert (np.abs(fast.slopes - slow.slopes).max(axis=0) <= 1e-9 * scale).all()


@pytest.mark.slow
@pytest.mark.parametrize('compiled', [True, False])
def test_a_run_that_takes_too_many_steps_is_given_up(compiled: bool) -> None:
    p = coordinates(MotorWhiteBox(NODES, KT, {'back_emf_constant': KB, 'hysteresis': 0.5}), THETA)
    volts = steps(160, hold=20)
    for interval_s, is_bounded in ((1e-3, True), (0.3, False)):
        followed = run(
            KT, p, np.zeros(2), volts, np.full(160, interval_s), LIMITS, is_compiled=compiled
        )
        assert followed.is_bounded == is_bounded


@pytest.mark.parametrize('interval_s', [1e-3, 1e-2])
def test_few_steps_are_as_good_as_many(interval_s: float, monkeypatch: pytest.MonkeyPatch) -> None:
    volts = steps(240, hold=20)
    once = free_run(THETA, volts, interval_s)
    assert once.steps < 12 * volts.size
    finely = np.repeat(volts, 100)
    monkeypatch.setattr(rotor_trajectory, 'LARGEST_STEP', 0.05)
    exact = free_run(THETA, finely, interval_s / 100.0).states[::100]
    assert (np.abs(once.states - exact) <= 1e-3 * np.abs(exact).max(axis=0)).all()


@pytest.mark.parametrize('compiled', [True, False])
@pytest.mark.parametrize('place', [*range(2), 3, *range(5, 9)])
def test_derivatives_of_straight_motions_are_finite_differences(place: int, compiled: bool) -> None:
    volts = np.linspace(6.0, 9.0, 8)
    interval = np.full(8, 1e-2)
    p = coordinates(BOX, THETA)
    start = np.array([1.0, 200.0])

    path, by_difference = differentiated(p, start, volts, interval, place, is_compiled=compiled)
    slope = path.slopes[:, :, 2 + place]
    assert path.steps == 2 * volts.size
    scale = np.abs(by_difference).max(axis=0)
    assert (np.abs(slope - by_difference) <= 1e-5 * scale).all()


HELD_THETA = np.array([4e-3, 2.0, 1e-5, 1e-5, 0.2])
"""Dry friction that up to 10 A do not overcome; a voltage of 12 V drives 6 A."""


def test_compiled_code_and_python_hold_a_rotor_by_the_same_rules() -> None:
    header = Path(held_state.__file__).parents[1] / 'native' / 'held_state.h'
    text = header.read_text()
    constants = dict(re.findall(r'#define (\w+) ([\d.e-]+)', text))
    constants |= dict(re.findall(r'enum \{ (\w+) = (\d+) \}', text))
    assert constants
    assert {name: getattr(held_state, name) for name in constants} == {
        name: float(number) for name, number in constants.items()
    }


@pytest.mark.parametrize('compiled', [True, False])
def test_where_a_slipping_rotor_ends_answers_where_it_began(compiled: bool) -> None:
    volts = np.full(1, 6.0)
    interval = np.full(1, 1e-3)
    p = coordinates(BOX, HELD_THETA)

    def end(speed: float) -> Run:
        begin = np.array([1.0, speed])
        return run(KT, p, begin, volts, interval, LIMITS, is_compiled=compiled)

    assert end(0.01).steps == rotor_trajectory.HELD_COST
    by_difference = (end(0.01).states[1] - end(0.0).states[1]) / 0.01
    np.testing.assert_allclose(end(0.005).slopes[1, :, 1], by_difference, rtol=0.2, atol=1e-9)


@pytest.mark.parametrize('compiled', [True, False])
@pytest.mark.parametrize('interval_s', [1e-3, 1e-2])
def test_a_rotor_that_friction_holds_is_followed_in_one_step(
    interval_s: float, compiled: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    volts = steps(20, hold=4)
    p = coordinates(BOX, HELD_THETA)

    def follow(voltage_v: np.ndarray, length_s: float, **options: bool) -> Run:
        lengths = np.full(voltage_v.size, length_s)
        return run(KT, p, np.zeros(2), voltage_v, lengths, LIMITS, **options)

    held = follow(volts, interval_s, is_compiled=compiled)
    assert held.steps == rotor_trajectory.HELD_COST * volts.size
    monkeypatch.setattr(rotor_trajectory, 'LARGEST_STEP', 0.05)
    finely = follow(np.repeat(volts, 200), interval_s / 200.0)  # too short to come to rest in
    assert finely.steps >= 200 * volts.size
    exact = finely.states[::200]
    current_error, speed_error = np.abs(held.states - exact).max(axis=0)
    assert current_error < held_state.FOLLOWING * np.abs(exact[:, 0]).max()
    assert speed_error < 1e-3


@pytest.mark.parametrize('compiled', [True, False])
def test_a_motor_without_voltage_comes_to_rest_in_few_steps(
    compiled: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its current is so small that a share of it is below rounding."""
    p = coordinates(BOX, np.array([3.5e-4, 16.7, 3.5e-4, 8e-5, 4e-2]))
    start = np.array([1e-8, 0.01])

    def follow(count: int, length_s: float, *, is_compiled: bool) -> Run:
        lengths = np.full(count, length_s)
        return run(KT, p, start, np.zeros(count), lengths, LIMITS, is_compiled=is_compiled)

    at_once = follow(40, 4e-3, is_compiled=compiled)
    assert at_once.is_bounded
    assert at_once.steps == rotor_trajectory.HELD_COST * 40
    monkeypatch.setattr(rotor_trajectory, 'LARGEST_STEP', 0.05)
    finely = follow(4000, 4e-5, is_compiled=True).states[::100]  # of Python it takes 47 s
    assert np.abs(at_once.states - finely)[:, 0].max() < 1e-8
    assert np.abs(at_once.states - finely)[:, 1].max() < 1e-5


@pytest.mark.parametrize('compiled', [True, False])
@pytest.mark.parametrize('friction_nm', [0.0, 2e-3])
def test_a_current_that_brushes_hold_is_followed_in_few_steps(
    friction_nm: float, compiled: bool
) -> None:
    """The rotor runs out while less voltage is left for the winding than the brushes drop."""
    box = MotorWhiteBox(NODES, KT, {'back_emf_constant': KB, 'brush_drop': 0.6})
    p = coordinates(box, np.array([3e-4, 0.15, 1e-4, 1e-5, friction_nm]))

    def follow(parts: int) -> Run:
        count = 10 * parts
        lengths = np.full(count, 1e-2 / parts)
        start = np.array([0.0, 20.0])
        return run(KT, p, start, np.full(count, 0.3), lengths, LIMITS, is_compiled=compiled)

    at_once = follow(1)
    finely = follow(200)
    assert at_once.is_bounded and finely.is_bounded
    assert at_once.steps < 40 * (rotor_trajectory.HELD_COST + rotor_trajectory.STRAIGHT_COST)
    exact = finely.states[::200]
    assert np.abs(at_once.states - exact)[:, 0].max() < 1e-5
    np.testing.assert_allclose(at_once.states[:, 1], exact[:, 1], rtol=1e-3)
    np.testing.assert_allclose(
        at_once.slopes[-1, 1], finely.slopes[-1, 1], rtol=0.02, atol=1e-6 * KT
    )


@pytest.mark.parametrize('known', [{'brush_drop': 0.6}, {}], ids=['brushes', 'no brushes'])
@pytest.mark.parametrize('effect', [{'hysteresis': 3e-3}, {'quadratic_friction': 6e-8}])
def test_where_no_motion_is_straight_a_slow_run_is_as_exact(
    effect: dict[str, float], known: dict[str, float]
) -> None:
    """A current that passed zero within 10 ms went wrong by up to a hundredth of its spread."""
    box = MotorWhiteBox(NODES, KT, {'back_emf_constant': KB, **effect, **known})
    p = coordinates(box, np.array([2e-3, 1.0, 1e-5, 1e-5, 5e-3]))
    volts = steps(300, seed=2, hold=10)

    def follow(parts: int) -> Run:
        count = volts.size * parts
        lengths = np.full(count, 1e-2 / parts)
        return run(KT, p, np.zeros(2), np.repeat(volts, parts), lengths, LIMITS)

    finely = follow(100).states[::100]
    errors = np.abs(follow(1).states - finely).max(axis=0)
    assert (errors < 1e-3 * finely.std(axis=0)).all()


@pytest.mark.parametrize('current_a', [1.0, 20.0, 100.0])
def test_no_run_of_a_motor_with_brushes_is_given_up(current_a: float) -> None:
    """Runs of strong motors took so many steps at 100 Hz that they were."""
    box = MotorWhiteBox(NODES, KT, {'back_emf_constant': KB, 'brush_drop': 0.5})
    ohms = 12.0 / current_a
    inertia = 0.05 * KT * KB / ohms
    p = coordinates(box, np.array([2e-3 * ohms, ohms, inertia, 1e-6 / ohms, 0.05 * KT * current_a]))
    volts = steps(3000, seed=1, hold=20)
    end = run(KT, p, np.zeros(2), volts, np.full(volts.size, 1e-2), LIMITS)
    assert end.is_bounded
    assert end.steps < 30 * volts.size


@pytest.mark.parametrize('compiled', [True, False])
@pytest.mark.parametrize('largest_a', [3.0, 30.0, 300.0])
def test_brushes_are_followed_however_strong_the_friction_is(
    largest_a: float, compiled: bool
) -> None:
    """Near zero current the brushes bend its balance: a straight step would miss them."""
    brushes = {'back_emf_constant': KB, 'brush_drop': 0.5}
    box = MotorWhiteBox(NODES, KT, brushes)
    p = coordinates(box, np.array([4e-3, 1.0, 1e-5, 1e-5, KT * largest_a]))
    volts = np.tile([2.0, -1.0, 0.4], 4)

    def follow(parts: int, *, is_compiled: bool) -> Run:
        lengths = np.full(volts.size * parts, 5e-3 / parts)
        finer = np.repeat(volts, parts)
        return run(KT, p, np.zeros(2), finer, lengths, LIMITS, is_compiled=is_compiled)

    at_once = follow(1, is_compiled=compiled)
    finely = follow(100, is_compiled=True)
    assert finely.is_bounded
    if at_once.is_bounded:
        off_a = np.abs(at_once.states - finely.states[::100])[:, 0]
        assert off_a.max() < 5e-4


@pytest.mark.parametrize('compiled', [True, False])
@pytest.mark.parametrize('place', [0, 1, 3, 6, 7, 8, 9])
def test_derivatives_with_the_rotor_held_are_finite_differences(place: int, compiled: bool) -> None:
    volts = np.linspace(6.0, 9.0, 8)
    interval = np.full(8, 1e-3)
    p = coordinates(BOX, HELD_THETA)
    start = np.array([1.0, 0.0])

    path, by_difference = differentiated(p, start, volts, interval, place, is_compiled=compiled)
    slope = path.slopes[:, :, 2 + place]
    assert path.steps == rotor_trajectory.HELD_COST * volts.size
    scale = np.abs(by_difference).max(axis=0)
    assert (np.abs(slope - by_difference) <= 0.03 * scale).all()


def test_a_rate_that_is_not_straight_is_not_taken_for_one() -> None:
    assert _straight(0.0) is not None
    assert _straight(1e-6) is None


def _straight(hysteresis: float) -> StraightMotion | None:
    p = coordinates(BOX, THETA)
    p[list(TERMS).index('hysteresis')] = hysteresis / THETA[0]
    motor = WholeMotor(KT)
    values = dict(enumerate(p.tolist()))
    return StraightMotion.of_motor(
        lambda at: rate(rotor_trajectory._FLOATS, motor, values, at, 0.0, 0.0), p, LIMITS, 1e-2
    )


def test_intervals_of_many_lengths_are_followed_alike() -> None:
    volts = steps(200, hold=20)
    rng = np.random.default_rng(3)
    interval = 1e-2 * rng.uniform(0.5, 1.5, volts.size)
    p = coordinates(BOX, THETA)
    start = np.array([0.1, 3.0])
    whole = run(KT, p, start, volts, interval, LIMITS)
    state = start
    for k in range(0, volts.size, 4):  # too few to prepare for
        own = slice(k, k + 4)
        state = run(KT, p, state, volts[own], interval[own], LIMITS).states[-1]
        scale = np.abs(whole.states).max(axis=0)
        assert (np.abs(whole.states[k + 4] - state) < 5e-3 * scale).all()


@pytest.mark.parametrize('node', range(len(NODES)))
def test_derivatives_by_the_logarithms_are_finite_differences(node: int) -> None:
    volts = steps(1500)
    step = 1e-6
    followed = free_run(THETA, volts)
    slope = followed.slopes[:, 0, 2:] @ slopes(BOX, coordinates(BOX, THETA))[:, node]
    ends = []
    for sign in (1.0, -1.0):
        moved = THETA.copy()
        moved[node] *= np.exp(sign * step)
        ends.append(free_run(moved, volts).states[:, 0])
    by_difference = (ends[0] - ends[1]) / (2.0 * step)
    assert np.std(slope - by_difference) < 1e-4 * np.std(by_difference)


def test_derivatives_by_the_first_states_are_finite_differences() -> None:
    volts = steps(400)
    p = coordinates(BOX, THETA)
    interval = np.full(400, 1e-3)
    middle = run(KT, p, np.array([0.5, 40.0]), volts, interval, LIMITS)
    for state, bump in enumerate((1e-5, 1e-3)):
        up, down = (
            run(KT, p, np.array([0.5, 40.0]) + d * np.eye(2)[state], volts, interval, LIMITS)
            for d in (bump, -bump)
        )
        by_difference = (up.states - down.states) / (2.0 * bump)
        np.testing.assert_allclose(
            middle.slopes[:, :, state], by_difference, atol=1e-4 * np.abs(by_difference).max()
        )


@pytest.mark.slow
@pytest.mark.parametrize('rate_hz', [1000.0, 250.0])
def test_the_trajectory_is_that_of_the_simulated_plant(rate_hz: float) -> None:
    inductance, resistance, inertia, viscous, coulomb = THETA.tolist()
    plant = PlantParameters(
        inductance=inductance, resistance=resistance, hysteresis=0.0, torque_constant=KT,
        back_emf_constant=KB, inertia=inertia, viscous_friction=viscous, coulomb_friction=coulomb,
    )  # fmt: skip
    recording = Simulation(
        {'m': plant}, 'R[-12,12]D[0.05,0.5]', seed=4, speed_mode='rotor', sample_rate_hz=rate_hz
    ).record(2.0)
    interval = np.diff(recording.stamp_ns) / 1e9
    current = recording.torque_nm[0] / KT
    start = np.array([current[0], recording.speed_rad_s[0, 0]])
    followed = run(
        KT, coordinates(BOX, THETA), start, recording.voltage_v[0, :-1], interval, LIMITS
    )
    assert followed.is_bounded
    assert np.std(followed.states[:, 0] - current) < 1e-3 * np.std(current)
    error = followed.states[:, 1] - recording.speed_rad_s[0]
    assert np.std(error) < 1e-3 * np.std(recording.speed_rad_s[0])


def test_whatever_the_parameters_nothing_overflows() -> None:
    bounded_count = 0
    for seed in range(8):
        rng = np.random.default_rng(seed)
        theta = np.array(
            [10.0 ** rng.uniform(np.log10(p.lower), np.log10(p.upper)) for p in BOX.parameters]
        )
        with np.errstate(all='raise'):
            followed = free_run(theta, steps(500))
        if followed.is_bounded:
            bounded_count += 1
            assert np.isfinite(followed.states).all(), seed
    assert bounded_count > 0


def test_a_rotor_at_rest_under_dry_friction_does_not_chatter() -> None:
    volts = np.full(400, 0.3)  # a current whose torque is below the friction
    p = coordinates(BOX, THETA)
    followed = run(KT, p, np.zeros(2), volts, np.full(400, 1e-3), LIMITS)
    speed = followed.states[100:, 1]
    assert np.ptp(speed) < 1e-3
    assert abs(speed).max() < 0.2


def test_compiled_code_and_python_carry_the_same_load() -> None:
    if whole_motor.library() is None:
        pytest.skip('no compiled code')
    volts = steps(120, hold=20)
    places = np.linspace(0.0, 3.0, volts.size)
    load = np.interp(places, np.arange(4), [0.0, 900.0, -400.0, 200.0])
    p = coordinates(BOX, THETA)
    start = np.array([0.1, 3.0])
    both = [
        run(KT, p, start, volts, np.full(volts.size, 1e-3), LIMITS, load, is_compiled=compiled)
        for compiled in (True, False)
    ]
    np.testing.assert_allclose(both[0].states, both[1].states, rtol=1e-10, atol=1e-11)
    fast, slow = (by_knot(both[0], places, 4, is_compiled=compiled) for compiled in (True, False))
    np.testing.assert_allclose(fast, slow, rtol=1e-10, atol=1e-12 * np.abs(slow).max())


@pytest.mark.parametrize('compiled', [True, False])
@pytest.mark.parametrize('load', [0.0, 900.0])
def test_an_interval_followed_by_itself_ends_as_in_a_run(compiled: bool, load: float) -> None:
    p = coordinates(BOX, THETA)
    interval = OneInterval(KT, p, is_compiled=compiled)
    at = np.array([0.1, 3.0])
    limits = (float(LIMITS[0]), float(LIMITS[1]))
    for volt, length_s in ((6.0, 1e-3), (-12.0, 1e-2), (0.0, 0.3)):
        signals = (np.array([volt]), np.array([length_s]), LIMITS, np.array([load]))
        path = run(KT, p, at, *signals, is_compiled=compiled)
        end = interval.end(at, volt, length_s, limits, load)
        assert end is not None
        np.testing.assert_array_equal(end, path.states[1])
        at = end
    assert interval.end(at, 6.0, 1e-3, (1e-9, 1e-9), load) is None


@pytest.mark.parametrize('knot', range(4))
def test_derivatives_by_the_knots_of_a_load_are_finite_differences(knot: int) -> None:
    volts = steps(300)
    places = np.linspace(0.0, 3.0, volts.size)
    p = coordinates(BOX, THETA)
    start = np.array([0.1, 50.0])

    def loaded(knots: np.ndarray) -> Run:
        load = np.interp(places, np.arange(4), knots)
        return run(KT, p, start, volts, np.full(volts.size, 1e-3), LIMITS, load)

    knots = np.array([100.0, 300.0, -200.0, 50.0])
    bump = 0.1 * np.eye(4)[knot]
    by_difference = (loaded(knots + bump).states - loaded(knots - bump).states) / 0.2
    slope = by_knot(loaded(knots), places, 4)[:, :, knot]
    for state in range(2):
        assert np.std(slope[:, state] - by_difference[:, state]) < 1e-3 * np.std(
            by_difference[:, state]
        )


def test_compiled_code_and_python_respond_alike_to_further_voltages() -> None:
    if whole_motor.library() is None:
        pytest.skip('no compiled code')
    rng = np.random.default_rng(5)
    transitions = free_run(THETA, steps(60)).transitions
    gains = rng.normal(size=(60, 2))
    inputs = rng.normal(size=(60, 3))
    fast, slow = (
        state_response(transitions, gains, inputs, is_compiled=compiled)
        for compiled in (True, False)
    )
    np.testing.assert_allclose(fast, slow, rtol=1e-12, atol=1e-12)
