"""Tuning: the gait that does something best, within the limits of the joints, by the gradient of the simulation."""

from collections.abc import Callable, Sequence
from typing import Any, Literal, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ._descend import Point, descend_all
from ._errors import InputError
from ._gait import Gait, Logged, Sines
from ._limits import Limits, peaks, room, told, within
from ._model import Model
from ._objective import FRAME_RATE, Objective, Ran
from ._ran import Ask, Driver, Seen, ran, seen, sloped
from ._shapes import AbstractShape, Sums
from ._simulate import Accuracy
from ._skid import Free
from ._units import Scalar, require_x64

STARTS, GUESSES, MOST = 8, 192, 60
"""Starts of a descent, the guesses they are chosen among, and the iterations of each at most."""
TERMS = 3
BAND = 4.0
"""Sines go up to so many times the frequency at which a joint uses both its whole angle and its whole rate."""
SHARP = Accuracy(derivative="forward")
MET = 0.5
"""Residuals below this share of what one would tolerate are met."""
_TOLERANCE = 1e-5
_NOWHERE = "None of the gaits {} can be simulated: the tyre is too stiff, or the limits are too wide"
STEEPEST = 1.5
"""Beyond this steering angle [rad] structures whose wheelsets hold the floor sideways cannot be simulated."""

Over = Literal["mean", "worst"]


class Journey(NamedTuple):
    """A gait and what it does: `result` of the objective, and the run at 100 frames a second on the first board."""

    gait: Gait
    result: Any
    run: Ran


class Tuned(NamedTuple):
    """A tuned gait.

    `before`, the best of the given gaits made to keep within the limits, where there was one; `after`, what was found;
    `spread`, what `after` achieves on each further board (the draws from an uncertain fit); `reached`, proven bounds of
    the angles, rates and accelerations of command and joint; `met`, whether what had to be zero is; `simulations`,
    how many runs were simulated, and `slopes`, how many of them with their derivative.
    """

    before: Journey | None
    after: Journey
    spread: list[Any]
    limits: Limits
    reached: dict[str, float]
    seconds: float
    start: tuple[float, float, float]
    met: bool
    simulations: int
    slopes: int

    def terms(self) -> dict[str, list[list[float]]]:
        """The gait as `case.toml` writes it. **Raises:** `ValueError` where it is not a sum of sines."""
        return {name: sines(told(getattr(self.after.gait, name))) for name in Limits._fields}


def sines(signal: Any) -> list[list[float]]:
    """[[amplitude, angular frequency, phase], ...] without terms of no size; **raises** `ValueError` for no sines."""
    if not isinstance(signal, Sines):
        raise ValueError("Only a sum of sines can be written so: write a spline as a joint log.")
    table = np.stack([np.asarray(part, float) for part in (signal.amplitude, signal.frequency, signal.phase)], axis=1)
    return [[float(number) for number in row] for row in table if abs(row[0]) > 1e-9]


def joint_log(gait: Gait) -> str:
    """A gait of splines as the CSV of a joint log, which `case.toml` takes: the knots that the same splines go through.

    **Raises:** `ValueError` where its commands are not splines through the same knots.
    """
    phi, psi = told(gait.phi), told(gait.psi)
    if not (isinstance(phi, Logged) and isinstance(psi, Logged) and np.array_equal(phi.knots, psi.knots)):
        raise ValueError("Only splines through the same knots make a joint log: write sines into case.toml.")
    columns = (phi.knots, *(jax.vmap(signal.at)(phi.knots).angle for signal in (phi, psi)))
    rows = zip(*(np.asarray(column) for column in columns), strict=True)
    return "\n".join(["time_s,phi_rad,psi_rad", *(",".join(f"{v:.17g}" for v in row) for row in rows)]) + "\n"


def band(limits: Limits, seconds: float) -> tuple[float, float]:
    """The angular frequencies [rad/s] that a gait of `seconds` is made of."""
    ratios = [limit.rate / limit.angle for limit in limits if np.isfinite(limit.rate)]
    low = np.pi / seconds
    return low, max(BAND * max(ratios, default=3.0), 4 * low)


