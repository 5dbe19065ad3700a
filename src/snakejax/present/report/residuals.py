"""The section of the residuals: over time, in mm and mrad, and their autocorrelation."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from snakejax.diagnosis.explanation import RunBand
from snakejax.diagnosis.residuals.whiteness import autocorrelation
from snakejax.estimation.goodness_of_fit import BAND

from ..style import MEASURED, LineStyle
from ..views import ModelView
from .chart import Chart, Trace, axis_name, band, line, stacked, thinned
from .page import Section

CHANNELS = ("x<br>[mm]", "y<br>[mm]", "heading<br>[mrad]")
LONGEST = 2.0
"""The longest lag of the autocorrelation [s]."""


def residuals(models: Sequence[ModelView]) -> Section:
    """Measured minus modelled pose of the first and the last model, and the autocorrelation of each channel."""
    ends = [models[0]] if len(models) == 1 else [models[0], models[-1]]
    charts = [_over_time(model, k) for k in range(len(models[0].scenes)) for model in ends]
    sentence = (
        "Measured minus modelled pose. Each model has its own scale. The last chart shows the autocorrelation of the"
        " residual over all train runs: it is 1 where the error persists, and lies between the dotted lines where the"
        " residual is white noise."
    )
    heading = "Residuals, before and after" if len(ends) > 1 else "Residuals"
    return Section("residuals", heading, (sentence,), (*charts, _autocorrelation(ends)), wide=False)


def _over_time(model: ModelView, k: int) -> Chart:
    scene = model.scenes[k]
    thin = thinned(scene.times.size)
    left = 1e3 * scene.track.residual * scene.track.sd
    traces: list[Trace] = [
        line(scene.times[thin], left[thin, c], name, model.look, width=1.2, yaxis=axis_name(c))
        for c, name in enumerate(CHANNELS)
    ]
    label = f"The residual of {scene.run} over time, {model.label}."
    layout = stacked("time [s]", CHANNELS)
    return Chart(f"residual-{k}-{model.key}", label, tuple(traces), layout, 330, scene.run, model.key)


def prediction_bands(bands: Sequence[RunBand], look: LineStyle, exact: bool) -> Section:
    """For each run the measured minus the predicted pose, and the 95% band of the prediction from its start.

    `exact`: the bands are those of the noise alone.
    """
    counted = (
        "contains the noise of the cameras"
        if exact
        else "contains the uncertainty of the parameters, the random force and the noise of the cameras; each train run"
        " is predicted with parameters from the other train runs"
    )
    sentence = (
        "Measured minus predicted pose of each run, with the 95% band of the prediction. The prediction is a simulation"
        f" from the start of the run, without later corrections. The band {counted}."
    )
    charts = tuple(_band_over_time(one, k, look) for k, one in enumerate(bands))
    return Section("bands", "Predictions and their bands", (sentence,), charts, wide=False)


def _band_over_time(one: RunBand, k: int, look: LineStyle) -> Chart:
    thin = thinned(one.times.size)
    times, left, ends = one.times[thin], 1e3 * one.residual[thin], 1e3 * BAND * one.sd[thin]
    traces: list[Trace] = []
    for c, name in enumerate(CHANNELS):
        traces.append(band(times, -ends[:, c], ends[:, c], "95% band", look, yaxis=axis_name(c)))
        traces.append(line(times, left[:, c], name, MEASURED, width=1.2, yaxis=axis_name(c)))
    label = f"The measured minus the predicted pose of {one.run}, with the 95% band of the prediction."
    caption = f"{one.run}: {100 * one.inside:.1f}% inside the 95% bands of its prediction"
    return Chart(f"band-{k}", label, tuple(traces), stacked("time [s]", CHANNELS), 330, one.run, caption=caption)


def _autocorrelation(models: Sequence[ModelView]) -> Chart:
    traces: list[Trace] = []
    for model in models:
        tracks = [scene.track for scene in model.scenes if scene.role == "train"]
        step = float(np.median(np.concatenate([np.diff(track.times) for track in tracks])))
        count = max(2, int(LONGEST / step))
        thin = thinned(count, 100)
        lags = step * np.arange(count)[thin]
        for c in range(len(CHANNELS)):
            parts: list[Float[np.ndarray, " n"]] = [track.residual[:, c] for track in tracks]
            values, bound = autocorrelation(parts, count)
            on = {"yaxis": axis_name(c)}
            traces.append(line(lags, values[thin], model.label, model.look, step=model.key, **on))
            ends = [[sign * bound] * 2 for sign in (-1, 1)]
            look = MEASURED._replace(dash="dot")
            traces += [line([0, lags[-1]], end, "white noise", look, width=1, hoverinfo="skip", **on) for end in ends]
    label = "The autocorrelation of the residual of each channel."
    layout = stacked("lag [s]", [name.split("<br>")[0] for name in CHANNELS])
    return Chart("autocorrelation", label, tuple(traces), layout, 330, caption="autocorrelation, train runs")
