"""One picture for each effect, drawn from the effect itself: from what its own code makes of one instant of motion."""

import io
from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from plan_view import LENGTH, compass, draw_board
from scipy.integrate import solve_ivp

import snakejax as sj
from snakejax.core.parameter import own_parameters
from snakejax.dynamics.contact import Motion, Wheel, slip_angle
from snakejax.dynamics.ports import Effect
from snakejax.dynamics.signals import Joint
from snakejax.effects import LIBRARY
from snakejax.present.style import COLOURS

WITHOUT, WITH, OTHER = "#707070", COLOURS[0], COLOURS[1]
BOARD = sj.Board(**sj.vehicles.TABLE_II)
TYRE = sj.Pacejka(B=7.6, C=1.5, D=8.5, E=-0.1)
FRONT, BACK = BOARD.wheelsets
STILL = Joint(*(jnp.zeros(()),) * 3)
TIME = np.linspace(0.0, 3.0, 301)


def motion(**given: Any) -> Motion:
    """The board at rest at the origin, but for what is given."""
    zero = jnp.zeros(())
    parts: dict[str, Any] = dict.fromkeys(Motion._fields, zero)
    joints = {"phi": STILL, "psi": STILL}
    return Motion(**(parts | {"inputs": joints, "wheels": (), "board": BOARD, "drive": None} | given))


def wheel(wheelset: sj.dynamics.Wheelset = FRONT, lateral: Any = 0.0, rolling: Any = 1.0) -> Wheel:
    """A wheelset that points ahead, at these speeds [m/s]."""
    return Wheel(wheelset, STILL, jnp.zeros(()), jnp.ones(()), jnp.asarray(lateral), jnp.asarray(rolling))


def curve(axis: Axes, x: np.ndarray, y: Any, label: str, colour: str = WITH, dash: str = "-") -> None:
    """One labelled line."""
    axis.plot(x, np.broadcast_to(np.asarray(y), x.shape), dash, color=colour, lw=2, label=label)


def titled(axis: Axes, x: str, y: str) -> None:
    """Titles of the axes, and lines through zero."""
    axis.set(xlabel=x, ylabel=y)
    for line in (axis.axhline, axis.axvline):
        line(0.0, color="#c0c0c0", lw=0.8, zorder=0)


def rolling(axis: Axes, name: str, values: dict[str, float], fastest: float) -> None:
    """A force against rolling over the rolling speed."""
    speed = np.linspace(-fastest, fastest, 201)
    curve(axis, speed, 0.0, "without", WITHOUT, "--")
    curve(axis, speed, made(name, values).resistance(wheel(rolling=speed), motion()), said(values))
    titled(axis, "rolling speed a_i [m/s], forward positive", "T_i [N], backward positive")


def wrench(axis: Axes, name: str, values: dict[str, float], variable: str, most: float) -> None:
    """One component of a wrench over one velocity."""
    x = np.linspace(-most, most, 201)
    unit, component, title = {
        "u": ("forward velocity u [m/s]", 0, "X along the body [N]"),
        "r": ("yaw rate r [rad/s], counter-clockwise positive", 2, "N [N m]"),
    }[variable]
    curve(axis, x, 0.0, "without", WITHOUT, "--")
    curve(axis, x, made(name, values).wrench(motion(**{variable: jnp.asarray(x)}))[component], said(values))
    titled(axis, unit, title)


def slope(axis: Axes, name: str, values: dict[str, float]) -> None:
    """The force of a slope along x, and of one along y, in the world."""
    draw_board(axis, (0.0, 0.0), 0.6)
    for part, colour in zip(values, (WITH, OTHER), strict=True):
        X, Y, _ = made(name, {part: values[part]}).wrench(motion(theta=jnp.asarray(0.6)))
        force = (float(X) + 1j * float(Y)) * np.exp(0.6j)
        tip = 0.9 * LENGTH * force / abs(force)
        label = f"{part} = {values[part]:g} rad: {abs(force):.2f} N"
        axis.annotate("", (tip.real, tip.imag), (0, 0), arrowprops={"arrowstyle": "-|>", "color": colour, "lw": 2})
        axis.plot([], [], color=colour, lw=2, label=label)
    compass(axis)


def steered(axis: Axes, name: str, values: dict[str, float]) -> None:
    """The wheelsets with the steering joint at zero."""
    angles = [float(made(name, values).steer(STILL, wheelset).angle) for wheelset in (FRONT, BACK)]
    draw_board(axis, (0.0, 0.0), 0.0, colour=WITHOUT, label="joint at zero, without")
    draw_board(axis, (0.0, 0.0), 0.0, angles, colour=WITH, label=said(values), body=False)
    compass(axis, "forward", "left")


