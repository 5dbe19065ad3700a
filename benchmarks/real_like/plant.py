"""An independent plant of the snakeboard, written from the equations of motion alone.

State: x, y, theta, then u, w, r (`free`, each wheelset skids on its own: Newton's law) or u, beta, s (`coupled`, the
structure of the paper), then the lagged slip angles of the front and back wheelset. Body frame, signs and effects are
those of `docs/effects.md`. The strange effects, which no library holds:

washboard     world-frame force -f sin(9 x) along x
spin_grip     lateral force x (1 + s tanh((psi' / 4)^2))
magnus_force  force across the velocity: (X, Y) += c r (-w, u)
cable         a cable dragged along: force -c d v / sqrt(|v|^2 + (2 cm/s)^2), d the distance from the world's origin
bump          a hill of height h at (x, y): world-frame force -m g grad(h exp(-d^2 / (2 width^2)))
spring        world-frame force k (point - position)
turning_wind  world-frame force f that turns once in 20 s
dead_spot     the rotor pushes the body less by the share s about psi = 0: psi'' (1 - s exp(-(psi / 0.3)^2))
"""

import math

import numpy as np
from joints import joint, njit, wheel
from layout import PLACE

GRAVITY = 9.81
P_M, P_I, P_JR, P_L, P_CREEP, P_KP, P_KD, P_B, P_C, P_D, P_E, P_FREE = range(12)
assert [PLACE[n] for n in ("m", "I", "Jr", "L", "creep", "kp", "kd", "B", "C", "D", "E", "free")] == list(range(12))
(P_K, P_F, P_DRAG, P_QUADRATIC, P_DAMPING, P_FRICTION, P_BIAS, P_SX, P_SY, P_OFFSET, P_CRAB, P_SLAG, P_RLAG) = range(
    12, 25
)
(P_SGAIN, P_RGAIN, P_BACKLASH, P_SPLIT, P_COM, P_SIGMA, P_DSH, P_DSV, P_STRIBECK, P_GRADIENT) = range(25, 35)
(P_MX, P_MY, P_H, P_CLOCK) = range(35, 39)
(P_WASH, P_SPIN, P_MAGNUS, P_CABLE, P_BUMP, P_BX, P_BY, P_BW, P_SPRING, P_PX, P_PY, P_WIND, P_DEAD) = range(39, 52)
(P_WASH_K, P_SPIN_RATE, P_CABLE_SPEED, P_PERIOD, P_DEAD_WIDTH) = range(52, 57)
assert len(PLACE) == 57 and PLACE["clock_offset.T"] == P_CLOCK and PLACE["dead_spot.s"] == P_DEAD
assert PLACE["dead_spot.width"] == P_DEAD_WIDTH


@njit
def slip_angle(v, a, creep):
    """Slip angle of a wheelset with lateral and rolling speed v and a, in rad."""
    return math.atan2(v, math.sqrt(a * a + creep * creep))


@njit
def lateral(p, slip, v, x, spin, side):
    """Lateral force of a wheelset at the slip angle `slip`, against the slip; `side` is +1 in front and -1 behind."""
    s = slip + p[P_DSH]
    eta = (1.0 - p[P_E]) * s + p[P_E] / p[P_B] * math.atan(p[P_B] * s)
    peak = p[P_D] * (1.0 + p[P_GRADIENT] * x)
    force = peak * math.sin(p[P_C] * math.atan(p[P_B] * eta)) + p[P_DSV]
    force *= 1.0 + p[P_STRIBECK] * math.exp(-((v / 0.05) ** 2))
    return force * (1.0 + side * p[P_SPLIT]) * (1.0 + p[P_SPIN] * math.tanh((spin / p[P_SPIN_RATE]) ** 2))


@njit
def rolling(p, a):
    """Rolling force of a wheelset at the rolling speed a, against it."""
    return p[P_K] * a + p[P_F] * math.tanh(a / 0.005)


@njit
def world_force(p, t, x, y):
    """Force along the axes of the world, in N."""
    fx = -p[P_M] * GRAVITY * p[P_SX] - p[P_WASH] * math.sin(p[P_WASH_K] * x) + p[P_SPRING] * (p[P_PX] - x)
    fy = -p[P_M] * GRAVITY * p[P_SY] + p[P_SPRING] * (p[P_PY] - y)
    if p[P_WIND] != 0.0:
        turned = 2.0 * math.pi * t / p[P_PERIOD]
        fx += p[P_WIND] * math.cos(turned)
        fy += p[P_WIND] * math.sin(turned)
    if p[P_BUMP] != 0.0:
        dx, dy, square = x - p[P_BX], y - p[P_BY], p[P_BW] ** 2
        steep = p[P_M] * GRAVITY * p[P_BUMP] / square * math.exp(-0.5 * (dx * dx + dy * dy) / square)
        fx += steep * dx
        fy += steep * dy
    return fx, fy


