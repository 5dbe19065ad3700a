"""The noise of one sample, estimated from the recordings alone."""

import math
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from ._errors import InputError
from ._recording import Noise, Run

ORDER = 5
CLIP = 4.0
FEWEST_DIFFERENCES = 30
MAD_TO_SD = 1.4826


def robust_sd(values: Float[np.ndarray, " n"]) -> float:
    """The standard deviation that the median absolute deviation of `values` has for a normal distribution."""
    return MAD_TO_SD * float(np.median(np.abs(values - np.median(values)))) if values.size else 0.0


def estimate_noise(runs: Sequence[Run]) -> Noise:
    """The standard deviation of one sample of position (x and y pooled) and of heading over all `runs`.

    White noise of variance s^2 on a smooth motion has k-th differences of variance C(2k, k) s^2, and the motion's own
    k-th difference falls with the k-th power of the frame time. k = 5, over frames that are all present; what lies
    beyond 4 robust standard deviations is left out, and the share of a normal distribution out there restored.

    **Raises:** `InputError` where fewer than 30 differences are whole, or the samples repeat so that no noise is seen.
    """
    poses = [np.asarray(run.pose) for run in runs]
    position = np.concatenate([_differences(pose[:, i]) for pose in poses for i in (0, 1)])
    heading = np.concatenate([_differences(pose[:, 2]) for pose in poses])
    return Noise(*(np.asarray(_clipped_sd(d)) for d in (position, heading)), source="estimated from the recordings")


def _differences(channel: Float[np.ndarray, " n"]) -> Float[np.ndarray, " m"]:
    difference = np.diff(channel, ORDER)
    return difference[np.isfinite(difference)] / math.sqrt(math.comb(2 * ORDER, ORDER))


def _clipped_sd(difference: Float[np.ndarray, " m"]) -> float:
    if difference.size < FEWEST_DIFFERENCES:
        what = f"Only {difference.size} stretches of {ORDER + 1} frames are whole: too few to estimate the noise"
        raise InputError(what, "all runs", "give position_m and heading_rad under [noise] in case.toml")
    limit = CLIP * robust_sd(difference)
    inside = difference[np.abs(difference) <= limit]
    # Variance of a standard normal cut off at +-CLIP.
    left = 1 - 2 * CLIP * math.exp(-(CLIP**2) / 2) / math.sqrt(2 * math.pi) / math.erf(CLIP / math.sqrt(2))
    sd = float(np.sqrt(np.mean(inside**2) / left))
    if not sd > 0:
        what = "Most samples repeat the one before, so that no noise can be estimated"
        raise InputError(what, "all runs", "give position_m and heading_rad under [noise] in case.toml")
    return sd
