"""Simulated boards a second: our two engines against SIMD C, diffrax by vmap, and scipy's LSODA with numba.

    python benchmarks/throughput.py [REPEATS] [engines | two_cores | million | cold]

Boards under `free`, Pacejka tyre, tracked joints, 7.7 s. Every number of board, tyre, gait, controller and start is
varied by 10 %: around Table II of the paper, and around the stiffer tyres of recordings. LSODA is called by `odeint`,
which is the faster way, and by `solve_ivp`. Each method has the loosest tolerance, of a common sequence, at which the
final positions of all boards of the table are within 1e-6 m of a reference. Needs a C compiler, AVX-512 and `pip
install -e .[bench]`. All methods alternate in one process on one core, REPEATS times. Ratios are those of medians;
against our Tsit5 it is the median of the ratios of neighbours. Two cores, a million boards and the cold command come
last. `engines` compares C and our engines alone. The order of the series is at least 9.
"""

import ctypes
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from snakejax import prepare_jax

prepare_jax()

import diffrax  # noqa: E402
import jax  # noqa: E402
import jax.numpy as jnp  # noqa: E402
import numba  # noqa: E402
import numpy as np  # noqa: E402
from scipy.integrate import odeint, solve_ivp  # noqa: E402

from snakejax import (  # noqa: E402
    Accuracy,
    Board,
    Gait,
    Model,
    Pacejka,
    Rayleigh,
    Sines,
    Tracked,
    preset,
    simulate,
    simulate_many,
    stacked,
    sweep,
)
from snakejax.core.parameter import with_parameters  # noqa: E402
from snakejax.simulation.ensemble import Engine  # noqa: E402

USUAL = dict(
    mass=7.0, inertia=0.4375, rotor=0.0238, length=0.25, creep=1e-3, B=0.09, C=1.8, D=1.0, E=0.6,
    phi_a=0.916, phi_w=4.0, phi_p=0.1, psi_a=1.57, psi_w=4.0, psi_p=0.1, kp=100.0, kd=10.0, x=0.1, y=0.1, heading=0.1,
)  # fmt: skip
STIFFER = dict(creep=0.01, B=8.0, C=1.4, D=4.0, E=0.1)
SECONDS, WITHIN = 7.7, 1e-6
TOLERANCES = (1e-4, 3e-5, 1e-5, 3e-6, 1e-6, 3e-7, 1e-7, 3e-8, 1e-8, 3e-9, 1e-9)
SAMPLE = 64
"""Boards that LSODA and diffrax simulate; their time for more is in proportion."""

Numbers = dict[str, np.ndarray]


def varied(count: int, **other: float) -> Numbers:
    rng = np.random.default_rng(0)
    numbers = {name: value * rng.uniform(0.9, 1.1, count) for name, value in (USUAL | other).items()}
    numbers["inertia"] = numbers["mass"] * numbers["length"] ** 2
    return numbers


def as_lanes(n: Numbers) -> tuple[Model, Gait, np.ndarray]:
    board = Board(mass=7.0, rotor_inertia=0.0238, wheelset_inertia=0.001, half_length=0.25, creep_speed=0.01)
    models = stacked([Model(board, Pacejka(8.0, 1.4, 4.0, 0.1), "free")] * n["mass"].size)
    parts = {"mass": "mass", "rotor_inertia": "rotor", "half_length": "length", "creep_speed": "creep"}
    moved = {f"board.{mine}": jnp.asarray(n[name]) for mine, name in parts.items()}
    moved |= {f"tyre.{name}": jnp.asarray(n[name]) for name in "BCDE"}

    def joint(name: str) -> Tracked:
        terms = (jnp.asarray(n[f"{name}_{part}"])[:, None] for part in "awp")
        return Tracked(Sines(*terms), jnp.asarray(n["kp"]), jnp.asarray(n["kd"]))

    start = np.stack([n["x"], n["y"], n["heading"]], axis=1)
    return with_parameters(models, moved), Gait(joint("phi"), joint("psi")), start


