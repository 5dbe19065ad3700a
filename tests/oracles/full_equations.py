"""Independent reference: the skidding snakeboard in plain numpy and scipy, from the full equations.

Nothing here is shared with the package. Where the package integrates a reduced, explicit model, this file keeps every
coordinate and every multiplier and solves the linear system of the equations of motion at each instant. Equation and
table numbers are those of Salman, Dear, Babikian, Shammas, Choset, "A physical parameter-based skidding model for the
snakeboard", CDC 2016. SI units and radians throughout, except in `bakker_coefficients` (kN, degrees; SAE 870421).

`constrained_accelerations`  Coordinates q = (x, y, theta, psi, phi, beta), mass matrix (2), one constraint row (3) per
    wheelset at +L and -L with its own steering angle p: the material point seen by the wheelset moves with
    thetadot - betadot, and (-sin(theta+p), cos(theta+p)) . velocity = 0. Differentiating A qdot = 0 once, with
    (theta+p)' = thetadot + p', gives A qddot = -Adot qdot. The joints have given accelerations, so their torques are
    unknowns in place of their accelerations: 4 accelerations + 2 torques + 2 multipliers = 8 unknowns in
        M qddot - A^T lambda - (torques) = Q,    A qddot = -Adot qdot,
    which are 6 + 2 equations, solved together by `numpy.linalg.solve` (the 6-by-6 M alone is singular: its theta and
    beta rows are equal). The structure says what Q is:
      coupled  traction acts against the slip coordinate alone, Q_beta = -L (cos(p_f) F_f + cos(p_b) F_b), with
               slip L betadot cos(p_i), equation (7);
      ideal    no slip: the further row betadot = 0 joins A and a third multiplier joins the unknowns;
      printed  equation (4) to the letter: Q = -A^T (F, F), delta = atan(v_s / v_a) without any regularisation.
    A body-frame wrench (X, Y along and across theta, yaw moment N on theta and beta alike) and rolling forces -T_i
    through the a_i of (7) join Q in every structure.
`free_accelerations`  Newton in the world frame: each wheelset is a point r +- L e on a rigid body, its velocity is
    rdot +- L thetadot e_perp, the ground pushes it with -F n - T t along its own normal n and rolling direction t, and
        m rddot = sum of forces,    I thetaddot + J_r psiddot = sum of moments about the centre.
`controlled_joint`  Equation (8) as it stands, q'' = q_d'' + K_d (q_d' - q') + K_p (q_d - q): joints are integrated
    along with the board rather than solved in closed form.
`pacejka`, `rayleigh`, `bakker_coefficients`  Equations (5)-(6) with the slip angle taken against
    sqrt(v_a^2 + creep^2), equation (1), and the load and camber formulas of Bakker, Nyborg, Pacejka 1987.
"""

from collections.abc import Callable
from dataclasses import dataclass
from math import atan, cos, hypot, sin
from typing import NamedTuple

import numpy as np
from scipy.integrate import solve_ivp

X, Y, THETA, PSI, PHI, BETA = range(6)

Tyre = Callable[[float, float], float]
"""Traction [N] that opposes the slip, from the lateral and the rolling speed of a wheelset [m/s]."""


@dataclass(frozen=True)
class Board:
    """Mass [kg], yaw inertia of the whole board and of its parts [kg m^2], L [m].

    `offset` [m] puts the centre of mass ahead of the middle of the wheelsets; the paper has none.
    """

    mass: float
    inertia: float
    rotor_inertia: float
    wheel_inertia: float
    half_length: float
    offset: float = 0.0


TABLE_2_BOARD = Board(mass=7.0, inertia=7.0 * 0.25**2, rotor_inertia=0.0238, wheel_inertia=0.001, half_length=0.25)
"""Table II with the paper's assumption m L^2 = J + J_r + 2 J_w (0.4375; the printed inertias add up to 0.4358)."""


class Steering(NamedTuple):
    """Steering angles [rad] of the two wheelsets against theta, and their rates [rad/s]."""

    front: float
    back: float
    front_rate: float
    back_rate: float


