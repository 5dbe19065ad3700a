"""Tuning by gradient against searches without gradients: the distance that a board covers in 8 s, tuned by
`snakejax.tune`, CMA-ES (`cma`) and scipy's differential evolution, on the same simulator, unknowns and limits, in one
run.

    python benchmarks/tune.py [TIMES]

The searches have no constraints: each gait they try is made smaller until it keeps to the limits, by the same proven
bounds. They may simulate TIMES (default 10) as often as `tune` with its eight starts did. `tune` runs with fewer starts
too, and for each of its results the table says after how many seconds a search comes as far. Needs the extra `bench`.
"""

import sys
import time
from collections.abc import Callable
from pathlib import Path

import snakejax as sj

sj.prepare_jax()

import cma  # noqa: E402
import equinox as eqx  # noqa: E402
import jax  # noqa: E402
import jax.numpy as jnp  # noqa: E402
import numpy as np  # noqa: E402
from scipy.optimize import differential_evolution  # noqa: E402

from snakejax.design.gait_families import scaled  # noqa: E402
from snakejax.design.limits import COARSE, QUANTITIES, Limits, clipped, reached  # noqa: E402
from snakejax.design.rollouts import RolloutSpec, rollout_jacobian, rollouts  # noqa: E402
from snakejax.design.tuning import TERMS, band  # noqa: E402

DATA = Path(__file__).resolve().parents[1] / "data"
TYRE = dict(B=6.0, C=1.4, D=6.0, E=0.3)
LIMITS = Limits.of({"phi": 0.916, "psi": 1.57, "phi_rate": 3.664, "psi_rate": 6.28})
SECONDS = 8.0
POPULATION = 32
STARTS = (1, 2, 4, 8)


class Counted:
    """The distance of many gaits at once, made feasible; counts simulations and keeps the best so far."""

    def __init__(self, model: sj.Model, spec: RolloutSpec) -> None:
        self.model, self.spec, self.count, self.best, self.history = model, spec, 0, 0.0, []
        self.low, self.high = spec.shape.bounds()
        self.began = time.perf_counter()

    def __call__(self, unknowns: np.ndarray) -> np.ndarray:
        rows = np.clip(unknowns, self.low, self.high)
        filled = np.concatenate([rows, np.repeat(rows[-1:], -len(rows) % POPULATION, axis=0)])
        found = np.concatenate(
            [
                _far(self.model, self.spec, jnp.asarray(filled[k : k + POPULATION]))
                for k in range(0, len(filled), POPULATION)
            ]
        )[: len(rows)]
        found = np.where(np.isfinite(found), found, 0.0)
        self.count += len(rows)
        self.best = max(self.best, float(found.max()))
        self.history.append((self.count, self.best, time.perf_counter() - self.began))
        return -found

    def at(self, count: int) -> float:
        """The best after `count` simulations."""
        return max((best for done, best, _ in self.history if done <= count), default=0.0)

    def reached(self, distance: float) -> float | None:
        """How many seconds it took to come so far."""
        return next((seconds for _, best, seconds in self.history if best >= distance), None)


@eqx.filter_jit
def _far(model: sj.Model, spec: RolloutSpec, unknowns):
    def one(z):
        command = spec.shape.gait(z)
        most = {name: [] for name in LIMITS.names}
        for name, signal in clipped(model, spec.driver.driven(command)):
            values = reached(signal, SECONDS, COARSE)
            for q, part in zip(QUANTITIES, values, strict=True):
                most[name].append(jnp.max(part) / LIMITS.named()[name + q])
        factors = {name: 1 / jnp.maximum(1.0, jnp.max(jnp.stack(parts))) for name, parts in most.items()}
        gait = sj.Gait(scaled(command.phi, factors["phi"]), scaled(command.psi, factors["psi"]))
        pose = sj.simulate(
            model, spec.driver.driven(gait), spec.times, spec.start,
            accuracy=sj.Accuracy(rtol=1e-6, atol=1e-8, derivative="forward"), throw=False,
        ).pose  # fmt: skip
        return jnp.hypot(*(pose[-1, :2] - pose[0, :2]))

    return jax.vmap(one)(unknowns)


