"""The observer's white box and the simulator's plant are written apart; here they have to agree."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from dc_motor_sim.plant import PlantParameters
from dc_motor_sim.simulation import Recording, Simulation
from gray_box_observer.predictor.steady_state import course
from gray_box_observer.white_box import MotorWhiteBox
from gray_box_observer.white_box.declaration import State
from gray_box_observer.white_box.flow import flow, to_coordinates

NAMES = ('inductance', 'resistance', 'hysteresis')


def roll_out(box: MotorWhiteBox, theta: np.ndarray, recording: Recording) -> np.ndarray:
    """Torque that the white box expects from voltages (and measured speeds) alone."""
    states = [box.state(recording.torque_nm[:, :1])]
    torque = [recording.torque_nm[:, :1]]
    for k in range(1, recording.stamp_ns.size):
        interval = np.full(
            (len(recording.motors), 1), (recording.stamp_ns[k] - recording.stamp_ns[k - 1]) / 1e9
        )
        speed, next_speed = recording.speed_rad_s[:, k - 1 : k], recording.speed_rad_s[:, k : k + 1]
        voltage = recording.voltage_v[:, k - 1 : k]
        states = flow(
            box, to_coordinates(theta), states, voltage, speed, next_speed, interval
        ).value
        torque.append(box.output(states[State.CURRENT]))
    return np.concatenate(torque, axis=1)


@pytest.mark.parametrize(
    'excitation', ['R[1,2]D[3,3]', 'R[0,33]D[1,20]', 'R[5,15]D[0.001,2]', 'R[-15,15]D[0.1,1]']
)
def test_white_box_and_plant_agree_in_thesis_mode(
    record: Callable[..., Recording], excitation: str
) -> None:
    recording = record(excitation, 10.0, motors=('a', 'b'))
    box = MotorWhiteBox(NAMES, 0.01, {'back_emf_constant': 0.01})
    theta = np.array([[0.5, 1.0, 10.0], [0.5, 1.5, 10.0]])
    error = np.abs(roll_out(box, theta, recording) - recording.torque_nm)
    assert error.max() < 2e-5 * np.abs(recording.torque_nm).max()  # what ode3 leaves at 10 ms steps


@pytest.mark.slow
def test_white_box_and_plant_agree_in_rotor_mode_with_measured_speed() -> None:
    plant = PlantParameters(
        inductance=2e-3, resistance=0.8, hysteresis=0.01, torque_constant=0.05,
        back_emf_constant=0.05,
        inertia=2e-4, viscous_friction=1e-3, coulomb_friction=0.0, load_torque=0.01,
    )  # fmt: skip
    simulation = Simulation(
        {'m': plant}, 'R[-12,12]D[0.05,0.3]', seed=4, speed_mode='rotor', sample_rate_hz=2000.0
    )
    recording = simulation.record(3.0)
    assert (
        np.ptp(recording.speed_rad_s) > 50.0
    )  # the comparison says nothing of a motor that stands still
    box = MotorWhiteBox((*NAMES, 'back_emf_constant'), 0.05, {}, True)
    error = np.abs(
        roll_out(box, np.array([[2e-3, 0.8, 0.01, 0.05]]), recording) - recording.torque_nm
    )
    assert (
        error.max() < 1e-3 * np.abs(recording.torque_nm).max()
    )  # speed is taken as straight between samples


def test_both_settle_at_the_same_steady_state(record: Callable[..., Recording]) -> None:
    recording = record('C[7.5]', 10.0)
    box = MotorWhiteBox(NAMES, 0.01, {'back_emf_constant': 0.01})
    way = course(np, box, [0.5, 1.0, 10.0], np.array([7.5]), np.zeros(1), 0.0)
    assert recording.torque_nm[0, -1] == pytest.approx(0.01 * way.steady_a[0], rel=1e-9)