class Wrench(NamedTuple):
    """Body-frame force [N] along and across theta, and yaw moment [N m]."""

    along: float = 0.0
    across: float = 0.0
    yaw: float = 0.0


NO_WRENCH = Wrench()


@dataclass(frozen=True)
class Sine:
    """Desired joint angle offset + amplitude sin(frequency t + phase) [rad], with its first two derivatives."""

    amplitude: float
    frequency: float
    phase: float = 0.0
    offset: float = 0.0

    def __call__(self, time: float) -> tuple[float, float, float]:
        angle = self.frequency * time + self.phase
        swing = self.amplitude * sin(angle)
        rate = self.amplitude * self.frequency * cos(angle)
        return self.offset + swing, rate, -(self.frequency**2) * swing


@dataclass(frozen=True)
class Gait:
    """Desired motion of rotor and steering, the gains of (8) [1/s^2, 1/s] and crab angles [rad]."""

    rotor: Sine
    steering: Sine
    stiffness: float = 100.0
    damping: float = 10.0
    crab: tuple[float, float] = (0.0, 0.0)


FORWARD = Gait(rotor=Sine(1.570, 4.0), steering=Sine(0.916, 4.0))
"""Table III, forward (7.7 s)."""
ROTATE = Gait(rotor=Sine(1.570, 4.0), steering=Sine(0.916, 2.0))
"""Table III, rotate (14 s)."""


# --- Tyres ---------------------------------------------------------------------------------------------------------


def magic_formula(
    slip: float, stiffness: float, shape: float, peak: float, curvature: float, shift: float = 0.0, lift: float = 0.0
) -> float:
    """Equation (5): B, C, D, E, dSh and dSv in this order; the slip is in whatever angle B and dSh are in."""
    shifted = slip + shift
    eta = (1.0 - curvature) * shifted + curvature / stiffness * atan(stiffness * shifted)
    return peak * sin(shape * atan(stiffness * eta)) + lift


def pacejka(
    stiffness: float = 0.09,
    shape: float = 2.0,
    peak: float = 1.0,
    curvature: float = 0.6,
    shift: float = 0.0,
    lift: float = 0.0,
    creep: float = 1e-3,
) -> Tyre:
    """Equations (5) and (6), slip angle in radians against sqrt(v_a^2 + creep^2); Table II by default."""

    def force(lateral: float, rolling: float) -> float:
        slip = atan(lateral / hypot(rolling, creep))
        return magic_formula(slip, stiffness, shape, peak, curvature, shift, lift)

    return force


def printed_pacejka(stiffness: float = 0.09, shape: float = 2.0, peak: float = 1.0, curvature: float = 0.6) -> Tyre:
    """Equations (5) and (6) to the letter: delta = atan(v_s / v_a), which changes sign when rolling backwards."""
    return lambda lateral, rolling: magic_formula(atan(lateral / rolling), stiffness, shape, peak, curvature)


def rayleigh(coefficient: float) -> Tyre:
    """Equation (1): R = k_s v_s^2 / 2 per wheelset, so a force k_s v_s; k_s in N s/m."""
    return lambda lateral, rolling: coefficient * lateral


def bakker_coefficients(load: float, camber: float = 0.0) -> tuple[float, float, float, float, float, float]:
    """B, C, D, E, dSh, dSv at a load [kN] and camber [deg]; slip in degrees, force in N (SAE 870421)."""
    a1, a2, a3, a4, a5, a6 = -22.1, 1011.0, 1078.0, 1.82, 0.208, 0.0
    a7, a8, a9, a10, a11, a12 = -0.354, 0.707, 0.028, 0.0, 14.8, 0.022
    shape = 1.30
    peak = a1 * load**2 + a2 * load
    stiffness = a3 * sin(a4 * atan(a5 * load)) / (shape * peak) * (1.0 - a12 * abs(camber))
    curvature = a6 * load**2 + a7 * load + a8
    return stiffness, shape, peak, curvature, a9 * camber, (a10 * load**2 + a11 * load) * camber


