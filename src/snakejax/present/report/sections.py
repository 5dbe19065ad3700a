"""The sections of a page, from the JSON of the command; each number in a table carries its place in the JSON."""

from collections.abc import Callable, Iterator, Sequence

from ..as_json.values import Json
from ..as_text.errors import milli_text, times_noise_text
from ..as_text.tables import error, number
from ..views import ModelView, doubt
from . import charts as figures
from .page import Cell, Row, Section, Table, cells, plain_sentences, table
from .parameters import PARAMETER_COLUMNS, parameter_rows

Words = Callable[[str], str]
"""The description of an effect."""


def paths(models: Sequence[ModelView]) -> Section:
    """Measured and modelled paths."""
    text = (
        "The broad grey line is the measured path, with gaps where frames were lost; a cross is its first frame."
        " Thin lines are the models. Axes are in metres and equally long."
    )
    return Section("paths", "Paths, measured and modelled", (text,), tuple(figures.paths(models)), wide=False)


def moving() -> Section:
    """The player."""
    text = (
        "The measured board, grey, and the modelled board. A bar across a wheelset is its slip speed; the circle is the"
        " rotor. The slider can be moved by keyboard too."
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
    poses = ("position, train [mm]", "heading, train [mrad]", "position, held out [mm]", "heading, held out [mrad]")
    heads = ("step", *(f"#{head}" for head in (*poses, "error / noise, train", "error / noise, held out")))
    yield table("The root mean square error", heads, rows)
    final = "final.runs" if result.get("final") else "runs"
    runs = result["final"]["runs"] if result.get("final") else result["runs"]
    rows = []
    for k, run in enumerate(runs):
        key = f"{final}.{k}"
        parts = _pose(run["rmse"], f"{key}.rmse")
        parts.append(_root(run["misfit"], f"{key}.misfit"))
        parts += [_root(v, f"{key}.channels.{name}") for name, v in run["channels"].items()]
        worst = Cell(f"{run['worst_time_s']:.2f}", f"{key}.worst_time_s")
        rows.append(Row(cells(run["run"], run["role"].replace("heldout", "held out"), *parts, worst), run["run"]))
    caption = "The errors of each run with the final model" if result.get("steps") else "The errors of each run"
    caption += doubt((result.get("final") or result["base"])["converged"])
    ratios = (f"#{what} / noise" for what in ("error", "x", "y", "heading"))
    yield table(caption, ("run", "role", "#position [mm]", "#heading [mrad]", *ratios, "#worst at [s]"), rows)


def _error_row(name: str, key: str, part: Json) -> Row:
    roles = ("train", "heldout")
    poses = [cell for role in roles for cell in _pose(part["rmse"][role], f"{key}.rmse.{role}")]
    roots = [_root(part["misfit"][role], f"{key}.misfit.{role}") for role in roles]
    return Row(cells(name + doubt(part["converged"]), *poses, *roots))


def _pose(rmse: Json | None, key: str) -> list[Cell]:
    """The error in position [mm] and in heading [mrad]."""
    return [_scaled((rmse or {}).get(name), f"{key}.{name}") for name in ("position_m", "heading_rad")]


def _scaled(value: float | None, key: str) -> Cell:
    """A length in mm or an angle in mrad; the key ends in the factor."""
    return Cell(milli_text(value), f"{key}*1000")


def _root(misfit: float | None, key: str, note: str = "") -> Cell:
    """An error in multiples of the noise and a `note`; the key ends in the power of the misfit that it is."""
    return Cell(times_noise_text(misfit) + note, f"{key}^0.5")


def failing(models: Sequence[ModelView], comparison: Json | None = None) -> Section:
    """Where the models fail."""
    charts = figures.failing(models)
    charts.append(figures.against(models, "gait_phase", "gait phase [rad]", circular=True))
    charts.append(figures.against(models, "slip", "slip angle [rad]"))
    charts.append(figures.against(models, "speed", "speed [m/s]"))
    text = "Each second of each run, then over gait phase, slip and speed. An error of 1 is noise."
    return Section("failing", "Where the model fails", (text,), tuple(charts), tuple(_comparison(comparison)))


def _comparison(comparison: Json | None) -> Iterator[Table]:
    if comparison is None:
        return
    rows = [
        Row(
            cells(
                part["variable"],
                part["channel"].replace("_rate", ", its rate"),
                Cell(f"{part['share']:.2f}", f"comparison.depends_on.{k}.share"),
                Cell(f"{part['p_value']:.2g}", f"comparison.depends_on.{k}.p_value"),
            )
        )
        for k, part in enumerate(comparison["depends_on"])
    ]
    if rows:
        yield table("Dependence of the residual", ("variable", "channel", "#share", "#p"), rows)
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
                _root(side["misfit"]["train"], f"comparison.models.{k}.misfit.train"),
                _root(side["misfit"]["heldout"], f"comparison.models.{k}.misfit.heldout"),
            )
        )
        for k, side in enumerate(comparison["models"])
    ]
    if rows:
        heads = ("model", "#position, train [mm]", "#heading, train [mrad]")
        heads = (*heads, "#error / noise, train", "#error / noise, held out")
        yield table("Comparison of models", heads, rows)


