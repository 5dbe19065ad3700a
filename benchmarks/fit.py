"""What a fit costs, beside scipy's least squares over LSODA with a compiled right-hand side.

    python benchmarks/fit.py [PART ...]

prints one table, or the PARTs named of against_scipy, jacobian, whole_case, imports and command_line. All times are
medians over repeats that alternate, so that a busy machine slows both sides.
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

jax.config.update("jax_enable_x64", True)

from snakejax._board import TABLE_II, Board  # noqa: E402
from snakejax._case import load_case  # noqa: E402
from snakejax._fit import estimated, fit, starting_model  # noqa: E402
from snakejax._gait import Gait, Sines, Tracked  # noqa: E402
from snakejax._model import Model  # noqa: E402
from snakejax._recording import Noise, Run  # noqa: E402
from snakejax._simulate import Accuracy, simulate  # noqa: E402
from snakejax._study import FIT_ACCURACY, Study  # noqa: E402
from snakejax._tyre import Pacejka  # noqa: E402
from snakejax._units import with_parameters  # noqa: E402

ROOT = Path(__file__).resolve().parents[1]
LEVEL = ROOT / "data" / "level-board"
TYRE = ["tyre.B", "tyre.C", "tyre.D", "tyre.E"]
TRUTH = np.array([6.0, 1.4, 2.0, 0.0])
START = np.array([6.6, 1.3, 2.2, 0.2])
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


def medians(*work: Callable[[], object], repeats: int = REPEATS) -> list[float]:
    """Median seconds of each of `work`, done in turns, the first turn not counted."""
    seconds = np.zeros((repeats + 1, len(work)))
    for turn in range(repeats + 1):
        for k, do in enumerate(work):
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


def scipy_fit(seen: np.ndarray, rtol: float, step: float):
    """scipy's Levenberg-Marquardt in ln B, ln C, ln D, E and the heading, by differences of size `step`."""
    sd = np.asarray(NOISE.channels)

    def residual(z):
        tyre = np.array([*np.exp(z[:3]), z[3]])
        return ((seen - scipy_pose(tyre, z[4], rtol)) / sd).ravel()

    began = np.array([*np.log(START[:3]), START[3], 0.0])
    found = least_squares(residual, began, method="lm", diff_step=step, ftol=1e-8, xtol=1e-8, gtol=1e-12)
    return np.array([*np.exp(found.x[:3]), *found.x[3:]]), 2 * found.cost / seen.size, found.nfev


# --- Our side -----------------------------------------------------------------------------------------------------


def tracked(terms: tuple[float, ...]) -> Tracked:
    """A joint under the controller."""
    return Tracked(Sines.of([terms[:3], terms[3:]]), kp=KP, kd=KD)


def one_run() -> tuple[Study, np.ndarray]:
    """The study of one run of 770 frames, of whose start only the heading is unknown; and what was seen."""
    board = Board(**TABLE_II, creep_speed=CREEP)
    gait = Gait(tracked(PHI), tracked(PSI))
    model = Model(board, Pacejka(*TRUTH), "coupled")
    true = simulate(model, gait, jnp.asarray(TIMES), (0.0, 0.0, HEADING), accuracy=Accuracy(rtol=1e-10, atol=1e-11))
    np.testing.assert_allclose(scipy_pose(TRUTH, HEADING, 1e-9), true.pose, atol=1e-6)
    seen = np.asarray(true.pose) + np.random.default_rng(0).normal(size=(TIMES.size, 3)) * np.asarray(NOISE.channels)
    run = Run("forward", "train", jnp.asarray(TIMES), jnp.asarray(seen), gait)
    study = Study.of(with_parameters(model, dict(zip(TYRE, START, strict=True))), [run], NOISE, TYRE, 4)
    start = jnp.zeros((1, 3)), jnp.array([[0.0, 0.0, 1.0]])
    return eqx.tree_at(lambda s: (s.batch.start, s.batch.free_start), study, start), seen


def against_scipy() -> None:
    """The same fit on both sides, down to the same misfit."""
    study, seen = one_run()
    ours = study.fit(study.values(), TYRE, [0])
    estimates = estimated(study, ours)
    print("The fit: coupled, one run of 7.7 s, 770 samples of x, y and heading; B, C, D, E and the start heading")
    print("  estimates: " + ", ".join(f"{n} {e.value:.4f} +- {e.sd:.4f}" for n, e in estimates.items()))
    rows = {"rtol 1e-7, differences of 1e-4": (1e-7, 1e-4), "rtol 1e-9, differences of 1e-5": (1e-9, 1e-5)}
    fits = {how: scipy_fit(seen, *setting) for how, setting in rows.items()}
    works = [lambda: study.fit(study.values(), TYRE, [0])]
    works += [lambda s=setting: scipy_fit(seen, *s) for setting in rows.values()]
    mine, *theirs = medians(*works)
    line(f"snakejax, warm, {ours.steps} steps, misfit {ours.misfit:.5f}", f"{mine * 1e3:.1f} ms")
    for (how, (_, misfit, calls)), seconds in zip(fits.items(), theirs, strict=True):
        line(f"scipy + LSODA + numba, {how}, {calls} calls, misfit {misfit:.5f}", f"{seconds * 1e3:.1f} ms")
        line("  scipy / snakejax", f"{seconds / mine:.2f}")
        if abs(misfit - ours.misfit) > 1e-3:
            print("  (not the same optimum)")


def jacobian() -> None:
    """The derivative of one run in five parameters, in units of the run itself."""
    study, _ = one_run()
    gait = jax.tree.map(lambda leaf: leaf[0], study.batch.gait)

    def pose(z):
        model = with_parameters(study.model, {name: z[k] for k, name in enumerate(TYRE)})
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
    train = found.study.numbered("train")
    line(
        f"level-board, warm: {len(train)} runs, {found.study.samples(train)} numbers, with held-out", f"{seconds:.2f} s"
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
    parts = (against_scipy, jacobian, whole_case, imports, command_line)
    for part in parts:
        if part.__name__ in sys.argv[1:] or not sys.argv[1:]:
            part()


if __name__ == "__main__":
    main()
