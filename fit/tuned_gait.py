"""How far can the paper's boards go? Gaits tuned by gradient, at the limits that the paper's forward gait keeps to.

    python fit/tuned_gait.py [FOLDER]

On the recorded board of `data/level-board`: distance in 8 s against the paper's forward gait, and a pose reached in
20 s. On Table II, which hardly grips: the distance in 8 s, beside the most that its tyre could give. Figures go into
FOLDER (default `docs/gallery`). Takes some five minutes.
"""

import sys
from pathlib import Path
from typing import NamedTuple

import snakejax as sj

sj.prepare_jax()

import numpy as np  # noqa: E402

from snakejax.core.files import write_whole  # noqa: E402
from snakejax.present import plot  # noqa: E402
from snakejax.present.as_json.design import tuned_json  # noqa: E402
from snakejax.present.as_json.values import as_text  # noqa: E402
from snakejax.present.as_text.errors import missed_text  # noqa: E402

DATA = Path(__file__).resolve().parents[1] / "data"
LIMITS = {"phi": 0.916, "psi": 1.57, "phi_rate": 3.664, "psi_rate": 6.28}
"""The commands of the paper's forward gait: 0.916 sin 4t and 1.570 sin 4t."""
PHI, PSI = [[0.916, 4.0, 0.0]], [[1.57, 4.0, 0.0]]
POSE = (0.5, 0.3, 1.0)


class Gaits(NamedTuple):
    """What was found; `paper`, the distance [m] of the paper's forward gait as it is on each board; `bound`, the
    distance [m] that the tyre of Table II would give if it pushed as hard as it can all the time.
    """

    distance: sj.TuningResult
    reach: sj.TuningResult
    table_ii: sj.TuningResult
    paper: tuple[float, float]
    bound: float


def main(folder: Path, **how) -> Gaits:
    """Tunes all three and writes the figures."""
    case = sj.load_case(DATA / "level-board")
    board = sj.estimation.fit(sj.starting_model(case), case.runs, sj.noise_of(case)).model
    example = sj.preset("paper-forward")
    forward, limits = example.gait, sj.Limits.of(LIMITS)
    how = {"driver": sj.Controller.of(forward), "given": [forward], **how}

    far = sj.design.tune(board, sj.Distance(), limits, 8.0, **how)
    there = sj.design.tune(board, sj.Reach(*POSE), limits, 20.0, **how)
    weak = sj.design.tune(example.model, sj.Distance(), limits, 8.0, **how)

    paper = (gone(board, forward, 8.0), gone(example.model, forward, 8.0))
    hardest = float(example.model.tyre.force(np.asarray(np.pi / 2), np.asarray(1.0)))
    push = hardest * np.sin(LIMITS["phi"]) / float(example.model.board.mass)
    found = Gaits(far, there, weak, paper, float(push * 8.0**2 / 2))
    named = {"distance": far, "reach": there, "table_ii": weak}
    for name, tuned in named.items():
        asked = "reach:0.5,0.3,1" if name == "reach" else "distance"
        result = {"case": "Table II" if name == "table_ii" else "level-board", **tuned_json(tuned, asked, "fit")}
        plot.save(plot.tuned(result), folder, f"tuned_{name}")
        write_whole(folder / f"tuned_{name}.json", as_text(result))
    tell(found)
    return found


def gone(model: sj.Model, gait: sj.Gait, seconds: float) -> float:
    """The distance [m] from start to end."""
    pose = np.asarray(sj.simulate(model, gait, [0.0, seconds]).pose)
    return float(np.hypot(*(pose[-1, :2] - pose[0, :2])))


def tell(found: Gaits) -> None:
    """What was found, in words."""
    far, weak = found.distance.after.result, found.table_ii.after.result
    print(f"level-board, 8 s: {far:.3f} m, the paper's forward gait {found.paper[0]:.3f} m")
    print(f"  {100 * (far / found.paper[0] - 1):.0f} % further, within the limits of its commands")
    print(f"level-board, 20 s, pose {POSE}: missed by {missed_text(found.reach.after.result)}")
    print(f"Table II, 8 s: {weak:.3f} m, the paper's forward gait {found.paper[1]:.3f} m; at most {found.bound:.2f} m")
    for name, tuned in found._asdict().items():
        if isinstance(tuned, sj.TuningResult):
            print(f"{name}: {tuned.simulations} simulations, {tuned.slopes} with derivative; {tuned.terms()}")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).resolve().parents[1] / "docs" / "gallery")
