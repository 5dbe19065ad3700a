"""The time of a fit, against scipy's least squares over LSODA with a compiled right-hand side.

    python benchmarks/fit.py [PART ...]

prints one table, or the PARTs named: against_scipy, canyon, jacobian, whole_case, imports, command_line. All times are
medians over repeats that alternate, so a busy machine slows both sides.
"""

import json
import math
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numba
import numpy as np
from scipy.integrate import odeint
from scipy.optimize import least_squares

from snakejax import prepare_jax

prepare_jax()

from snakejax.core.parameter import with_parameters  # noqa: E402
from snakejax.dynamics.inputs import Gait  # noqa: E402
from snakejax.dynamics.model import Model  # noqa: E402
from snakejax.dynamics.signals import Sines, Tracked  # noqa: E402
from snakejax.dynamics.tyres import Pacejka  # noqa: E402
from snakejax.estimation import levenberg_marquardt  # noqa: E402
from snakejax.estimation.fitting import fit  # noqa: E402
from snakejax.estimation.initial_model import starting_model  # noqa: E402
from snakejax.estimation.linear_residuals import LinearResiduals  # noqa: E402
from snakejax.estimation.problem import FIT_ACCURACY, Problem  # noqa: E402
from snakejax.estimation.uncertainty import estimates_of  # noqa: E402
from snakejax.recording.case import load_case  # noqa: E402
from snakejax.recording.run import Noise, Run  # noqa: E402
from snakejax.simulation.integrate import Accuracy, simulate  # noqa: E402
from snakejax.vehicles.snakeboard.board import TABLE_II, Board  # noqa: E402

ROOT = Path(__file__).resolve().parents[1]
LEVEL = ROOT / "data" / "level-board"
TYRE = ["tyre.B", "tyre.C", "tyre.D", "tyre.E"]
TRUTH = np.array([6.0, 1.4, 2.0, 0.0])
STARTS = TRUTH * np.exp(np.random.default_rng(1).uniform(-0.1, 0.1, (9, 4))) + [0.0, 0.0, 0.0, 0.2]
"""Within a tenth of the truth, E 0.2 off: the misfit there is some ten thousand times the noise."""
HEADING = 0.3
"""The fifth unknown: where the board points at the start [rad]; it is first guessed to be zero."""
TIMES = np.arange(770) / 100
NOISE = Noise(4e-4, 2.5e-3, "given")
PHI, PSI = (0.916, 4.0, 0.0, 0.0, 0.0, 0.0), (1.57, 4.0, 0.0, 0.0, 0.0, 0.0)
"""The paper's forward gait; there is room for a second sine."""
KP, KD, CREEP = 100.0, 10.0, 0.01
REPEATS = 9


def line(what: str, value: str) -> None:
    """One line of the table."""
    print(f"{what:<86} {value:>12}", flush=True)


def medians(*work: Callable[[], object], repeats: int = REPEATS, row: int = 1) -> list[float]:
    """Median seconds of each of `work`, done in turns, the first turn not counted.

    In its turn each is done `row` times, and the last of them counts: what ran before then no longer slows it.
    """
    seconds = np.zeros((repeats + 1, len(work)))
    for turn in range(repeats + 1):
        for k, do in enumerate(work):
            for _ in range(row):
                begun = time.perf_counter()
                do()
                seconds[turn, k] = time.perf_counter() - begun
    return list(np.median(seconds[1:], axis=0))


# --- The other side: the coupled structure in numba ---------------------------------------------------------------


@numba.njit(inline="always")
def command(terms, t):
    """Angle, rate and acceleration of a sum of two sines."""
    a = terms[0] * math.sin(terms[1] * t + terms[2]) + terms[3] * math.sin(terms[4] * t + terms[5])
    r = terms[0] * terms[1] * math.cos(terms[1] * t + terms[2]) + terms[3] * terms[4] * math.cos(
        terms[4] * t + terms[5]
    )
    s = -terms[0] * terms[1] ** 2 * math.sin(terms[1] * t + terms[2]) - terms[3] * terms[4] ** 2 * math.sin(
        terms[4] * t + terms[5]
    )
    return a, r, s