def tune(
    model: Model | Sequence[Model],
    objective: Objective,
    limits: Limits,
    seconds: float,
    *,
    driver: Driver | None = None,
    given: Sequence[Gait] = (),
    shape: AbstractShape | None = None,
    start: Sequence[float] = (0.0, 0.0, 0.0),
    over: Over = "mean",
    starts: int = STARTS,
    most: int = MOST,
    seed: int = 0,
    others: Sequence[Model] = (),
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> Tuned:
    """The gait within `limits` that does best by `objective` in `seconds` [s] from rest.

    Guesses at random are simulated side by side; from the best of them, and from the `given` gaits, SLSQP descends with
    the exact derivative of the simulation, the limits its constraints.

    **Arguments:** `model`: a board, or several, the first of which is reported and the others (draws from an uncertain
    fit) tuned for: on their mean cost or, with `over="worst"`, on the worst one. `driver`: how the joints follow their
    commands (default exactly). `given`: gaits known already. `shape`: the family of gaits (default sums of three
    sines). `start`: where the board stands at time 0, (x [m], y [m], heading [rad]). `starts`, `most`: how many
    descents, of how many iterations. `others`: boards the gait is not tuned for, but whose `spread` is shown too.
    `progress` is told how many iterations are done, of how many.
    **Raises:** `InputError` for limits or seconds that cannot be; `RuntimeError` where no guess can be simulated.
    """
    require_x64()
    boards = [model] if isinstance(model, Model) else list(model)
    _require_possible(boards[0], limits, seconds)
    driver = Driver() if driver is None else driver
    angles = (limits.phi.angle, limits.psi.angle)
    shape = Sums(angles, band(limits, seconds), TERMS) if shape is None else shape
    times = jnp.asarray(objective.times(seconds))
    place = jnp.asarray(start, jnp.float64)
    ask = Ask(shape, driver, times, place, objective.counts_effort)

    task = _Task(boards[0], tuple(boards[1:] or boards), ask, objective, limits, seconds, over)
    known = [within(boards[0], driver.driven(_command(g)), limits, seconds) for g in given]
    begins, screened = task.starts(known, starts, np.random.default_rng(seed))
    bounds = shape.bounds()
    if over == "worst" and len(boards) > 2:
        bounds = tuple(np.append(end, inf) for end, inf in zip(bounds, (-np.inf, np.inf), strict=True))
        begins = [np.append(z, task.worst(z)) for z in begins]
        ended = descend_all(task.worst_point, begins, bounds, most, progress)
        ended = [e._replace(unknowns=e.unknowns[:-1]) for e in ended]
    else:
        task.point(begins[0])  # compiled before the threads begin
        ended = descend_all(task.point, begins, bounds, most, progress, task.enough if objective.once else None)

    def journey(board: Model, gait: Gait) -> Journey:
        whole = accurate(board, gait, seconds, start)
        return Journey(gait, objective.result(_looked(whole, times)), whole)

    best = task.best([within(boards[0], ask.gait(jnp.asarray(e.unknowns)), limits, seconds) for e in ended] + known)
    after = journey(boards[0], best)
    before = journey(boards[0], task.best(known)) if known else None
    spread = [journey(board, best).result for board in (*boards[1:], *others)]
    slopes = len(boards[1:] or boards) * sum(e.looks for e in ended)
    met = bool(np.all(np.abs(objective.residual(_looked(after.run, times))) < MET))
    found = peaks(boards[0], best, seconds)
    where = (float(start[0]), float(start[1]), float(start[2]))
    return Tuned(before, after, spread, limits, found, seconds, where, met, screened + slopes, slopes)


class _Task(eqx.Module):
    """One tuning: boards, what is asked of them, and the limits."""

    nominal: Model
    boards: tuple[Model, ...]
    ask: Ask
    objective: Objective
    limits: Limits = eqx.field(static=True)
    seconds: float = eqx.field(static=True)
    over: Over = eqx.field(static=True)

    def merits(self, runs: Sequence[Seen]) -> Float[np.ndarray, " S"]:
        """Cost plus what is not met, of the runs (S, ...) on each board: by this guesses are compared."""
        stack = jax.tree.map(lambda *parts: jnp.stack(parts, axis=1), *runs)
        return np.asarray(_merits(self.objective, self.ask.times, stack, self.over))

    def starts(self, known: Sequence[Gait], count: int, rng) -> tuple[list[np.ndarray], int]:
        """The unknowns of the known gaits and of the best guesses, `count` in all, and how many runs that took."""
        shape = self.ask.shape
        guesses = [np.clip(shape.guess(rng), *shape.bounds()) for _ in range(GUESSES)]
        mine = [z for z in (shape.like(_command(g)) for g in known) if z is not None]
        every = np.array([*mine, *guesses])[:GUESSES]
        found = self.merits([seen(board, self.ask, jnp.asarray(every)) for board in self.boards])
        if not np.isfinite(found).any():
            raise RuntimeError(
                "None of the gaits tried can be simulated: the tyre is too stiff, or the limits too wide"
            )
        ranked = np.argsort(np.where(np.isfinite(found), found, np.inf))
        first = [int(k) for k in ranked if k < len(mine)][: max(count // 2, 1)]
        others = [int(k) for k in ranked if k not in first and np.isfinite(found[k])]
        return [every[k] for k in [*first, *others][:count]], len(every) * len(self.boards)

    def best(self, gaits: Sequence[Gait]) -> Gait:
        """The one of `gaits` that does best, simulated accurately."""
        costs = []
        for gait in gaits:
            runs = [_looked(accurate(b, gait, self.seconds, self.ask.start), self.ask.times) for b in self.boards]
            whole = [Seen(run.pose[None], run.effort[None]) for run in runs]
            costs.append(float(self.merits(whole)[0]))
        if not np.isfinite(costs).any():
            raise RuntimeError(
                "None of the gaits found can be simulated: the tyre is too stiff, or the limits too wide"
            )
        return gaits[int(np.nanargmin(np.where(np.isfinite(costs), costs, np.inf)))]

    def runs(self, unknowns: Float[Array, " P"]) -> tuple[Seen, Seen]:
        """The runs on all boards (M, ...), and their derivatives."""
        each = [sloped(board, self.ask, unknowns) for board in self.boards]
        return jax.tree.map(lambda *parts: jnp.stack(parts), *each)

    def point(self, unknowns: np.ndarray) -> Point:
        """The problem at `unknowns`."""
        z = jnp.asarray(unknowns)
        cost, left, cost_slope, left_slope = _together(self.objective, self.ask.times, *self.runs(z))
        space = _room(self.nominal, self.ask, self.limits, self.seconds, z)
        return Point(float(cost), *(np.asarray(part) for part in (cost_slope, left, left_slope, *space)))

    def enough(self, unknowns: np.ndarray) -> bool:
        """Whether `unknowns` meet all there is to meet."""
        found = self.point(unknowns)
        return bool((np.abs(found.equal) < MET).all() and found.cost < MET and (found.room > -_TOLERANCE).all())

    def worst(self, unknowns: np.ndarray) -> float:
        """The cost of the worst board."""
        return float(_apart(self.objective, self.ask.times, *self.runs(jnp.asarray(unknowns)))[0].max())

    def worst_point(self, unknowns: np.ndarray) -> Point:
        """The problem with one more unknown, last: a bound on the cost of every board, itself made small."""
        z, bound = jnp.asarray(unknowns[:-1]), float(unknowns[-1])
        parts = _apart(self.objective, self.ask.times, *self.runs(z))
        cost, left, cost_slope, left_slope = (np.asarray(part) for part in parts)
        space, space_slope = (np.asarray(p) for p in _room(self.nominal, self.ask, self.limits, self.seconds, z))

        def wide(slope: np.ndarray, last: float) -> np.ndarray:
            return np.append(slope, np.full((slope.shape[0], 1), last), axis=1)

        return Point(
            bound,
            np.append(np.zeros(z.size), 1.0),
            left.mean(axis=0),
            wide(left_slope.mean(axis=0), 0.0),
            np.concatenate([space, bound - cost]),
            np.concatenate([wide(space_slope, 0.0), wide(-cost_slope, 1.0)]),
        )


@eqx.filter_jit
def _merits(objective: Objective, times, runs: Seen, over: Over) -> Float[Array, " S"]:
    def one(each: Seen):
        if over == "mean":
            cost, left = objective.together(Ran(times, *each))
            return cost + jnp.sum(left**2)
        return jnp.max(jax.vmap(lambda run: _alone(objective, times, run)[0])(each))

    return jax.vmap(one)(runs)


def _alone(objective: Objective, times, run: Seen) -> tuple[Scalar, Float[Array, " k"]]:
    """Cost of a run, with what is not zero counted too, and residual."""
    looked = Ran(times, *run)
    left = objective.residual(looked)
    return objective.cost(looked) + jnp.sum(left**2), left


@eqx.filter_jit
def _together(objective: Objective, times, runs: Seen, slopes: Seen):
    """Cost and residual (k,) of runs on all boards, and their derivatives (P,) and (k, P)."""
    return _sloped(lambda each: objective.together(Ran(times, *each)), runs, slopes)


@eqx.filter_jit
def _apart(objective: Objective, times, runs: Seen, slopes: Seen):
    """Cost (M,) and residual (M, k) on each board, and their derivatives (M, P) and (M, k, P)."""
    return jax.vmap(lambda run, slope: _sloped(lambda one: _alone(objective, times, one), run, slope))(runs, slopes)


def _sloped(of: Callable[[Seen], tuple[Array, Array]], run: Seen, slope: Seen):
    def along(direction: Seen):
        return jax.jvp(of, (run,), (direction,))

    (cost, left), (cost_slope, left_slope) = jax.vmap(along, in_axes=-1, out_axes=((None, None), (-1, -1)))(slope)
    return cost, left, cost_slope, left_slope


@eqx.filter_jit
def _room(model: Model, ask: Ask, limits: Limits, seconds: float, unknowns):
    def of(z):
        return room(model, ask.gait(z), limits, seconds)

    def along(direction):
        return jax.jvp(of, (unknowns,), (direction,))

    return jax.vmap(along, out_axes=(None, -1))(jnp.eye(unknowns.size))


@eqx.filter_jit
def _accurate(model: Model, gait: Gait, times, start) -> Seen:
    return ran(model, gait, times, start, True, SHARP)


def accurate(model: Model, gait: Gait, seconds: float, start) -> Ran:
    """A run simulated accurately, 100 frames a second, with its effort."""
    times = jnp.linspace(0.0, seconds, int(np.ceil(seconds * FRAME_RATE)) + 1)
    return Ran(times, *_accurate(model, gait, times, jnp.asarray(start, jnp.float64)))


def _looked(run: Ran, times) -> Ran:
    """`run` at those of its frames that are nearest to `times`."""
    frames = np.linspace(0, len(run.times) - 1, len(times)).round().astype(int)
    return Ran(jnp.asarray(times), run.pose[frames], run.effort)


def _command(gait: Gait) -> Gait:
    return Gait(told(gait.phi), told(gait.psi))


def _require_possible(model: Model, limits: Limits, seconds: float) -> None:
    if not (np.isfinite(seconds) and seconds > 0):
        raise InputError(f"A run of {seconds:g} s is none", "option --seconds", "give a time above 0")
    if limits.phi.angle > STEEPEST and not isinstance(model.skid, Free):
        what = f"Steering by {limits.phi.angle:g} rad puts the wheelsets across the board"
        raise InputError(what, "option --limit", f"write phi={STEEPEST:g} or less, or take --skid free")
