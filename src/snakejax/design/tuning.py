"""Gait optimisation within the limits of the joints, with the derivative of the simulation."""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, TypedDict, Unpack

import jax.numpy as jnp
import numpy as np

from snakejax.core.errors import InputError
from snakejax.core.jax_config import require_x64
from snakejax.core.progress import Progress, no_progress
from snakejax.core.tabular import Tabular
from snakejax.dynamics.inputs import AbstractInputs, G, Gait, with_signals
from snakejax.dynamics.model import Model
from snakejax.dynamics.signals import Logged, Sines, angles_at

from .gait_families import GaitFamily, SumsOfSines
from .gait_problem import MET, GaitProblem, Robustness, accurate, command, rollout_of
from .limits import Limits, input_names, limits_of, peaks, within
from .objectives import Objective, Rollout
from .rollouts import Controller, RolloutSpec
from .slsqp import Minimum, minimise_from_starts

STARTS, MOST = 8, 60
"""Number of starts, and the largest number of iterations from each."""
ORIGIN = (0.0, 0.0, 0.0)
TERMS = 3
"""Sines for each joint by default."""
BAND = 4.0
"""Largest frequency of a sine, as a multiple of the frequency rate / angle at which a joint reaches both limits."""
STEEPEST = 1.5
"""Largest steering angle [rad] for constrained wheelsets: their equations are singular at pi / 2."""


class GaitResult(NamedTuple):
    """A gait, its `result` by the objective, and its run on the first board at `FRAME_RATE`."""

    gait: AbstractInputs
    result: Any
    run: Rollout


@dataclasses.dataclass(frozen=True, eq=False, repr=False)
class TuningResult(Tabular):
    """Result of a gait optimisation.

    `before`: the best of the given gaits, scaled to the limits, or None; `after`: the optimised gait; `spread`: results
    of `after` on each further board (posterior samples of a fit); `reached`: proven upper bounds of angles, rates and
    accelerations of command and joint motion; `met`: whether the residual is satisfied; `simulations`: number of
    simulated runs, `slopes` of them with derivatives; `units`: of the inputs by name.
    """

    before: GaitResult | None
    after: GaitResult
    spread: list[Any]
    limits: Limits
    reached: dict[str, float]
    seconds: float
    start: tuple[float, float, float]
    met: bool
    simulations: int
    slopes: int
    units: Mapping[str, str]

    def terms(self) -> dict[str, list[list[float]]]:
        """The gait in the form of `case.toml`. **Raises:** `ValueError` if it is not a sum of sines."""
        return {name: sines(limits_of(self.after.gait.signal(name))) for name in self.limits.names}

    def headline(self) -> str:
        """The objective before and after, and whether a target is reached."""
        before = "" if self.before is None else f"{_result_text(self.before.result)} -> "
        missed = "" if self.met else "; the target is not reached"
        return f"{before}{_result_text(self.after.result)} in {self.seconds:g} s{missed}"

    def columns(self) -> dict[str, list[Any]]:
        """A row for each sine of the gait, or for each knot where it is a spline."""
        try:
            rows = [(joint, *term) for joint, terms in self.terms().items() for term in terms]
            names = ["joint", "amplitude_rad", "frequency_rad_s", "phase_rad"]
        except ValueError:
            first, *text = joint_log(self.after.gait).split()
            names, rows = first.split(","), [tuple(map(float, line.split(","))) for line in text]
        return {name: [row[k] for row in rows] for k, name in enumerate(names)}


def _result_text(result: Any) -> str:
    """A number, or numbers by name, of an objective; without one, only that there is a gait."""
    if isinstance(result, dict):
        return ", ".join(f"{name} {value:.4g}" for name, value in result.items())
    return "a gait" if result is None else f"{result:.4g}"


def sines(signal: Any) -> list[list[float]]:
    """[[amplitude [rad], angular frequency [rad/s], phase [rad]], ...] of the terms with nonzero amplitude.

    **Raises:** `ValueError` if `signal` is not a sum of sines.
    """
    if not isinstance(signal, Sines):
        raise ValueError("Only a sum of sines can be written so: write a spline as a joint log.")
    table = np.stack([np.asarray(part, float) for part in (signal.amplitude, signal.frequency, signal.phase)], axis=1)
    return [[float(number) for number in row] for row in table if abs(row[0]) > 1e-9]


