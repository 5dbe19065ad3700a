"""Other ways to find what a model lacks, on the same recordings: held-out misfit and seconds of each and of ours.

    python benchmarks/peers.py FOLDER [CASE ...]

All start from the same base model (four fitted tyre parameters) and are validated on the same held-out runs, on which
only the start poses are estimated.

AIC       every effect of the library is added to the base and refitted, one at a time; that of the least AIC is kept.
PySINDy   discrepancy model: the acceleration of the smoothed recording minus that of the base model, by sparse
          regression (STLSQ) on polynomials of degree 2 in speeds, joint angles and rates, heading and place. Of five
          thresholds the one whose simulation has the least train misfit is used.
GP        a Gaussian process (scikit-learn, one length scale a variable) from the same variables to the missing force
          that our smoother estimates, on 300 knots, with the tyre of that estimate: how much a force that depends on
          the present state could explain at most.
"""

import math
import statistics
import sys
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import NamedTuple

from snakejax import prepare_jax

prepare_jax()

import equinox as eqx  # noqa: E402
import jax  # noqa: E402
import jax.numpy as jnp  # noqa: E402
import numpy as np  # noqa: E402
import pysindy  # noqa: E402
from scipy.signal import savgol_filter  # noqa: E402
from sklearn.gaussian_process import GaussianProcessRegressor, kernels  # noqa: E402

from snakejax import Accuracy, Force, Model, Motion, load_case, noise_of  # noqa: E402
from snakejax.commands.cli.pipeline import Stopwatch, start_jax  # noqa: E402
from snakejax.core.parameter import with_parameters  # noqa: E402
from snakejax.diagnosis import explain  # noqa: E402
from snakejax.diagnosis.latent_force.missing_force import estimate_latent_force  # noqa: E402
from snakejax.diagnosis.selection.candidates import CandidateFit, CandidateSet  # noqa: E402
from snakejax.diagnosis.selection.refit import base_fit, refit  # noqa: E402
from snakejax.effects import LIBRARY  # noqa: E402
from snakejax.estimation.fit_workspace import fit_heldout_starts  # noqa: E402
from snakejax.estimation.initial_model import starting_model  # noqa: E402
from snakejax.estimation.multiple_shooting import initial_states  # noqa: E402
from snakejax.estimation.problem import Problem  # noqa: E402

CANDIDATES = {name: kind() for name, kind in LIBRARY.items()}
THRESHOLDS = (0.02, 0.05, 0.1, 0.2, 0.4)
ROUGH = Accuracy(rtol=1e-5, atol=1e-7, max_steps=12000, derivative="forward")
"""A regressed force can make a model that no step is small enough for: it is given up, and counts as infinite."""
KNOTS = 300


def variables(motion: Motion) -> jax.Array:
    """What a force may depend on (12,)."""
    phi, psi = motion.steering, motion.rotor
    turn = (jnp.cos(motion.heading), jnp.sin(motion.heading))
    joints = (phi.angle, phi.rate, psi.angle, psi.rate)
    return jnp.stack([motion.u, motion.w, motion.r, *joints, *turn, motion.x, motion.y, motion.wheels[0].lateral])


class Sparse(Force):
    """A wrench that is a polynomial of the scaled variables: `powers` (T, 12), `weights` (T, 3)."""

    scale: jax.Array
    powers: jax.Array
    weights: jax.Array

    def wrench(self, motion: Motion):
        v = variables(motion) / self.scale
        terms = jnp.prod(jnp.where(self.powers == 2, v**2, jnp.where(self.powers == 1, v, 1.0)), axis=1)
        return tuple(jnp.clip(terms @ self.weights, -50.0, 50.0))


class Process(Force):
    """The mean of a Gaussian process for each component: `seen` (K, 12), `length` (3, 12), `weights` (K, 3)."""

    scale: jax.Array
    seen: jax.Array
    length: jax.Array
    weights: jax.Array
    mean: jax.Array

    def wrench(self, motion: Motion):
        v = variables(motion) / self.scale
        far = jnp.sum(((v - self.seen)[None] / self.length[:, None, :]) ** 2, axis=-1)
        return tuple(self.mean + jnp.einsum("ck,kc->c", jnp.exp(-far / 2), self.weights))


