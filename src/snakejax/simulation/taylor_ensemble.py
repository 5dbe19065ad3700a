"""Ensembles by Taylor series: members in vectors of eight doubles, each with its own steps, by heyoka.

The method is that of Jorba and Zou (2005), as heyoka implements it (Biscani and Izzo 2021): the order follows from the
tolerance, the step from the last coefficients. Sine, cosine and arctangent are evaluated once for a step; all other
coefficients are sums and products.
"""

import copy
import importlib.metadata
import math
import queue
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from snakejax.core.parallel import cores
from snakejax.core.parameter import Scalar
from snakejax.dynamics.inputs import AbstractInputs
from snakejax.dynamics.model import Model, State

from .integrate import Accuracy
from .taylor_series import Level, NoTaylorSeries, Trace, equations

SHARE = 256
"""Members whose parameters are computed at a time."""
INSTANTS = 129
"""Times of the run at which a branch on time must be the same. A shorter exception goes unnoticed, as it may between
the stages of a Runge-Kutta step."""
ORDERS = (9, 12, 16, 20)
"""Orders of the series: the least that the accuracy needs, and a higher one for a member whose steps are too short."""
PROGRAMS = 16
"""Compiled programs that are kept."""


class Ensemble(NamedTuple):
    """V members: stacked `models` and, with `own_gaits`, stacked gaits; `starts` (V, 3) at rest or (V, 6) in motion;
    `times` (n,) [s].

    `varied` says of each leaf of (models, gaits) whether it differs between members; the others are constants of the
    compiled program.
    """

    models: Model
    gaits: AbstractInputs
    starts: Float[np.ndarray, "V k"]
    times: Float[np.ndarray, " n"]
    own_gaits: bool
    varied: tuple[bool, ...]

    @staticmethod
    def of(
        models: Model, gaits: AbstractInputs, starts: np.ndarray, times: np.ndarray, own_gaits: bool, by_value: bool
    ) -> "Ensemble":
        """An ensemble whose leaves vary where their values differ, or else where they are no broadcast of one value."""
        models, gaits = jax.tree.map(np.asarray, (models, gaits))
        stacked = jax.tree.leaves((models, gaits if own_gaits else None))

        def varies(leaf: np.ndarray) -> bool:
            return leaf.strides[0] != 0 and not (by_value and (leaf == leaf[:1]).all())

        alike = () if own_gaits else (False,) * len(jax.tree.leaves(gaits))
        return Ensemble(models, gaits, starts, times, own_gaits, (*map(varies, stacked), *alike))

    def leaves(self, rows: slice | np.ndarray) -> list[np.ndarray]:
        """The leaves of (models, gaits): of the members `rows` where they vary, else of one member."""
        stacked = len(self.varied) if self.own_gaits else len(jax.tree.leaves(self.models))
        return [
            leaf[rows] if varies else leaf[0] if k < stacked else leaf
            for k, (leaf, varies) in enumerate(
                zip(jax.tree.leaves((self.models, self.gaits)), self.varied, strict=True)
            )
        ]


class Poses(NamedTuple):
    """Poses (V, n, 3) of an ensemble, and why a member was not integrated by Taylor series: "" where it was."""

    poses: Float[np.ndarray, "V n 3"]
    refusals: np.ndarray


def orders(accuracy: Accuracy) -> list[int]:
    """The order of the series, 1 - ln(tolerance) / 2 (Jorba and Zou 2005), and those above it, to be tried in turn.

    The tolerance is three times that of Tsit5. The largest error over the boards of `benchmarks/throughput.py` is then
    below that of Tsit5, which does not hold for every single board: where both are far below the tolerance, Tsit5 may
    be nearer.
    """
    first = math.ceil(1 - math.log(3 * min(accuracy.rtol, 100 * accuracy.atol)) / 2)
    first = min(max(first, ORDERS[0]), ORDERS[-1])
    return [first, *(order for order in ORDERS if order > first)]