def bakker_force(load: float, slip: float, camber: float = 0.0) -> float:
    """Lateral force [N] at a load [kN], slip angle [deg] and camber [deg]."""
    return magic_formula(slip, *bakker_coefficients(load, camber))


# --- Equations of motion ---------------------------------------------------------------------------------------------


def mass_matrix(board: Board) -> np.ndarray:
    """Equation (2)."""
    whole, rotor = board.inertia, board.rotor_inertia
    matrix = np.zeros((6, 6))
    matrix[X, X] = matrix[Y, Y] = board.mass
    for row in (THETA, BETA):
        matrix[row, [THETA, PSI, BETA]] = whole, rotor, whole
    matrix[PSI, [THETA, PSI, BETA]] = rotor
    matrix[PHI, PHI] = 2.0 * board.wheel_inertia
    return matrix


def _wheelsets(board: Board, steering: Steering):
    """Steering angle, its rate and the signed arm of the front and of the back wheelset."""
    yield steering.front, steering.front_rate, board.half_length - board.offset
    yield steering.back, steering.back_rate, -board.half_length - board.offset


def constraint_matrix(board: Board, theta: float, steering: Steering) -> np.ndarray:
    """Equation (3): one row per wheelset, none moves across its own rolling direction."""
    return np.array([
        [-sin(theta + p), cos(theta + p), arm * cos(p), 0.0, 0.0, -arm * cos(p)]
        for p, _, arm in _wheelsets(board, steering)
    ])  # fmt: skip


def constraint_matrix_rate(board: Board, theta: float, theta_rate: float, steering: Steering) -> np.ndarray:
    """Time derivative of `constraint_matrix`, by hand."""
    rows = []
    for p, p_rate, arm in _wheelsets(board, steering):
        turn, swing = theta_rate + p_rate, arm * sin(p) * p_rate
        rows.append([-cos(theta + p) * turn, -sin(theta + p) * turn, -swing, 0.0, 0.0, swing])
    return np.array(rows)


def rolling_matrix(board: Board, theta: float, steering: Steering) -> np.ndarray:
    """Equation (7): rows a_i with v_a,i = a_i . qdot, the rolling speed of each wheelset."""
    return np.array([
        [cos(theta + p), sin(theta + p), arm * sin(p), 0.0, 0.0, -arm * sin(p)]
        for p, _, arm in _wheelsets(board, steering)
    ])  # fmt: skip


def slip_speeds(board: Board, beta_rate: float, steering: Steering) -> np.ndarray:
    """Equation (7): v_s,i = L betadot cos(p_i) [m/s]."""
    return board.half_length * beta_rate * np.cos([steering.front, steering.back])


class Instant(NamedTuple):
    """Solution of the equations of motion: q'' and the torques of rotor and steering [N m], multipliers [N]."""

    acceleration: np.ndarray
    rotor_torque: float
    steering_torque: float
    multipliers: np.ndarray