def commanded(axis: Axes, name: str, values: dict[str, float], joint: str) -> None:
    """A joint over time, as commanded and as it moves."""
    command = sj.Sines(jnp.asarray([0.5]), jnp.asarray([4.0]), jnp.asarray([0.0]))
    signal = getattr(made(name, values).gait(sj.Gait(command, command)), joint)
    curve(axis, TIME, command.at(jnp.asarray(TIME)).angle, "command", WITHOUT, "--")
    curve(axis, TIME, signal.at(jnp.asarray(TIME)).angle, said(values))
    titled(axis, "time [s]", f"{joint} [rad]")


def backlash(axis: Axes, name: str, values: dict[str, float]) -> None:
    """Wheel angle over joint angle."""
    angle = np.linspace(-0.4, 0.4, 201)
    turned = made(name, values).steer(Joint(jnp.asarray(angle), jnp.zeros(201), jnp.zeros(201)), FRONT)
    curve(axis, angle, angle, "without", WITHOUT, "--")
    curve(axis, angle, turned.angle, said(values))
    titled(axis, "joint angle phi [rad]", "wheel angle [rad]")


def lateral(axis: Axes, name: str, values: dict[str, float], wheelsets: dict[str, Any]) -> None:
    """Lateral force of wheelsets over their slip speed at a rolling speed of 0.5 m/s."""
    speed = np.linspace(-0.3, 0.3, 241)
    force = TYRE.force(slip_angle(jnp.asarray(speed), jnp.asarray(0.5), BOARD.creep_speed), jnp.asarray(speed))
    curve(axis, speed, force, "without", WITHOUT, "--")
    for (label, wheelset), colour in zip(wheelsets.items(), (WITH, OTHER), strict=False):
        changed = made(name, values).lateral(force, wheel(wheelset, speed, 0.5), motion())
        curve(axis, speed, changed, f"{label}{said(values)}", colour)
    titled(axis, "lateral slip speed v_i [m/s], left positive", "F_i [N], to the right positive")


def law(axis: Axes, name: str, values: dict[str, float]) -> None:
    """The tyre law with each parameter by itself."""
    slip = np.linspace(-0.5, 0.5, 201)
    curve(axis, slip, TYRE.force(jnp.asarray(slip), jnp.zeros(())), "without", WITHOUT, "--")
    for part, colour in zip(values, (WITH, OTHER), strict=True):
        tyre = made(name, {part: values[part]}).tyre(TYRE, motion())
        label = said({part: values[part]})
        curve(axis, slip, tyre.force(jnp.asarray(slip), jnp.zeros(())), label, colour)
    titled(axis, "slip angle delta [rad], left positive", "F [N], to the right positive")


def gradient(axis: Axes, name: str, values: dict[str, float]) -> None:
    """D over the place."""
    x = np.linspace(-1.5, 1.5, 101)
    curve(axis, x, TYRE.D, "without", WITHOUT, "--")
    curve(axis, x, made(name, values).tyre(TYRE, motion(x=jnp.asarray(x))).D, said(values))
    titled(axis, "x of the centre of mass [m]", "D [N]")
    axis.set_ylim(0)


def relaxation(axis: Axes, name: str, values: dict[str, float]) -> None:
    """The force over the rolled distance, after the slip angle jumped to 0.1 rad."""
    effect, slip, speed = made(name, values), jnp.asarray(0.1), 0.5
    rate = lambda _, m: np.asarray(effect.rate(jnp.asarray(m), slip, wheel(rolling=speed)))  # noqa: E731
    path = np.linspace(0.0, 0.25, 101)
    memory = solve_ivp(rate, (0.0, path[-1] / speed), [0.0], t_eval=path / speed, rtol=1e-8, atol=1e-10).y[0]
    seen = effect.slip(jnp.asarray(memory), slip)
    curve(axis, path, TYRE.force(slip, jnp.zeros(())), "without", WITHOUT, "--")
    curve(axis, path, TYRE.force(seen, jnp.zeros(())), said(values))
    titled(axis, "distance rolled since the slip angle jumped to 0.1 rad [m]", "F [N]")


def centre(axis: Axes, name: str, values: dict[str, float]) -> None:
    """Middle and centre of mass, by the arms of the wheelsets."""
    board = made(name, values).board(BOARD)
    place = -(float(board.arm(FRONT)) + float(board.arm(BACK))) / 2
    draw_board(axis, (0.0, 0.0), 0.0)
    axis.plot(0, 0, "o", color=WITHOUT, ms=9, label="middle")
    axis.plot(place, 0, "o", color=WITH, ms=9, label=f"centre of mass, {said(values)}")
    compass(axis, "forward", "left")


def marker(axis: Axes, name: str, values: dict[str, float]) -> None:
    """Centre of mass and tracked point."""
    heading = 0.5
    x, y, _ = made(name, values).observe(jnp.zeros(()), jnp.zeros(()), jnp.asarray(heading))
    draw_board(axis, (0.0, 0.0), heading)
    axis.plot(0, 0, "o", color=WITHOUT, ms=9, label="centre of mass")
    axis.plot(float(x), float(y), "o", color=WITH, ms=9, label=f"tracked point,\n{said(values)}")
    compass(axis)