def heyoka_version() -> str | None:
    """The version of heyoka, of the extra `taylor`, or None if it is not installed."""
    try:
        return importlib.metadata.version("heyoka")
    except importlib.metadata.PackageNotFoundError:
        return None


def by_taylor_series(ensemble: Ensemble, accuracy: Accuracy, workers: int | None) -> Poses:
    """Simulate the members of `ensemble` by Taylor series, as far as they have one."""
    count, program = len(ensemble.starts), _program(ensemble)

    def share(first: int) -> Poses:
        # A share is filled up with copies of the last member, which are dropped: one program serves any number.
        rows = np.minimum(np.arange(first, first + SHARE), count - 1)
        size = min(SHARE, count - first)
        return Poses(*(part[:size] for part in program.simulated(ensemble, rows, size, accuracy)))

    with ThreadPoolExecutor(workers or cores()) as pool:
        parts = list(pool.map(share, range(0, count, SHARE)))
    return Poses(*(np.concatenate(part) for part in zip(*parts, strict=True)))


_PROGRAMS: dict[Any, "_Program"] = {}
_BUILDING = threading.RLock()


def _program(ensemble: Ensemble) -> "_Program":
    leaves = ensemble.leaves(0)
    structure = jax.tree.structure((ensemble.models, ensemble.gaits))
    key = (structure, ensemble.varied, *((np.shape(leaf), leaf.dtype) for leaf in leaves))
    return _kept(_PROGRAMS, key, lambda: _Program(structure, leaves, ensemble.varied))


def _kept(cache: dict, key: Any, make: Callable[[], Any]) -> Any:
    """The entry of `cache` under `key`, made if it is missing; the oldest of too many is dropped."""
    with _BUILDING:
        if key not in cache:
            if len(cache) >= PROGRAMS:
                del cache[next(iter(cache))]
            cache[key] = make()
        return cache[key]


def beginning(model: Model, gait: AbstractInputs, start: Float[Array, " k"]) -> tuple[Scalar, State]:
    """The time [s] of the inputs at which a member begins, and its state there: at rest for a start of three numbers,
    and in motion at time 0 of the run for one of six."""
    if start.shape[0] == 3:
        return gait.begins(), model.start((start[0], start[1], start[2]))
    at = -model.delay() + jnp.zeros(())
    return at, model.initial_state(tuple(start[k] for k in range(start.shape[0])), at, gait)


class _Start(NamedTuple):
    """What is known of V members before their integration; `steady` says of each branch that it stays the same."""

    begins: np.ndarray
    ends: np.ndarray
    state: list[np.ndarray]
    residuals: list[np.ndarray]
    choices: np.ndarray
    steady: np.ndarray