@numba.njit(inline="always")
def joint(terms, t):
    """The joint that the controller drives from rest to the command; KP > KD^2 / 4."""
    a0, r0, _ = command(terms, 0.0)
    a, r, s = command(terms, t)
    decay = KD / 2
    w = math.sqrt(KP - decay**2)
    e0, slope = -a0, -r0 - decay * a0
    fade, c, sn = math.exp(-decay * t), math.cos(w * t), math.sin(w * t) / w
    e = fade * (e0 * c + slope * sn)
    e_rate = fade * (slope * c - w * w * e0 * sn) - decay * e
    return a + e, r + e_rate, s - KD * e_rate - KP * e


@numba.njit
def rates(y, t, B, C, D, E, out):
    """The coupled structure for steering +phi and -phi, so that W = 0."""
    mass, rotor, L = 7.0, 0.0238, 0.25
    inertia = mass * L**2
    phi, _, _ = joint(PHI, t)
    _, _, spin = joint(PSI, t)
    cosine = math.cos(phi)
    turn = math.tan(phi) / L
    theta, u, s = y[2], y[4], y[5]
    beta_rate = (s - turn * u) / 2
    lateral, rolling = L * beta_rate * cosine, u / cosine
    slip = math.atan(lateral / math.sqrt(rolling**2 + CREEP**2))
    eta = (1 - E) * slip + E / B * math.atan(B * slip)
    G = 2 * L * cosine * D * math.sin(C * math.atan(B * eta))
    out[0], out[1] = u * math.cos(theta), u * math.sin(theta)
    out[2], out[3] = (s + turn * u) / 2, beta_rate
    out[4], out[5] = turn / 2 * G / mass, (-rotor * spin - G / 2) / inertia
    return out


@numba.njit
def rates_anew(y, t, B, C, D, E):
    """`rates` for odeint, which keeps what it is given."""
    return rates(y, t, B, C, D, E, np.empty(6))


def scipy_pose(tyre: np.ndarray, heading: float, rtol: float) -> np.ndarray:
    """Pose (n, 3) at TIMES by LSODA."""
    start = np.array([0.0, 0.0, heading, 0.0, 0.0, 0.0])
    states = odeint(rates_anew, start, TIMES, args=tuple(tyre), rtol=rtol, atol=rtol / 100, mxstep=100_000)
    return np.stack([states[:, 0], states[:, 1], states[:, 2] + states[:, 3]], axis=1)


def scipy_fit(seen: np.ndarray, start: np.ndarray, rtol: float, method: str, step: float | None):
    """scipy's least squares in ln B, ln C, ln D, E and the heading, by differences of size `step`."""
    sd = np.asarray(NOISE.channels)

    def residual(z):
        tyre = np.array([*np.exp(z[:3]), z[3]])
        return ((seen - scipy_pose(tyre, z[4], rtol)) / sd).ravel()

    began = np.array([*np.log(start[:3]), start[3], 0.0])
    found = least_squares(residual, began, method=method, diff_step=step)
    return 2 * found.cost / seen.size, found.nfev


# --- Our side -----------------------------------------------------------------------------------------------------


def tracked(terms: tuple[float, ...]) -> Tracked:
    """A joint under the controller."""
    return Tracked(Sines.of([terms[:3], terms[3:]]), kp=KP, kd=KD)


def one_run() -> tuple[Problem, np.ndarray]:
    """The study of one run of 770 frames, of whose start only the heading is unknown; and what was seen."""
    board = Board(**TABLE_II, creep_speed=CREEP)
    gait = Gait(tracked(PHI), tracked(PSI))
    model = Model(board, Pacejka(*TRUTH), "coupled")
    true = simulate(model, gait, jnp.asarray(TIMES), (0.0, 0.0, HEADING), accuracy=Accuracy(rtol=1e-10, atol=1e-11))
    np.testing.assert_allclose(scipy_pose(TRUTH, HEADING, 1e-9), true.pose, atol=1e-6)
    seen = np.asarray(true.pose) + np.random.default_rng(0).normal(size=(TIMES.size, 3)) * np.asarray(NOISE.channels)
    run = Run("forward", "train", jnp.asarray(TIMES), jnp.asarray(seen), gait)
    problem = Problem.of(model, [run], NOISE, TYRE, 4)
    start = jnp.zeros((1, 3)), jnp.array([[0.0, 0.0, 1.0]])
    return eqx.tree_at(lambda s: (s.batch.start, s.batch.free_start), problem, start), seen