def ranking(result: Json, words: Words) -> Section:
    """The candidates at the base, best first."""
    rows = []
    for k, one in enumerate(result["ranking"]):
        key = f"ranking.{k}"
        p = one["p_value"]
        first = [
            Cell("" if p is None else f"{p:.1g}" if p > 0 else "< 1e-300", f"{key}.p_value"),
            _root(one["predicted_misfit"], f"{key}.predicted_misfit"),
            "failed"
            if one["refit_failed"]
            else _root(one["refit_misfit"], f"{key}.refit_misfit", doubt(one["converged"])),
        ]
        for place, (name, estimate) in enumerate(list(one["estimate"].items()) or [("", None)]):
            value = ("", "", "")
            if estimate is not None:
                smallest = one["detectable"].get(name)
                value = (
                    Cell(number(estimate["value"], estimate["sd"]), f"{key}.estimate.{name}.value"),
                    Cell(f"{error(estimate['sd'])} {_unit(estimate)}".rstrip(), f"{key}.estimate.{name}.sd"),
                    Cell("" if smallest is None else f"{smallest:.2g}", f"{key}.detectable.{name}"),
                )
            said = one["effect"] if place == 0 else ""
            twins = ", ".join(one["confusable_with"]) if place == 0 else ""
            head = cells(said, *(first if place == 0 else ("", "", "")), name, *value, twins)
            rows.append(Row(head, strong=place == 0 and one["effect"] in (result.get("effects") or ())))
    heads = (
        "candidate",
        "#p",
        "#predicted error / noise",
        "#refitted error / noise",
        "",
        "#expected",
        "#+-",
        "#detects",
        "not distinguished from",
    )
    best = [one["effect"] for one in result["ranking"][:3]]
    sentences = plain_sentences(
        "The significance and the expected value of each effect, tested against the base model before any is added."
        " p is corrected for the number of candidates; predictions are of short windows, the best few were refitted on"
        " whole runs. The expected value does not depend on the other candidates; a refit may give another.",
        *(f"{name}: {words(name)}" for name in best),
        *_twins(result["ranking"]),
    )
    tables = [table("Candidates, best first", heads, rows)]
    if result["left_out"]:
        left = [Row(cells(part["effect"], part["why"])) for part in result["left_out"]]
        tables.append(table("Excluded", ("effect", "why"), left))
    return Section("ranking", "What may be missing", sentences, (figures.candidates(result["ranking"]),), tuple(tables))


def _unit(estimate: Json) -> str:
    """The unit behind a number; none where it has none."""
    return "" if estimate["unit"] == "-" else estimate["unit"]


def _twins(ranked: Sequence[Json]) -> Iterator[str]:
    """The pairs of effects that these runs cannot distinguish, each once."""
    named: set[frozenset[str]] = set()
    for one in sorted(ranked, key=lambda one: -len(one["confusable_with"])):
        pairs = {other: frozenset((one["effect"], other)) for other in one["confusable_with"]}
        others = [other for other, pair in pairs.items() if pair not in named]
        named.update(pairs.values())
        if others:
            *first, last = others
            listed = f"{', '.join(first)}{' or ' if first else ''}{last}"
            yield f"These runs cannot distinguish {one['effect']} from {listed}."


def tyre(models: Sequence[ModelView]) -> Section:
    """The tyre force against slip, fitted and reconstructed from the recordings."""
    text = (
        "Lines are the fitted tyre laws with their 95% bands. Marks are the lateral forces reconstructed from the"
        " measured motion of the train runs, without a tyre law: means with 95% bars in both directions. Points off"
        " the line: the tyre law does not fit there."
    )
    return Section("tyre", "Lateral force against slip", (text,), (figures.tyre(models),))


def missing(result: Json, charts: Sequence[figures.Chart]) -> Section:
    """The missing force and its dependence."""
    left = result["unexplained"]
    shares = left["depends_on"] or []
    rows = [
        Row(cells(part["variable"], Cell(f"{part['share']:.3f}", f"unexplained.depends_on.{k}.share")))
        for k, part in enumerate(shares)
    ]
    sentences = plain_sentences(
        "No known effect brings the error down to the noise. This is the force that must be added to the model, along"
        " (X) and across (Y) the board and about its vertical (N), with 95% bands.",
        f"These effects remain significant with it: {', '.join(left['beside'])}." if left["beside"] else None,
        f"It depends on {shares[0]['variable']} first: that alone predicts {100 * shares[0]['share']:.0f}% of the"
        " excess on excluded runs."
        if shares
        else "No variable of these runs predicts it.",
        f"These effects lower the error without explaining it: {', '.join(left['partial'])}."
        if left["partial"]
        else None,
    )
    tables = []
    if shares:
        tables.append(table("Dependence of the missing force", ("variable", "#share"), rows))
        charts = (figures.dependence(shares), *charts)
    known = [
        row
        for effect, values in left["beside"].items()
        for row in parameter_rows(values, f"unexplained.beside.{effect}", f"{effect}.")
    ]
    if known:
        tables.append(table("Effects that remain significant with it", PARAMETER_COLUMNS, known))
    return Section("missing", "The missing force", sentences, tuple(charts), tuple(tables), wide=False)


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
