"""The sections of a page, from the JSON of the command; each number in a table carries its place in the JSON."""

from collections.abc import Iterator, Sequence

from snakejax.diagnosis.explanation import Explanation
from snakejax.diagnosis.latent_force.missing_force import LatentForce

from ..as_json.values import Json
from ..as_text.certainty import law_sentences
from ..as_text.columns import CHANNELS, ERROR, HEADING, POSITION, of_heldout
from ..as_text.errors import milli_text
from ..as_text.missing import components_text
from ..views import ModelView, doubt
from . import charts as figures
from .page import Cell, Row, Section, Table, cells, plain_sentences, root, table
from .parameters import PARAMETER_COLUMNS, parameter_rows


def paths(models: Sequence[ModelView]) -> Section:
    """Measured and modelled paths."""
    text = (
        "The broad grey line is the measured path, with gaps where frames were lost; a cross is its first frame."
        " Thin lines are the models. The start pose is fitted too, so a model that lacks something may not begin at the"
        " cross. Axes are in metres and equally long."
    )
    return Section("paths", "Paths, measured and modelled", (text,), tuple(figures.paths(models)), wide=False)


def moving() -> Section:
    """The player."""
    text = (
        "The measured vehicle, grey, and the modelled one. A bar across a wheel is its slip speed; the circle of a"
        " snakeboard is its rotor. The slider can be moved by keyboard too."
    )
    return Section("motion", "The motion", (text,), player=True)


def falling(result: Json) -> Section:
    """The error after each step, and the errors of each run."""
    chart = figures.falling(result)
    return Section("falling", "The error", (_falls(result),), (chart,), tuple(_errors(result)))


def _falls(result: Json) -> str:
    size = (
        "The error is the root mean square residual, in mm and mrad, and over x, y and heading together in multiples of"
        " the noise: 1 is noise."
    )
    if not result.get("steps"):
        return size
    return (
        "Each step adds one effect, or drops one, and fits everything again. Held-out runs are used only for"
        f" validation. {size}"
    )


def _errors(result: Json) -> Iterator[Table]:
    rows = [_error_row("base", "base", result["base"])]
    for k, step in enumerate(result.get("steps", ())):
        name = next(f"{key} {step[key]}" for key in ("added", "dropped") if key in step)
        rows.append(_error_row(name, f"steps.{k}", step))
    columns = (POSITION, HEADING, ERROR)
    heads = ("step", *(f"#{head}" for head in (*columns, *map(of_heldout, columns))))
    yield table("The root mean square error", heads, rows)
    final = "final.runs" if result.get("final") else "runs"
    runs = result["final"]["runs"] if result.get("final") else result["runs"]
    rows = []
    for k, run in enumerate(runs):
        key = f"{final}.{k}"
        parts = _pose(run["rmse"], f"{key}.rmse")
        parts.append(root(run["misfit"], f"{key}.misfit"))
        parts += [root(v, f"{key}.channels.{name}") for name, v in run["channels"].items()]
        worst = Cell(f"{run['worst_time_s']:.2f}", f"{key}.worst_time_s")
        rows.append(Row(cells(run["run"], run["role"].replace("heldout", "held out"), *parts, worst), run["run"]))
    caption = "The errors of each run with the final model" if result.get("steps") else "The errors of each run"
    caption += doubt((result.get("final") or result["base"])["converged"])
    columns = (f"#{name}" for name in (POSITION, HEADING, ERROR, *CHANNELS))
    yield table(caption, ("run", "role", *columns, "#worst at [s]"), rows)


def _error_row(name: str, key: str, part: Json) -> Row:
    errors = [
        cell
        for role in ("train", "heldout")
        for cell in (
            *_pose(part["rmse"][role], f"{key}.rmse.{role}"),
            root(part["misfit"][role], f"{key}.misfit.{role}"),
        )
    ]
    return Row(cells(name + doubt(part["converged"]), *errors))


def _pose(rmse: Json | None, key: str) -> list[Cell]:
    """The error in position [mm] and in heading [mrad]."""
    return [_scaled((rmse or {}).get(name), f"{key}.{name}") for name in ("position_m", "heading_rad")]


def _scaled(value: float | None, key: str) -> Cell:
    """A length in mm or an angle in mrad; the key ends in the factor."""
    return Cell(milli_text(value), f"{key}*1000")


def failing(models: Sequence[ModelView], comparison: Json | None = None) -> Section:
    """Where the models fail: over time, and over gait phase, slip and speed."""
    charts = figures.failing(models)
    charts.append(figures.against(models, "gait_phase", "gait phase [rad]", circular=True))
    charts.append(figures.against(models, "slip", "slip angle [rad]"))
    charts.append(figures.against(models, "speed", "speed [m/s]"))
    text = "The error in each second of each run, then over gait phase, slip and speed. An error of 1 is noise."
    return Section("failing", "Where the model fails", (text,), tuple(charts), tuple(_comparison(comparison)))


