"""The parts of a page, from the JSON that the command wrote; each number in a table says where it stands there."""

from collections.abc import Callable, Iterator, Mapping, Sequence

from .._json import Json
from .._played import Played
from .._text import error, misfit_text, number
from . import _figures as figures
from ._page import Cell, Row, Section, Table, cells, plain_sentences, table

Words = Callable[[str], str]
"""What an effect is, in a sentence."""


def paths(models: Sequence[Played]) -> Section:
    """Measured and modelled paths."""
    text = (
        "The broad grey line is what the cameras saw, with gaps where frames were lost; a cross is its first frame."
        " Thin lines are the models. Axes are in metres and equally long."
    )
    return Section("paths", "Paths, measured and modelled", (text,), tuple(figures.paths(models)), wide=False)


def moving() -> Section:
    """The player."""
    text = (
        "The board as it was measured, grey, and as the model has it. A bar across a wheelset is its slip speed; the "
        "circle is the rotor. The slider moves by keyboard too."
    )
    return Section("motion", "The motion", (text,), player=True)


def falling(result: Json) -> Section:
    """The error falling, step by step, and how each run fares."""
    chart = figures.falling(result)
    return Section("falling", "The error", (_falls(result),), (chart,), tuple(_errors(result)))


def _falls(result: Json) -> str:
    if not result.get("steps"):
        return "The misfit is the mean squared residual in units of the noise variance: 1 is noise."
    return (
        "Each step adds one effect, or drops one, and fits everything again. Held-out runs never choose; they judge."
        " The misfit is the mean squared residual in units of the noise variance: 1 is noise."
    )


def _errors(result: Json) -> Iterator[Table]:
    rows = [_error_row("base", "base", result["base"])]
    for k, step in enumerate(result.get("steps", ())):
        name = next(f"{key} {step[key]}" for key in ("added", "dropped") if key in step)
        rows.append(_error_row(name, f"steps.{k}", step))
    heads = ("step", "#misfit, train", "#misfit, held out", "#position [mm]", "#heading [mrad]")
    yield table("Misfit, and the root mean square error on train runs", heads, rows)
    final = "final.runs" if result.get("final") else "runs"
    runs = result["final"]["runs"] if result.get("final") else result["runs"]
    rows = []
    for k, run in enumerate(runs):
        key = f"{final}.{k}"
        parts = [Cell(misfit_text(run["misfit"]), f"{key}.misfit")]
        parts += [Cell(misfit_text(v), f"{key}.channels.{name}") for name, v in run["channels"].items()]
        worst = Cell(f"{run['worst_time_s']:.2f}", f"{key}.worst_time_s")
        rows.append(Row(cells(run["run"], run["role"].replace("heldout", "held out"), *parts, worst), run["run"]))
    caption = "How each run fares with the final model" if result.get("steps") else "How each run fares"
    yield table(caption, ("run", "role", "#misfit", "#x", "#y", "#heading", "#worst at [s]"), rows)


def _error_row(name: str, key: str, part: Json) -> Row:
    rmse, misfit = part["rmse"]["train"] or {}, part["misfit"]
    return Row(
        cells(
            name,
            Cell(misfit_text(misfit["train"]), f"{key}.misfit.train"),
            Cell(misfit_text(misfit["heldout"]), f"{key}.misfit.heldout"),
            _scaled(rmse.get("position_m"), f"{key}.rmse.train.position_m"),
            _scaled(rmse.get("heading_rad"), f"{key}.rmse.train.heading_rad"),
        )
    )


def _scaled(value: float | None, key: str) -> Cell:
    """A length in mm or an angle in mrad; the key ends in the factor."""
    scaled = None if value is None else 1000 * value
    text = "" if scaled is None else f"{scaled:#.3g}".rstrip(".") if abs(scaled) < 999.5 else f"{scaled:.0f}"
    return Cell(text, f"{key}*1000")


