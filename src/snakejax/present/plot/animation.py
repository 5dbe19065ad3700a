"""The board as it moves: one picture of it, and films."""

import shutil
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from snakejax.core.errors import InputError
from snakejax.core.progress import Phase, Progress, ProgressEvent, no_progress
from snakejax.dynamics.vehicle import AbstractVehicle

from ..style import MATPLOTLIB, MEASURED
from ..views import ModelView
from .paths import path, titled

RATE = 20.0
"""Pictures a second."""
WHEEL, TRACK, ROTOR, SKID = 0.18, 0.3, 0.25, 1.2
"""Half the length of a wheel, half the width of a wheelset, the rotor's radius, the longest skid; in half lengths."""
KINDS = ("gif", "mp4")


class _Drawn:
    """A board in a figure, to be put where it is."""

    def __init__(self, axis: Axes, colour: str, width: float, alpha: float, places: list[float], half: float) -> None:
        self.half, self.places = half, places

        def stroke(times: float = 1.0, **more) -> Line2D:
            drawn_line = Line2D([], [], color=colour, lw=width * times, alpha=alpha, solid_capstyle="round", **more)
            return axis.add_line(drawn_line)

        self.body, self.rotor, self.spoke = stroke(), stroke(), stroke()
        self.axles = [stroke() for _ in places]
        self.wheels = [[stroke(2.0), stroke(2.0)] for _ in places]
        self.skids = [stroke(3.0) for _ in places]
        for constraint in self.skids:
            constraint.set_alpha(0.45 * alpha)

    def put(self, pose: np.ndarray, steered: np.ndarray, rotor: float, constraint: np.ndarray) -> None:
        """Place it; `constraint` is the signed length of the bar at each wheelset, in half lengths. NaN hides it."""
        x, y, heading = pose
        place, ahead = complex(x, y), np.exp(1j * heading)
        L = self.half

        def draw(line: Line2D, points: np.ndarray, origin: complex = 0.0, turned: complex = 1.0) -> None:
            world = place + ahead * L * (origin + turned * points)
            line.set_data(world.real, world.imag)

        draw(self.body, np.array([-1.0, 1.0, 1.0 - 0.12j, 1.25, 1.0 + 0.12j, 1.0]))
        draw(self.rotor, ROTOR * np.exp(1j * np.linspace(0.0, 2 * np.pi, 25)))
        draw(self.spoke, np.array([0.0, ROTOR]), turned=np.exp(1j * rotor))
        for k, at in enumerate(self.places):
            turned = np.exp(1j * steered[k])
            draw(self.axles[k], np.array([-1j, 1j]) * TRACK, at, turned)
            for wheel, side in zip(self.wheels[k], (-1j, 1j), strict=True):
                draw(wheel, np.array([-WHEEL, WHEEL]) + side * TRACK, at, turned)
            draw(self.skids[k], np.array([0.0, 1j * constraint[k]]), at, turned)


class _Film:
    """One run as a figure whose picture can be set."""

    def __init__(self, model: ModelView, board: AbstractVehicle, run: str | None) -> None:
        names = [scene.run for scene in model.scenes]
        if run is not None and run not in names:
            raise ValueError(f"There is no run `{run}`: take one of {', '.join(names)}.")
        self.scene = scene = model.scenes[0 if run is None else names.index(run)]
        self.figure = Figure(figsize=(6.4, 5.2), layout="constrained", dpi=100)
        axis = self.figure.subplots()
        half, places = float(board.length), [float(w.place) for w in board.wheelsets]
        path(axis, scene.measured, MEASURED._replace(colour="#c0c0c0"), "measured", wide=True)
        self.trail = axis.plot([], [], color=model.look.colour, ls=MATPLOTLIB[model.look.dash], lw=1.2)[0]
        self.ghost = _Drawn(axis, MEASURED.colour, 2.5, 0.5, places, half)
        self.board = _Drawn(axis, model.look.colour, 1.4, 1.0, places, half)
        both = np.concatenate([scene.measured[:, :2], scene.pose[:, :2]])
        low, high = np.nanmin(both, axis=0) - 1.5 * half, np.nanmax(both, axis=0) + 1.5 * half
        axis.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), xlabel="x [m]", ylabel="y [m]")
        axis.set_aspect("equal", adjustable="box")
        axis.set_title(titled(scene.run, scene.role), loc="left", fontsize="medium")
        self.clock = axis.set_title("", loc="right", fontsize="medium")
        self.constraint = SKID / max(float(np.abs(scene.slip_speed).max()), 1e-9)
        # Laid out once: every picture has the same axes.
        self.clock.set_text("0.00 s")
        self.figure.draw_without_rendering()
        self.figure.set_layout_engine("none")

    def show(self, k: int) -> None:
        """The picture of sample `k`."""
        scene = self.scene
        still = np.zeros(scene.slip_speed.shape[1])
        self.ghost.put(scene.measured[k], scene.steered[k], scene.rotor[k], still)
        self.board.put(scene.pose[k], scene.steered[k], scene.rotor[k], self.constraint * scene.slip_speed[k])
        self.trail.set_data(scene.pose[: k + 1, 0], scene.pose[: k + 1, 1])
        self.clock.set_text(f"{scene.times[k]:.2f} s")


