"""What a vehicle and its cameras leave: white noise, and noise that wanders (Ornstein and Uhlenbeck's process)."""

import dataclasses
import math

import numpy as np
from joints import njit


@njit
def _innovations(values, times, white, wander, correlation):
    """What the rows before do not foretell of each row of `values` (n, k), in standard deviations: Kalman's filter."""
    out = np.empty_like(values)
    known, doubt = np.zeros(values.shape[1]), wander * wander
    for i in range(values.shape[0]):
        if i > 0:
            keep = math.exp(-(times[i] - times[i - 1]) / correlation)
            known *= keep
            doubt = keep * keep * doubt + wander * wander * (1.0 - keep * keep)
        spread = doubt + white * white
        for j in range(values.shape[1]):
            off = values[i, j] - known[j]
            out[i, j] = off / math.sqrt(spread)
            known[j] += doubt / spread * off
        doubt *= white * white / spread
    return out


@dataclasses.dataclass(frozen=True)
class Noise:
    """Standard deviations of the white and of the wandering part, in m and rad, and the latter's time constant in s."""

    white: tuple[float, float]
    wander: tuple[float, float] = (0.0, 0.0)
    correlation: float = 0.2

    def draw(self, rng: np.random.Generator, times: np.ndarray) -> np.ndarray:
        """Noise (n, 3) of x, y and heading at evenly spaced `times`; the wandering part starts in its steady state."""
        white, wander = ([a, a, b] for a, b in (self.white, self.wander))
        keep = np.exp(-(times[1] - times[0]) / self.correlation)
        walk = rng.normal(size=(len(times), 3))
        walk[1:] *= np.sqrt(1 - keep**2)
        for k in range(1, len(times)):
            walk[k] += keep * walk[k - 1]
        return walk * wander + rng.normal(size=walk.shape) * white

    @property
    def scale(self) -> np.ndarray:
        """Standard deviation of one sample of x, y and heading, both parts together."""
        a, b = np.hypot(self.white, self.wander)
        return np.array([a, a, b])

    def whiten(self, times: np.ndarray, error: np.ndarray) -> np.ndarray:
        """Errors (n, 3) or their sensitivities (n, 3, k) at `times`, made independent and of variance 1 if noise."""
        columns = error.reshape(len(error), 3, -1)
        out = []
        for c, part in enumerate((0, 0, 1)):
            white, wander = self.white[part], self.wander[part]
            out.append(_innovations(np.ascontiguousarray(columns[:, c]), times, white, wander, self.correlation))
        return np.stack(out, axis=1).reshape(error.shape)
