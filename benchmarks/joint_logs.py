"""How often the stated intervals cover the truth where the joints come from noisy logs on clocks of their own.

    python benchmarks/joint_logs.py [BOARDS]

The boards are synthetic, with three train runs of 6 s each. The true motion of the joints is logged with noise, on a
clock up to 0.3 s ahead of that of the cameras or behind it. The fit estimates tyre and clocks. Each board adds a line
to `joint_logs.jsonl`, where a stopped run continues. The table then shows how many estimates lie within 1.96 and
within 3 of their standard errors, and the same for these recordings with exactly known joints.
"""

import json
import sys
from pathlib import Path
from typing import Any

from snakejax import prepare_jax

prepare_jax()

import boards  # noqa: E402
import equinox as eqx  # noqa: E402
import numpy as np  # noqa: E402

from snakejax import Case, fit_logged, starting_model  # noqa: E402
from snakejax.core.errors import FitError, InputError  # noqa: E402
from snakejax.core.parameter import parameters  # noqa: E402
from snakejax.dynamics.inputs import Gait  # noqa: E402
from snakejax.dynamics.signals import AbstractSignal, Logged  # noqa: E402
from snakejax.recording.quality import angles, smoothed, with_log_clock  # noqa: E402
from snakejax.recording.run import LogClock, Run  # noqa: E402

BOARDS = 15
KNOWN = None
LOGS = (KNOWN, (100.0, 0.0), (100.0, 5e-4), (100.0, 2e-3))
"""Samples a second, and the noise of one logged angle [rad]: none, that of a good encoder, or of a poor one."""
FARTHEST = 0.3


def logged(signal: AbstractSignal, clock: LogClock, rate: float, noise: float, rng: np.random.Generator) -> Logged:
    """A joint as its log tells it once `clock` is corrected; a second before the start and after the end are in it."""
    times = np.arange(-1.0, boards.SECONDS + 1.0, 1 / rate)
    seen = angles(signal, times) + noise * rng.normal(size=times.shape)
    shown = times + clock.offset
    return Logged.of(shown, *smoothed(shown, seen, starts=True))


def with_log(run: Run, clock: LogClock, rate: float, noise: float, rng: np.random.Generator) -> Run:
    """`run` with logged joints, whose clock nobody knows."""
    gait = Gait(*(logged(signal, clock, rate, noise, rng) for signal in (run.gait.phi, run.gait.psi)))
    run = eqx.tree_at(lambda r: r.gait, run, gait)
    return with_log_clock(run, LogClock(free=("offset",)), clock.offset - 1.0)


def tried(board: int, log: tuple[float, float] | None) -> dict[str, Any]:
    """By estimate, how many of its standard errors it is from the truth."""
    made = boards.make(6000 + board, boards.STRUCTURES[board % 2])
    rng = np.random.default_rng([6000, board])
    case: Case = boards.case(made, 6000 + board)
    clocks = {run.name: LogClock(rng.uniform(-FARTHEST, FARTHEST)) for run in case.having("train")}
    runs = list(case.having("train"))
    if log is not KNOWN:
        runs = [with_log(run, clocks[run.name], *log, rng) for run in runs]
    found = fit_logged(starting_model(case), runs, boards.NOISE)
    known = parameters(made.model)
    away = {
        name: (estimate.value - float(known[name].value)) / estimate.sd
        for name, estimate in found.estimates.items()
        if estimate.determined
    }
    for run in found.recordings if log is not KNOWN else ():
        away[f"clock {run.name}"] = (run.log.offset - clocks[run.name].offset) / run.log.offset_sd
    return {"away": away, "misfit": found.train_score.misfit}


def table(lines: list[dict[str, Any]]) -> None:
    """How often the intervals cover the truth."""
    for log in LOGS:
        mine = [line for line in lines if _log_of(line) == log]
        away = [line["away"] for line in mine if "away" in line]
        failed = len(mine) - len(away)
        what = "joints known exactly" if log is KNOWN else f"logs of {log[0]:g} Hz with noise {log[1]:g} rad"
        print(f"{what}, {len(away)} boards, {failed} not fitted")
        for kind in ("tyre",) if log is KNOWN else ("tyre", "clock"):
            z = np.abs([value for one in away for name, value in one.items() if name.startswith(kind)])
            inside = (
                f"{100 * (z < 1.96).mean():5.1f} % within 1.96 standard errors, {100 * (z < 3).mean():5.1f} % within 3"
            )
            print(f"  {kind:5}  {z.size:4d} estimates: {inside}, worst {z.max():.1f}")


def _log_of(line: dict[str, Any]) -> tuple[float, float] | None:
    return KNOWN if line["log"] is KNOWN else tuple(line["log"])


def main(count: int) -> None:
    path = Path(__file__).with_suffix(".jsonl")
    lines = [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []
    done = {(line["board"], _log_of(line)) for line in lines}
    for board in range(count):
        for log in LOGS:
            if (board, log) in done:
                continue
            try:
                line = {"board": board, "log": log, **tried(board, log)}
            except (InputError, FitError) as error:  # A board whose clocks cannot be told is a result too.
                line = {"board": board, "log": log, "error": str(error)}
            lines.append(line)
            with path.open("a") as file:
                file.write(json.dumps(line) + "\n")
    table(lines)


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else BOARDS)