def board(model: ModelView, board: AbstractVehicle, run: str | None = None, time: float = 0.0) -> Figure:
    """One picture of a run at `time` [s]: the board as measured, grey, and as the model has it.

    **Arguments:** `run`, the name of a run, by default the first. **Raises:** `ValueError` where there is none.
    """
    film = _Film(model, board, run)
    film.show(int(np.argmin(np.abs(film.scene.times - time))))
    return film.figure


def animate(
    model: ModelView,
    board: AbstractVehicle,
    file: Path | str,
    run: str | None = None,
    progress: Progress = no_progress,
) -> Path:
    """Write a film of a run to `file`, whose ending says what it is: .gif, or .mp4 where ffmpeg is there.

    The board as it was measured is grey, as the model has it in colour, with its rotor and wheelsets; a bar at a
    wheelset is its slip speed. It plays as fast as it was.

    **Arguments:** `run`, the name of a run, by default the first; `progress` counts the pictures.
    **Raises:** `InputError` for another ending, where ffmpeg is not there, or where the file cannot be written.
    """
    from matplotlib.animation import FFMpegWriter, PillowWriter

    file = Path(file)
    kind = file.suffix.removeprefix(".").lower()
    require_film(kind, str(file))
    film = _Film(model, board, run)
    times = film.scene.times
    stride = max(round((times.size - 1) / (RATE * float(times[-1] - times[0]))), 1)
    # A GIF counts in hundredths of a second, and its writer rounds down.
    hundredths = max(round(100 * stride * float(times[-1] - times[0]) / (times.size - 1)), 1)
    rate = 100.0 / hundredths * (1 - 1e-9)
    shown = range(0, times.size, stride)
    writer = PillowWriter(fps=rate) if kind == "gif" else FFMpegWriter(fps=rate, extra_args=["-pix_fmt", "yuv420p"])
    # A film that is cut short leaves what was there before.
    unfinished = file.with_name(f".{file.stem}.unfinished{file.suffix}")
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        with writer.saving(film.figure, str(unfinished), dpi=100):
            for done, k in enumerate(shown, 1):
                film.show(k)
                writer.grab_frame()
                progress(ProgressEvent(Phase.ANIMATION, f"filming {film.scene.run}", done, len(shown)))
        unfinished.replace(file)
    except OSError as error:
        remedy = "name a file in a folder you may write to"
        raise InputError(f"Cannot write the film ({error.strerror})", str(file), remedy) from None
    finally:
        unfinished.unlink(missing_ok=True)
    return file


def require_film(kind: str, where: str) -> None:
    """**Raises:** `InputError` where films of this `kind` cannot be made here, said before the work and not after."""
    if kind not in KINDS:
        raise InputError(f"A film cannot be written as `{kind}`", where, f"take {' or '.join(KINDS)}")
    if kind == "mp4" and shutil.which("ffmpeg") is None:
        raise InputError("An MP4 needs ffmpeg, which is not installed", where, "install ffmpeg, or write a GIF")
