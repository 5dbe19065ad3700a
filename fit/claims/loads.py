"""The gaits of Table I under load and camber: P6, P7, P9 and P14."""

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

import snakejax as sj

from .claim import Claim, keep, verdict
from .example import STRUCTURES, board, mass, poses, times


def with_payload(folder: Path, loads: np.ndarray, cambers: np.ndarray) -> list[Claim]:
    """P6, P7, P9, P14: Table I's gaits with Bakker's tyre; P9 at each of `loads` [N] and `cambers` [rad]."""
    rows = []
    matched = {}
    for name, figure_name in (("paper-gait1", "fig5-6"), ("paper-gait2", "fig7")):
        figure = Figure(figsize=(9.0, 4.2), layout="constrained")
        for axis, (load, camber) in zip(figure.subplots(1, 2), ((2.54, 0.52), (5.08, 0.3)), strict=True):
            example = sj.preset(name, load, camber)
            near = sj.nearest_rayleigh(board(example), example.gait, times(example), {"board.mass": [mass(example)]})
            k_s, mismatch = float(near.best[0]), float(near.mismatch[0])
            matched[name, load] = (k_s, mismatch)
            for tyre, label in ((None, "Pacejka"), (sj.Rayleigh(k_s), f"Rayleigh, $k_s$ = {k_s:.3g} N s/m")):
                path = poses([board(example, tyre)], example)[0]
                axis.plot(path[:, 0], path[:, 1], lw=2.2 if tyre is None else 1, label=label)
            axis.set(xlabel="x [m]", ylabel="y [m]", title=f"{load} N, {camber} rad: {100 * mismatch:.2g} %")
            axis.set_aspect("equal", adjustable="datalim")
            axis.legend(fontsize="x-small")
        keep(figure, folder, figure_name)
    first = [matched["paper-gait1", load] for load in (2.54, 5.08)]
    second = [matched["paper-gait2", load] for load in (2.54, 5.08)]
    others = untuned(first)
    rows.append(
        Claim(
            "P6",
            "Gait 1 at 2.54 N, 0.52 rad and at 5.08 N, 0.3 rad: shape and distance of the best Rayleigh board agree",
            ", ".join(f"{100 * m:.2g} % of the path at k_s = {k:.3g}" for k, m in first),
            verdict(max(m for _, m in first) < 0.02),
            f"rms distance below 2 %. {readings()}",
        )
    )
    rows.append(
        Claim(
            "P7",
            "Gait 2: similar shape, diverging slowly; tuning reduces it",
            ", ".join(f"{100 * m:.2g} % at the best k_s = {k:.3g}" for k, m in second)
            + "; at the k_s of gait 1: "
            + ", ".join(f"{100 * m:.2g} %" for m in others),
            verdict(max(m for _, m in second) < 0.1 and all(m < u for (_, m), u in zip(second, others, strict=True))),
            "rms distance below 10 %, and less than untuned",
        )
    )
    missing = {}
    for name in ("paper-gait1", "paper-gait2"):
        example = sj.preset(name)
        for constraint in STRUCTURES:
            over = sj.grid({"tyre.load": loads, "tyre.camber": cambers})
            over = over.moving("board.mass", 2 * over.columns["tyre.load"] / 9.81)
            model = sj.Model(example.model.board, example.model.tyre, constraint)
            found = sj.nearest_rayleigh(model, example.gait, times(example), over)
            missing[name, constraint] = found
    maps(missing, folder)
    none = {key: int(np.isnan(found.k_s).sum()) for key, found in missing.items()}
    worst = {key: float(found.mismatch.max()) for key, found in missing.items()}
    count = loads.size * cambers.size
    rows.append(
        Claim(
            "P9",
            "Some loads cannot be reproduced by any k_s",
            "; ".join(
                f"{name[6:]} `{kind}`: {none[name, kind]} of {count}, worst {100 * worst[name, kind]:.0f} %"
                for name, kind in missing
            ),
            verdict(sum(none.values()) > 0),
            f"loads of {loads[0]:g} to {loads[-1]:g} N and cambers of 0 to {cambers[-1]:g} rad where no Rayleigh board"
            " comes within 10 % of the path; see the maps",
        )
    )
    peak = [float(sj.Bakker(load, 0.0).coefficients().D) for load in (2.54, 5.08, 1000.0)]
    rows.append(
        Claim(
            "P14",
            "D depends only on the road",
            f"Bakker's D is {peak[0]:.3g}, {peak[1]:.3g} and {peak[2]:.4g} N at loads of 2.54, 5.08 and 1000 N",
            verdict(max(peak) / min(peak) < 1.1),
            "D at these loads within 10 %; the ratio of D to load is nearly constant",
        )
    )
    return rows


def readings() -> str:
    """How much the readings of P6 change its answer: mass from load, and the camber offsets."""
    example = sj.preset("paper-gait1")
    near = {}
    light = sj.Board(**{**vars_of(example.model.board), "mass": mass(example) / 2})
    offsets = sj.Model(example.model.board, sj.Bakker(2.54, 0.52).coefficients(), "coupled")
    for what, model in (("half that mass", sj.Model(light, board(example).tyre)), ("with camber offsets", offsets)):
        found = sj.nearest_rayleigh(model, example.gait, times(example), {"tyre.D": [float(model.tyre.D)]})
        near[what] = f"{what} {100 * float(found.mismatch[0]):.2g} % (k_s = {float(found.best[0]):.3g})"
    return "We read the load as m = 2 load / 9.81, without camber offsets. Other readings at 2.54 N: " + ", ".join(
        near.values()
    )


def vars_of(own: sj.Board) -> dict:
    names = ("rotor_inertia", "wheelset_inertia", "half_length", "creep_speed")
    return {name: float(getattr(own, name)) for name in names}


def untuned(first: list[tuple[float, float]]) -> list[float]:
    """The mismatch of gait 2 at the k_s that suits gait 1."""
    found = []
    for (load, camber), (k_s, _) in zip(((2.54, 0.52), (5.08, 0.3)), first, strict=True):
        example = sj.preset("paper-gait2", load, camber)
        own, other = (poses([board(example, tyre)], example)[0, :, :2] for tyre in (None, sj.Rayleigh(k_s)))
        length = np.linalg.norm(np.diff(own, axis=0), axis=1).sum()
        found.append(float(np.sqrt(((own - other) ** 2).sum(axis=1).mean()) / length))
    return found


def maps(found: dict, folder: Path) -> None:
    figure = Figure(figsize=(9.0, 6.4), layout="constrained")
    axes = figure.subplots(2, 2, sharex=True, sharey=True)
    for axis, ((name, constraint), sweep) in zip(axes.ravel(), found.items(), strict=True):
        loads, cambers = sweep["tyre.load"], sweep["tyre.camber"]
        drawn = axis.pcolormesh(loads, cambers, 100 * sweep.mismatch.T, shading="nearest", vmin=0, vmax=20)
        blank = np.argwhere(np.isnan(sweep.k_s.values))
        axis.plot(loads[blank[:, 0]], cambers[blank[:, 1]], "wx", ms=5)
        axis.set(title=f"{name}, {constraint}", xlabel="load [N]", ylabel="camber [rad]")
    figure.colorbar(drawn, ax=axes, label="rms distance [% of the path]; x: no $k_s$ fits")
    keep(figure, folder, "loads")
