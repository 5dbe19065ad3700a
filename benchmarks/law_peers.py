"""Other ways to a law that no library holds, on boards with a hidden one: held-out misfit and seconds of each.

    python benchmarks/law_peers.py [--ways GP,gplearn] ["STRUCTURE NAME" ...]     default: all ways, all boards

The boards are the strangers of benchmarks/boards.py. Where snakejax is not among the ways, its line is that of the same
board in benchmarks/accuracy.jsonl.

All start from the same base model (four fitted tyre parameters) and are validated on the same held-out runs, on which
only the start poses are estimated. Each line names the variable on which the hidden law depends.

PySINDy   as in benchmarks/peers.py.
GP        as in benchmarks/peers.py: a Gaussian process of the missing force that our smoother estimates.
gplearn   symbolic regression (genetic programming) of each component of that force on the same twelve variables, where
          pysr would need Julia: 2000 formulas in 20 generations, sums, products, quotients, sine, cosine, |x|.
network   a neural residual in equinox: two hidden layers of 16 (tanh) from the same variables to the same force,
          fitted by Levenberg-Marquardt; its weight decay is the one that predicts the last train run best.

The seconds of the last three hold the estimate of that force, which each makes for itself.
"""

import argparse
import json
import statistics
from pathlib import Path

from snakejax import prepare_jax

prepare_jax()

import boards  # noqa: E402
import equinox as eqx  # noqa: E402
import jax  # noqa: E402
import jax.numpy as jnp  # noqa: E402
import numpy as np  # noqa: E402
import optimistix  # noqa: E402
from gplearn.genetic import SymbolicRegressor  # noqa: E402
from peers import Latent, by_process, by_sindy, judged, latent, ours, side_by_side, variables  # noqa: E402

from snakejax import Force, Model, Motion  # noqa: E402
from snakejax.commands.cli.pipeline import start_jax  # noqa: E402
from snakejax.diagnosis.selection.candidates import CandidateFit, CandidateSet  # noqa: E402

WIDTH = 16
DECAYS = (1.0, 10.0, 100.0, 1000.0)
"""Weight decays: standard deviations of the residual for a weight of one."""
FUNCTIONS = {
    "add": jnp.add,
    "sub": jnp.subtract,
    "mul": jnp.multiply,
    "div": lambda a, b: jnp.where(jnp.abs(b) > 0.001, a / jnp.where(jnp.abs(b) > 0.001, b, 1.0), 1.0),
    "sin": jnp.sin,
    "cos": jnp.cos,
    "abs": jnp.abs,
}
"""The functions of gplearn, with its protected quotient."""
ARITY = {"add": 2, "sub": 2, "mul": 2, "div": 2}
Node = str | int | float
"""The name of a function, the index of a variable, or a constant."""


class Formula(Force):
    """A formula of the scaled variables for each component, in prefix notation as gplearn has it."""

    scale: jax.Array
    size: jax.Array
    programs: tuple[tuple[Node, ...], ...] = eqx.field(static=True)

    def wrench(self, motion: Motion):
        v = variables(motion) / self.scale
        values = [jnp.clip(_value(list(program), v), -50, 50) for program in self.programs]
        return tuple(size * value for size, value in zip(self.size, values, strict=True))


def _value(left: list, v: jax.Array) -> jax.Array:
    """The value of the formula at the front of `left`, which is taken off."""
    node = left.pop(0)
    if isinstance(node, str):
        return FUNCTIONS[node](*(_value(left, v) for _ in range(ARITY.get(node, 1))))
    return v[node] if isinstance(node, int) else jnp.asarray(node)


class Network(Force):
    """The wrench that a network gives for the scaled variables."""

    scale: jax.Array
    size: jax.Array
    network: eqx.nn.MLP

    def wrench(self, motion: Motion):
        return tuple(self.size * self.network(variables(motion) / self.scale))