def joint_log(gait: AbstractInputs) -> str:
    """A gait of natural splines as the CSV text of a log of its knots, for `case.toml`.

    **Raises:** `ValueError` if the commands are not splines with the same knots.
    """
    signals = [limits_of(gait.signal(name)) for name in gait.names]
    logs = [signal for signal in signals if isinstance(signal, Logged)]
    if len(logs) < len(signals) or any(not np.array_equal(log.knots, logs[0].knots) for log in logs):
        raise ValueError("Only splines through the same knots make a joint log: write sines into case.toml.")
    columns = (logs[0].knots, *(angles_at(log, log.knots) for log in logs))
    rows = zip(*(np.asarray(column) for column in columns), strict=True)
    unit = "_rad" if isinstance(gait, Gait) else ""
    head = ",".join(["time_s", *(f"{name}{unit}" for name in gait.names)])
    return "\n".join([head, *(",".join(f"{v:.17g}" for v in row) for row in rows)]) + "\n"


def band(limits: Limits, seconds: float) -> tuple[float, float]:
    """Bounds of the angular frequencies [rad/s] of a gait of `seconds` [s]; the lower one is half a cycle."""
    ratios = [limit.rate / limit.angle for _, limit in limits.each if np.isfinite(limit.rate)]
    low = np.pi / seconds
    return low, max(BAND * max(ratios, default=3.0), 4 * low)


class TuningOptions(TypedDict, total=False):
    """Options of `tune`.

    `driver`: controller of the joints (default: exact tracking); `given`: known gaits; `shape`: gait family (default:
    sums of three sines); `start`: pose at time 0, (x [m], y [m], heading [rad]) (default: the origin); `over`: the cost
    over several models is their "mean" (default) or the "worst"; `starts`, `most`: number of minimisations (default 8),
    and largest number of iterations of each (default 60); `seed`: of the random gaits (default 0); `others`: models
    that do not enter the cost but are reported in `spread`; `progress` counts iterations.
    """

    driver: Controller | None
    given: Sequence[AbstractInputs]
    shape: GaitFamily | None
    start: Sequence[float]
    over: Robustness
    starts: int
    most: int
    seed: int
    others: Sequence[Model]
    progress: Progress


def tune(
    model: Model | Sequence[Model],
    objective: Objective,
    limits: Limits,
    seconds: float,
    **options: Unpack[TuningOptions],
) -> TuningResult:
    """Optimise a gait of `seconds` [s] from rest for `objective`, within `limits`.

    Random gaits are simulated in one batch; from the best of them and from the `given` gaits SLSQP (Kraft 1988)
    minimises the cost with the automatic derivative of the simulation, under the limits as constraints.

    **Arguments:** `model`: one model, or several: the first is reported, the others (posterior samples of a fit) define
    the cost. `options`: see `TuningOptions`.
    **Raises:** `InputError` for `seconds` not above 0, limits that are not those of the inputs of the vehicle, or a
    steering limit beyond `STEEPEST`; `RuntimeError` if no gait can be simulated.
    """
    require_x64()
    boards = [model] if isinstance(model, Model) else list(model)
    _require_possible(boards[0], objective, limits, seconds)
    task = _problem(boards, objective, limits, seconds, options)
    driver, start = task.spec.driver, options.get("start", ORIGIN)
    given = [_filled_up(command(gait), task.spec.shape) for gait in options.get("given", ())]
    known = [within(boards[0], driver.driven(gait), limits, seconds) for gait in given]
    minima, screened = _minima(task, known, options)

    def gait_result(board: Model, gait: AbstractInputs) -> GaitResult:
        run = accurate(board, gait, seconds, start)
        return GaitResult(gait, objective.result(rollout_of(run, task.spec.times)), run)

    optimised = [within(boards[0], task.spec.gait(jnp.asarray(m.unknowns)), limits, seconds) for m in minima]
    best = task.best(optimised + known)
    after = gait_result(boards[0], best)
    slopes = len(task.boards) * sum(m.evaluations for m in minima)
    return TuningResult(
        before=gait_result(boards[0], task.best(known)) if known else None,
        after=after,
        spread=[gait_result(board, best).result for board in (*boards[1:], *options.get("others", ()))],
        limits=limits,
        reached=peaks(boards[0], best, seconds),
        seconds=seconds,
        start=(float(start[0]), float(start[1]), float(start[2])),
        met=bool(np.all(np.abs(objective.residual(rollout_of(after.run, task.spec.times))) < MET)),
        simulations=screened + slopes,
        slopes=slopes,
        units={one.name: one.unit for one in boards[0].board.inputs if one.name in limits.names},
    )


