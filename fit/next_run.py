"""Which run to do next: five pairs of effects that the runs of `data/level-board` hardly tell apart.

    python fit/next_run.py [FOLDER]

For each pair: the strength at which the given runs are right in 70 % of the cases, the gait that tells the two apart
best, and the proof. Recordings are made up with one of the effects or the other, fitted with either, and the better fit
is taken for the answer; first the given runs alone, then with the designed one. Takes some 10 minutes; figure and
table go into FOLDER (default `docs/gallery`).
"""

import sys
from pathlib import Path
from typing import NamedTuple

import snakejax as sj

sj.prepare_jax()

import jax.numpy as jnp  # noqa: E402
import numpy as np  # noqa: E402
from matplotlib.figure import Figure  # noqa: E402

from snakejax.core.files import write_whole  # noqa: E402
from snakejax.core.parameter import with_parameters  # noqa: E402
from snakejax.effects import LIBRARY  # noqa: E402
from snakejax.estimation.block_linearisation import linearise_runs  # noqa: E402
from snakejax.estimation.problem import Problem  # noqa: E402
from snakejax.estimation.replay import replay  # noqa: E402
from snakejax.present import plot  # noqa: E402
from snakejax.present.as_json.values import as_text  # noqa: E402

DATA = Path(__file__).resolve().parents[1] / "data"
PAIRS = (
    ("body_drag", "longitudinal_slip"),
    ("steering_lag", "rotor_lag"),
    ("rolling_resistance", "yaw_friction"),
    ("yaw_damping", "yaw_friction"),
    ("longitudinal_slip", "rolling_resistance"),
)
SECONDS = 8.0
LIMITS = {"phi": 0.916, "psi": 1.57, "phi_rate": 3.664, "psi_rate": 6.28}
"""Those of the paper's forward gait, a little below what the recorded runs use."""


class Proof(NamedTuple):
    """A pair, its design, how many designed runs were made up, and the share of right answers of fits to made-up
    recordings, from the given runs alone and with the designed ones.
    """

    design: sj.DiscriminationDesign
    runs: int
    given: float
    designed: float
    trials: int


def main(folder: Path, pairs=PAIRS, trials: int = 200, **how) -> list[Proof]:
    """Designs and proves every pair; writes figure and table."""
    case = sj.load_case(DATA / "level-board")
    noise = sj.noise_of(case)
    fit = sj.estimation.fit(sj.starting_model(case), case.runs, noise)
    proofs = []
    # All candidates in one model, so that all pairs share what is compiled.
    known = sj.prior_information(fit, {name: LIBRARY[name]() for pair in pairs for name in pair})
    driver = sj.Controller.of(case.runs[0].gait)
    for pair in pairs:
        design = sj.design_discrimination(
            known, pair, sj.Limits.of(LIMITS), SECONDS, case.runs, driver=driver, given=_gaits(case), **how
        )
        proofs.append(proved(fit, known, design, trials))
        print(_row(proofs[-1]), flush=True)
    write_whole(folder / "next_run.json", as_text([_as_json(proof) for proof in proofs]))
    plot.save(drawn(proofs), folder, "next_run")
    return proofs


def _gaits(case: sj.Case) -> list:
    return [run.gait for run in case.having("train")]


def proved(fit: sj.Fit, known: sj.PriorInformation, design: sj.DiscriminationDesign, trials: int) -> Proof:
    """The share of right answers of fits to recordings that are made up with either effect.

    The recordings are simulated, with all that is not linear in them. So near the base the fits are linear: one
    Gauss-Newton step from there, every start, the tyre and one effect free, its sign held.
    """
    noise, count = fit.fitted.noise, max(design.repeats or 1, 1)
    train = [run for run in fit.recordings if run.role == "train"]
    frames = jnp.asarray(np.arange(round(design.tuned.seconds * 100) + 1) / 100)
    blank = jnp.zeros((frames.size, 3))
    new = [sj.Run(f"designed-{k}", "train", frames, blank, design.tuned.after.gait) for k in range(count)]
    runs, starts = [*train, *new], np.zeros((len(train) + count, 3))
    starts[: len(train)] = fit.fitted.starts[fit.fitted.numbered("train")][:, :3]
    problem = Problem.of(known.model, runs, noise, known.names, len(known.names))
    weight = np.asarray(problem.batch.weight)

    def whitened(poses) -> np.ndarray:
        whole = np.zeros_like(weight)
        for k, pose in enumerate(poses):
            whole[k, : len(pose)] = pose
        return whole * weight

    base = whitened(replay(known.model, runs, starts))
    J = -linearise_runs(problem, problem.values(), starts, range(len(runs))).jacobian
    rng, right = np.random.default_rng(1), np.zeros(2)
    for truth in design.effects:
        part = {known.names[k]: design.strengths[known.names[k]] for k in known.places[truth]}
        shift = whitened(replay(with_parameters(known.model, part), runs, starts)) - base
        for seen, label in ((range(len(train)), 0), (range(len(runs)), 1)):
            left = _Left(J, seen, known)
            for _ in range(trials):
                data = [shift[k] + (weight[k] > 0) * rng.standard_normal(shift[k].shape) for k in seen]
                chi2 = {name: left.after(np.concatenate([d.ravel() for d in data]), name) for name in design.effects}
                right[label] += min(chi2, key=chi2.__getitem__) == truth
    given, designed = right / (2 * trials)
    return Proof(design, count, float(given), float(designed), 2 * trials)


