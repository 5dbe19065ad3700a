"""The single-track car against the CommonRoad vehicle models, which share no code with the package."""

from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from snakejax.dynamics.axle_tyres import FrontRear, Linear, LoadedPacejka
from snakejax.dynamics.inputs import Inputs
from snakejax.dynamics.model import Model, no_traction
from snakejax.dynamics.signals import Sines
from snakejax.simulation.integrate import simulate
from snakejax.vehicles.car import Car

st = pytest.importorskip("vehiclemodels.vehicle_dynamics_st", reason="needs commonroad-vehicle-models")
ks = pytest.importorskip("vehiclemodels.vehicle_dynamics_ks")
parameters = pytest.importorskip("vehiclemodels.vehicle_parameters")

BMW = parameters.setup_vehicle_parameters(vehicle_id=2)
STIFF = -BMW.tire.p_ky1 / BMW.tire.p_dy1
CAR = Car(mass=BMW.m, inertia=BMW.I_z, front=BMW.a, rear=BMW.b, creep_speed=1e-5)


def constant(**values: float) -> Inputs:
    return Inputs({name: Sines.of([[value, 0.0, np.pi / 2]]) for name, value in values.items()})


@pytest.mark.slow
def test_the_linear_tyre_has_the_right_hand_side_of_commonroad_st() -> None:
    """CommonRoad's `st` is linear in steering angle, yaw rate and slip angle; it is the derivative of ours at 0."""
    tyre = Linear(C_S=STIFF, mu=BMW.tire.p_dy1)
    model = Model(CAR, FrontRear(tyre, tyre), "free")
    for speed in (5.0, 15.0, 30.0):

        def ours(small, speed=speed):
            delta, spin, beta = small
            inputs = Inputs({"steer": Sines(delta[None], jnp.zeros(1), jnp.full(1, np.pi / 2)), "drive": Sines.of([])})
            body = tuple(map(jnp.asarray, (0.0, 0.0, 0.0, speed * jnp.cos(beta), speed * jnp.sin(beta), spin)))
            rates = model.rates(jnp.asarray(0.0), (body, ()), inputs)[0]
            u, w = body[3], body[4]
            return jnp.stack([rates[5], (rates[4] * u - w * rates[3]) / speed**2])

        slope = np.asarray(jax.jacfwd(ours)(jnp.zeros(3)))
        theirs = np.empty((2, 3))
        for k in range(3):
            x = np.zeros(7)
            x[3], x[[2, 5, 6][k]] = speed, 0.1
            theirs[:, k] = np.array(st.vehicle_dynamics_st(list(x), [0.0, 0.0], BMW))[[5, 6]] / 0.1
        np.testing.assert_allclose(slope, theirs, rtol=1e-9, atol=1e-9)


def test_without_slip_the_motion_is_that_of_commonroad_ks() -> None:
    """Their point is the middle of the rear axle, ours the centre of mass."""
    model = Model(CAR, no_traction(), "ideal")
    for delta in (-0.6, 0.2, 0.9):
        theirs = ks.vehicle_dynamics_ks([0.0, 0.0, delta, 8.0, 0.4], [0.0, 0.0], BMW)
        body = tuple(map(jnp.asarray, (0.0, 0.0, 0.4, 8.0)))
        rates = np.asarray(model.rates(jnp.asarray(0.0), (body, ()), constant(steer=delta, drive=0.0))[0])
        rear = rates[:2] - rates[2] * BMW.b * np.array([-np.sin(0.4), np.cos(0.4)])
        np.testing.assert_allclose([*rear, rates[2]], [theirs[0], theirs[1], theirs[4]], rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(rates[3], 0.0, atol=1e-9)


@pytest.mark.slow
def test_the_force_works_without_slip() -> None:
    """The kinetic energy grows by the work of the driving force, the front wheels turning meanwhile."""
    inputs = Inputs({"steer": Sines.of([[0.4, 2.0, 0.3]]), "drive": Sines.of([[900.0, 1.0, 1.0]])})
    model = Model(CAR, no_traction(), "ideal")
    times = jnp.linspace(0.0, 4.0, 4001)
    found = simulate(model, inputs, times, (0.0, 0.0, 0.0, 6.0, 0.0, 0.0))
    motion = jax.vmap(lambda t, s: model.motion(t, s[0], inputs))(found.command_times, found.state)
    energy = CAR.mass * (motion.u**2 + motion.w**2) / 2 + CAR.inertia * motion.r**2 / 2
    power = motion.drive[1] * motion.wheels[1].rolling
    work = np.concatenate([[0.0], np.cumsum((power[1:] + power[:-1]) / 2 * np.diff(times))])
    np.testing.assert_allclose(energy - energy[0], work, rtol=0, atol=1e-6 * float(energy[0]))


@pytest.mark.slow
def test_the_magic_formula_under_load_is_that_of_commonroad() -> None:
    """Pure lateral slip of their `std` and `mb` models, without camber and shifts (E is constant there too)."""
    lateral = pytest.importorskip("vehiclemodels.utils.tire_model")
    tire = BMW.tire
    for load in (2000.0, 4000.0):
        known = {name: getattr(tire, name) for name in ("p_dy1", "p_dy3", "p_cy1", "p_ky1")}
        parts = SimpleNamespace(**known, p_ey1=0.2, p_hy1=0.0, p_hy3=0.0, p_vy1=0.0, p_vy3=0.0)
        theirs = [lateral.formula_lateral(slip, 0.0, load, parts)[0] for slip in (-0.2, 0.01, 0.1)]
        # Their stiffness is in proportion to the load: the rising part of the sine at a far peak.
        far = 1e6
        stiffness = -tire.p_ky1 * far / 2
        tyre = LoadedPacejka(stiffness, tire.p_dy1, nominal=3000.0, C=tire.p_cy1, E=0.2, peak=far)
        loaded, still = tyre.under(jnp.asarray(load)), jnp.asarray(0.0)
        ours = [-float(loaded.force(jnp.asarray(slip), still)) for slip in (-0.2, 0.01, 0.1)]
        np.testing.assert_allclose(ours, theirs, rtol=1e-9)