def simd(n: Numbers) -> Callable[[float], np.ndarray]:
    """The C program, compiled for this machine."""
    source = Path(__file__).with_name("simd") / "lanes.c"
    library = Path(tempfile.mkdtemp()) / "lanes.so"
    flags = ["-O3", "-march=native", "-mprefer-vector-width=512", "-ffast-math", "-shared", "-fPIC"]
    subprocess.run(["cc", *flags, "-o", library, source, "-lm", "-lmvec"], check=True)
    integrate = ctypes.CDLL(str(library)).integrate
    tableau = diffrax.Tsit5.tableau
    stages = np.zeros((6, 6))
    for k, row in enumerate(tableau.a_lower):
        stages[k, : len(row)] = row
    lanes = np.ascontiguousarray(np.stack([n[name] for name in USUAL]))
    arrays = (stages, np.ascontiguousarray(tableau.c), np.ascontiguousarray(tableau.b_error))

    def pointer(array: np.ndarray) -> ctypes.c_void_p:
        return array.ctypes.data_as(ctypes.c_void_p)

    def run(rtol: float) -> np.ndarray:
        poses = np.zeros((lanes.shape[1], 3))
        numbers = [ctypes.c_double(v) for v in (SECONDS, rtol, rtol / 100)]
        integrate(pointer(lanes), ctypes.c_long(lanes.shape[1]), *map(pointer, arrays), *numbers, pointer(poses))
        return poses

    return run


def lanes(n: Numbers, workers: int, engine: Engine = "tsit5") -> Callable[[float], np.ndarray]:
    models, gaits, start = as_lanes(n)

    def run(rtol: float) -> np.ndarray:
        accuracy = Accuracy(rtol=rtol, atol=rtol / 100, max_steps=10**6)
        how = dict(own_gaits=True, accuracy=accuracy, workers=workers, engine=engine)
        return simulate_many(models, gaits, [SECONDS], start, **how)[:, 0]

    return run


def by_vmap(n: Numbers) -> Callable[[float], np.ndarray]:
    models, gaits, start = as_lanes(n)

    def run(rtol: float) -> np.ndarray:
        accuracy = Accuracy(rtol=rtol, atol=rtol / 100)
        return np.asarray(_vmapped(models, gaits, start, accuracy))

    return run


def _many(models, gaits, start, accuracy):
    def one(model, gait, at):
        return simulate(model, gait, jnp.array([SECONDS]), at, accuracy=accuracy, throw=False).pose[-1]

    return jax.vmap(one)(models, gaits, start)


_vmapped = jax.jit(_many, static_argnames="accuracy")


@numba.njit(fastmath=True)
def _rates(y, t, p):
    mass, inertia, rotor, length, creep, B, C, D, E, pa, pw, pp, ra, rw, rp, kp, kd = p[:17]
    a = kd / 2
    q = np.sqrt(kp - a * a)
    fade, c, s = np.exp(-a * t), np.cos(q * t), np.sin(q * t) / q
    e0, slope = -pa * np.sin(pp), -pa * pw * np.cos(pp) - a * pa * np.sin(pp)
    phi = pa * np.sin(pw * t + pp) + fade * (e0 * c + slope * s)
    f0, f_slope = -ra * np.sin(rp), -ra * rw * np.cos(rp) - a * ra * np.sin(rp)
    f = fade * (f0 * c + f_slope * s)
    f_rate = fade * (f_slope * c - q * q * f0 * s) - a * f
    psi2 = -ra * rw * rw * np.sin(rw * t + rp) - kd * f_rate - kp * f
    sine, cosine, u, w, r = np.sin(phi), np.cos(phi), y[3], y[4], y[5]
    X = Y = N = 0.0
    for side in (1.0, -1.0):
        across = w + side * length * r
        v, roll = -side * u * sine + across * cosine, u * cosine + side * across * sine
        square = roll * roll + creep * creep
        slip = 2 * np.arctan(v / (np.sqrt(square) + np.sqrt(square + v * v)))
        eta = (1 - E) * slip + E / B * np.arctan(B * slip)
        F = D * np.sin(C * np.arctan(B * eta))
        X += F * side * sine
        Y -= F * cosine
        N -= side * length * F * cosine
    d = np.empty(6)
    d[0] = u * np.cos(y[2]) - w * np.sin(y[2])
    d[1] = u * np.sin(y[2]) + w * np.cos(y[2])
    d[2] = r
    d[3] = X / mass + r * w
    d[4] = Y / mass - r * u
    d[5] = (N - rotor * psi2) / inertia
    return d


