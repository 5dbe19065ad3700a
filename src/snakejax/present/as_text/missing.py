"""The components of a missing force as text: those that the data show, and those that they do not."""

import numpy as np

from snakejax.diagnosis.latent_force.missing_force import LatentForce, RunForce

DETERMINED = 0.1
"""A component is determined where its root mean square is at least so many times that of its standard error. Data that
say nothing of it leave it far smaller: at the zero of its prior, with the error of the prior."""
PLACES = ("along the board", "across it", "in yaw")
FORCE_UNITS = ("N", "N", "N m")


def determined(runs: "tuple[RunForce, ...]") -> tuple[bool, ...]:
    """Whether the data show each of X, Y and N in some run: elsewhere only the prior of the estimate is seen."""
    force, sd = np.concatenate([run.force for run in runs]), np.concatenate([run.sd for run in runs])
    felt = np.isfinite(sd).any(axis=0)
    force, sd = (np.sqrt(np.nanmean(np.where(felt, part, 0.0) ** 2, axis=0)) for part in (force, sd))
    return tuple(bool(part) for part in felt & (force > 0) & (force >= DETERMINED * sd))


def components_text(latent: LatentForce) -> str:
    """`0.22 N along the board, 0.15 N across it, in yaw not determined`: root mean squares."""
    sizes = np.sqrt(np.nanmean(np.concatenate([run.force for run in latent.runs]) ** 2, axis=0))
    return ", ".join(
        f"{size:.2g} {unit} {place}" if shown else f"{place} not determined"
        for shown, size, unit, place in zip(determined(latent.runs), sizes, FORCE_UNITS, PLACES, strict=True)
    )
