"""How the board of Table II turns and drives: P1 to P5, P11 and P12."""

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

import snakejax as sj

from .claim import Claim, keep, verdict
from .example import board, poses, times

K_S = (1.0, 3.0, 9.0, 20.0, 60.0, 300.0)


def turning(folder: Path) -> list[Claim]:
    """P1, P5, P11, P12: the rotate gait."""
    example = sj.preset("paper-rotate")
    t = times(example)
    rayleigh = poses([board(example, sj.Rayleigh(k)) for k in K_S], example)
    own = poses([board(example)], example)[0]
    free = [poses([board(example, tyre, "free")], example)[0, -1, 2] for tyre in (None, sj.Rayleigh(9.0))]
    exact = sj.Gait(example.gait.phi.command, example.gait.psi.command)
    tracked = poses([board(example)], example, exact)[0, -1, 2]
    ideal = poses([board(example, constraint="ideal")], example)[0]
    nine = rayleigh[K_S.index(9.0)]
    figure = Figure(figsize=(6.4, 4.0), layout="constrained")
    axis = figure.subplots()
    for k, pose in zip(K_S, rayleigh, strict=True):
        axis.plot(t, pose[:, 2], lw=1, label=f"Rayleigh, $k_s$ = {k:g} N s/m")
    axis.plot(t, own[:, 2], "k", lw=1.5, label="Pacejka, Table II")
    axis.plot(t, ideal[:, 2], "k:", lw=1.2, label="ideal")
    axis.set(xlabel="time [s]", ylabel="heading [rad]", title="Rotate: counterpart of Fig. 13")
    axis.legend(fontsize="x-small")
    keep(figure, folder, "fig13")
    settled = t > 2.0
    ratio = [second_component(t[settled], pose[settled, 2]) for pose in (own, nine)]
    tones = [tone(t[settled], pose[settled, 2], 4.0) for pose in rayleigh]
    phases = np.unwrap([phase for _, phase in tones])
    away = np.linalg.norm(own[:, :2], axis=1).max()
    ends = rayleigh[:, -1, 2]
    return [
        Claim(
            "P1", "Rotate turns about 0.95 rad in 14 s, under Table II and under Rayleigh with k_s = 9",
            f"{own[-1, 2]:.3f} and {nine[-1, 2]:.3f} rad (`free`: {free[0]:.3f} and {free[1]:.3f}; ideal"
            f" {ideal[-1, 2]:.3f})",
            verdict(abs(own[-1, 2] - 0.95) < 0.1 and abs(nine[-1, 2] - 0.95) < 0.1),
            f"both within 0.1 rad. The start matters as much as the tyre: joints that follow their commands"
            f" exactly from the first instant give {tracked:.3f} rad",
        ),
        Claim(
            "P5", "Rotate: the Pacejka heading has about two frequency components, the Rayleigh one only one",
            f"second largest over largest peak of the spectrum: {ratio[0]:.3f} (Pacejka), {ratio[1]:.3f} (k_s = 9)",
            verdict(ratio[0] > 0.1 > ratio[1], ratio[0] > 0.05 > ratio[1]),
            "a second component counts if it is at least a tenth of the first, after 2 s, without a straight line",
        ),
        Claim(
            "P11", "Rotate moves the board very little",
            f"at most {1000 * away:.0f} mm from the start", verdict(away < 0.25),
            "less than half the length of the board, 250 mm",
        ),
        Claim(
            "P12", "Rotate under Rayleigh: k_s changes the final angle, not frequency and phase of the heading",
            f"k_s from {K_S[0]:g} to {K_S[-1]:g}: final angle {ends.min():.2f} to {ends.max():.2f} rad; phase at"
            f" 4 rad/s within {np.ptp(phases):.2f} rad",
            verdict(np.ptp(ends) > 0.2 and np.ptp(phases) < 0.2, np.ptp(ends) > 0.2 and np.ptp(phases) < 0.6),
            "final angles differ by more, phases by less than 0.2 rad",
        ),
    ]  # fmt: skip


def driving() -> list[Claim]:
    """P2, P3, P4: the forward gait, and when a board is ideal."""
    rows = []
    forward, rotate = sj.preset("paper-forward"), sj.preset("paper-rotate")
    ends = {}
    for example in (forward, rotate):
        sixty, ideal = (
            poses([board(example, sj.Rayleigh(60.0))], example)[0],
            poses([board(example, constraint="ideal")], example)[0],
        )
        ends[example.name] = (sixty[-1], ideal[-1])
    gone = [float(np.hypot(*pose[:2])) for pose in ends["paper-forward"]]
    turned = [float(pose[2]) for pose in ends["paper-rotate"]]
    short, less = abs(gone[0] / gone[1] - 1), abs(turned[0] / turned[1] - 1)
    ours = f"forward {gone[0]:.2f} and {gone[1]:.2f} m, rotate {turned[0]:.2f} and {turned[1]:.2f} rad"
    rows.append(
        Claim(
            "P2",
            "k_s above 60 is effectively ideal for this board",
            f"k_s = 60 against ideal: {ours}",
            verdict(short < 0.05 and less < 0.05, less < 0.1),
            "both within 5 %",
        )
    )
    rayleigh = poses([board(forward, sj.Rayleigh(k)) for k in K_S], forward)
    distance, heading = np.linalg.norm(rayleigh[:, -1, :2], axis=1), rayleigh[:, :, 2].mean(axis=1)
    rows.append(
        Claim(
            "P3",
            "Forward under Rayleigh: k_s changes the distance, not the average heading",
            f"k_s from {K_S[0]:g} to {K_S[-1]:g}: {distance.min():.3f} to {distance.max():.2f} m; average heading"
            f" within {np.ptp(heading):.4f} rad",
            verdict(distance.max() > 2 * distance.min() and np.ptp(heading) < 0.05),
            "distances a factor of 2 apart, headings within 0.05 rad",
        )
    )
    own = float(np.linalg.norm(poses([board(forward)], forward)[0, -1, :2]))
    rows.append(
        Claim(
            "P4",
            "Forward: the Pacejka board travels much less than the ideal one",
            f"{own:.3f} against {gone[1]:.2f} m",
            verdict(own < gone[1] / 2),
            "less than half",
        )
    )
    return rows


def second_component(t: np.ndarray, heading: np.ndarray) -> float:
    """The second largest peak of the amplitude spectrum over the largest, without the trend."""
    left = (heading - np.polyval(np.polyfit(t, heading, 1), t)) * np.hanning(t.size)
    height = np.abs(np.fft.rfft(left, 16 * t.size))
    peaks = height[1:-1][(height[1:-1] > height[:-2]) & (height[1:-1] > height[2:])]
    peaks = np.sort(peaks)[::-1]
    # The side lobes of the window are below 3 % of a peak.
    return float(peaks[1] / peaks[0])


def tone(t: np.ndarray, heading: np.ndarray, frequency: float) -> tuple[float, float]:
    """Amplitude and phase [rad] of one angular frequency, beside a straight line."""
    columns = np.stack([np.ones_like(t), t, np.sin(frequency * t), np.cos(frequency * t)], axis=1)
    _, _, sine, cosine = np.linalg.lstsq(columns, heading, rcond=None)[0]
    return float(np.hypot(sine, cosine)), float(np.arctan2(cosine, sine))