def main(times: float) -> None:
    """Prints the table."""
    case = sj.load_case(DATA / "level-board")
    model = sj.Model(case.board, sj.Pacejka(**TYRE), "free")
    driver = sj.Controller.of(case.runs[0].gait)
    shape = sj.SumsOfSines((LIMITS["phi"].angle, LIMITS["psi"].angle), band(LIMITS, SECONDS), TERMS)
    spec = RolloutSpec(shape, driver, jnp.array([0.0, SECONDS]), jnp.zeros(3), False)

    sj.design.tune(model, sj.Distance(), LIMITS, SECONDS, driver=driver, starts=1, most=1)  # compiled
    tuned, seconds = {}, {}
    for starts in STARTS:
        began = time.perf_counter()
        tuned[starts] = sj.design.tune(model, sj.Distance(), LIMITS, SECONDS, driver=driver, starts=starts)
        seconds[starts] = time.perf_counter() - began
    ours = tuned[max(STARTS)]
    budget = int(times * ours.simulations)

    far = Counted(model, spec)
    far(np.array([shape.guess(np.random.default_rng(0))]))
    evolving = Counted(model, spec)
    rng, round_ = np.random.default_rng(0), 0
    while evolving.count < budget:
        # Restarts from further guesses, as `tune` has several starts.
        options = dict(popsize=POPULATION, verbose=-9, seed=round_ + 1, bounds=list(map(list, shape.bounds())))
        guesses = np.array([np.clip(shape.guess(rng), *shape.bounds()) for _ in range(POPULATION)])
        first = guesses[int(np.argmin(evolving(guesses)))]
        search, round_ = cma.CMAEvolutionStrategy(first, 0.2, options), round_ + 1
        while not search.stop() and evolving.count < budget:
            asked = search.ask()
            search.tell(asked, evolving(np.array(asked)).tolist())

    differing = Counted(model, spec)
    guesses = np.array([np.clip(shape.guess(rng), *shape.bounds()) for _ in range(4 * POPULATION)])
    differential_evolution(
        lambda x: differing(x.T), list(zip(*shape.bounds(), strict=True)), init=guesses, seed=0, polish=False,
        vectorized=True, updating="deferred", tol=0.0, maxiter=max(budget // len(guesses) - 1, 1),
    )  # fmt: skip

    z = jnp.asarray(guesses[0])
    slow, quick = _each(lambda: rollout_jacobian(model, spec, z), lambda: rollouts(model, spec, z[None]))
    print(
        f"distance in {SECONDS:g} s; a simulation with its {shape.size} derivatives takes {slow / quick:.1f} plain ones"
    )
    print(f"{'':26}{'distance [m]':>14}{'simulations':>13}{'seconds':>9}   as far: CMA-ES, differential evolution")
    for starts, one in tuned.items():
        later = [_later(other.reached(one.after.result), seconds[starts]) for other in (evolving, differing)]
        name, far = f"tune, starts: {starts}", one.after.result
        print(f"{name:26}{far:14.4f}{one.simulations:13d}{seconds[starts]:9.1f}   {', '.join(later)}")
    for name, other in (("CMA-ES", evolving), ("differential evolution", differing)):
        print(f"{name:26}{other.best:14.4f}{other.count:13d}{other.history[-1][-1]:9.1f}")
        print(f"{'  after as many as tune':26}{other.at(ours.simulations):14.4f}{ours.simulations:13d}")


def _later(seconds: float | None, ours: float) -> str:
    return "never" if seconds is None else f"{seconds:.1f} s ({seconds / ours:.1f} times)"


def _each(*calls: Callable[[], object], count: int = 60) -> list[float]:
    """The median seconds of each of some calls, which take turns."""
    seconds = []
    for _ in range(count):
        seconds.append([])
        for call in calls:
            began = time.perf_counter()
            jax.block_until_ready(call())
            seconds[-1].append(time.perf_counter() - began)
    return np.median(seconds, axis=0).tolist()


if __name__ == "__main__":
    main(float(sys.argv[1]) if len(sys.argv) > 1 else 10.0)