def scales(known: Latent) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Size of the variables (12,), of the force (3,), and which components these runs show (3,)."""
    determined = np.isfinite(known.sd).all(axis=0)
    force = np.where(determined, known.force, 0.0)
    return known.variables.std(axis=0) + 1e-9, force.std(axis=0) + 1e-9, determined


def by_formula(case, noise, bench: CandidateSet, step: CandidateFit, model: Model) -> tuple[str, float]:
    known = latent(case, bench, step, model)
    scale, size, determined = scales(known)
    programs: list[tuple[Node, ...]] = []
    for k in range(3):
        if not determined[k]:
            programs.append((0.0,))
            continue
        search = SymbolicRegressor(
            population_size=2000,
            generations=20,
            function_set=tuple(FUNCTIONS),
            parsimony_coefficient=0.001,
            random_state=0,
        )
        search.fit(known.variables / scale, known.force[:, k] / size[k], sample_weight=1 / known.sd[:, k] ** 2)
        programs.append(tuple(_plain(node) for node in search._program.program))
    return judged(model, known, Formula(jnp.asarray(scale), jnp.asarray(size), tuple(programs)), case, noise)


def _plain(node) -> Node:
    """A node of gplearn: the name of a function, a constant, or the index of a variable, which numpy may have made."""
    return float(node) if isinstance(node, float) else getattr(node, "name", None) or int(node)


def by_network(case, noise, bench: CandidateSet, step: CandidateFit, model: Model) -> tuple[str, float]:
    known = latent(case, bench, step, model)
    scale, size, determined = scales(known)
    V = jnp.asarray(known.variables / scale)
    F = jnp.asarray(np.where(determined, known.force, 0.0) / size)
    weight = jnp.asarray(np.where(determined, size / np.where(determined, known.sd, 1.0), 0.0))
    start, rest = eqx.partition(eqx.nn.MLP(V.shape[1], 3, WIDTH, 2, jnp.tanh, key=jax.random.key(0)), eqx.is_array)
    last = jnp.asarray(known.run == known.run.max())

    def residual(parameters, parts):
        rows, decay = parts
        apart = jnp.where(rows[:, None], (jax.vmap(eqx.combine(parameters, rest))(V) - F) * weight, 0.0)
        weights = jnp.concatenate([w.ravel() for w in jax.tree.leaves(parameters)])
        return jnp.concatenate([apart.ravel(), decay * weights])

    @eqx.filter_jit
    def fitted(rows, decay):
        solver = optimistix.LevenbergMarquardt(rtol=1e-4, atol=1e-6)
        return optimistix.least_squares(residual, solver, start, (rows, decay), max_steps=200, throw=False).value

    def unseen(decay: float) -> float:
        return float((residual(fitted(~last, jnp.asarray(decay)), (last, 0.0)) ** 2).sum())

    decay = min(DECAYS, key=unseen)
    network = eqx.combine(fitted(jnp.ones_like(last), jnp.asarray(decay)), rest)
    force = Network(jnp.asarray(scale), jnp.asarray(np.where(determined, size, 0.0)), network)
    return judged(model, known, force, case, noise, f"decay {decay}, ")


WAYS = {
    "snakejax": ours,
    "PySINDy": by_sindy,
    "GP": by_process,
    "gplearn": by_formula,
    "network": by_network,
}


def of_table(key: str) -> tuple[float, float]:
    """The held-out misfit and the seconds of snakejax on the board `key`, as benchmarks/accuracy.jsonl has them."""
    lines = map(json.loads, (Path(__file__).parent / "accuracy.jsonl").read_text().splitlines())
    (line,) = (line for line in lines if line["part"] == "strangers" and line["key"] == key)
    held, seconds = line["heldout"][1], line["seconds"]
    print(f"  {'snakejax':9} held out {held:10.4g}            {line['verdict']}, of accuracy.jsonl", flush=True)
    return held, seconds


def main(chosen: list[str], ways: dict) -> None:
    """One line a board and method; the medians, and on how many boards each way predicts held-out runs best."""
    start_jax()
    known = {**boards.STRANGERS, **boards.MORE_STRANGERS}
    kinds = [f"{structure} {name}" for name in known for structure in boards.STRUCTURES]
    results: list[dict[str, tuple[float, float]]] = []
    for key in chosen or kinds:
        structure, name = key.split()
        k = list(known).index(name)
        effect, variable = known[name]
        case = boards.case(boards.make_long(5000 + k, structure), 5000 + k, **{name: effect})
        of_board = side_by_side(f"{key} ({variable})", case, boards.NOISE, ways)
        results.append(of_board if "snakejax" in ways else {"snakejax": of_table(key), **of_board})
    for way in results[0]:
        left, seconds = zip(*(result[way] for result in results), strict=True)
        best = sum(result[way][0] <= min(held for held, _ in result.values()) for result in results)
        wins = f"below 2 on {sum(held < 2 for held in left)} of {len(left)}, best on {best}"
        print(f"{way:9} median held out {statistics.median(left):.4g}, {wins}; {statistics.median(seconds):.1f} s")


if __name__ == "__main__":
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("boards", nargs="*")
    options.add_argument("--ways", default=",".join(WAYS))
    given = options.parse_args()
    main(given.boards, {way: WAYS[way] for way in given.ways.split(",")})
