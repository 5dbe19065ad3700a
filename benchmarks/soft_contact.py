"""What board-k lacks: tyres that slip by the speed and not by the angle, and resistance, fitted to it step by step.

    python benchmarks/soft_contact.py ../shared/recordings/board-k

The wheels of board-k touch the ground through the soft contact of another simulator, so that no model here is exact.
Each model is fitted by itself: misfit of each run, 1 is noise, train runs first.
"""

import sys
import time
from pathlib import Path

from snakejax import prepare_jax

prepare_jax()

import jax.numpy as jnp  # noqa: E402

from snakejax import LateralForce, Model, Motion, Scalar, load_case, noise_of, param  # noqa: E402
from snakejax.dynamics.contact import Wheel  # noqa: E402
from snakejax.effects import LIBRARY  # noqa: E402
from snakejax.estimation import fit  # noqa: E402
from snakejax.estimation.initial_model import default_free, starting_model  # noqa: E402


class SlipSpeed(LateralForce):
    """F v / sqrt(v^2 + s^2), v the lateral slip speed: dry friction that begins smoothly. It takes the place of the
    tyre."""

    F: Scalar = param("N", positive=True, default=3.4)
    s: Scalar = param("m/s", positive=True, default=0.03)

    def lateral(self, force: Scalar, wheel: Wheel, motion: Motion) -> Scalar:
        return self.F * wheel.lateral / jnp.sqrt(wheel.lateral**2 + self.s**2)


class Leading(SlipSpeed):
    """The same, and 1 + q times as much on the wheels that lead in the direction of motion, 1 - q on the others."""

    q: Scalar = param("-", default=0.0)

    def lateral(self, force: Scalar, wheel: Wheel, motion: Motion) -> Scalar:
        ahead = jnp.sign(wheel.wheelset.place) * jnp.tanh(wheel.rolling / 0.05)
        return super().lateral(force, wheel, motion) * (1 + self.q * ahead)


MODELS = {
    "Pacejka": {},
    "Pacejka, rolling_resistance": {"rolling_resistance": LIBRARY["rolling_resistance"]()},
    "slip speed": {"slip_speed": SlipSpeed()},
    "slip speed, rolling_resistance": {
        "slip_speed": SlipSpeed(),
        "rolling_resistance": LIBRARY["rolling_resistance"](),
    },
    "slip speed, rolling_resistance, grip_split": {
        "slip_speed": SlipSpeed(),
        "grip_split": LIBRARY["grip_split"](),
        "rolling_resistance": LIBRARY["rolling_resistance"](),
    },
    "slip speed, rolling_resistance, leading wheels": {
        "slip_speed": Leading(),
        "rolling_resistance": LIBRARY["rolling_resistance"](),
    },
}


def main(folder: Path) -> None:
    case = load_case(folder)
    base = starting_model(case)
    for name, effects in MODELS.items():
        begin = time.perf_counter()
        model = Model(base.board, base.tyre, base.constraint, effects)
        free = [one for one in default_free(model) if "slip_speed" not in effects or not one.startswith("tyre.")]
        fitted = fit(model, case.runs, noise_of(case), free)
        held = fitted.heldout_score
        print(f"{name}: train {fitted.misfit:.3g}, held out {held.misfit if held else float('nan'):.3g}", end="")
        print(f"; {time.perf_counter() - begin:.0f} s" + ("" if fitted.converged else "; did not converge"))
        print("  " + ", ".join(f"{score.run} {score.misfit:.3g}" for score in (*fitted.runs, *fitted.heldout)))
        print("  " + ", ".join(f"{one} = {estimate}" for one, estimate in fitted.estimates.items()), flush=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
