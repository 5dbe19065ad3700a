"""Tyre laws against published values and against the same formulas in other units."""

import jax.numpy as jnp
import pytest
from oracles import full_equations as full

from snakejax.dynamics.tyres import Bakker


@pytest.mark.parametrize(("load", "force"), [(2.0, 1722.54), (4.0, 3096.61), (6.0, 3833.10)])
def test_bakker_check_values(load, force):
    """SAE 870421 at 4 degrees of slip and no camber; load in kN, force in N."""
    slip, lateral = jnp.deg2rad(4.0), jnp.array(0.1)
    assert float(Bakker(1000.0 * load).force(slip, lateral)) == pytest.approx(force, abs=0.005)


@pytest.mark.parametrize(("load", "slip", "camber"), [(2.0, 7.0, 3.0), (0.0025, -2.0, 30.0), (5.0, 12.0, -5.0)])
def test_bakker_under_camber(load, slip, camber):
    """Against the same formulas in kN and degrees; the second is a robot's load."""
    tyre = Bakker(1000.0 * load, jnp.deg2rad(camber))
    force = float(tyre.force(jnp.deg2rad(slip), jnp.array(0.1)))
    assert force == pytest.approx(full.bakker_force(load, slip, camber), rel=1e-12)
