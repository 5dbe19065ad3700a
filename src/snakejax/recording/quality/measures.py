"""Measures of the board that do not go with how it moves, or that no vehicle has: masses in grams, lengths in
millimetres, the inertia of another rotor.

The push along the board (see `push`) tells I / (m L) and J_r / (m L). A measure that is wrong by itself shows by how
these two are off together; where several would do, all are named.
"""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from snakejax.vehicles.snakeboard.board import Board

from ..run import Run
from .finding import Finding
from .push import Push, motions, pushes, together

UNITS = {"kg": "kg", "m": "m", "kgm2": "kg m^2"}
"""Units as messages write them, by the last word of a key of case.toml."""
LAGS = np.linspace(-0.5, 0.5, 21)
"""Lags [s] of the joints against the cameras that are tried: measures are right if they fit the motion at one lag."""
FACTOR, UNIT = 1.5, 30.0
"""A measure that is wrong by the first factor is doubtful; by the second, it is in another unit."""
CERTAIN, EQUAL = 5.0, 3.0
"""Standard errors by which another value must fit better, and within which two values fit equally well."""
MOST = 0.8
"""A measure is reported if another value of it removes this share of the error that any quotients can remove."""
HARDLY = 0.75
"""If the best measures leave more than this share of the push, the push gives no information."""
FACTORS = np.exp(np.linspace(-14.0, 14.0, 2801))
"""Factors on a measure that are tried: from a millionth to a million, in steps of 1%."""
DENSITY = (1e-3, 1.3e5)
"""Mass over L^3 [kg/m^3]: a thousandth of air, and solid steel of 4 L by 2 L by 2 L."""
GYRATION = (0.02, 20.0)
"""I / (m L^2): nearly all mass in the middle, and most of it far beyond the wheels."""
LENGTH = (1e-3, 20.0)
"""Half lengths [m] of what cameras see and a floor bears."""


DEGREES = 180 / np.pi
"""With psi in degrees the rotor seems to have so many times less inertia."""
NEAR = 1.2
"""The factor up to which the motion may miss that one."""


class _Other(NamedTuple):
    """Other values of measures, `(key, value, given)`, of which any one goes with the motion; how far `off` they are,
    as a factor; what is `left` of the push then, and with what factors `at` its two parts.
    """

    measures: tuple[tuple[str, float, float], ...]
    off: float
    left: float
    at: tuple[float, float]


def measures(runs: Sequence[Run], board: Board) -> list[Finding]:
    """Measures of `board` with which it cannot move as it does in `runs`, or that no vehicle has."""
    return by_motion(runs, board) or by_range(board)


def by_motion(runs: Sequence[Run], board: Board) -> list[Finding]:
    """A measure of `board` with another value of which the push in `runs` is explained far better."""
    now = 1.0, float(board.rotor_inertia)
    of_runs = motions(runs)
    pooled = together(pushes(of_runs, board))
    if pooled is None or pooled.deviations(_left(pooled, *now), _left(pooled, *pooled.best())) < CERTAIN:
        return []
    tried = [
        (all_runs, each)
        for lag in LAGS
        if (all_runs := together(each := pushes(of_runs, board, float(lag)))) is not None
    ]
    given = min(_left(all_runs, *now) for all_runs, _ in tried)
    pooled, each = min(tried, key=lambda pair: _left(pair[0], *pair[0].best()))
    free = _left(pooled, *pooled.best())
    if free > HARDLY * pooled.square or pooled.deviations(given, free) < CERTAIN:
        return []
    others = list(_others(pooled, board))
    least = min(others, key=lambda one: one.left)
    if pooled.deviations(given, least.left) < CERTAIN or given - least.left < MOST * (given - free):
        return []
    # All runs are of one board: what only one of them wants is no measure.
    rest = [together(each[:k] + each[k + 1 :]) for k in range(len(each)) if len(each) > 2]
    if any(one is None or one.deviations(_left(one, *now), _left(one, *least.at)) < EQUAL for one in rest):
        return []
    equal = [one for one in others if pooled.deviations(one.left, least.left) < EQUAL]
    off = min(one.off for one in equal)
    if off < FACTOR:
        return []
    named = [part for one in equal for part in one.measures]
    others = [f"{key} were {_rounded(value, 2)}, not {_rounded(before, 4)}" for key, value, before in named]
    in_degrees = any(key == "rotor_inertia_kgm2" and _near(before, DEGREES * value) for key, value, before in named)
    what = ", or ".join(["psi were in degrees"] * in_degrees + others)
    units = dict.fromkeys(UNITS[key.rpartition("_")[2]] for key, *_ in named)
    remedy = f"measure it again, in {' or '.join(units)}"
    if any(key == "rotor_inertia_kgm2" for key, *_ in named):
        remedy += ", and check that psi is in rad"
    return [_finding(f"the board moves as if {what}", remedy, off)]


