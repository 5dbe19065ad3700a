"""Figure of the errors of predictions: after each horizon, for each group and model."""

from matplotlib.figure import Figure

from snakejax.estimation.prediction import Predictions

COLOURS = ("C0", "C1", "C2", "C3", "C4", "C5", "C6", "C7", "C8", "C9")


def prediction(groups: Predictions, title: str = "") -> Figure:
    """Median error (line) and 90% (dashed) over the horizon, position [mm] above, heading [mrad] below; one column a
    group, one colour a model."""
    figure = Figure(figsize=(3.2 * max(len(groups), 1) + 1.0, 5.2), layout="constrained")
    axes = figure.subplots(2, max(len(groups), 1), sharex=True, squeeze=False)
    for column, (group, models) in enumerate(groups.items()):
        above, below = axes[:, column]
        for k, (model, by_horizon) in enumerate(models.items()):
            seconds = [float(h) for h in by_horizon]
            errors = list(by_horizon.values())
            how = {"color": COLOURS[k % len(COLOURS)], "marker": "."}
            above.plot(seconds, [1e3 * e.position for e in errors], label=model, **how)
            above.plot(seconds, [1e3 * e.position_90 for e in errors], ls="--", lw=0.8, **how)
            below.plot(seconds, [1e3 * e.heading for e in errors], **how)
            below.plot(seconds, [1e3 * e.heading_90 for e in errors], ls="--", lw=0.8, **how)
        windows = max((e.windows for by in models.values() for e in by.values()), default=0)
        above.set(title=f"{group} ({windows} windows)", ylim=(0, None))
        below.set(xlabel="after the lead-in [s]", ylim=(0, None))
    axes[0, 0].set_ylabel("position [mm]")
    axes[1, 0].set_ylabel("heading [mrad]")
    axes[0, 0].legend(fontsize="small")
    figure.suptitle(title)
    return figure