class _Left:
    """What a linear fit of the tyre, the starts and one effect leaves of the runs `seen`."""

    def __init__(self, J: np.ndarray, seen, known: sj.PriorInformation) -> None:
        names, rows = len(known.names), J[0, ..., 0].size
        starts = np.zeros((rows * len(seen), 3 * len(seen)))
        for place, k in enumerate(seen):
            starts[place * rows : (place + 1) * rows, 3 * place : 3 * place + 3] = J[k].reshape(rows, -1)[:, names:]
        columns = np.concatenate([J[k].reshape(rows, -1)[:, :names] for k in seen])
        self.q = np.linalg.qr(np.append(starts, columns[:, : known.tyre], axis=1))[0]
        self.effects = {name: columns[:, list(places)] for name, places in known.places.items()}
        self.effects = {name: E - self.q @ (self.q.T @ E) for name, E in self.effects.items()}

    def after(self, data: np.ndarray, effect: str) -> float:
        """chi^2 with `effect`, whose one parameter cannot be negative, beside that without it."""
        (column,) = self.effects[effect].T
        return -float(max(column @ data, 0.0) ** 2 / (column @ column))


def _row(proof: Proof) -> str:
    design = proof.design
    strengths = ", ".join(f"{n.removeprefix('effects.')} {v:.2g}" for n, v in design.strengths.items())
    best = design.advice[0]
    return (
        f"| {design.effects[0]} or {design.effects[1]} | {strengths} | {100 * design.before:.0f} % | "
        f"{100 * proof.given:.0f} % | {100 * best.certainty:.0f} % ({best.do}) | {100 * design.after:.1f} % | "
        f"{proof.runs} | {100 * proof.designed:.1f} % |"
    )


def _as_json(proof: Proof) -> dict:
    design = proof.design
    return {
        "effects": design.effects,
        "strengths": design.strengths,
        "gait": design.tuned.terms(),
        "expected": {"given": design.before, "designed": design.after},
        "found": {"given": proof.given, "designed": proof.designed, "trials": proof.trials, "runs": proof.runs},
        "advice": [a._asdict() for a in design.advice],
    }


def drawn(proofs: list[Proof]) -> Figure:
    """The share of right answers of each pair: expected as bars, found by fits as dots with their 95 % intervals."""
    figure = Figure(figsize=(8.6, 4.0), layout="constrained")
    axis = figure.subplots()
    places = np.arange(len(proofs))[::-1]
    before = ("0.7", "given runs, expected", [p.design.before for p in proofs], [p.given for p in proofs])
    after = ("#f0a37f", "with one designed run", [p.design.after for p in proofs], [p.designed for p in proofs])
    for shift, (colour, label, expected, found) in ((0.2, before), (-0.2, after)):
        share = np.array(found)
        error = 196 * np.sqrt(np.maximum(share * (1 - share), 0.01) / proofs[0].trials)
        axis.barh(places + shift, 100 * np.array(expected), 0.36, color=colour, label=label)
        dots = {"fmt": "ko", "ms": 4, "lw": 1, "label": None if shift > 0 else "found, with all designed runs"}
        axis.errorbar(100 * share, places + shift, xerr=error, **dots)
    axis.axvline(95, color="0.2", ls=":", lw=1)
    axis.set(xlim=(40, 102), xlabel="right answers [%]", yticks=places)
    axis.set_yticklabels([" or\n".join(p.design.effects) for p in proofs], fontsize="small")
    axis.legend(fontsize="small", loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=3)
    return figure


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).resolve().parents[1] / "docs" / "gallery")
