"""A friction too small to matter is known to be negligible; one that matters is not."""

from __future__ import annotations

import pytest
from rotor_motors import BOX, INITIAL, KB, KT, THETA, samples_of

from dc_motor_sim.plant import PlantParameters
from dc_motor_sim.simulation import Simulation
from gray_box_observer.context_nodes import RotorUpdate, Verdict

VISCOUS = 3
COULOMB = 4


def learnt(viscous: float, coulomb: float, excitation: str = 'R[-12,12]D[0.05,0.5]') -> RotorUpdate:
    """Return the rule after three seconds of a motor with these frictions."""
    inductance, resistance, inertia, *_ = THETA.tolist()
    plant = PlantParameters(
        inductance=inductance, resistance=resistance, hysteresis=0.0, torque_constant=KT,
        back_emf_constant=KB, inertia=inertia, viscous_friction=viscous, coulomb_friction=coulomb,
    )  # fmt: skip
    simulation = Simulation(
        {'motor': plant}, excitation, seed=1, speed_mode='rotor', sample_rate_hz=1000.0,
        torque_noise_std=3e-4,
    )  # fmt: skip
    update = RotorUpdate(BOX, INITIAL)
    for sample in samples_of(simulation.record(3.0)):
        update.learn(sample)
    return update


@pytest.mark.slow
@pytest.mark.parametrize(
    ('viscous', 'coulomb', 'place'), [(0.0, 8.4e-3, VISCOUS), (1e-5, 0.0, COULOMB)]
)
def test_a_friction_that_is_not_there_is_negligible(
    viscous: float, coulomb: float, place: int
) -> None:
    update = learnt(viscous, coulomb)
    estimate = update.estimate()
    assert estimate.verdicts[0][place] is Verdict.NEGLIGIBLE
    assert Verdict.UNEXCITED not in estimate.verdicts[0]
    other = learnt(viscous, coulomb)
    other.restore(*update.state())
    assert other.estimate().verdicts == estimate.verdicts


@pytest.mark.slow
def test_frictions_that_matter_are_identified_and_their_bound_holds() -> None:
    update = learnt(1e-5, 8.4e-3)
    estimate = update.estimate()
    assert Verdict.NEGLIGIBLE not in estimate.verdicts[0]
    share, reach = update.voltage_shares(0)
    assert (share[:3] == 0.0).all()
    for place in (VISCOUS, COULOMB):
        most = estimate.value[0, place] * share[place] + reach[place]
        assert most > THETA[place] * share[place] > 0.005


def test_of_a_constant_voltage_no_friction_is_negligible() -> None:
    assert Verdict.NEGLIGIBLE not in learnt(1e-5, 0.0, 'C[6]').estimate().verdicts[0]