class _Program:
    """The trace of models of one structure, and the integrators compiled from it."""

    def __init__(self, structure: Any, leaves: Sequence[np.ndarray], varied: tuple[bool, ...]) -> None:
        model, _ = jax.tree.unflatten(structure, leaves)
        initial, state_structure = jax.tree.flatten(model.start((jnp.zeros(()),) * 3))

        def rates(t, state, *leaves):
            model, gait = jax.tree.unflatten(structure, leaves)
            return jax.tree.leaves(model.rates(t, jax.tree.unflatten(state_structure, state), gait))

        self.trace = trace = Trace(rates, len(initial), leaves, varied)
        self.residuals, self.decisions = trace.residuals(), trace.decisions()
        self.alike = [trace.levels[k] == Level.CONSTANT for k in self.residuals]
        self.sizes = [int(np.prod(trace.shapes[op.takes[0]])) for op in self.decisions]
        changing = any(trace.choice_level(op) == Level.TIME for op in self.decisions)
        self.integrators: dict[Any, _Integrator | str] = {}
        axes = [0 if varies else None for varies in varied]

        def before(start, times, *leaves):
            model, gait = jax.tree.unflatten(structure, leaves)
            begins, state = beginning(model, gait, start)
            ends = jnp.maximum(times - model.delay(), begins)
            at = begins + (ends[-1] - begins) * jnp.linspace(0.0, 1.0, INSTANTS if changing else 1)
            choices = jax.vmap(lambda t: _row(trace.decided(t, leaves)))(at)
            residuals = list(trace.evaluated(self.residuals, None, leaves).values())
            return _Start(
                begins, ends, jax.tree.leaves(state), residuals, choices[0], (choices == choices[:1]).all(axis=0)
            )

        shared = [None if alike else 0 for alike in self.alike]
        self.before = jax.jit(jax.vmap(before, (0, None, *axes), _Start(0, 0, 0, shared, 0, 0)))

        def observed(states, *leaves):
            model, _ = jax.tree.unflatten(structure, leaves)
            body, _ = jax.tree.unflatten(state_structure, list(states))
            return jnp.stack(jnp.broadcast_arrays(*model.observe(body)), axis=-1)

        self.observed = jax.jit(jax.vmap(observed, (0, *axes)))

    def simulated(self, ensemble: Ensemble, rows: np.ndarray, size: int, accuracy: Accuracy) -> Poses:
        """The first `size` of the members `rows`; the poses of the others mean nothing."""
        leaves = ensemble.leaves(rows)
        start = jax.tree.map(np.asarray, self.before(ensemble.starts[rows], ensemble.times, *leaves))
        states = np.full((len(rows), len(self.trace.outputs), ensemble.times.size), np.nan)
        refusals = np.full(len(rows), "", object)
        early = (start.ends <= start.begins[:, None]).sum(axis=1)
        kinds, kind = np.unique(
            np.column_stack([early, start.steady, start.choices])[:size], axis=0, return_inverse=True
        )
        for number, row in enumerate(kinds):
            members = np.flatnonzero(kind.reshape(-1) == number)
            for order in orders(accuracy):
                integrator = self._integrator(start, members[0], order)
                if isinstance(integrator, str):
                    refusals[members] = integrator
                    break
                finished, shortest = integrator.states(start, members, int(row[0]), accuracy.max_steps, states)
                refusals[members] = np.where(finished, "", "its Taylor series does not reach the end of the run")
                # A step may leap over a singularity of the series at a distance of exp(-order) seconds.
                members = members[finished & (shortest < np.exp(-order))]
                if not members.size:
                    break
                refusals[members] = "its Taylor series converge on too short steps"
        poses = np.asarray(self.observed(states, *leaves))
        refusals[(refusals == "") & ~np.isfinite(poses).all(axis=(1, 2))] = "its pose is not finite"
        return Poses(poses, refusals.astype(str))

    def _integrator(self, start: _Start, member: int, order: int) -> "_Integrator | str":
        """The integrator of `order` for the branches that `member` takes, or why there is none."""
        if not start.steady[member].all():
            which = int(np.searchsorted(np.cumsum(self.sizes), np.flatnonzero(~start.steady[member])[0], side="right"))
            return str(self.decisions[which].refused("its rates take another branch in the course of the run"))
        known = zip(self.residuals, start.residuals, self.alike, strict=True)
        constants = {k: value for k, value, alike in known if alike}
        choices = start.choices[member]
        key = (order, choices.tobytes(), *(value.tobytes() for value in constants.values()))

        def make() -> "_Integrator | str":
            shapes = [self.trace.shapes[op.takes[0]] for op in self.decisions]
            parts = np.split(choices, np.cumsum(self.sizes)[:-1]) if self.sizes else []
            try:
                branches = [part.reshape(shape) for part, shape in zip(parts, shapes, strict=True)]
                system = equations(self.trace, constants, branches)
            except NoTaylorSeries as why:
                return str(why)
            numbers = {quantity: place for place, quantity in enumerate(self.residuals)}
            return _Integrator(system.system, [(numbers[k], e) for k, e in system.parameters], order)

        return _kept(self.integrators, key, make)