def against_scipy() -> None:
    """The same fits on both sides, in turns, those compared that end at the same misfit."""
    problem, seen = one_run()
    settings = {
        "its defaults, rtol 1e-8": (1e-8, "trf", None),
        "its defaults, rtol 1e-10": (1e-10, "trf", None),
        "trf, rtol 1e-8, differences of 1e-4": (1e-8, "trf", 1e-4),
        "lm, rtol 1e-8, differences of 1e-4": (1e-8, "lm", 1e-4),
    }
    print("The fit: coupled, one run of 7.7 s, 770 samples of x, y and heading; B, C, D, E and the start heading")
    solution = problem.fit(dict(zip(TYRE, TRUTH, strict=True)), TYRE, [0])
    best = solution.misfit
    print(
        "  estimates: "
        + ", ".join(f"{n} {e.value:.4f} +- {e.sd:.4f}" for n, e in estimates_of(problem, solution).items())
        + f"; misfit {best:.5f}"
    )
    rows = {name: [] for name in ("snakejax", *settings)}
    for start in STARTS:
        values = dict(zip(TYRE, start, strict=True))
        works = [lambda v=values: problem.fit(v, TYRE, [0])]
        works += [lambda s=start, how=how: scipy_fit(seen, s, *how) for how in settings.values()]
        seconds = medians(*works, repeats=3, row=2)
        ended = [works[0]().misfit, *(work()[0] for work in works[1:])]
        for row, time_, misfit in zip(rows.values(), seconds, ended, strict=True):
            row.append((time_, abs(misfit - best) < 1e-3))
    ours = np.array(rows["snakejax"])
    line(
        f"snakejax, warm: median of {len(STARTS)} starts, {int(ours[:, 1].sum())} reach the optimum",
        f"{np.median(ours[:, 0]) * 1e3:.1f} ms",
    )
    for how in settings:
        theirs = np.array(rows[how])
        both = (ours[:, 1] > 0) & (theirs[:, 1] > 0)
        line(
            f"scipy + LSODA + numba, {how}: {int(theirs[:, 1].sum())} reach it",
            f"{np.median(theirs[:, 0]) * 1e3:.1f} ms",
        )
        if both.any():
            ratio = np.median(theirs[both, 0] / ours[both, 0])
            line("  scipy / snakejax, median over the starts from which both do", f"{ratio:.1f}")


def canyon() -> None:
    """Steps along the sine of a valley with steep walls, r = (wall (z_1 - sin z_0), z_0 - 2) from the origin."""
    print("Steps to the end of a valley that bends, with walls so many times as steep as its floor")
    bend = levenberg_marquardt.SMALL
    ending = levenberg_marquardt.StoppingRule(*(np.asarray(part) for part in (1e-9, 0.0, 1e9, 60)))
    for wall in (30.0, 100.0, 300.0, 1000.0):

        def residual(z, wall=wall):
            return jnp.stack([wall * (z[1] - jnp.sin(z[0])), z[0] - 2.0])

        slope = jax.jit(jax.jacfwd(residual))

        def linearised(z, residual=residual, slope=slope):
            none = np.zeros(2)
            return LinearResiduals(np.asarray(residual(z))[None], np.asarray(slope(z))[None], none, none)

        steps = []
        for levenberg_marquardt.SMALL in (bend, 0.0):
            ended = levenberg_marquardt.levenberg_marquardt(linearised, np.zeros(2), np.asarray(30.0), ending)
            steps.append(f"{ended.steps}" if ended.settled else f"more than {ended.steps}")
        theirs = least_squares(residual, np.zeros(2), lambda z, slope=slope: np.asarray(slope(z)), method="lm")
        line(f"walls {wall:g}: snakejax; with straight steps; scipy (MINPACK)", "; ".join([*steps, str(theirs.nfev)]))
    levenberg_marquardt.SMALL = bend