@eqx.filter_jit
def _along(model: Model, gait, times, start):
    """Variables (n, 12), and the rates of the state (n, 6), of the model at the states of a recording."""

    def at(t, s):
        state = model.initial_state(tuple(s[k] for k in range(6)), t, gait)
        return variables(model.motion(t, state[0], gait)), jnp.stack(model.rates(t, state, gait)[0])

    return jax.vmap(at)(times, start)


def discrepancy(model: Model, run) -> tuple[np.ndarray, np.ndarray]:
    """Variables (n, 12) along a recorded run, and the wrench (n, 3) that its acceleration has beyond the model's."""
    seen = initial_states(model, run)
    v, rates = (np.asarray(part) for part in _along(model, run.gait, run.times, jnp.asarray(seen)))
    step = float(np.median(np.diff(np.asarray(run.times))))
    m, inertia = float(model.board.mass), float(model.board.total_inertia)
    coupled = type(model.constraint).__name__ == "Coupled"
    # The columns of `initial_states` and of the rates that are u, w, r, or u and s.
    pairs = [(3, 4), (None, None), (5, 5)] if coupled else [(3, 3), (4, 4), (5, 5)]
    wrench = np.zeros((len(seen), 3))
    for k, ((mine, rate), size) in enumerate(zip(pairs, (m, m, inertia), strict=True)):
        if mine is not None:
            wrench[:, k] = size * (savgol_filter(seen[:, mine], 25, 3, deriv=1, delta=step) - rates[:, rate])
    keep = slice(30, -30)
    return v[keep], wrench[keep]


def misfit(model: Model, case, noise, role: str) -> float:
    """Misfit of the runs of `role` under a model as it is, only the starts estimated."""
    found = fit_heldout_starts(Problem.of(model, case.runs, noise, (), 1, ROUGH), {}, role)
    return math.inf if found is None or not np.isfinite(found.misfit) else found.misfit


def by_aic(case, noise, bench: CandidateSet, step: CandidateFit, model: Model) -> tuple[str, float]:
    best = None
    for name, parts in bench.candidates.items():
        try:
            found = refit(bench, (name,), step.solution.values, near=False)
        except RuntimeError:
            continue
        aic = found.misfit * found.samples + 2 * len(parts)
        if np.isfinite(aic) and (best is None or aic < best[0]):
            best = aic, name, found
    assert best is not None
    heldout = fit_heldout_starts(bench.problem, best[2].values)
    return best[1], math.inf if heldout is None else heldout.misfit


def by_sindy(case, noise, bench: CandidateSet, step: CandidateFit, model: Model) -> tuple[str, float]:
    pairs = [discrepancy(model, run) for run in case.having("train")]
    scale = np.sqrt(np.mean(np.concatenate([v for v, _ in pairs]) ** 2, axis=0)) + 1e-9
    size = np.sqrt(np.mean(np.concatenate([w for _, w in pairs]) ** 2, axis=0)) + 1e-9
    best = None
    for threshold in THRESHOLDS:
        library = pysindy.PolynomialLibrary(degree=2)
        optimizer = pysindy.STLSQ(threshold=threshold, alpha=1.0, normalize_columns=False)
        A = library.fit([pairs[0][0] / scale]).transform([v / scale for v, _ in pairs])
        X, y = np.concatenate([np.asarray(a) for a in A]), np.concatenate([w / size for _, w in pairs])
        weights = np.asarray(optimizer.fit(X, y).coef_).T * size
        force = Sparse(jnp.asarray(scale), jnp.asarray(np.asarray(library.powers_)), jnp.asarray(weights))
        train = misfit(model.add(discrepancy=force), case, noise, "train")
        if best is None or train < best[0]:
            best = train, f"{int((weights != 0).sum())} terms, train {train:.3g}", force
    assert best is not None
    return best[1], misfit(model.add(discrepancy=best[2]), case, noise, "heldout")


class Latent(NamedTuple):
    """The missing force that our smoother estimates: `variables` (N, 12), `force` and `sd` (N, 3), the train run of
    each row, and the tyre of that estimate by name."""

    variables: np.ndarray
    force: np.ndarray
    sd: np.ndarray
    run: np.ndarray
    tyre: dict[str, float]


