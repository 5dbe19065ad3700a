"""A small case that several files of tests look at: two short runs of a board that skids."""

from functools import cache

import jax.numpy as jnp
import numpy as np

from snakejax import TABLE_II, Board, Case, Fit, Force, Gait, Model, Noise, Pacejka, Run, Sines, param, simulate
from snakejax.estimation import fit

NASTY = "<script>alert(1)</script>"
"""What a case, a run or an effect might be called."""
NASTY_RUN = '"><img src=x onerror=alert(2)> %{y} &amp;'


class Pull(Force):
    """A force along the board."""

    description = NASTY
    p: jnp.ndarray = param("N", default=0.0)

    def wrench(self, motion):
        return self.p, jnp.zeros_like(self.p), jnp.zeros_like(self.p)


@cache
def small(
    case: str = "small", runs: tuple[str, str] = ("here", "there"), effect: str = "pull"
) -> tuple[Case, Noise, Fit]:
    """A case of that name with its noise and a fit of D, the second run held out, 20 frames of each lost."""
    noise = Noise(jnp.asarray(4e-4), jnp.asarray(2.5e-3), source=case)
    gait = Gait(Sines.of([[0.35, 3.0, 0.0]]), Sines.of([[1.2, 3.0, 0.4]]))
    times = jnp.arange(400.0) * 0.01
    # It slips past its peak, so that the run tells its D.
    tyre = Pacejka(8.0, 1.3, 0.9, 0.2)
    pose = np.asarray(simulate(Model(Board(**TABLE_II), tyre, "free"), gait, times).pose)
    errors = np.random.default_rng(0).normal(size=(2, 400, 3)) * np.asarray(noise.channels)
    errors[:, 100:120] = np.nan
    made = tuple(
        Run(name, role, times, jnp.asarray(pose + error), gait)
        for name, role, error in zip(runs, ("train", "heldout"), errors, strict=True)
    )
    model = Model(Board(**TABLE_II), tyre, "free", {effect: Pull()})
    whole = Case(case, case, "free", model.board, made, noise, {case: "0"})
    return whole, noise, fit(model, made, noise, ["tyre.D"])
