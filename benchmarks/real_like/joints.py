"""What the joints do: sums of sines behind the autonomous controller of physics.md, equation (8), in closed form."""

import math

try:
    from numba import njit  # not cached: numba would not see that a function called from another file has changed
except ImportError:

    def njit(function):
        """The function as it is, some hundred times slower: enough for the tests that come without numba."""
        return function


@njit
def command(t, terms):
    """Angle, rate and acceleration of sum a sin(w t + p), `terms` being the rows (a, w, p)."""
    angle, rate, acceleration = 0.0, 0.0, 0.0
    for k in range(terms.shape[0]):
        a, w, p = terms[k, 0], terms[k, 1], terms[k, 2]
        s, c = math.sin(w * t + p), math.cos(w * t + p)
        angle += a * s
        rate += a * w * c
        acceleration -= a * w * w * s
    return angle, rate, acceleration


@njit
def transient(t, e0, v0, kp, kd):
    """Error and its rate at `t` of e'' + kd e' + kp e = 0 from (e0, v0) at 0."""
    decay, square = 0.5 * kd, kp - 0.25 * kd * kd
    if square > 1e-12 * kp:
        w = math.sqrt(square)
        c, s = math.cos(w * t), math.sin(w * t) / w
    elif square < -1e-12 * kp:
        w = math.sqrt(-square)
        c, s = math.cosh(w * t), math.sinh(w * t) / w
    else:
        c, s = 1.0, t
    slope = -square * s
    shape = e0 * c + (v0 + decay * e0) * s
    rate = e0 * slope + (v0 + decay * e0) * c
    fall = math.exp(-decay * t)
    return fall * shape, fall * (rate - decay * shape)


@njit
def joint(t, terms, gain, lag, kp, kd):
    """Angle, rate and acceleration of a joint at rest at zero whose command is that of `lag` ago, times 1 + `gain`.

    With `kp` = 0 it follows the command exactly, from the lag on.
    """
    since = t - lag
    if since < 0.0:
        return 0.0, 0.0, 0.0
    angle, rate, acceleration = command(since, terms)
    if kp > 0.0:
        angle0, rate0, _ = command(0.0, terms)
        e, v = transient(since, -angle0, -rate0, kp, kd)
        angle, rate, acceleration = angle + e, rate + v, acceleration - kd * v - kp * e
    return (1.0 + gain) * angle, (1.0 + gain) * rate, (1.0 + gain) * acceleration


@njit
def wheel(angle, rate, backlash, offset):
    """Angle and rate of a wheelset behind a smooth dead zone, and turned by `offset`."""
    if backlash > 0.0:
        t = math.tanh(angle / backlash)
        angle, rate = angle - backlash * t, rate * t * t
    return angle + offset, rate
