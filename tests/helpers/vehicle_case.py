"""Cases of any vehicle, made up: a folder with case.toml, input logs held between samples, and noisy poses."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from snakejax.dynamics.inputs import Inputs
from snakejax.dynamics.model import Model
from snakejax.dynamics.sampled_signals import Held
from snakejax.dynamics.signals import AbstractSignal, Sines
from snakejax.recording.case_vehicle import key_of
from snakejax.simulation.integrate import simulate

POSITION, HEADING = 2e-4, 5e-4
FRAME, COMMAND = 0.02, 0.1
"""Time between frames and between commands [s]."""

Commands = Mapping[str, np.ndarray]
"""By input: its levels (k,), each held for `COMMAND`, or its terms (k, 3), a sin(w t + p) summed."""

Runs = Mapping[str, tuple[Commands, tuple[float, ...]]]
"""The commands and the start of runs by name."""


def steps(rng: np.random.Generator, seconds: float, low: float, high: float, every: float = 0.6) -> np.ndarray:
    """Random levels that last `every` [s], one value for each command."""
    levels = rng.uniform(low, high, int(seconds / every) + 2)
    return levels[(np.arange(round(seconds / COMMAND) + 1) * COMMAND / every).astype(int)]


def signal_of(values: np.ndarray) -> AbstractSignal:
    """The signal of one of the `Commands`."""
    return Held.of(COMMAND * np.arange(len(values)), values) if values.ndim == 1 else Sines.of(values)


@eqx.filter_jit
def _pose(truth: Model, inputs: Inputs, start: tuple[jax.Array, ...], times: jax.Array) -> jax.Array:
    return simulate(truth, inputs, times, start).pose


def poses(truth: Model, runs: Runs, seconds: float) -> list[np.ndarray]:
    """The pose (n, 3) of each run, one every `FRAME`, without noise."""
    times = jnp.asarray(FRAME * np.arange(round(seconds / FRAME)))
    model = jax.tree.map(jnp.asarray, truth)
    every = [
        (Inputs({key: signal_of(values) for key, values in commands.items()}), tuple(map(jnp.asarray, start)))
        for commands, start in runs.values()
    ]
    return [np.asarray(_pose(model, inputs, start, times)) for inputs, start in every]


def write_case(
    folder: Path,
    kind: str,
    constants: Mapping[str, float | str],
    truth: Model,
    runs: Runs,
    seconds: float,
    seed: int | Sequence[int] = 1,
) -> Path:
    """A case of `truth`, which slips, in `folder`: `runs` of so many `seconds` by name with commands and start; those
    called "held..." are not fitted. `seed`: of the noise."""
    rng = np.random.default_rng(seed)
    folder.mkdir(parents=True, exist_ok=True)
    units = {
        f: p.metadata["domain"].unit
        for f, p in type(truth.board).__dataclass_fields__.items()
        if "domain" in p.metadata
    }
    lines = ['skid = "free"', "[vehicle]", f'kind = "{kind}"']
    lines += [f"{key_of(f, units[f])} = {v!r}".replace("'", '"') for f, v in constants.items()]
    lines += ["[noise]", f"position_m = {POSITION}", f"heading_rad = {HEADING}"]
    for (name, (commands, start)), pose in zip(runs.items(), poses(truth, runs, seconds), strict=True):
        pose = pose + rng.normal(size=pose.shape) * [POSITION, POSITION, HEADING]
        table = np.column_stack([FRAME * np.arange(len(pose)), pose])
        np.savetxt(folder / f"{name}.csv", table, "%.7f", ",", header="time_s,x_m,y_m,heading_rad", comments="")
        role = "heldout" if name.startswith("held") else "train"
        moving = 'start = "moving"' if len(start) == 6 else 'start = "rest"'
        lines += ["[[runs]]", f'role = "{role}"', f'mocap = "{name}.csv"', 'object = "body"', moving]
        levels = {key: values for key, values in commands.items() if values.ndim == 1}
        lines += [f"{key} = {values.tolist()!r}" for key, values in commands.items() if values.ndim == 2]
        if levels:
            log = np.column_stack([COMMAND * np.arange(len(next(iter(levels.values())))), *levels.values()])
            header = ",".join(["time_s", *levels])
            np.savetxt(folder / f"{name}-log.csv", log, "%.6f", ",", header=header, comments="")
            lines += [f'joint_log = {{file = "{name}-log.csv", kind = "commanded", hold = true}}']
    (folder / "case.toml").write_text("\n".join(lines) + "\n", encoding="utf-8")
    return folder
