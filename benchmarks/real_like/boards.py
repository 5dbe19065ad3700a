"""Boards made up as real ones are, and boards that are exact but for one thing: from a kind, a set and a number.

kind            what is hidden
real_like       one strong effect, three weak ones, a strange one at 4 % of what anyone would see, constants off
real_like_null  the same without the strong effect
moderate        five to eight effects at 0.1 to 0.5 of the usual sizes; constants exact, noise white and stated
wrong_mass      exact and without effects, but 5 % more or less mass than case.toml says; noise white and stated
wrong_length    the same with a half length 2 mm longer or shorter
wandering       exact and without effects; noise that wanders, not stated
odd_tyre        exact, every other one with a strong effect; in one run to train on the tyre has another peak
odd_bump        the same with a bump of the floor under the path of that run
odd_marker      the same with a marker that slipped before that run
scale           real_like in ten variants (`VARIANTS`), one a number
exact           exact, every other one with a strong effect; noise white and stated

Off means: the mass by up to 4 %, the half length 0.4 %, the inertia 6 %, that of the rotor 10 %, evenly spread. A
strong effect has 0.8 to 1.25 of its usual size and moves the paths by at least 12 standard deviations of the noise, a
weak one 5 to 12 % of it and 0.3 to 9 of these, the strange one at most 9: what the boards l to o have (strong ones 27
to 280). The true model must tell the strong one by ten standard errors, with all that is hidden free beside it: weak
ones that do the same are drawn again. The odd run is off by 5 standard errors in its peak, bump or marker: of the shift
of this run alone beside a tyre and a strong effect that are fitted to all runs.
"""

import dataclasses

import numpy as np
from hidden import GAITS, Hidden, Run
from layout import BOARD, EFFECTS
from noise import Noise
from odd import bump_beside, with_odd_run
from strengths import STRANGE_USUAL, calibrated, scaled, sized
from truth import clearness

SETS = {"dev": 1, "final": 2}
"""Seeds of boards to develop with, and of those that judge: nobody looks into the latter before the end."""

KINDS = {
    "real_like": 60,
    "real_like_null": 20,
    "moderate": 20,
    "wrong_mass": 6,
    "wrong_length": 6,
    "wandering": 6,
    "odd_tyre": 12,
    "odd_bump": 12,
    "odd_marker": 12,
    "scale": 10,
    "exact": 6,
}
"""How many boards of each kind the whole table has."""

VARIANTS = ("fine", "coarse", "20hz", "500hz", "3s", "120s", "single", "no_heldout", "10g", "2000kg")
"""0.05 and 5 mm of noise, frames a second, length of the runs, one run to train on, none held out, and the mass."""

SIZES = {"10g": (0.01 / 7, 0.1127), "2000kg": (2000 / 7, 6.587)}
"""Mass and length of these two over those of the board: of one density."""

REAL = Noise((3e-4, 1e-3), (5e-4, 1.5e-3))
WHITE = Noise((4e-4, 2.5e-3))
OFF = {"m": 0.04, "L": 0.004, "I": 0.06, "Jr": 0.1}
CLEAR = 10.0


def draw(kind: str, group: str, number: int) -> Hidden:
    """The board of that kind, set (`dev` or `final`) and number."""
    rng = np.random.default_rng([SETS[group], list(KINDS).index(kind), number])
    variant = VARIANTS[number % len(VARIANTS)] if kind == "scale" else ""
    real = kind in ("real_like", "real_like_null", "scale")
    strong = kind in ("real_like", "scale") or (number % 2 == 1 and kind.startswith(("odd", "exact")))
    board = dataclasses.replace(
        _bare(rng, kind, SIZES.get(variant, (1.0, 1.0))),
        name=f"{kind}-{number:02d}" + f"-{variant}" * bool(variant),
        noise=REAL if real or kind == "wandering" else WHITE,
        noise_stated=not (real or kind == "wandering"),
    )
    if kind == "moderate":
        board = _several(board, rng)
    elif real or strong:
        # What a size is and what is clear is asked of 12 s runs with the usual noise: a variant is the same board.
        board = _furnished(board, rng, strong, real, variant)
    if kind.startswith("odd"):
        board = with_odd_run(board, rng, kind.removeprefix("odd_"), 5.0)
    return _varied(board, variant) if variant else board


def _bare(rng: np.random.Generator, kind: str, size: tuple[float, float]) -> Hidden:
    """A board without effects, with what is wrong in its case.toml."""
    stated = scaled(BOARD | {"Jw": 0.001}, *size)
    limits = {"B": (4.5, 9.0), "C": (1.25, 1.55), "D": (4.4, 9.0), "E": (-0.1, 0.5)}
    tyre = scaled({name: rng.uniform(*two) for name, two in limits.items()}, *size)
    values = {k: v for k, v in stated.items() if k != "Jw"} | tyre
    if kind.startswith(("real_like", "scale")):
        values |= {k: values[k] * (1 + rng.uniform(-share, share)) for k, share in OFF.items()}
    if kind == "wrong_mass":
        values["m"] *= 1 + float(rng.choice([-0.05, 0.05]))
    if kind == "wrong_length":
        values["L"] += float(rng.choice([-0.002, 0.002]))
    times = np.arange(1200) / 100
    starts = [np.append(rng.uniform(-0.5, 0.5, 2) * size[1], rng.uniform(-np.pi, np.pi)) for _ in GAITS]
    runs = tuple(Run(n, *GAITS[n], times, start) for n, start in zip(GAITS, starts, strict=True))
    return Hidden("", "free", stated, values, runs, REAL, False)