def failing(models: Sequence[Played], comparison: Json | None = None) -> Section:
    """Where the models fail."""
    charts = figures.failing(models)
    charts.append(figures.against(models, "gait_phase", "gait phase [rad]", circular=True))
    charts.append(figures.against(models, "slip", "slip angle [rad]"))
    charts.append(figures.against(models, "speed", "speed [m/s]"))
    text = "Each second of each run, then over gait phase, slip and speed. A misfit of 1, its logarithm 0, is noise."
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
        yield table("What the residual goes with", ("variable", "channel", "#share", "#p"), rows)
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
    yield table("The moments furthest off", ("run", "channel", "#time [s]", "#off by [sd]", "#[mm, mrad]"), rows)
    rows = [
        Row(
            cells(
                side["model"] if not side["failure"] else f"{side['model']}: {side['failure']}",
                Cell(misfit_text(side["misfit"]["train"]), f"comparison.models.{k}.misfit.train"),
                Cell(misfit_text(side["misfit"]["heldout"]), f"comparison.models.{k}.misfit.heldout"),
            )
        )
        for k, side in enumerate(comparison["models"])
    ]
    if rows:
        yield table("Models side by side", ("model", "#misfit, train", "#misfit, held out"), rows)


def ranking(result: Json, words: Words) -> Section:
    """The candidates at the base, best first."""
    rows = []
    for k, one in enumerate(result["ranking"]):
        key = f"ranking.{k}"
        p = one["p_value"]
        first = [
            Cell("" if p is None else f"{p:.1g}" if p > 0 else "< 1e-300", f"{key}.p_value"),
            Cell(misfit_text(one["predicted_misfit"]), f"{key}.predicted_misfit"),
            Cell(misfit_text(one["refit_misfit"]), f"{key}.refit_misfit"),
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
    heads = ("candidate", "#p", "#predicts", "#refitted", "", "#expected", "#+-", "#smallest seen", "not told from")
    best = [one["effect"] for one in result["ranking"][:3]]
    sentences = plain_sentences(
        "How sure each effect is beside the base model, and the value to expect, before any is added. p is corrected"
        " for the number of candidates; predictions are of short windows, the best few were refitted on whole runs.",
        *(f"{name}: {words(name)}" for name in best),
        *_twins(result["ranking"]),
    )
    tables = [table("Candidates, best first", heads, rows)]
    if result["left_out"]:
        left = [Row(cells(part["effect"], part["why"])) for part in result["left_out"]]
        tables.append(table("Left out", ("effect", "why"), left))
    return Section("ranking", "What may be missing", sentences, (figures.suspects(result["ranking"]),), tuple(tables))


def _unit(estimate: Json) -> str:
    """The unit behind a number; none where it has none."""
    return "" if estimate["unit"] == "-" else estimate["unit"]


def _twins(ranked: Sequence[Json]) -> Iterator[str]:
    """Which effects these runs cannot tell apart, each pair once: two that resemble a third need not resemble."""
    told: set[frozenset[str]] = set()
    for one in sorted(ranked, key=lambda one: -len(one["confusable_with"])):
        pairs = {other: frozenset((one["effect"], other)) for other in one["confusable_with"]}
        others = [other for other, pair in pairs.items() if pair not in told]
        told.update(pairs.values())
        if others:
            *first, last = others
            yield f"These runs cannot tell {one['effect']} from {', '.join(first)}{' or ' if first else ''}{last}."


def tyre(models: Sequence[Played]) -> Section:
    """The tyre, and what the recordings ask of it."""
    text = (
        "Lines are the fitted tyres with their 95% bands. Marks are what the train runs ask of the tyre whatever its"
        " law: means of the force that gives the board the motion it was seen to have, with 95% bars both ways."
        " Where the marks leave the line the force is another than the model's."
    )
    return Section("tyre", "What the tyre was asked for", (text,), (figures.tyre(models),))


def parameters(result: Json, advice: Sequence[str] = ()) -> Section:
    """The parameters with their intervals, and what could not be determined."""
    tables = []
    # Without a step the final model is the base.
    parts = [("base", result["base"])] + ([("final", result["final"])] if result.get("steps") else [])
    for key, part in parts:
        rows = list(_parameter_rows(part["parameters"], f"{key}.parameters"))
        for effect, values in (part.get("effects") or {}).items():
            rows += _parameter_rows(values, f"{key}.effects.{effect}", f"{effect}.")
        caption = {"base": "The base model", "final": "The final model"}[key] if len(parts) > 1 else "Parameters"
        tables.append(table(caption, _PARAMETERS, rows))
    if result.get("combinations"):
        rows = list(_parameter_rows(result["combinations"], "combinations"))
        heads = ("together", "#value", "#+-", "unit", "95% interval", "")
        tables.append(table("What the runs determine of several together", heads, rows))
    return Section("parameters", "Parameters", plain_sentences(*advice), (), tuple(tables))


_PARAMETERS = ("parameter", "#value", "#+-", "unit", "95% interval", "")


def _parameter_rows(parts: Mapping[str, Json], key: str, prefix: str = "") -> Iterator[Row]:
    for name, part in parts.items():
        low, high = part.get("interval") or (None, None)
        sd = part["sd"]
        interval = "" if low is None and high is None else f"{_end(low, sd, '-inf')} to {_end(high, sd, 'inf')}"
        note = "held" if part.get("held") else "" if part["determined"] else "cannot be determined"
        note = "at its bound" if part.get("at_bound") else note
        value = Cell(number(part["value"], sd), f"{key}.{name}.value")
        yield Row(cells(prefix + name, value, Cell(error(sd), f"{key}.{name}.sd"), part["unit"], interval, note))


def _end(value: float | None, sd: float | None, open_: str) -> str:
    return open_ if value is None else number(value, sd)


def missing(result: Json, charts: Sequence[figures.Chart]) -> Section:
    """The force that is missing, and what it depends on."""
    left = result["unexplained"]
    shares = left["depends_on"] or []
    rows = [
        Row(cells(part["variable"], Cell(f"{part['share']:.3f}", f"unexplained.depends_on.{k}.share")))
        for k, part in enumerate(shares)
    ]
    sentences = plain_sentences(
        "No known effect leaves only noise. This is the force that must be added to the model, along (X) and across (Y)"
        " the board and about its vertical (N), with 95% bands.",
        f"It is counted beside what survives there: {', '.join(left['beside'])}." if left["beside"] else None,
        f"It depends on {shares[0]['variable']} first: that alone predicts {100 * shares[0]['share']:.0f}% of the"
        " excess on runs left out."
        if shares
        else "It depends on nothing that these runs could tell.",
        f"These helped without explaining: {', '.join(left['partial'])}." if left["partial"] else None,
    )
    tables = []
    if shares:
        tables.append(table("What it depends on", ("variable", "#share"), rows))
        charts = (figures.dependence(shares), *charts)
    known = [
        row
        for effect, values in left["beside"].items()
        for row in _parameter_rows(values, f"unexplained.beside.{effect}", f"{effect}.")
    ]
    if known:
        tables.append(table("What survives beside it", _PARAMETERS, known))
    return Section("missing", "The missing force", sentences, tuple(charts), tuple(tables), wide=False)


def recordings(result: Json) -> Section | None:
    """What was found wrong with the recordings before anything was fitted, and what was done about it."""
    quality = result.get("quality")
    if quality is None:
        return None
    masked = {name: count for name, count in quality["masked"].items() if count}
    if not quality["findings"]:
        return Section("recordings", "The recordings", ("Nothing was found wrong with them.",))
    rows = [
        Row(
            cells(
                found["run"] or "all",
                found["kind"].replace("_", " "),
                found["what"],
                found["action"] if found["applied"] else found["remedy"],
            ),
            found["run"],
        )
        for found in quality["findings"]
    ]
    told = ", ".join(f"{count} of {name}" for name, count in masked.items())
    sentences = plain_sentences(
        "They were looked at before anything was fitted.",
        "They were taken as recorded: nothing was mended." if quality["as_recorded"] else None,
        f"Frames that count as lost for it: {told}." if told else None,
    )
    heads = ("run", "what", "where and how large", "what was done, or what to do")
    return Section("recordings", "The recordings", sentences, (), (table("Findings", heads, rows),))
