"""Reports: one HTML file of a result, to open from disk and to send on.

Each function returns the page as text. It needs no network and no other file.
"""

from collections.abc import Sequence

from .._case import Case
from .._explain import Explanation
from .._fit import Fit
from .._json import Json
from .._played import Played, played_stage
from .._recording import Noise
from .._stage import Stage
from .._story import headline, sentence
from .._text import misfit_text, noise_line
from . import _figures as figures
from . import _sections as sections
from ._movie import movie
from ._page import Model, Page, Section, render
from ._sweep import sweep_page
from ._tune import tune_page


def fit_page(case: Case, noise: Noise, found: Fit, result: Json, model: Played) -> str:
    """The report of a fit, or of a comparison where `result` has one; `model` is that of `played_fit`."""
    models = (model,)
    train, held = found.train_score, found.heldout_score
    unseen = "" if held is None else f", {misfit_text(held.misfit)} on held-out runs"
    told = f"{case.name}: the model leaves a misfit of {misfit_text(train.misfit)}{unseen} (1 is noise)."
    parts = (
        sections.paths(models),
        sections.moving(),
        sections.falling(result),
        sections.failing(models, result.get("comparison")),
        sections.tyre(models),
        sections.parameters(result, found.advice),
    )
    return _page(case, noise, told, models, parts, result, found.study.model.board)


def diagnosis_page(case: Case, noise: Noise, base: Stage, result: Json) -> str:
    """The report of a diagnosis."""
    models = (played_stage(base),)
    sure = [one["effect"] for one in result["ranking"] if one["p_value"] is not None and one["p_value"] < 0.01]
    told = f"{case.name}: the base model leaves a misfit of {misfit_text(base.train.misfit)} (1 is noise)."
    told += f" First suspect: {result['ranking'][0]['effect']}." if sure else " No candidate is significant."
    parts = (
        sections.ranking(result, lambda effect: sentence(effect, base)),
        sections.paths(models),
        sections.moving(),
        sections.falling(result),
        sections.failing(models),
        sections.tyre(models),
        sections.parameters(result),
    )
    return _page(case, noise, told, models, parts, result, base.bench.study.model.board)


def explanation_page(found: Explanation, result: Json, models: Sequence[Played]) -> str:
    """The report of an explanation, from the first misfit to the verdict; `models` are those of `played_stages`."""
    parts: list[Section] = [sections.paths(models), sections.falling(result), sections.moving()]
    if found.missing is not None and result["unexplained"] is not None:
        charts = figures.missing(found.missing)
        if found.missing.depends_on and found.missing.shape is not None:
            charts.insert(0, figures.shape(found.missing, found.missing.depends_on[0][0], models[0]))
        parts.insert(2, sections.missing(result, charts))
    parts += [
        sections.failing(models),
        sections.ranking(result, lambda effect: sentence(effect, found.base)),
        sections.tyre(models),
        sections.parameters(result),
    ]
    board = found.base.bench.study.model.board
    return _page(found.case, found.noise, headline(found), models, parts, result, board)


def _page(case, noise, told: str, models: Sequence[Played], parts: Sequence[Section], result: Json, board) -> str:
    """A page about recorded runs."""
    shown = {models[0].key, models[-1].key}
    switches = tuple(Model(m.key, m.label, m.look, m.key in shown) for m in models)
    runs = tuple((scene.run, scene.role) for scene in models[0].scenes)
    recordings = sections.recordings(result)
    parts = [*parts, *([recordings] if recordings is not None else [])]
    facts = (case.title, f"{noise_line(noise)[0].upper()}{noise_line(noise)[1:]}.")
    return render(
        Page(f"{case.name} - snakejax", told, facts, runs, switches, tuple(parts), result, movie(models, board))
    )


__all__ = ["diagnosis_page", "explanation_page", "fit_page", "sweep_page", "tune_page"]