def constrained_accelerations(
    board: Board,
    tyre: Tyre | None,
    position: np.ndarray,
    velocity: np.ndarray,
    steering: Steering,
    joint_accelerations: tuple[float, float],
    *,
    structure: str = "coupled",
    wrench: Wrench = NO_WRENCH,
    rolling_forces: tuple[float, float] = (0.0, 0.0),
) -> Instant:
    """Solve the constrained equations of motion for q'', the joint torques and the multipliers.

    `joint_accelerations` are psi'' and phi'' [rad/s^2]; phi itself is never used, only `steering` is.
    `rolling_forces` T_f, T_b [N] act against positive rolling.
    """
    theta = position[THETA]
    rows = constraint_matrix(board, theta, steering)
    rates = constraint_matrix_rate(board, theta, velocity[THETA], steering)
    rolling = rolling_matrix(board, theta, steering)
    applied = np.zeros(6)
    applied[X] = wrench.along * cos(theta) - wrench.across * sin(theta)
    applied[Y] = wrench.along * sin(theta) + wrench.across * cos(theta)
    applied[[THETA, BETA]] = wrench.yaw
    applied -= np.asarray(rolling_forces) @ rolling
    slips = slip_speeds(board, velocity[BETA], steering)
    if structure == "coupled":
        tractions = np.array([tyre(slip, speed) for slip, speed in zip(slips, rolling @ velocity, strict=True)])
        applied[BETA] -= board.half_length * (np.cos([steering.front, steering.back]) @ tractions)
    elif structure == "ideal":
        rows = np.vstack([rows, np.eye(6)[BETA]])
        rates = np.vstack([rates, np.zeros(6)])
    elif structure == "printed":
        traction = tyre(slips[0], rolling[0] @ velocity)
        applied -= rows.T @ np.array([traction, traction])
    else:
        raise ValueError(f"unknown structure {structure!r}")

    known, unknown = [PSI, PHI], [X, Y, THETA, BETA]
    mass = mass_matrix(board)
    given = np.asarray(joint_accelerations)
    count = len(rows)
    system = np.block([
        [mass[:, unknown], -np.eye(6)[:, known], -rows.T],
        [rows[:, unknown], np.zeros((count, 2)), np.zeros((count, count))],
    ])  # fmt: skip
    right = np.concatenate([applied - mass[:, known] @ given, -rates @ velocity - rows[:, known] @ given])
    solution = np.linalg.solve(system, right)
    acceleration = np.empty(6)
    acceleration[unknown], acceleration[known] = solution[:4], given
    return Instant(acceleration, solution[4], solution[5], solution[6:])


def free_accelerations(
    board: Board,
    tyre: Tyre,
    theta: float,
    velocity: np.ndarray,
    steering: Steering,
    rotor_acceleration: float,
    *,
    wrench: Wrench = NO_WRENCH,
    rolling_forces: tuple[float, float] = (0.0, 0.0),
) -> np.ndarray:
    """(xddot, yddot, thetaddot) of the free structure from the world velocity (xdot, ydot, thetadot)."""
    axis = np.array([cos(theta), sin(theta)])
    side = np.array([-sin(theta), cos(theta)])
    force = wrench.along * axis + wrench.across * side
    moment = wrench.yaw
    for (p, _, arm), resistance in zip(_wheelsets(board, steering), rolling_forces, strict=True):
        tangent = np.array([cos(theta + p), sin(theta + p)])
        normal = np.array([-sin(theta + p), cos(theta + p)])
        contact = velocity[:2] + arm * velocity[2] * side
        push = -tyre(normal @ contact, tangent @ contact) * normal - resistance * tangent
        lever = arm * axis
        force = force + push
        moment += lever[0] * push[1] - lever[1] * push[0]
    yaw = (moment - board.rotor_inertia * rotor_acceleration) / board.inertia
    return np.array([*(force / board.mass), yaw])


# --- Runs ------------------------------------------------------------------------------------------------------------


def controlled_joint(desired: Sine, gait: Gait, time: float, angle: float, rate: float) -> float:
    """Equation (8): the acceleration that inverse dynamics gives a joint [rad/s^2]."""
    target, target_rate, target_acceleration = desired(time)
    return target_acceleration + gait.damping * (target_rate - rate) + gait.stiffness * (target - angle)


def starting_velocity(
    board: Board, theta: float, steering: Steering, speed: float, spin: float, structure: str = "coupled"
) -> np.ndarray:
    """qdot with a given speed along theta [m/s] and spin thetadot + betadot [rad/s], the joints still.

    The constraints (3) give the rest; `ideal` has betadot = 0 in the place of the spin, and `free` neither constraints
    nor beta, so that its sideways speed is 0.
    """
    along = np.array([cos(theta), sin(theta), 0.0, 0.0, 0.0, 0.0])
    across = np.array([-sin(theta), cos(theta), 0.0, 0.0, 0.0, 0.0])
    turning, skidding = np.eye(6)[THETA], np.eye(6)[BETA]
    joints = np.eye(6)[[PSI, PHI]]
    constraints = constraint_matrix(board, theta, steering)
    rows, values = {
        "coupled": ([*constraints, along, turning + skidding], [0.0, 0.0, speed, spin]),
        "printed": ([*constraints, along, turning + skidding], [0.0, 0.0, speed, spin]),
        "ideal": ([*constraints, along, skidding], [0.0, 0.0, speed, 0.0]),
        "free": ([along, across, turning, skidding], [speed, 0.0, spin, 0.0]),
    }[structure]
    return np.linalg.solve(np.vstack([rows, joints]), [*values, 0.0, 0.0])