def _ends(n: Numbers, one: Callable[..., np.ndarray]) -> Callable[[float], np.ndarray]:
    """One board after the other: `one` takes its numbers, its start and the tolerance."""
    rows = np.stack([n[name] for name in USUAL], axis=1)
    _rates(np.zeros(6), 0.0, rows[0])
    return lambda rtol: np.array([one(row, np.concatenate([row[17:], np.zeros(3)]), rtol) for row in rows])


def by_odeint(n: Numbers) -> Callable[[float], np.ndarray]:
    def one(row, start, rtol):
        return odeint(_rates, start, [0.0, SECONDS], args=(row,), rtol=rtol, atol=rtol / 100, mxstep=10**6)[-1, :3]

    return _ends(n, one)


def by_solve_ivp(n: Numbers) -> Callable[[float], np.ndarray]:
    def one(row, start, rtol):
        how = dict(method="LSODA", rtol=rtol, atol=rtol / 100)
        return solve_ivp(lambda t, y: _rates(y, t, row), (0.0, SECONDS), start, **how).y[:3, -1]

    return _ends(n, one)


FAST = {
    "C, AVX-512": simd,
    "Tsit5 lanes": lambda n: lanes(n, 1),
    "Taylor series": lambda n: lanes(n, 1, "taylor"),
}


def tolerance(run: Callable[[float], np.ndarray], true: np.ndarray) -> tuple[float, float]:
    """The loosest tolerance that is good enough, and the error it leaves [m]."""
    for rtol in TOLERANCES:
        error = float(np.abs(run(rtol) - true)[:, :2].max())
        if error <= WITHIN:
            return rtol, error
    raise SystemExit("No tolerance is good enough.")


def seconds(work: Callable[[], object]) -> float:
    begin = time.perf_counter()
    work()
    return time.perf_counter() - begin


def compare(title: str, repeats: int, peers: bool, **other: float) -> None:
    few = varied(1024, **other)
    sample = {name: column[:SAMPLE] for name, column in few.items()}
    slow = {"diffrax, vmap": by_vmap, "LSODA, odeint": by_odeint, "LSODA, solve_ivp": by_solve_ivp} if peers else {}
    print(f"\n{title}; one core, medians of {repeats} (least to most)")
    for count in (1024, 16384):
        n = few if count == 1024 else varied(count, **other)
        true = simd(n)(1e-12)
        makers = FAST | slow if count == 1024 else FAST
        chosen = {name: tolerance(make(n), true) for name, make in makers.items()}
        methods = {name: (make(n), count) if name in FAST else (make(sample), SAMPLE) for name, make in makers.items()}
        for run, _ in methods.values():
            run(TOLERANCES[0])
        taken: dict[str, list[float]] = {name: [] for name in methods}
        for _ in range(repeats):
            for name, (run, size) in methods.items():
                taken[name].append(seconds(lambda run=run, name=name, to=chosen: run(to[name][0])) / size)
        each = {name: statistics.median(values) for name, values in taken.items()}
        print(f"  {f'{count} boards':16} {'boards/s':>9} {'':>17} {'against C':>10} {'Tsit5':>7}"
              f" {'solve_ivp':>10} {'odeint':>8} {'rtol':>7} {'error [m]':>10}")  # fmt: skip
        for name, median in each.items():
            low, high = 1 / max(taken[name]), 1 / min(taken[name])
            pairs = zip(taken["Tsit5 lanes"], taken[name], strict=True)
            ratios = f"{each['C, AVX-512'] / median:10.3f} {statistics.median(a / b for a, b in pairs):7.2f}"
            for peer, width in (("LSODA, solve_ivp", 10), ("LSODA, odeint", 8)):
                ratios += f" {each[peer] / median:{width}.1f}" if peer in each else " " * (width + 1)
            print(f"  {name:16} {1 / median:9.0f} {f'({low:.0f} to {high:.0f})':>17} {ratios} {chosen[name][0]:7g}"
                  f" {chosen[name][1]:10.1e}")  # fmt: skip


