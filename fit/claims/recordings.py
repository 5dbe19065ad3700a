"""What recordings say: P10 and P13."""

from pathlib import Path

import numpy as np

import snakejax as sj
from snakejax.effects import LongitudinalSlip
from snakejax.estimation import fit
from snakejax.present import plot
from snakejax.present.as_text.errors import three_digits, times_noise, times_noise_text

from .claim import Claim, keep, verdict

CLEARLY = 0.01
"""A share of a misfit that is more than rounding."""


def recorded(folder: Path, recordings: list[Path]) -> tuple[list[Claim], str]:
    """P10 and P13 on recordings."""
    lines, gains, beaten = [], {"forward": [], "rotate": []}, []
    for place in recordings:
        case = sj.load_case(place)
        noise = sj.noise_of(case)
        forward = [run for run in case.having("train") if "forward" in run.name]
        beaten.append(times_noise(fit(sj.starting_model(case, "rayleigh"), forward, noise).train_score.misfit))
        fits = {
            "rayleigh": fit(sj.starting_model(case, "rayleigh"), case.runs, noise),
            "pacejka": fit(sj.starting_model(case), case.runs, noise),
            "slip": fit(sj.starting_model(case).add(longitudinal_slip=LongitudinalSlip()), case.runs, noise),
        }
        if place == recordings[0]:
            for kind in ("rayleigh", "pacejka"):
                keep(plot.paths(fits[kind]), folder, f"fig11-12-{kind}")
        for gait in gains:
            excess = {what: misfit(fit, gait) for what, fit in fits.items()}
            gain = (excess["pacejka"] - excess["slip"]) / excess["pacejka"]
            gains[gait].append(gain)
            shown = " | ".join(f"{times_noise_text(excess[what])}" for what in fits)
            lines.append(f"| {case.name} | {gait} | {shown} | {100 * gain:+.1f} % |")
    head = [
        "| recording | gait | Rayleigh | Pacejka | with longitudinal slip | misfit lowered by |",
        "|---|---|---|---|---|---|",
    ]
    more = sum(f > r + CLEARLY for f, r in zip(gains["forward"], gains["rotate"], strict=True))
    rows = [
        Claim(
            "P10", "Forward disagrees more than rotate because longitudinal slip is missing (a hypothesis)",
            f"adding it lowers the misfit of forward by more than that of rotate on {more} of {len(recordings)}"
            " recordings",
            "tested", "by at least 1 %, fitted to all train runs. These boards are not the board of the paper, so the"
            " result holds only for them",
        ),
        Claim(
            "P13", "No k_s matches the forward recording",
            f"error of the forward runs at the k_s that is best for them: {three_digits(min(beaten))} to"
            f" {three_digits(max(beaten))} times the noise",
            verdict(min(beaten) > 2), "above twice the noise. The recording of the paper is not public",
        ),
    ]  # fmt: skip
    return rows, "\n".join([*head, *lines])


def misfit(found: sj.Fit, gait: str) -> float:
    """Mean misfit of the train runs of one gait."""
    return float(np.mean([run.misfit for run in found.runs if gait in run.run]))