def _comparison(comparison: Json | None) -> Iterator[Table]:
    if comparison is None:
        return
    rows = [
        Row(
            cells(
                part["variable"],
                part["channel"].replace("_rate", ", its rate"),
                Cell(f"{100 * part['share']:.0f}", f"comparison.depends_on.{k}.share*100"),
                Cell(f"{part['p_value']:.2g}", f"comparison.depends_on.{k}.p_value"),
            )
        )
        for k, part in enumerate(comparison["depends_on"])
    ]
    if rows:
        yield table("Dependence of the residual", ("variable", "channel", "#share [%]", "#p"), rows)
    rows = [
        Row(
            cells(
                part["run"],
                part["channel"],
                Cell(f"{part['time_s']:.2f}", f"comparison.worst.{k}.time_s"),
                Cell(f"{part['residual_sd']:.1f}", f"comparison.worst.{k}.residual_sd"),
                _scaled(part["residual"], f"comparison.worst.{k}.residual"),
            ),
            part["run"],
        )
        for k, part in enumerate(comparison["worst"])
    ]
    yield table("The largest residuals", ("run", "channel", "#time [s]", "#residual [sd]", "#[mm, mrad]"), rows)
    rows = [
        Row(
            cells(
                f"{side['model']}: {side['failure']}" if side["failure"] else side["model"] + doubt(side["converged"]),
                *_pose(side["rmse"]["train"], f"comparison.models.{k}.rmse.train"),
                root(side["misfit"]["train"], f"comparison.models.{k}.misfit.train"),
                root(side["misfit"]["heldout"], f"comparison.models.{k}.misfit.heldout"),
            )
        )
        for k, side in enumerate(comparison["models"])
    ]
    if rows:
        heads = ("model", *(f"#{name}" for name in (POSITION, HEADING, ERROR, of_heldout(ERROR))))
        yield table("Comparison of models", heads, rows)


def tyre(models: Sequence[ModelView]) -> Section:
    """The tyre force against slip, fitted and reconstructed from the recordings."""
    text = (
        "Lines are the fitted tyre laws with their 95% bands. Marks are the lateral forces reconstructed from the"
        " measured motion of the train runs, without a tyre law: means with 95% bars in both directions. Points off"
        " the line: the tyre law does not fit there."
    )
    return Section("tyre", "Lateral force against slip", (text,), (figures.tyre(models),))


def law(explanation: Explanation, size: str, charts: Sequence[figures.Chart]) -> Section:
    """The force of which a law was found, its `size` in words, and the law."""
    assert explanation.law is not None
    lacking = (
        "A law was found in the random force. This is the force that the model lacks without the law"
        if explanation.law.is_random
        else "No known effect brings the error down to the noise. This is the force that the base model lacks"
    )
    sentences = plain_sentences(
        f"{lacking}, along (X) and across (Y) the board and about its vertical (N), with 95% bands; its root mean"
        f" square is {size}.",
        "The law is drawn in black, if it is a force beside those of the tyres.",
        *(f"{name}: {effect.expression}." for name, effect in explanation.named_laws.items()),
        *law_sentences(explanation),
    )
    return Section("law", "The law of the missing force", sentences, tuple(charts), (), wide=False)


def missing(result: Json, force: LatentForce, charts: Sequence[figures.Chart]) -> Section:
    """The missing `force`, and what is known of its dependence: nothing was tested of a random one."""
    left = result["unexplained"]
    shares = left["depends_on"] or []
    rows = [
        Row(cells(part["variable"], Cell(f"{100 * part['share']:.1f}", f"unexplained.depends_on.{k}.share*100")))
        for k, part in enumerate(shares)
    ]
    sentences = plain_sentences(
        "No known effect brings the error down to the noise. This is the force that must be added to the model, along"
        " (X) and across (Y) the board and about its vertical (N), with 95% bands.",
        f"Its root mean square is {components_text(force)}. A component that is not determined is not shown.",
        "It is a random force, estimated with the effects of the final model." if force.is_random else None,
        f"These effects remain significant with it: {', '.join(left['beside'])}." if left["beside"] else None,
        _dependence(force, shares),
        f"These effects lower the error without explaining it: {', '.join(left['partial'])}."
        if left["partial"]
        else None,
    )
    tables = []
    if shares:
        tables.append(table("Dependence of the missing force", ("variable", "#share [%]"), rows))
        charts = (figures.dependence(shares), *charts)
    known = [
        row
        for effect, values in left["beside"].items()
        for row in parameter_rows(values, f"unexplained.beside.{effect}", f"{effect}.")
    ]
    if known:
        tables.append(table("Effects that remain significant with it", PARAMETER_COLUMNS, known))
    return Section("missing", "The missing force", sentences, tuple(charts), tuple(tables), wide=False)


def _dependence(force: LatentForce, shares: Sequence[Json]) -> str | None:
    """On what a missing force depends, or None of a random one without a law."""
    if not shares:
        return None if force.is_random else "No variable of these runs predicts it."
    variable, percent = shares[0]["variable"], f"{100 * shares[0]['share']:.0f}%"
    return (
        f"It depends most on {variable}: this variable alone predicts {percent} of the squared error above the noise on"
        " omitted runs."
    )


def recordings(result: Json) -> Section | None:
    """The defects of the recordings and what was done about them before the fit."""
    quality = result.get("quality")
    if quality is None:
        return None
    masked = {name: count for name, count in quality["masked"].items() if count}
    if not quality["findings"]:
        return Section("recordings", "The recordings", ("No defects were found.",))
    rows = [
        Row(
            cells(
                finding["run"] or "all",
                finding["kind"].replace("_", " "),
                finding["what"],
                finding["action"] if finding["applied"] else finding["remedy"],
            ),
            finding["run"],
        )
        for finding in quality["findings"]
    ]
    counts = ", ".join(f"{count} of {name}" for name, count in masked.items())
    sentences = plain_sentences(
        "The recordings were inspected before the fit.",
        "They were used as recorded, without repair." if quality["as_recorded"] else None,
        f"Frames masked as lost: {counts}." if counts else None,
    )
    heads = ("run", "defect", "where and how large", "action, or remedy")
    return Section("recordings", "The recordings", sentences, (), (table("Findings", heads, rows),))