def _finding(what: str, remedy: str, off: float) -> Finding:
    return Finding("board_measure", what, remedy, 0.0, 0.0, size=off, severity="refused" if off > UNIT else "doubtful")


def _rounded(value: float, digits: int) -> str:
    """`value` with so many digits, and with a power of ten only where it has more than six."""
    return f"{float(f'{value:.{digits}g}'):g}"


def _near(one: float, other: float) -> bool:
    return _apart(one, other) < NEAR


def _apart(one: float, other: float) -> float:
    """The factor, above 1, between two numbers that are not negative."""
    low, high = sorted((one, other))
    return high / low if low > 0 else np.inf


def by_range(board: Board) -> list[Finding]:
    """Measures of `board` that no vehicle has, whether it moves or not."""
    m, L, total = (float(part) for part in (board.mass, board.half_length, board.total_inertia))
    density, gyration = m / L**3, total / (m * L**2)
    remedy = "measure it again, in kg and m"
    if not LENGTH[0] <= L <= LENGTH[1]:
        return [
            _finding(
                f"half_length_m is {_rounded(L, 3)}: no board is {_rounded(2 * L, 3)} m long",
                remedy,
                _beyond(L, LENGTH),
            )
        ]
    if not DENSITY[0] <= density <= DENSITY[1]:
        than = "lighter than air" if density < DENSITY[0] else "heavier than solid steel"
        what = f"mass_kg = {_rounded(m, 3)} on half_length_m = {_rounded(L, 3)} is {than}"
        return [_finding(what, remedy, _beyond(density, DENSITY))]
    if not GYRATION[0] <= gyration <= GYRATION[1]:
        times = f"{_rounded(total, 3)} is {_rounded(gyration, 2)} times mass half_length^2"
        what = f"inertia_kgm2 = {times}: it is 0.3 to 3 times for most"
        return [_finding(what, "measure it again, in kg m^2", _beyond(gyration, GYRATION))]
    return []


def _beyond(value: float, limits: tuple[float, float]) -> float:
    """The factor by which `value` is beyond the nearer of the `limits`."""
    return max(limits[0] / value, value / limits[1])


def _left(pooled: Push, yaw: float, rotor: float) -> float:
    return float(pooled.left(np.asarray(yaw), np.asarray(rotor)))


def _others(pooled: Push, board: Board) -> Iterator[_Other]:
    """For each measure that may be wrong by itself, the value that explains the push best."""
    given = {
        "mass_kg": float(board.mass),
        "rotor_inertia_kgm2": float(board.rotor_inertia),
        "half_length_m": float(board.half_length),
        "inertia_kgm2": float(board.total_inertia),
    }
    for yaw, rotor, factors in _families(board):
        left = pooled.left(yaw, rotor)
        k = int(np.argmin(left))
        values = {key: float(factor[k]) * (given[key] or given["inertia_kgm2"]) for key, factor in factors.items()}
        measures = tuple((key, value, given[key]) for key, value in values.items())
        off = max(_apart(value, before) for _, value, before in measures)
        yield _Other(measures, off, float(left[k]), (float(yaw[k]), float(rotor[k])))


def _families(board: Board) -> list[tuple[np.ndarray, np.ndarray, dict[str, np.ndarray]]]:
    """Factors on the two parts of the push, and on the measures of which any one brings them about.

    The parts are I / (m L) and J_r / (m L); I is m L^2 where it is not given. A rotor said to have no inertia is
    measured by I.
    """
    J, total, f = float(board.rotor_inertia), float(board.total_inertia), FACTORS
    one = np.ones_like(f)
    rotor = {"rotor_inertia_kgm2": f}
    if board.inertia is not None:
        both = {"mass_kg": f, "half_length_m": f}
        return [(one, f * (J or total), rotor), (1 / f, J / f, both), (f, J * one, {"inertia_kgm2": f})]
    lighter = {"mass_kg": 1 / f} if J > 0 else {}
    return [(one, f * (J or total), rotor | lighter), (f, J / f, {"half_length_m": f})]