def _problem(
    boards: Sequence[Model], objective: Objective, limits: Limits, seconds: float, options: TuningOptions
) -> GaitProblem:
    """The optimisation problem: the first of several `boards` is reported, the others define the cost."""
    driver, shape = options.get("driver"), options.get("shape")
    if shape is None:
        angles = tuple(limit.angle for _, limit in limits.each)
        shape = SumsOfSines(angles, band(limits, seconds), TERMS, limits.names)
    spec = RolloutSpec(
        shape,
        Controller() if driver is None else driver,
        jnp.asarray(objective.times(seconds)),
        jnp.asarray(options.get("start", ORIGIN), jnp.float64),
        objective.counts_effort,
    )
    over = options.get("over", "mean")
    return GaitProblem(boards[0], tuple(boards[1:] or boards), spec, objective, limits, seconds, over)


def _filled_up(gait: G, family: GaitFamily) -> G:
    """`gait` with its sums of sines filled up to the terms of those of `family`: one program simulates both."""
    example = family.gait(jnp.asarray(family.bounds()[0]))
    terms = max((s.amplitude.size for n in family.names if isinstance(s := example.signal(n), Sines)), default=0)
    return with_signals(gait, lambda s: s.padded(max(terms, s.amplitude.size)) if isinstance(s, Sines) else s)


def _minima(task: GaitProblem, known: Sequence[AbstractInputs], options: TuningOptions) -> tuple[list[Minimum], int]:
    """The minimum from each start, and the number of runs simulated to choose the starts.

    The worst of several costs is minimised in epigraph form, with its bound as one further unknown.
    """
    most, progress = options.get("most", MOST), options.get("progress", no_progress)
    rng = np.random.default_rng(options.get("seed", 0))
    starts, screened = task.starts(known, options.get("starts", STARTS), rng)
    bounds = task.spec.shape.bounds()
    if task.over == "worst" and len(task.boards) > 1:
        bounds = tuple(np.append(end, inf) for end, inf in zip(bounds, (-np.inf, np.inf), strict=True))
        starts = [np.append(z, task.worst(z)) for z in starts]
        minima = minimise_from_starts(task.worst_point, starts, bounds, most, progress)
        return [m._replace(unknowns=m.unknowns[:-1]) for m in minima], screened
    task.point(starts[0])  # compiled before the threads begin
    enough = task.enough if task.objective.once else None
    return minimise_from_starts(task.point, starts, bounds, most, progress, enough), screened


def _require_possible(model: Model, objective: Objective, limits: Limits, seconds: float) -> None:
    if objective.counts_effort and not model.board.knows_actuator_torques:
        what = f"The joint torques of a {model.board.noun} are not known, so its effort is not"
        raise InputError(what, "option --objective", "take distance, turn or reach")
    if not (np.isfinite(seconds) and seconds > 0):
        raise InputError(f"A run cannot last {seconds:g} s", "option --seconds", "give a time above 0")
    if limits.names != (names := input_names(model)):
        what = (
            f"The limits are of {', '.join(limits.names) or 'nothing'}, but the inputs are {', '.join(names) or 'none'}"
        )
        raise InputError(what, "option --limit", "name the inputs of the vehicle")
    for one in model.board.inputs:
        steep = one.label == "steering" and limits[one.name].angle > STEEPEST
        if steep and not model.constraint.frees_wheels:
            what = f"Steering by {limits[one.name].angle:g} rad puts the wheels across the {model.board.noun}"
            raise InputError(what, "option --limit", f"write {one.name}={STEEPEST:g} or less, or take --skid free")
