"""Defects put into clean recordings: how often they are found, how many frames are lost, and how a fit turns out.

    python benchmarks/defects.py [FOLDER ...]      folders with cases, whose runs must be clean; default data/

Each clean run is used as it is, and with new noise on its smoothed path. Each defect of tests/oracles/defects.py is put
into each of them once at each size. The table is kept in benchmarks/defects.txt.
"""

import dataclasses
import sys
from pathlib import Path

import jax.numpy as jnp
import numpy as np
from scipy.interpolate import make_smoothing_spline

import snakejax as sj

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "tests"))

from oracles import defects  # noqa: E402

from snakejax.recording.quality import PoseSeries  # noqa: E402
from snakejax.recording.quality.inspection import find_defects  # noqa: E402

NOISE = np.array([4e-4, 4e-4, 2.5e-3])
SIZES = {
    "teleport": (0.003, 0.004, 0.006, 0.01, 0.1, 7.0),
    "teleports": (0.006, 0.01, 0.1),
    "wild_heading": (0.02, 0.04, 0.06, 0.1, 1.0),
    "swap": (5, 20, 100, 380),
    "near_swap": (0.01, 0.02, 0.05, 0.1),
    "frozen": (1, 5, 20, 300),
    "reordered": (0.003, 0.01, 0.03),
    "clock_jump": (0.006, 0.01, 0.03),
    "flip": (1, 50, 300),
    "jitter": (2, 3, 4, 5),
    "length_unit": (1000, 100, 10, 0.1, 0.01, 0.001),
    "angle_unit": (57.2958, 0.0174533),
    "up_axis": (1.0,),
    "late": (0.1, 0.15, 0.2),
    "gap": (0.3, 0.6),
}
FITTED = (("teleports", 0.1), ("swap", 100), ("frozen", 20), ("reordered", 0.03), ("flip", 50), ("clock_jump", 0.03))


def tracks(folders: list[Path]) -> list[PoseSeries]:
    """The runs of all cases in `folders`, as they are and with noise made anew."""
    found = []
    for case in sorted(path.parent for folder in folders for path in folder.glob("*/case.toml")):
        for number, run in enumerate(sj.load_case(case).runs):
            track = PoseSeries.of(run)
            seen = track.complete()
            smooth = np.stack(
                [make_smoothing_spline(seen.times, c, lam=1e-7)(track.times) for c in seen.pose.T], axis=1
            )
            noisy = smooth + np.random.default_rng(number).normal(size=smooth.shape) * NOISE
            found += [track, track._replace(pose=np.where(track.present[:, None], noisy, np.nan))]
    return found


def alarms(clean: list[PoseSeries]) -> None:
    """False alarms on clean runs, at several frame rates."""
    print("clean runs                  runs   with a finding   frames masked")
    for every in (1, 2, 4, 5):
        found = [find_defects(PoseSeries(t.times[::every], t.pose[::every])) for t in clean]
        masked = sum(
            int(np.isfinite(t.pose[::every, 0]).sum()) - int(m.present.sum())
            for t, (m, _) in zip(clean, found, strict=True)
        )
        print(f"  every frame of {every:<10} {len(clean):6d} {sum(bool(f) for _, f in found):16d} {masked:15d}")


def rates(clean: list[PoseSeries]) -> None:
    """How often each defect is found at each size."""
    print("\ndefect            size   runs   found   bad frames lost   good frames lost a run")
    for name, sizes in SIZES.items():
        for size in sizes:
            hits = runs = bad = lost = good = 0
            for number, track in enumerate(clean):
                made = getattr(defects, name)(track, size, np.random.default_rng([number, 11]))
                if not made.kinds:
                    continue
                runs += 1
                mended, findings = find_defects(made.track)
                hits += any(f.kind in made.kinds for f in findings)
                gone = made.track.present & ~mended.present
                inside = np.zeros(gone.size, bool)
                inside[made.frames] = True
                bad, lost = bad + int((inside & made.track.present).sum()), lost + int((gone & inside).sum())
                good += int((gone & ~inside).sum())
            share = f"{lost / max(bad, 1):15.1%}" if lost else f"{'-':>15}"
            print(
                f"{name:14} {size:8g} {runs:6d} {hits / max(runs, 1):7.1%} {share} {good / max(runs, 1):18.2f}",
                flush=True,
            )


def fits(folder: Path) -> None:
    """A defect in every run of a case: its fit beside that of the clean case, with the remedies and as recorded."""
    case = sj.load_case(folder)
    model = sj.starting_model(case)
    clean = sj.estimation.fit(model, case.runs, case.noise).estimates
    print(f"\n{folder.name}: largest change of B, C, D, E in standard errors; misfit (clean 1)")
    print("defect            size   with remedies        as recorded")
    for name, size in FITTED:
        runs = []
        for number, run in enumerate(case.runs):
            made = getattr(defects, name)(PoseSeries.of(run), size, np.random.default_rng([number, 5]))
            runs.append(
                dataclasses.replace(run, times=jnp.asarray(made.track.times), pose=jnp.asarray(made.track.pose))
            )
        spoiled = dataclasses.replace(case, runs=tuple(runs))
        told = []
        for raw in (False, True):
            seen = sj.inspect(spoiled, as_recorded=raw)
            if any(f.severity == "refused" for f in seen.findings) and not raw:
                told.append("refused")
                continue
            try:
                found = sj.estimation.fit(model, seen.case.runs, case.noise)
            except sj.FitError:
                told.append("fails")
                continue
            off = max(abs(found.estimates[p].value - e.value) / (e.sd or np.inf) for p, e in clean.items())
            told.append(f"{off:6.2f} ({found.train_score.misfit:.4g})")
        print(f"{name:14} {size:8g}   {told[0]:20} {told[1]}", flush=True)


def main() -> None:
    sj.prepare_jax()
    folders = [Path(name) for name in sys.argv[1:]] or [ROOT / "data"]
    clean = tracks(folders)
    alarms(clean)
    rates(clean)
    fits(ROOT / "data" / "level-board")


if __name__ == "__main__":
    main()
