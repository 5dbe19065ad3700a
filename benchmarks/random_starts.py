"""Fits of `data/level-board` from random starts: how many reach the same optimum, and in what time.

    python benchmarks/random_starts.py [NUMBER]

B, C and D start within a factor 3 of the optimum (C below 2, the end of its domain), E within 1 of it. A start counts
as successful if each parameter ends within a tenth of its standard error of the result of the usual start. Ctrl-C
ends the table early.
"""

import contextlib
import sys
import time
from pathlib import Path

import numpy as np

from snakejax import prepare_jax

prepare_jax()

from snakejax.core.errors import FitError  # noqa: E402
from snakejax.estimation.fitting import fitted_workspace  # noqa: E402
from snakejax.estimation.initial_model import starting_model  # noqa: E402
from snakejax.estimation.initialisation import continue_over_horizons  # noqa: E402
from snakejax.recording.case import load_case  # noqa: E402

LEVEL = Path(__file__).resolve().parents[1] / "data" / "level-board"
TYRE = ["tyre.B", "tyre.C", "tyre.D", "tyre.E"]
LETTERS = "BCDE"


def random_start(centre: dict[str, float], seed: int) -> dict[str, float]:
    """B, C, D, E drawn around `centre`."""
    rng = np.random.default_rng(seed)
    factors = 3.0 ** rng.uniform(-1, 1, 3)
    start = {name: centre[name] * f for name, f in zip(TYRE, factors, strict=False)}
    return {**start, "tyre.C": min(start["tyre.C"], 1.95), "tyre.E": min(centre["tyre.E"] + rng.uniform(-1, 1), 0.95)}


def main(number: int) -> None:
    """Print one line a start, and how many arrived."""
    case = load_case(LEVEL)
    workspace = fitted_workspace(starting_model(case), case.runs, case.noise)
    problem, reference = workspace.problem, workspace.result()
    train = problem.run_indices("train")
    best = {name: reference.estimates[name].value for name in TYRE}
    sd = np.array([reference.estimates[name].sd for name in TYRE])
    titles = [f"start {c}" for c in LETTERS] + [f"end {c}" for c in LETTERS]
    usual = ", ".join(f"{name} {value:.5f}" for name, value in best.items())
    print(f"usual start: misfit {reference.train_score.misfit:.6f}, {usual}")
    print("seed " + " ".join(f"{title:>9}" for title in titles) + "    misfit  sd away  seconds", flush=True)
    away, seconds, refused = [], [], 0
    with contextlib.suppress(KeyboardInterrupt):
        for seed in range(number):
            start, begun = random_start(best, seed), time.perf_counter()
            try:
                near = continue_over_horizons(problem, start, TYRE, train)
                solution = problem.fit(near.values, TYRE, train, near.start)
                ends, misfit = [solution.values[name] for name in TYRE], solution.misfit
            except FitError:
                refused += 1
                ends, misfit = [np.nan] * 4, np.nan
            seconds.append(time.perf_counter() - begun)
            away.append(np.abs((np.array(ends) - [best[name] for name in TYRE]) / sd).max())
            numbers = " ".join(f"{v:9.4f}" for v in [*(start[name] for name in TYRE), *ends])
            print(f"{seed:4d} {numbers} {misfit:9.6f} {away[-1]:8.4f} {seconds[-1]:8.2f}", flush=True)
    arrived = int((np.array(away) < 0.1).sum())
    print(f"{arrived} of {len(away)} starts reached the same optimum; {refused} were refused as too stiff to simulate;")
    print(f"seconds a fit: median {np.median(seconds):.2f}, longest {max(seconds):.2f}.")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 50)