def jacobian() -> None:
    """The derivative of one run in five parameters, in units of the run itself."""
    problem, _ = one_run()
    gait = jax.tree.map(lambda leaf: leaf[0], problem.batch.gait)

    def pose(z):
        model = with_parameters(problem.model, {name: z[k] for k, name in enumerate(TYRE)})
        start = jnp.stack([jnp.zeros(()), jnp.zeros(()), z[4]])
        return simulate(model, gait, jnp.asarray(TIMES), start, accuracy=FIT_ACCURACY, throw=False).pose

    z = jnp.asarray([*TRUTH, HEADING])
    forward, tangents = jax.jit(pose), jax.jit(jax.jacfwd(pose))
    one, five, lsoda = medians(
        lambda: forward(z).block_until_ready(),
        lambda: tangents(z).block_until_ready(),
        lambda: scipy_pose(TRUTH, HEADING, FIT_ACCURACY.rtol),
        repeats=31,
    )
    line(f"one forward solve (rtol {FIT_ACCURACY.rtol:g})", f"{one * 1e3:.2f} ms")
    line("  LSODA + numba, the same", f"{lsoda * 1e3:.2f} ms")
    line("forward solve with its Jacobian in 5 parameters", f"{five * 1e3:.2f} ms")
    line("  in forward solves", f"{five / one:.2f}")


def whole_case() -> None:
    """`data/level-board`, from the starting tyre to the judged fit, once compiled."""
    case = load_case(LEVEL)
    found = fit(starting_model(case), case.runs, case.noise)
    (seconds,) = medians(lambda: fit(starting_model(case), case.runs, case.noise), repeats=3)
    line(
        f"level-board, warm: {len(found.runs)} runs, {found.train_score.samples} numbers, with held-out",
        f"{seconds:.2f} s",
    )


# --- Fresh processes ----------------------------------------------------------------------------------------------


def fresh(*arguments: str, **environment: str) -> float:
    """Seconds of a Python process."""
    path = os.pathsep.join(filter(None, [str(ROOT / "src"), os.environ.get("PYTHONPATH", "")]))
    begun = time.perf_counter()
    subprocess.run(
        [sys.executable, *arguments],
        check=True,
        stdout=subprocess.PIPE,
        env={**os.environ, "PYTHONPATH": path, **environment},
    )
    return time.perf_counter() - begun


def imports() -> None:
    """What importing the package adds to importing what it stands on."""
    below = "import jax, diffrax, optimistix, equinox"
    lazy = f"{below}; import snakejax"
    whole = f"{lazy}; [getattr(snakejax, name) for name in snakejax.__all__]"
    seconds = medians(*(lambda code=code: fresh("-c", code) for code in (below, lazy, whole)), repeats=5)
    line("fresh process: import jax, diffrax, optimistix, equinox", f"{seconds[0]:.2f} s")
    line("  and snakejax, beyond that", f"{seconds[1] - seconds[0]:+.3f} s")
    line("  and every public name of it, beyond that", f"{seconds[2] - seconds[0]:+.3f} s")


def command_line() -> None:
    """The command a user types, with an empty cache of compiled programs and with a full one."""
    words = ("-m", "snakejax", "fit", str(LEVEL), "--quiet", "--json", "-")
    with tempfile.TemporaryDirectory() as cache:
        cold = fresh(*words, JAX_COMPILATION_CACHE_DIR=cache)
        second = statistics.median(fresh(*words, JAX_COMPILATION_CACHE_DIR=cache) for _ in range(3))
    line("snakejax fit data/level-board --quiet --json -, first time", f"{cold:.1f} s")
    line("  again, its programs in the cache", f"{second:.1f} s")


def main() -> None:
    """Print the table."""
    versions = {name: __import__(name).__version__ for name in ("jax", "diffrax", "optimistix", "scipy", "numba")}
    print(f"{os.cpu_count()} cores; {json.dumps(versions)}")
    parts = (against_scipy, canyon, jacobian, whole_case, imports, command_line)
    for part in parts:
        if part.__name__ in sys.argv[1:] or not sys.argv[1:]:
            part()


if __name__ == "__main__":
    main()
