"""Cases of any vehicle, made up: a folder with case.toml, input logs held between samples, and noisy poses."""

from collections.abc import Mapping
from pathlib import Path

import jax.numpy as jnp
import numpy as np

from snakejax.dynamics.inputs import Inputs
from snakejax.dynamics.model import Model
from snakejax.dynamics.sampled_signals import Held
from snakejax.recording.case_vehicle import key_of
from snakejax.simulation.integrate import simulate

POSITION, HEADING = 2e-4, 5e-4
FRAME, COMMAND = 0.02, 0.1
"""Time between frames and between commands [s]."""

Commands = Mapping[str, np.ndarray]


def steps(rng: np.random.Generator, seconds: float, low: float, high: float, every: float = 0.6) -> np.ndarray:
    """Random levels that last `every` [s], one value for each command."""
    levels = rng.uniform(low, high, int(seconds / every) + 2)
    return levels[(np.arange(round(seconds / COMMAND) + 1) * COMMAND / every).astype(int)]


def write_case(
    folder: Path,
    kind: str,
    constants: Mapping[str, float | str],
    truth: Model,
    runs: Mapping[str, tuple[Commands, tuple[float, ...]]],
    skid: str = "free",
) -> Path:
    """A case of `truth` in `folder`: `runs` by name with commands and start; those called "held..." are not fitted."""
    rng = np.random.default_rng(1)
    folder.mkdir(parents=True, exist_ok=True)
    units = {
        f: p.metadata["domain"].unit
        for f, p in type(truth.board).__dataclass_fields__.items()
        if "domain" in p.metadata
    }
    lines = [f'skid = "{skid}"', "[vehicle]", f'kind = "{kind}"']
    lines += [f"{key_of(f, units[f])} = {v!r}".replace("'", '"') for f, v in constants.items()]
    lines += ["[noise]", f"position_m = {POSITION}", f"heading_rad = {HEADING}"]
    for name, (commands, start) in runs.items():
        at = np.arange(len(next(iter(commands.values())))) * COMMAND
        inputs = Inputs({key: Held.of(at, values) for key, values in commands.items()})
        times = np.arange(round(at[-1] / FRAME)) * FRAME
        pose = np.asarray(simulate(truth, inputs, jnp.asarray(times), start).pose)
        pose = pose + rng.normal(size=pose.shape) * [POSITION, POSITION, HEADING]
        table = np.column_stack([times, pose])
        np.savetxt(folder / f"{name}.csv", table, "%.7f", ",", header="time_s,x_m,y_m,heading_rad", comments="")
        log = np.column_stack([at, *commands.values()])
        np.savetxt(folder / f"{name}-log.csv", log, "%.6f", ",", header=",".join(["time_s", *commands]), comments="")
        role = "heldout" if name.startswith("held") else "train"
        moving = 'start = "moving"' if len(start) == 6 else 'start = "rest"'
        lines += ["[[runs]]", f'role = "{role}"', f'mocap = "{name}.csv"', 'object = "body"', moving]
        lines += [f'joint_log = {{file = "{name}-log.csv", kind = "commanded", hold = true}}']
    (folder / "case.toml").write_text("\n".join(lines) + "\n", encoding="utf-8")
    return folder
