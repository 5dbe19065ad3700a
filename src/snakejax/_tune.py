"""Tuning: the gait that does something best, within the limits of the joints, by the gradient of the simulation."""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ._descend import descend_all
from ._errors import InputError
from ._gait import Gait, Logged, Sines
from ._limits import Limits, peaks, told, within
from ._model import Model
from ._objective import Objective, Ran
from ._ran import Ask, Driver
from ._shapes import AbstractShape, Sums
from ._skid import Free
from ._task import MET, Over, Task, accurate, command, looked
from ._units import require_x64

STARTS, MOST = 8, 60
"""Starts of a descent, and the iterations of each at most."""
TERMS = 3
BAND = 4.0
"""Sines go up to so many times the frequency at which a joint uses both its whole angle and its whole rate."""
STEEPEST = 1.5
"""Beyond this steering angle [rad] structures whose wheelsets hold the floor sideways cannot be simulated."""


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

    task = Task(boards[0], tuple(boards[1:] or boards), ask, objective, limits, seconds, over)
    known = [within(boards[0], driver.driven(command(g)), limits, seconds) for g in given]
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
        return Journey(gait, objective.result(looked(whole, times)), whole)

    best = task.best([within(boards[0], ask.gait(jnp.asarray(e.unknowns)), limits, seconds) for e in ended] + known)
    after = journey(boards[0], best)
    before = journey(boards[0], task.best(known)) if known else None
    spread = [journey(board, best).result for board in (*boards[1:], *others)]
    slopes = len(boards[1:] or boards) * sum(e.looks for e in ended)
    met = bool(np.all(np.abs(objective.residual(looked(after.run, times))) < MET))
    found = peaks(boards[0], best, seconds)
    where = (float(start[0]), float(start[1]), float(start[2]))
    return Tuned(before, after, spread, limits, found, seconds, where, met, screened + slopes, slopes)


def _require_possible(model: Model, limits: Limits, seconds: float) -> None:
    if not (np.isfinite(seconds) and seconds > 0):
        raise InputError(f"A run of {seconds:g} s is none", "option --seconds", "give a time above 0")
    if limits.phi.angle > STEEPEST and not isinstance(model.skid, Free):
        what = f"Steering by {limits.phi.angle:g} rad puts the wheelsets across the board"
        raise InputError(what, "option --limit", f"write phi={STEEPEST:g} or less, or take --skid free")
