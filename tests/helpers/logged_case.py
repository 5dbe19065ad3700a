"""A bundled case whose joints are logs, each on a clock of its own."""

import shutil
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from helpers.folders import DATA
from snakejax import load_case

LEVEL = DATA / "level-board"


TILTED = DATA / "tilted-floor"


CLOCKS = {
    "train-forward-1": (0.137, 0.0),
    "train-forward-2": (-0.2, 0.0),
    "train-rotate-1": (0.05, 0.0),
    "train-arc-1": (0.4, 1e-3),
    "train-wander-1": (-0.05, 0.0),
    "heldout-reverse-1": (0.11, 0.0),
    "heldout-sweep-1": (-0.31, 0.0),
}


def logged_case(folder: Path, keys: str, names=tuple(CLOCKS), noise: float = 0.0, data: Path = LEVEL) -> Path:
    """The runs `names` of `data`, with the joints' true motion and `noise` [rad] as logs, on the clocks above; `keys`
    say what is known of them.
    """
    rng = np.random.default_rng(1)
    shutil.copytree(data, folder)
    head, *runs = (data / "case.toml").read_text(encoding="utf-8").split("[[runs]]")
    text = head.split("[actuator]")[0]
    times = np.arange(0, 12.5, 0.01)
    for run, part in zip(load_case(data).runs, runs, strict=True):
        if run.name not in names:
            continue
        offset, drift = CLOCKS[run.name]
        joints = [
            np.asarray(jax.vmap(lambda t, s=s: s.at(t).angle)(jnp.asarray(times))) for s in (run.gait.phi, run.gait.psi)
        ]
        # Some time before the start, when the joints stand still.
        at = np.concatenate([times[:100] - 1.0, times]) * (1 + drift) + offset
        table = np.column_stack([at, *(np.concatenate([np.zeros(100), joint]) for joint in joints)])
        table[:, 1:] += noise * rng.normal(size=table[:, 1:].shape)
        rows = "".join(f"{t:.6f},{phi:.9f},{psi:.9f}\n" for t, phi, psi in table)
        (folder / f"{run.name}-joints.csv").write_text("time_s,phi_rad,psi_rad\n" + rows, encoding="utf-8")
        kept = [line for line in part.strip().splitlines() if not line.startswith(("phi", "psi"))]
        log = f'joint_log = {{file = "{run.name}-joints.csv", kind = "measured", {keys}}}'
        text += "\n".join(["[[runs]]", *kept, log, "", ""])
    (folder / "case.toml").write_text(text, encoding="utf-8")
    return folder