@njit
def wrench(p, t, x, y, theta, u, w, r):
    """Force and yaw moment on the body, in its frame, of all but the wheels and the rotor."""
    fx, fy = world_force(p, t, x, y)
    c, s = math.cos(theta), math.sin(theta)
    speed = math.sqrt(u * u + w * w)
    drag = p[P_DRAG] + p[P_QUADRATIC] * speed
    if p[P_CABLE] != 0.0:
        drag += p[P_CABLE] * math.sqrt(x * x + y * y) / math.sqrt(speed * speed + p[P_CABLE_SPEED] ** 2)
    X = c * fx + s * fy - drag * u - p[P_MAGNUS] * r * w
    Y = -s * fx + c * fy - drag * w + p[P_MAGNUS] * r * u
    N = p[P_BIAS] - p[P_DAMPING] * r - p[P_FRICTION] * math.tanh(r / 0.02)
    return X, Y, N


@njit
def relaxed(p, slip, lag, a):
    """The slip angle that the tyre feels, and the rate of the lagged one."""
    if p[P_SIGMA] <= 0.0:
        return slip, 0.0
    return lag, (abs(a) + 0.02) / p[P_SIGMA] * (slip - lag)


@njit
def rates(t, state, p, phi, psi, out):
    """Write the time derivative of `state` into `out`; `phi` and `psi` are the sums of sines of the commands."""
    steer, steer_rate, _ = joint(t, phi, p[P_SGAIN], p[P_SLAG], p[P_KP], p[P_KD])
    rotor, spin, push = joint(t, psi, p[P_RGAIN], p[P_RLAG], p[P_KP], p[P_KD])
    if p[P_DEAD] != 0.0:
        push *= 1.0 - p[P_DEAD] * math.exp(-((rotor / p[P_DEAD_WIDTH]) ** 2))
    front, front_rate = wheel(steer, steer_rate, p[P_BACKLASH], p[P_OFFSET] + p[P_CRAB])
    back, back_rate = wheel(-steer, -steer_rate, p[P_BACKLASH], p[P_CRAB] - p[P_OFFSET])
    if p[P_FREE] > 0.5:
        free_rates(t, state, p, front, back, spin, push, out)
    else:
        coupled_rates(t, state, p, front, back, front_rate, back_rate, spin, push, out)


@njit
def free_rates(t, state, p, front, back, spin, push, out):
    """Newton's law with two wheelsets that skid: m (u' - r w) = X, m (w' + r u) = Y, I r' + Jr psi'' = N."""
    x, y, theta, u, w, r = state[0], state[1], state[2], state[3], state[4], state[5]
    X, Y, N = wrench(p, t, x, y, theta, u, w, r)
    for k in range(2):
        side = 1.0 - 2.0 * k
        arm, angle = side * p[P_L] - p[P_COM], front if k == 0 else back
        c, s = math.cos(angle), math.sin(angle)
        across = w + arm * r
        v, a = -u * s + across * c, u * c + across * s
        slip, out[6 + k] = relaxed(p, slip_angle(v, a, p[P_CREEP]), state[6 + k], a)
        F, T = lateral(p, slip, v, x, spin, side), rolling(p, a)
        X += F * s - T * c
        Y -= F * c + T * s
        N -= arm * (F * c + T * s)
    out[0] = u * math.cos(theta) - w * math.sin(theta)
    out[1] = u * math.sin(theta) + w * math.cos(theta)
    out[2] = r
    out[3] = X / p[P_M] + r * w
    out[4] = Y / p[P_M] - r * u
    out[5] = (N - p[P_JR] * push) / p[P_I]


@njit
def coupled_rates(t, state, p, front, back, front_rate, back_rate, spin, push, out):
    """The paper's structure: traction acts on the slip coordinate beta, the wheels hold u, w and d = theta' - beta'."""
    x, y, theta, u, s = state[0], state[1], state[2], state[3], state[5]
    tf, tb = math.tan(front), math.tan(back)
    W, D = 0.5 * (tf + tb), 0.5 * (tf - tb) / p[P_L]
    W_rate = 0.5 * (front_rate * (1.0 + tf * tf) + back_rate * (1.0 + tb * tb))
    w, d = W * u, D * u
    beta_rate = 0.5 * (s - d)
    X, Y, N = wrench(p, t, x, y, theta, u, w, s)
    G, braking = 0.0, 0.0
    for k in range(2):
        c = math.cos(front if k == 0 else back)
        v, a = p[P_L] * beta_rate * c, u / c
        slip, out[6 + k] = relaxed(p, slip_angle(v, a, p[P_CREEP]), state[6 + k], a)
        G += p[P_L] * c * lateral(p, slip, v, x, spin, 1.0 - 2.0 * k)
        braking += rolling(p, a) / c
    out[0] = u * math.cos(theta) - w * math.sin(theta)
    out[1] = u * math.sin(theta) + w * math.cos(theta)
    out[2] = 0.5 * (s + d)
    out[3] = (X + W * Y + 0.5 * D * G - braking - p[P_M] * W * W_rate * u) / (p[P_M] * (1.0 + W * W))
    out[4] = beta_rate
    out[5] = (N - p[P_JR] * push - 0.5 * G) / p[P_I]


def seen(p: np.ndarray, states: np.ndarray) -> np.ndarray:
    """Poses (n, 3) that motion capture reports of `states` (n, 8): position in m and unwrapped heading in rad."""
    heading = states[:, 2] + (0.0 if p[P_FREE] > 0.5 else states[:, 4])
    c, s = np.cos(heading), np.sin(heading)
    x = states[:, 0] + c * p[P_MX] - s * p[P_MY]
    y = states[:, 1] + s * p[P_MX] + c * p[P_MY]
    return np.column_stack([x, y, heading + p[P_H]])
