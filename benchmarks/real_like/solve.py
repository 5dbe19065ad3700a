"""Integration of the plant: Dormand and Prince's pair of order 5(4), adaptive, landing on every frame."""

import numpy as np
from joints import njit
from layout import PLACE
from plant import rates, seen

_A = np.zeros((7, 7))
_A[1, :1] = [1 / 5]
_A[2, :2] = [3 / 40, 9 / 40]
_A[3, :3] = [44 / 45, -56 / 15, 32 / 9]
_A[4, :4] = [19372 / 6561, -25360 / 2187, 64448 / 6561, -212 / 729]
_A[5, :5] = [9017 / 3168, -355 / 33, 46732 / 5247, 49 / 176, -5103 / 18656]
_A[6, :6] = [35 / 384, 0.0, 500 / 1113, 125 / 192, -2187 / 6784, 11 / 84]
_C = np.array([0.0, 1 / 5, 3 / 10, 4 / 5, 8 / 9, 1.0, 1.0])
_ERROR = np.array([71 / 57600, 0.0, -71 / 16695, 71 / 1920, -17253 / 339200, 22 / 525, -1 / 40])


@njit
def _march(times, start, p, phi, psi, rtol, atol, most, A, C, error):
    """States (n, 8) at `times` from `start` at times[0]; rows stay NaN where more than `most` steps would be needed."""
    states = np.full((len(times), 8), np.nan)
    state, slopes, trial = start.copy(), np.zeros((7, 8)), np.zeros(8)
    states[0] = state
    t, step, taken = times[0], 1e-4, 0
    for k in range(1, len(times)):
        while t < times[k]:
            taken += 1
            if taken > most:
                return states
            last = t + step >= times[k] - 1e-12
            h = times[k] - t if last else step
            for i in range(7):
                for j in range(8):
                    total = 0.0
                    for m in range(i):
                        total += A[i, m] * slopes[m, j]
                    trial[j] = state[j] + h * total
                rates(t + C[i] * h, trial, p, phi, psi, slopes[i])
            worst = 0.0
            for j in range(8):
                off = 0.0
                for i in range(7):
                    off += error[i] * slopes[i, j]
                worst = max(worst, abs(h * off) / (atol + rtol * max(abs(state[j]), abs(trial[j]))))
            if worst <= 1.0:
                t = times[k] if last else t + h
                state[:] = trial
            factor = 5.0 if worst == 0.0 else min(5.0, max(0.2, 0.9 * worst**-0.2))
            if not (last and worst <= 1.0 and h * factor < step):
                step = h * factor
        states[k] = state
    return states


def poses(p: np.ndarray, phi, psi, times: np.ndarray, start, rtol: float = 1e-7) -> np.ndarray:
    """Noiseless poses (n, 3) at `times` of a board at rest until 0 s with its body at `start` (x, y, theta).

    Raises ArithmeticError where the integration does not come to its end.
    """
    phi, psi = (np.asarray(terms, float).reshape(-1, 3) for terms in (phi, psi))
    local = np.maximum(times - p[PLACE["clock_offset.T"]], 0.0)
    moving = np.concatenate([[0.0], local])
    state = np.zeros(8)
    state[:3] = start
    states = _march(moving, state, p, phi, psi, rtol, 1e-2 * rtol, 40 * len(moving) + 200_000, _A, _C, _ERROR)
    if not np.isfinite(states).all():
        raise ArithmeticError(f"The plant did not get past {moving[np.isfinite(states).all(1)][-1]:.3f} s.")
    return seen(p, states[1:])
