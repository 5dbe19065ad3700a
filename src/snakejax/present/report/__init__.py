"""Reports: one HTML file of a result, to open from disk and to send on.

Each function returns the page as text. It needs no network and no other file.
"""

from collections.abc import Sequence

from snakejax.diagnosis.explanation import Explanation
from snakejax.diagnosis.latent_force.missing_force import LatentForce
from snakejax.diagnosis.selection.steps import SelectionStep
from snakejax.estimation.fit_record import Fit
from snakejax.recording.case import Case
from snakejax.recording.run import Noise

from ..as_json.values import Json
from ..as_text.certainty import (
    band_sentences,
    confidence_sentences,
    floor_sentences,
    horizon_sentences,
    odd_run_sentences,
)
from ..as_text.errors import error_text
from ..as_text.explanation import base_headline, warnings
from ..as_text.first_lines import first_lines, title
from ..as_text.fit import noise_line
from ..as_text.missing import components_text
from ..as_text.tables import not_converged_line
from ..views import ModelView, view_of_step
from . import charts as figures
from . import sections as sections
from .candidates import candidates
from .certainty import certainty
from .design import tune_page
from .law_force import law_forces
from .page import Model, Page, Section, render
from .parameters import parameters
from .player import movie
from .residuals import prediction_bands, residuals
from .sweep import sweep_page


def fit_page(case: Case, noise: Noise, fit: Fit, result: Json, model: ModelView) -> str:
    """The report of a fit, or of a comparison where `result` has one; `model` is that of `view_of_fit`."""
    models = (model,)
    train, held = fit.train_score, fit.heldout_score
    unseen = "" if held is None else f", on held-out runs {error_text(held)}"
    headline = f"{case.name}: the root mean square error of the model is {error_text(train)}{unseen}."
    parts = (
        sections.paths(models),
        residuals(models),
        parameters(result, [fit.fitted], fit.advice),
        sections.falling(result),
        sections.moving(),
        sections.failing(models, result.get("comparison")),
        sections.tyre(models),
    )
    warned = () if fit.converged else (not_converged_line("the model"),)
    return render(_page(case, noise, headline, warned, models, parts, result, fit.model.board))


def diagnosis_page(case: Case, noise: Noise, base: SelectionStep, result: Json) -> str:
    """The report of a diagnosis."""
    models = (view_of_step(base),)
    level = base.criteria.significance_level
    significant = [one for one in result["ranking"] if one["p_value"] is not None and one["p_value"] < level]
    headline = base_headline(case.name, base)
    headline += f" Best candidate: {significant[0]['effect']}." if significant else " No candidate is significant."
    parts = (
        candidates(result, base.description_of, [base.predicted_of_runs]),
        sections.paths(models),
        residuals(models),
        parameters(result, [base.fitted]),
        sections.falling(result),
        sections.moving(),
        sections.failing(models),
        sections.tyre(models),
    )
    return render(_page(case, noise, headline, warnings([base]), models, parts, result, base.model.board))


def explanation_page(explanation: Explanation, result: Json, models: Sequence[ModelView]) -> str:
    """The report of an explanation, from the base model to the verdict; `models` are those of `views_of_steps`."""
    parts: list[Section] = [sections.paths(models), residuals(models)]
    if explanation.missing is not None and result["unexplained"] is not None:
        charts = _force_charts(explanation.missing, explanation, models)
        parts.append(sections.missing(result, explanation.missing, charts))
    elif explanation.law is not None:
        charts = _force_charts(explanation.law, explanation, models)
        parts.append(sections.law(explanation, components_text(explanation.law), charts))
    if explanation.confidence or explanation.candidates:
        lines = [
            f"{effect}: {' '.join(confidence_sentences(explanation, effect))}" for effect in explanation.confidence
        ]
        beside = (floor_sentences, horizon_sentences, band_sentences, odd_run_sentences)
        lines += [line for sentences in beside for line in sentences(explanation)]
        parts.append(certainty(result, lines))
    if explanation.bands:
        parts.append(prediction_bands(explanation.bands, models[-1].look, explanation.floor is None))
    parts += [
        parameters(result, [explanation.base.fitted, explanation.final.fitted]),
        candidates(result, explanation.base.description_of, [step.predicted_of_runs for step in explanation.steps]),
        sections.falling(result),
        sections.moving(),
        sections.failing(models),
        sections.tyre(models),
    ]
    page = _page(
        explanation.case,
        explanation.noise,
        title(explanation),
        warnings(explanation.steps),
        models,
        parts,
        result,
        explanation.base.model.board,
    )
    return render(page._replace(lead=tuple(first_lines(explanation))))


def _force_charts(force: LatentForce, explanation: Explanation, models: Sequence[ModelView]) -> list[figures.Chart]:
    """The force of each run, and before them, where it depends on a variable, the force over that variable; each with
    the force of the laws of the final model."""
    laws = law_forces(explanation.final.fitted, models[-1].scenes)
    charts = figures.missing(force, models[-1], laws)
    if force.depends_on and (force.shape is not None or laws):
        charts.insert(0, figures.shape(force, force.depends_on[0][0], models[-1] if laws else models[0], laws))
    return charts


def _page(
    case,
    noise,
    headline: str,
    warned: tuple[str, ...],
    models: Sequence[ModelView],
    parts: Sequence[Section],
    result,
    board,
) -> Page:
    """A page about recorded runs."""
    shown = {models[0].key, models[-1].key}
    switches = tuple(Model(m.key, m.label, m.look, m.key in shown) for m in models)
    runs = tuple((scene.run, scene.role) for scene in models[0].scenes)
    recordings = sections.recordings(result)
    parts = [*parts, *([recordings] if recordings is not None else [])]
    facts = (case.title, f"{noise_line(noise)[0].upper()}{noise_line(noise)[1:]}.")
    shots = movie(models, board)
    return Page(f"{case.name} - snakejax", headline, facts, runs, switches, tuple(parts), result, shots, warned)


__all__ = ["diagnosis_page", "explanation_page", "fit_page", "sweep_page", "tune_page"]