def latent(case, bench: CandidateSet, step: CandidateFit, model: Model) -> Latent:
    """What the ways that regress the missing force start from."""
    missing = estimate_latent_force(bench, step)
    rows = []
    for k, (found, run) in enumerate(zip(missing.runs, case.having("train"), strict=True)):
        v, _ = _along(model, run.gait, run.times, jnp.asarray(initial_states(model, run)))
        at = np.searchsorted(np.asarray(run.times), found.t[1:-1]).clip(0, len(run.times) - 1)
        rows.append((np.asarray(v)[at], found.force[1:-1], found.sd[1:-1], np.full(len(at), k)))
    known = {name: e.value for name, e in missing.estimates.items() if name.startswith("tyre.")}
    return Latent(*(np.concatenate(parts) for parts in zip(*rows, strict=True)), known)


def by_process(case, noise, bench: CandidateSet, step: CandidateFit, model: Model) -> tuple[str, float]:
    known = latent(case, bench, step, model)
    pick = np.random.default_rng(0).permutation(len(known.run))[:KNOTS]
    scale = known.variables.std(axis=0) + 1e-9
    V, F, S = known.variables[pick] / scale, known.force[pick], known.sd[pick]
    length, weights, mean = np.ones((3, V.shape[1])), np.zeros((len(V), 3)), np.zeros(3)
    for k in range(3):
        if not np.isfinite(S[:, k]).all():
            continue
        mean[k], size = F[:, k].mean(), F[:, k].std() + 1e-9
        kernel = kernels.ConstantKernel(1.0) * kernels.RBF(np.full(V.shape[1], 3.0), (0.3, 1e3))
        process = GaussianProcessRegressor(kernel + kernels.WhiteKernel(0.1), alpha=(S[:, k] / size) ** 2)
        process.fit(V, (F[:, k] - mean[k]) / size)
        factor = process.kernel_.k1
        length[k] = factor.k2.length_scale
        weights[:, k] = process.alpha_.ravel() * factor.k1.constant_value * size
    force = Process(*(jnp.asarray(part) for part in (scale, V, length, weights, mean)))
    return judged(model, known, force, case, noise)


def judged(model: Model, known: Latent, force: Force, case, noise, what: str = "") -> tuple[str, float]:
    """Train and held-out misfit of the model with the tyre of `known` and a regressed `force`."""
    model = with_parameters(model, known.tyre).add(residual=force)
    return f"{what}train {misfit(model, case, noise, 'train'):.3g}", misfit(model, case, noise, "heldout")


def ours(case, noise, bench: CandidateSet, step: CandidateFit, model: Model) -> tuple[str, float]:
    found = explain(case, noise, CANDIDATES)
    what = found.verdict + (": " + ", ".join(found.effects) if found.effects else "")
    if found.missing is not None and found.missing.depends_on:
        what += f"; depends on {found.missing.depends_on[0][0]}"
    return what, math.nan if found.final.heldout is None else found.final.heldout.misfit


WAYS = {"snakejax": ours, "AIC": by_aic, "PySINDy": by_sindy, "GP": by_process}


def side_by_side(name: str, case, noise, ways: Mapping[str, Callable]) -> dict[str, tuple[float, float]]:
    """One line for the base of a case and one for each of the `ways`: the held-out misfit and the seconds of each."""
    bench = CandidateSet.of(starting_model(case), case, noise, CANDIDATES)
    step = base_fit(bench)
    model = bench.problem.fitted(step.solution).without(*bench.problem.model.effects)
    heldout = fit_heldout_starts(bench.problem, step.solution.values)
    print(f"{name}: base train {step.solution.misfit:.4g}, held out {heldout.misfit if heldout else math.nan:.4g}")
    results: dict[str, tuple[float, float]] = {}
    for way, work in ways.items():
        clock, begin = Stopwatch(), time.perf_counter()
        try:
            what, left = work(case, noise, bench, step, model)
        except (RuntimeError, ValueError, np.linalg.LinAlgError) as error:
            what, left = f"failed: {str(error)[:60]}", math.nan
        results[way] = left, time.perf_counter() - begin - clock.seconds()["compile"]
        print(f"  {way:9} held out {left:10.4g}   {results[way][1]:6.1f} s   {what}", flush=True)
    return results


def main(folder: Path, names: list[str]) -> None:
    """One line a case and method, and the medians."""
    start_jax()
    seconds: dict[str, list[float]] = {way: [] for way in WAYS}
    for name in names or sorted(path.name for path in folder.iterdir() if (path / "case.toml").exists()):
        case = load_case(folder / name)
        for way, (_, spent) in side_by_side(name, case, noise_of(case), WAYS).items():
            seconds[way].append(spent)
    print("median seconds: " + ", ".join(f"{way} {statistics.median(found):.1f}" for way, found in seconds.items()))


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2:])