@dataclass(frozen=True)
class Run:
    """A trajectory: coordinates and velocities (6, times), work done by the joints [J] (times)."""

    times: np.ndarray
    position: np.ndarray
    velocity: np.ndarray
    joint_work: np.ndarray

    @property
    def pose(self) -> np.ndarray:
        """x [m], y [m] and the visible heading theta + beta [rad], (3, times)."""
        return np.array([self.position[X], self.position[Y], self.position[THETA] + self.position[BETA]])


def kinetic_energy(board: Board, velocity: np.ndarray) -> float:
    """Half of qdot^T M qdot [J]."""
    return 0.5 * velocity @ mass_matrix(board) @ velocity


def integrate(
    board: Board,
    tyre: Tyre | None,
    gait: Gait,
    times: np.ndarray,
    *,
    structure: str = "coupled",
    wrench: Callable[[float, np.ndarray, np.ndarray], Wrench] = lambda time, position, velocity: NO_WRENCH,
    rolling_force: Callable[[float], float] = lambda speed: 0.0,
    pose: tuple[float, float, float] = (0.0, 0.0, 0.0),
    speed: float = 0.0,
    spin: float = 0.0,
    max_step: float = 0.02,
    rtol: float = 1e-12,
    atol: float = 1e-13,
) -> Run:
    """Integrate a structure (`coupled`, `ideal`, `printed`, `free`) from times[0] with the joints at rest at zero.

    `pose` is (x [m], y [m], theta [rad]) at times[0], `speed` and `spin` are those of `starting_velocity`. For `free`
    the coordinate beta stays zero. `rolling_force` maps the rolling speed of a wheelset to its T_i [N].
    """
    front_offset, back_offset = gait.crab

    def steer(position, velocity) -> Steering:
        angle, rate = position[PHI], velocity[PHI]
        return Steering(angle + front_offset, -angle + back_offset, rate, -rate)

    def derivative(time, state):
        position, velocity = state[:6], state[6:12]
        joints = (
            controlled_joint(gait.rotor, gait, time, position[PSI], velocity[PSI]),
            controlled_joint(gait.steering, gait, time, position[PHI], velocity[PHI]),
        )
        steering, push = steer(position, velocity), wrench(time, position, velocity)
        resistances = tuple(map(rolling_force, rolling_matrix(board, position[THETA], steering) @ velocity))
        if structure == "free":
            x, y, theta = free_accelerations(
                board,
                tyre,
                position[THETA],
                velocity[: THETA + 1],
                steering,
                joints[0],
                wrench=push,
                rolling_forces=resistances,
            )
            acceleration = np.array([x, y, theta, *joints, 0.0])
            torques = board.rotor_inertia * (theta + joints[0]), 2.0 * board.wheel_inertia * joints[1]
        else:
            instant = constrained_accelerations(
                board,
                tyre,
                position,
                velocity,
                steering,
                joints,
                structure=structure,
                wrench=push,
                rolling_forces=resistances,
            )
            acceleration, torques = instant.acceleration, (instant.rotor_torque, instant.steering_torque)
        power = torques[0] * velocity[PSI] + torques[1] * velocity[PHI]
        return np.concatenate([velocity, acceleration, [power]])

    start = np.zeros(13)
    start[[X, Y, THETA]] = pose
    start[6:12] = starting_velocity(board, pose[2], steer(start[:6], start[6:12]), speed, spin, structure)
    times = np.asarray(times, dtype=float)
    span = (times[0], times[-1])
    options = {"method": "DOP853", "rtol": rtol, "atol": atol, "max_step": max_step}
    solution = solve_ivp(derivative, span, start, t_eval=times, **options)
    if not solution.success:
        raise RuntimeError(solution.message)
    return Run(times, solution.y[:6], solution.y[6:12], solution.y[12])