def _furnished(board: Hidden, rng: np.random.Generator, with_strong: bool, real: bool, variant: str) -> Hidden:
    """The first of the boards drawn that can be as visible as it has to be, and whose strong effect is clear."""
    while True:
        try:
            one = _furnish(board, rng, with_strong, real, variant)
        except ArithmeticError:
            continue
        if one.strong in (None, "lateral_skid") or clearness(one, one.strong) >= CLEAR:
            return one


def _furnish(board: Hidden, rng: np.random.Generator, with_strong: bool, real: bool, variant: str) -> Hidden:
    """The board with its strong effect if it has one, and with three weak ones and the strange one if it is real.

    In 120 s there are none but strong effects that do not carry the board away, and no grip that changes along x.
    """
    size = SIZES.get(variant, (1.0, 1.0))
    noise = _longer(REAL, size[1]) if real else WHITE
    steady = variant == "120s"
    names = [n for n in EFFECTS if not (steady and n == "grip_gradient")]
    choice = ["rolling_resistance", "steering_lag", "yaw_friction"] if steady else ["lateral_skid", *names]
    strong = str(rng.choice(choice)) if with_strong else None
    weak = tuple(str(n) for n in rng.permutation(names) if n != strong)[:3] if real else ()
    strange = str(rng.choice(list(STRANGE_USUAL))).split(".")[0] if real else None
    values, runs = dict(board.values), board.runs

    def add(effect: dict, low: float, high: float) -> None:
        """Put it in, as visible as it has to be."""
        values.update(_within(calibrated(effect, values, runs, noise, low, high), values, runs))

    if strong and strong != "lateral_skid":
        add(scaled(sized(strong, rng, rng.uniform(0.8, 1.25)), *size), 12.0, np.inf)
    for name in weak:
        add(scaled(sized(name, rng, rng.uniform(0.05, 0.12)), *size), 0.3, 9.0)
    if strange:
        effect = scaled({n: 0.04 * v for n, v in STRANGE_USUAL.items() if n.startswith(f"{strange}.")}, *size)
        if strange == "spring":
            effect |= scaled({f"spring.{axis}": rng.uniform(0.2, 0.8) for axis in ("x", "y")}, *size)
        add(effect | (bump_beside(runs[4], values) if strange == "bump" else {}), 0.0, 9.0)
    skid = "coupled" if strong == "lateral_skid" else "free"
    return dataclasses.replace(board, values=values, skid=skid, strong=strong, weak=weak, strange=strange)


def _several(board: Hidden, rng: np.random.Generator) -> Hidden:
    """The board with five to eight effects at 0.1 to 0.5 of their usual sizes."""
    weak = tuple(str(n) for n in rng.permutation(list(EFFECTS))[: rng.integers(5, 9)])
    values = dict(board.values)
    for name in weak:
        values |= _within(sized(name, rng, rng.uniform(0.1, 0.5)), values, board.runs)
    return dataclasses.replace(board, values=values, weak=weak)


def _within(effect: dict, values: dict, runs) -> dict:
    """The same, with a grip along the world that changes by 60 % at most where the board comes."""
    gradient = abs(effect.get("grip_gradient.g", 0.0))
    if not gradient:
        return effect
    reach = max(np.max(np.abs(run.path(values)[:, 0])) for run in runs)
    return {name: float(value * min(1.0, 0.6 / (gradient * reach))) for name, value in effect.items()}


def _longer(noise: Noise, times: float, turns: float = 1.0) -> Noise:
    """The noise with positions `times` and headings `turns` as uncertain."""
    return Noise(*((a * times, b * turns) for a, b in (noise.white, noise.wander)), noise.correlation)


def _varied(board: Hidden, variant: str) -> Hidden:
    """The board as the variant has it recorded."""
    rate = {"20hz": 20.0, "500hz": 500.0}.get(variant, 100.0)
    seconds = {"3s": 3.0, "120s": 120.0}.get(variant, 12.0)
    times = np.arange(round(seconds * rate)) / rate
    runs = [dataclasses.replace(run, times=times) for run in board.runs]
    if variant == "single":
        runs = [run for run in runs if run.role == "heldout" or run.name == "train-wander-1"]
    if variant == "no_heldout":
        runs = board.train
    size = {"fine": 0.05e-3, "coarse": 5e-3, "10g": 0.05e-3, "2000kg": 5e-3}.get(variant, REAL.scale[0])
    more = size / REAL.scale[0]
    noise = _longer(REAL, more, more if variant in ("fine", "coarse") else 1.0)
    return dataclasses.replace(board, runs=tuple(runs), noise=noise)