def two_cores(repeats: int) -> None:
    """In a process that was never held to one core: the threads of XLA stay where their process began."""
    n = varied(16384)
    for name, engine in (("Tsit5", "tsit5"), ("Taylor series", "taylor")):
        one, two = lanes(n, 1, engine), lanes(n, 2, engine)
        one(3e-6), two(3e-6)
        taken = [(seconds(lambda one=one: one(3e-6)), seconds(lambda two=two: two(3e-6))) for _ in range(repeats)]
        ratio = statistics.median(a / b for a, b in taken)
        print(f"\nTwo cores against one, {name}, 16384 boards: {ratio:.2f} (median of {repeats})")


def million(repeats: int) -> None:
    """A sweep of 10^6 viscous boards over k_s under paper-rotate, 14 s, on all cores, and the wait for the first board.

    `repeats` is not used: the sweep is done once.
    """
    example = preset("paper-rotate")
    model = Model(example.model.board, Rayleigh(10.0), "coupled")
    for count in (1, 10**6):
        over = {"tyre.k_s": np.linspace(1.0, 100.0, count)}
        whole = seconds(lambda over=over: sweep(model, example.gait, example.times[-1:], over))
        print(f"\nSweep of {count} boards over k_s: {whole:.1f} s")


def cold(repeats: int) -> None:
    """`snakejax sweep` over 1024 boards in fresh processes; the first one, which compiles, is left out."""
    mine = ("commands.cli.sweep", "commands.requested_model", "simulation.parameter_sweep", "simulation.rayleigh_match")
    imports = "; ".join(f"import snakejax.{name}" for name in mine) + "; import xarray, rich.console, rich.progress"
    sweeps = {
        "k_s of a Rayleigh board": ("--model", "rayleigh", "--vary", "k_s=1:100:1024"),
        "D, with the nearest k_s of each": ("--vary", "D=0.5:10:1024"),
    }
    for what, options in sweeps.items():
        command = [sys.executable, "-m", "snakejax", "sweep", "paper-rotate", *options, "--quiet", "--json", "-"]
        subprocess.run(command, check=True, capture_output=True)
        found = []
        for _ in range(repeats):
            whole = seconds(lambda command=command: subprocess.run(command, check=True, capture_output=True))
            found.append((whole, seconds(lambda: subprocess.run([sys.executable, "-c", imports], check=True))))
        said = json.loads(subprocess.run(command, check=True, capture_output=True).stdout)["seconds"]
        whole, imported = (statistics.median(part) for part in zip(*found, strict=True))
        print(f"\n`snakejax sweep` of 1024 values of {what}, second run: {whole:.1f} s, of which its imports")
        print(f"{imported:.1f} s: {whole - imported:.1f} s beyond them (the command itself says {said['total']:.1f} s)")


if __name__ == "__main__":
    repeats = int(sys.argv[1]) if len(sys.argv) > 1 else 7
    for part in (two_cores, million, cold):
        if part.__name__ in sys.argv:
            part(repeats)
            raise SystemExit
    cores = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {min(cores)})
    peers = "engines" not in sys.argv
    compare("Table II of the paper", repeats, peers)
    compare("Tyres as of recordings", repeats, peers, **STIFFER)
    if not peers:
        raise SystemExit
    os.sched_setaffinity(0, cores)
    for part in (two_cores, million):
        subprocess.run([sys.executable, __file__, str(repeats), part.__name__], check=True)
    cold(repeats)
