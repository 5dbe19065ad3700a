"""The effect that `explain` writes to start from: it acts on the variable that was found, as the model computes it."""

import jax.numpy as jnp
import numpy as np
import pytest

from snakejax import TABLE_II, Board, Gait, Model, Pacejka, Sines
from snakejax.commands.named_effects import effect_class
from snakejax.commands.option_texts import effect_spec
from snakejax.diagnosis.latent_force.dependence import FittedFunction
from snakejax.diagnosis.latent_force.missing_force import LatentForce
from snakejax.diagnosis.latent_force.template import effect_template
from snakejax.dynamics.contact import slip_angle


def test_a_grip_that_depends_on_the_slip_angle_takes_that_of_the_model(tmp_path) -> None:
    """At 2 mm/s under a creep speed of 5 mm/s: another regularisation would give another angle."""
    values = np.linspace(-1, 1, 25)
    found = FittedFunction("slip", "slip_angle", "grip", values, 0.1 * values[:, None])
    file = tmp_path / "mine.py"
    file.write_text(effect_template(LatentForce((), (("slip", 1.0),), found, (9.0, 1.0), {}, False)))
    effect = effect_class(effect_spec(f"{file}:MissingForce"))(p=0.5)
    model = Model(Board(**TABLE_II, creep_speed=0.005), Pacejka(8.0, 1.4, 5.0, 0.2), "free")
    gait = Gait(Sines.of([[0.3, 2.0, 0.0]]), Sines.of([[1.0, 2.0, 0.3]]))
    body = model.initial_state((0.0, 0.0, 0.0, 0.002, 0.001, 0.0), jnp.asarray(0.3), gait)[0]
    motion = model.motion(jnp.asarray(0.3), body, gait)
    wheel = motion.wheels[0]
    angle = float(slip_angle(wheel.lateral, wheel.rolling, model.board.creep_speed))
    gained = float(effect.lateral(jnp.asarray(1.0), wheel, motion)) - 1.0
    scale = float(file.read_text().split("jnp.tanh(v / ")[1].split(")")[0])
    assert gained == pytest.approx(0.5 * np.tanh(angle / scale), rel=1e-9) and abs(gained) > 1e-3
