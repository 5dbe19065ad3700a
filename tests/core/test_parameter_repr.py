"""How parameters look in a Python session."""

import jax
import jax.numpy as jnp

import snakejax as sj
from snakejax.effects import GroundSlope


def test_parameters_show_their_values_and_units() -> None:
    assert repr(GroundSlope(sx=0.003, sy=-0.002)) == "GroundSlope(sx=0.003 rad, sy=-0.002 rad)"
    assert repr(sj.Pacejka(8.0, 1.3, jnp.asarray(0.9), 0.2)).startswith("Pacejka(B=8 1/rad, C=1.3, D=0.9 N, E=0.2")


def test_a_model_shows_the_values_in_it() -> None:
    model = sj.Model(sj.Board(**sj.TABLE_II), sj.Rayleigh(9.0), "free").add(ground_slope=GroundSlope(sx=0.01, sy=0.0))
    text = repr(model)
    assert "mass=7 kg" in text and "k_s=9 N s/m" in text and "sx=0.01 rad" in text and "f64[" not in text


def test_a_signal_shows_its_table_and_a_traced_parameter_does_not_fail() -> None:
    assert "[0.9, 0.3]" in repr(sj.Sines.of([[0.9, 4.0, 0.0], [0.3, 8.0, 0.0]]))
    seen = []

    @jax.jit
    def doubled(x):
        seen.append(repr(GroundSlope(sx=x, sy=x)))
        return 2 * x

    doubled(jnp.asarray(0.1))
    assert seen[0].startswith("GroundSlope(sx=")
