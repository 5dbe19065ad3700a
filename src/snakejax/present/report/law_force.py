"""The force of laws along replayed runs, which the charts of a missing force draw over its estimate."""

from collections.abc import Iterable, Sequence

import numpy as np
from jaxtyping import Float

from snakejax.core.formula import evaluated
from snakejax.diagnosis.residuals.replays import RunReplay
from snakejax.dynamics.law import ForceLaw, Law


def law_forces(laws: Iterable[Law], replays: Sequence[RunReplay]) -> dict[str, Float[np.ndarray, "n 3"]]:
    """X, Y [N] and N [N m] of all `laws` together along each run, by its name.

    None where a law acts on each wheel, or depends on what a replay does not hold.
    """
    forces = [law for law in laws if isinstance(law, ForceLaw)]
    if not forces:
        return {}
    try:
        return {one.run: sum((_force(law, one) for law in forces), np.zeros((len(one.times), 3))) for one in replays}
    except KeyError:
        return {}


def _force(law: ForceLaw, replay: RunReplay) -> Float[np.ndarray, "n 3"]:
    theta = replay.pose[:, 2] - replay.skid_angle
    known = {**replay.track.variables, "theta": theta, **dict(zip("uwr", replay.velocity.T, strict=True))}
    known |= {name: float(value) for name, value in law.values().items()}
    part = dict.fromkeys(("X", "Y", "N", "east", "north"), np.zeros(len(theta)))
    for name, tree in law.formulas.items():
        part[name] = part[name] + evaluated(tree, known, np)
    c, s = np.cos(theta), np.sin(theta)
    along, across = c * part["east"] + s * part["north"], c * part["north"] - s * part["east"]
    return np.stack([part["X"] + along, part["Y"] + across, part["N"]], axis=1)
