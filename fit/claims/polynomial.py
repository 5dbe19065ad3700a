"""The k_s of the nearest Rayleigh board as a polynomial of D: P8."""

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

import snakejax as sj
from snakejax.present.style import HELDOUT, MEASURED

from .claim import Claim, keep, verdict
from .example import STRUCTURES, board, times

GAITS = ("paper-gait1", "paper-gait2", "paper-forward", "paper-rotate")


def polynomials(folder: Path, D: np.ndarray) -> tuple[list[Claim], str]:
    """P8: k_s against `D` [N] for all four gaits and both structures."""
    figure = Figure(figsize=(11.0, 5.6), layout="constrained")
    axes = figure.subplots(2, 4)
    lines, good = [], []
    for row, constraint in zip(axes, STRUCTURES, strict=True):
        for axis, name in zip(row, GAITS, strict=True):
            example = sj.preset(name)
            found = sj.nearest_rayleigh(
                board(example, constraint=constraint), example.gait, times(example), {"tyre.D": D}
            )
            curve = sj.polynomial(D, found.k_s.values)
            axis.plot(D, found.best, ".", color="0.75", ms=5)
            axis.plot(D, found.k_s, ".", color=MEASURED.colour, ms=5)
            fits = int(np.isfinite(found.k_s).sum())
            text = "none"
            if curve is not None:
                low, high = curve.fitted_range
                x = np.linspace(low, high, 200)
                axis.plot(x, curve(x), color=HELDOUT, lw=1.2)
                text = f"{curve.r_squared:.5f} on {low:g} to {high:g} N"
                good.append(curve.r_squared)
            axis.set(title=f"{name[6:]}, {constraint}", xlabel="D [N]", ylabel="$k_s$ [N s/m]")
            coefficients = "-" if curve is None else ", ".join(f"{c:.4g}" for c in curve.coefficients)
            lines.append(f"| {name[6:]} | {constraint} | {fits} of {D.size} | {100 * float(found.mismatch.min()):.2g}"
                         f" to {100 * float(found.mismatch.max()):.2g} % | {text} | {coefficients} |")  # fmt: skip
    keep(figure, folder, "fig8")
    head = ["| gait | structure | D with a k_s | mismatch | R^2 | c4, c3, c2, c1, c0 |", "|---|---|---|---|---|---|"]
    row = Claim(
        "P8", "With all else fixed, k_s is a polynomial of order 4 of D",
        f"R^2 from {min(good):.4f} to {max(good):.6f} over four gaits and two structures",
        verdict(min(good) > 0.99, sorted(good)[1] > 0.99),
        "R^2 above 0.99 for all D with a k_s; the table below lists each case",
    )  # fmt: skip
    return [row], "\n".join([*head, *lines])