def _row(parts: Sequence[Any]) -> Any:
    """The numbers of `parts` as one array."""
    return jnp.concatenate([jnp.zeros(0, int), *map(jnp.ravel, parts)])


class _Integrator:
    """A compiled integrator of a batch of members; each thread runs a copy."""

    def __init__(self, system: list, parameters: list[tuple[int, int]], order: int) -> None:
        import heyoka as hy

        self.batch, self.parameters = hy.recommended_simd_size(), parameters
        # heyoka derives the order from the tolerance, and the step from the order and the coefficients.
        how = {"tol": math.exp(3 - 2 * order), "force_avx512": True, "fast_math": True}
        self.original = hy.taylor_adaptive_batch(system, np.zeros((len(system), self.batch)), **how)
        self.done = int(hy.taylor_outcome.time_limit)
        self.failures = [int(hy.taylor_outcome.step_limit), int(hy.taylor_outcome.err_nf_state)]
        self.free: queue.SimpleQueue = queue.SimpleQueue()

    def states(
        self, start: _Start, members: np.ndarray, early: int, max_steps: int, states: np.ndarray
    ) -> tuple[Bool[np.ndarray, " m"], Float[np.ndarray, " m"]]:
        """Write the states of `members` at their times, from number `early` on after their start, into `states`.

        Returns which members reached the end, and the shortest step [s] of each.
        """
        at_start = np.stack(start.state, axis=1)
        states[members, :, :early] = at_start[members, :, None]
        if early == states.shape[2]:
            return np.ones(len(members), bool), np.full(len(members), np.inf)
        parameters = [start.residuals[k].reshape(len(at_start), -1)[:, element] for k, element in self.parameters]
        table = _Table(at_start, np.array(parameters).reshape(-1, len(at_start)), start.begins, start.ends.T)
        try:
            integrator = self.free.get_nowait()
        except queue.Empty:
            integrator = copy.copy(self.original)
        results = self._propagated(integrator, table, members, max_steps, states[:, :, early:])
        self.free.put(integrator)
        return results

    def _propagated(
        self, integrator: Any, table: "_Table", members: np.ndarray, max_steps: int, states: np.ndarray
    ) -> tuple[Bool[np.ndarray, " m"], Float[np.ndarray, " m"]]:
        shortest = np.full(len(members), np.inf)
        finished, waiting = np.ones(len(members), bool), np.arange(len(members))
        while waiting.size:
            batch, waiting = waiting[: self.batch], waiting[self.batch :]
            rows = members[np.resize(batch, self.batch)]
            integrator.state[:], integrator.pars[:] = table.states[rows].T, table.parameters[:, rows]
            integrator.set_time(table.begins[rows])
            if states.shape[2] == 1:
                integrator.propagate_until(table.ends[-1, rows], max_steps=max_steps)
                reached = integrator.state[None]
            else:
                grid = np.concatenate([table.begins[rows][None], table.ends[-states.shape[2] :, rows]])
                reached = integrator.propagate_grid(grid, max_steps=max_steps)[-1][1:]
            results = integrator.propagate_res[: len(batch)]
            outcomes = np.array([int(outcome) for outcome, *_ in results])
            shortest[batch] = [step for _, step, *_ in results]
            done, failed = outcomes == self.done, (outcomes == self.failures[0]) | (outcomes == self.failures[1])
            failed |= not (done | failed).any()
            states[members[batch[done]]] = reached[..., : len(batch)].transpose(2, 1, 0)[done]
            finished[batch[failed]] = False
            # A member whose state is not finite stops all of its batch: the others start again without it.
            waiting = np.concatenate([batch[~(done | failed)], waiting])
        return finished, shortest


class _Table(NamedTuple):
    """State (V, s) at the start, parameters (p, V), first time (V,) [s] and times (n, V) [s] of members."""

    states: np.ndarray
    parameters: np.ndarray
    begins: np.ndarray
    ends: np.ndarray
