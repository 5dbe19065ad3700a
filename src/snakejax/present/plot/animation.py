"""The vehicle as it moves: one picture of it, and films."""

import shutil
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from snakejax.core.errors import InputError
from snakejax.core.progress import Phase, Progress, ProgressEvent, no_progress
from snakejax.diagnosis.residuals.replays import RunReplay
from snakejax.dynamics.vehicle import AbstractVehicle, Stroke

from ..style import MATPLOTLIB, MEASURED
from ..views import ModelView
from .paths import path, titled

RATE = 20.0
"""Pictures a second."""
SKID = 1.2
"""The longest bar of a slip speed, in lengths of the vehicle."""
KINDS = ("gif", "mp4")


class _Drawn:
    """A vehicle in a figure, to be put where it is."""

    def __init__(self, axis: Axes, colour: str, width: float, alpha: float, vehicle: AbstractVehicle) -> None:
        def drawn(stroke: Stroke, times: float = 1.0) -> tuple[Stroke, Line2D]:
            return stroke, axis.add_line(
                Line2D([], [], color=colour, lw=width * times, alpha=alpha, solid_capstyle="round")
            )

        self.body = [drawn(stroke) for stroke in vehicle.outline()]
        self.wheels = [[drawn(stroke, 1.7) for stroke in vehicle.wheel_outline(w)] for w in vehicle.wheelsets]
        self.skids = [drawn(Stroke(()), 3.0)[1] for _ in vehicle.wheelsets]
        for skid in self.skids:
            skid.set_alpha(0.45 * alpha)

    def put(self, scene: RunReplay, k: int, pose: np.ndarray, skid: np.ndarray) -> None:
        """Place it at `pose` with the joints and wheels of sample `k`; NaN hides it.

        `skid` (W,): the signed length of the bar at each wheelset [m].
        """
        x, y, heading = pose
        base = complex(x, y), np.exp(1j * heading)

        def draw(line: Line2D, points: np.ndarray, origin: complex, angle: float) -> None:
            world = base[0] + base[1] * (origin + points * np.exp(1j * angle))
            line.set_data(world.real, world.imag)

        for stroke, line in self.body:
            angle = 0.0 if stroke.part == "base" else float(scene.joints[stroke.part][k])
            draw(line, _complex(stroke.points), complex(*stroke.pivot), angle)
        for wheel, bar, length, place in zip(self.wheels, self.skids, skid, scene.wheels[k], strict=True):
            origin, angle = complex(*place[:2]), float(place[2])
            for stroke, line in wheel:
                draw(line, _complex(stroke.points), origin, angle)
            draw(bar, np.array([0.0, 1j * length]), origin, angle)


def _reach(stroke: Stroke) -> float:
    return float(np.abs(_complex(stroke.points)).max())


def _complex(points: Sequence[tuple[float, float]]) -> np.ndarray:
    return np.array([complex(*point) for point in points])