def heading(axis: Axes, name: str, values: dict[str, float]) -> None:
    """Axis of the board and axis of the tracked object."""
    true = 0.2
    reported = float(made(name, values).observe(jnp.zeros(()), jnp.zeros(()), jnp.asarray(true))[2])
    draw_board(axis, (0.0, 0.0), true)
    for angle, colour, label in ((true, WITHOUT, "x axis of the board"), (reported, WITH, f"reported, {said(values)}")):
        tip = 1.5 * LENGTH * np.exp(1j * angle)
        axis.annotate("", (tip.real, tip.imag), (0, 0), arrowprops={"arrowstyle": "-|>", "color": colour, "lw": 2})
        axis.plot([], [], color=colour, lw=2, label=label)
    compass(axis)


def clock(axis: Axes, name: str, values: dict[str, float]) -> None:
    """x of a board that starts at command time 0, over the time of the cameras."""
    late = float(made(name, values).delay())
    times = np.linspace(-0.5, 2.0, 251)
    curve(axis, times, 0.5 * np.maximum(times, 0) ** 2, "without", WITHOUT, "--")
    curve(axis, times, 0.5 * np.maximum(times - late, 0) ** 2, said(values))
    titled(axis, "time of the cameras [s]", "x [m]")


def made(name: str, values: dict[str, float]) -> Any:
    """The effect with these values."""
    return LIBRARY[name](**values)


def said(values: dict[str, float]) -> str:
    """Names, values and units, as in a legend."""
    return ", ".join(f"{part} = {value:g} {UNITS[part]}".rstrip(" -") for part, value in values.items())


UNITS: dict[str, str] = {}
"""Unit of each parameter of the effect that is drawn."""
Drawing = Callable[..., None]
PICTURES: dict[str, tuple[Drawing, dict[str, float], tuple[Any, ...]]] = {
    "longitudinal_slip": (rolling, {"k": 0.5}, (0.6,)),
    "rolling_resistance": (rolling, {"f": 0.2}, (0.06,)),
    "body_drag": (wrench, {"c": 0.5}, ("u", 0.6)),
    "quadratic_drag": (wrench, {"c": 0.5}, ("u", 0.6)),
    "yaw_damping": (wrench, {"c": 0.05}, ("r", 1.0)),
    "yaw_friction": (wrench, {"t": 0.02}, ("r", 0.2)),
    "yaw_bias": (wrench, {"t": 0.02}, ("r", 1.0)),
    "ground_slope": (slope, {"sx": 0.003, "sy": 0.003}, ()),
    "steering_offset": (steered, {"o": 0.25}, ()),
    "steering_crab": (steered, {"o": 0.25}, ()),
    "steering_lag": (commanded, {"T": 0.2}, ("phi",)),
    "rotor_lag": (commanded, {"T": 0.2}, ("psi",)),
    "steering_gain": (commanded, {"g": 0.2}, ("phi",)),
    "rotor_gain": (commanded, {"g": 0.2}, ("psi",)),
    "steering_backlash": (backlash, {"b": 0.05}, ()),
    "grip_split": (lateral, {"s": 0.3}, ({"front, ": FRONT, "back, ": BACK},)),
    "com_offset": (centre, {"a": 0.06}, ()),
    "tyre_relaxation": (relaxation, {"sigma": 0.05}, ()),
    "tyre_offset": (law, {"dSh": 0.05, "dSv": 1.0}, ()),
    "stribeck_grip": (lateral, {"s": 0.3}, ({"": FRONT},)),
    "grip_gradient": (gradient, {"g": 0.2}, ()),
    "marker_offset": (marker, {"mx": 0.1, "my": 0.06}, ()),
    "heading_offset": (heading, {"h": 0.2}, ()),
    "clock_offset": (clock, {"T": 0.3}, ()),
}
"""How each effect is drawn, with which values, and what the drawing needs besides."""


def picture(name: str) -> str:
    """The picture of the effect `name` as SVG. **Raises:** `KeyError` for an effect without a drawing."""
    draw, values, more = PICTURES[name]
    effect: type[Effect] = LIBRARY[name]
    UNITS.update({part: p.domain.unit for part, p in own_parameters(effect())})
    return drawn(lambda axis: draw(axis, name, values, *more))


def drawn(draw: Callable[[Axes], None]) -> str:
    """One axis as SVG, the same at every build."""
    with rc_context({"svg.hashsalt": "snakejax", "font.size": 10, "font.family": "sans-serif"}):
        figure = Figure(figsize=(7.0, 2.7), layout="constrained")
        draw(figure.add_subplot())
        figure.legend(loc="outside right center", frameon=False)
        file = io.StringIO()
        figure.savefig(file, format="svg", metadata={"Date": None})
    return file.getvalue()
