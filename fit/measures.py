"""How well a board must be measured: what an error of 1% in each of its measures does to a fit.

    python fit/measures.py [FILE]

Fits the tyre of `data/level-board` once with the right measures and once with each 1% too large, and writes the errors
that are left into FILE (default `docs/measures.json`), from which the documentation makes its table. About 10 minutes.
"""

import sys
from pathlib import Path
from typing import Any

import snakejax as sj

sj.prepare_jax()

import equinox as eqx  # noqa: E402
import numpy as np  # noqa: E402

from snakejax.core.files import write_whole  # noqa: E402
from snakejax.core.parameter import parameters, with_parameters  # noqa: E402
from snakejax.present.as_json.values import as_text  # noqa: E402

ROOT = Path(__file__).resolve().parents[1]
ERROR = 0.01
MEASURES = {
    "mass_kg": ("mass",),
    "inertia_kgm2": ("inertia",),
    "rotor_inertia_kgm2": ("rotor_inertia",),
    "half_length_m": ("half_length",),
    "wheelset_inertia_kgm2": ("wheelset_inertia",),
    "mass and both inertias": ("mass", "inertia", "rotor_inertia"),
}


def main(file: Path) -> None:
    """Fits with each measure wrong, and writes what they leave."""
    case = sj.load_case(ROOT / "data" / "level-board")
    right = sj.starting_model(case)
    # The yaw inertia is m L^2 unless it is given; here it is given, so that mass and length are wrong by themselves.
    inertia = np.asarray(float(right.board.total_inertia))
    right = eqx.tree_at(lambda m: m.board.inertia, right, inertia, is_leaf=lambda leaf: leaf is None)
    rows = {"none": row(case, right)}
    for key, names in MEASURES.items():
        values = {f"board.{name}": (1 + ERROR) * float(parameters(right)[f"board.{name}"].value) for name in names}
        rows[key] = row(case, with_parameters(right, values))
        print(key, rows[key], flush=True)
    write_whole(file, as_text({"error": ERROR, "case": case.name, "measures": rows}))


def row(case: sj.Case, model: sj.Model) -> dict[str, Any]:
    """What a fit of `model` leaves, and its tyre."""
    fit = sj.estimation.fit(model, case.runs, sj.noise_of(case))
    assert fit.heldout_score is not None
    return {
        "train": {"position_m": fit.train_score.position_m, "misfit": fit.train_score.misfit},
        "heldout": {"position_m": fit.heldout_score.position_m, "misfit": fit.heldout_score.misfit},
        "tyre": {name.removeprefix("tyre."): {"value": e.value, "sd": e.sd} for name, e in fit.estimates.items()},
        "converged": fit.converged,
    }


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else ROOT / "docs" / "measures.json")