class _Film:
    """One run as a figure whose picture can be set."""

    def __init__(self, model: ModelView, vehicle: AbstractVehicle, run: str | None) -> None:
        names = [scene.run for scene in model.scenes]
        if run is not None and run not in names:
            raise ValueError(f"There is no run `{run}`: take one of {', '.join(names)}.")
        self.scene = scene = model.scenes[0 if run is None else names.index(run)]
        self.figure = Figure(figsize=(6.4, 5.2), layout="constrained", dpi=100)
        self.axis = axis = self.figure.subplots()
        self.of, self.colour, half = vehicle, model.look.colour, float(vehicle.length)
        path(axis, scene.measured, MEASURED._replace(colour="#c0c0c0"), "measured", wide=True)
        self.trail = axis.plot([], [], color=model.look.colour, ls=MATPLOTLIB[model.look.dash], lw=1.2)[0]
        self.ghost = _Drawn(axis, MEASURED.colour, 2.5, 0.5, vehicle)
        self.vehicle = _Drawn(axis, model.look.colour, 1.4, 1.0, vehicle)
        both = np.concatenate([scene.measured[:, :2], scene.pose[:, :2]])
        room = 1.2 * max(half, *(abs(complex(*stroke.pivot)) + _reach(stroke) for stroke in vehicle.outline()))
        low, high = np.nanmin(both, axis=0) - room, np.nanmax(both, axis=0) + room
        axis.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), xlabel="x [m]", ylabel="y [m]")
        axis.set_aspect("equal", adjustable="box")
        axis.set_title(titled(scene.run, scene.role), loc="left", fontsize="medium")
        self.clock = axis.set_title("", loc="right", fontsize="medium")
        self.skid = SKID * half / max(float(np.abs(scene.slip_speed).max()), 1e-9)
        # Laid out once: every picture has the same axes.
        self.clock.set_text("0.00 s")
        self.figure.draw_without_rendering()
        self.figure.set_layout_engine("none")

    def stamp(self, k: int) -> None:
        """Leave the vehicle of sample `k` in the picture."""
        drawn = _Drawn(self.axis, self.colour, 1.0, 0.6, self.of)
        drawn.put(self.scene, k, self.scene.pose[k], np.zeros(self.scene.slip_speed.shape[1]))

    def show(self, k: int) -> None:
        """The picture of sample `k`."""
        scene = self.scene
        still = np.zeros(scene.slip_speed.shape[1])
        self.ghost.put(scene, k, scene.measured[k], still)
        self.vehicle.put(scene, k, scene.pose[k], self.skid * scene.slip_speed[k])
        self.trail.set_data(scene.pose[: k + 1, 0], scene.pose[: k + 1, 1])
        self.clock.set_text(f"{scene.times[k]:.2f} s")


def vehicle(model: ModelView, of: AbstractVehicle, run: str | None = None, time: float = 0.0) -> Figure:
    """One picture of a run at `time` [s]: the vehicle as measured, grey, and as the model has it.

    **Arguments:** `run`, the name of a run, by default the first. **Raises:** `ValueError` where there is none.
    """
    film = _Film(model, of, run)
    film.show(int(np.argmin(np.abs(film.scene.times - time))))
    return film.figure


def snapshots(model: ModelView, of: AbstractVehicle, run: str | None = None, count: int = 7) -> Figure:
    """The path of a run, and the vehicle on it at `count` times, evenly spread.

    **Arguments:** `run`, the name of a run, by default the first. **Raises:** `ValueError` where there is none.
    """
    film = _Film(model, of, run)
    last = film.scene.times.size - 1
    film.show(last)
    for k in np.linspace(0, last, count)[:-1].round().astype(int):
        film.stamp(int(k))
    film.clock.set_text(f"every {(film.scene.times[-1] - film.scene.times[0]) / (count - 1):.2g} s")
    return film.figure


def animate(
    model: ModelView,
    vehicle: AbstractVehicle,
    file: Path | str,
    run: str | None = None,
    progress: Progress = no_progress,
) -> Path:
    """Write an animation of a run to `file`: .gif, or .mp4 if ffmpeg is installed.

    The vehicle as it was measured is grey, as the model has it in colour, with its joints and wheels; a bar at a wheel
    is its slip speed. It plays as fast as it was.

    **Arguments:** `run`, the name of a run, by default the first; `progress` counts the pictures.
    **Raises:** `InputError` for another ending, where ffmpeg is not there, or where the file cannot be written.
    """
    from matplotlib.animation import FFMpegWriter, PillowWriter

    file = Path(file)
    kind = file.suffix.removeprefix(".").lower()
    require_film(kind, str(file))
    film = _Film(model, vehicle, run)
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
    """Check, before a long computation, that animations of this `kind` can be made.

    **Raises:** `InputError`.
    """
    if kind not in KINDS:
        raise InputError(f"A film cannot be written as `{kind}`", where, f"take {' or '.join(KINDS)}")
    if kind == "mp4" and shutil.which("ffmpeg") is None:
        raise InputError("An MP4 needs ffmpeg, which is not installed", where, "install ffmpeg, or write a GIF")
