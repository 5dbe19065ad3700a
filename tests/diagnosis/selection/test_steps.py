"""Which candidates explain the runs as well as an effect that was added."""

import dataclasses

import pytest
from helpers.made_up_explanation import story

from snakejax.diagnosis.selection.steps import CandidateScore, SelectionStep, indistinguishable
from snakejax.estimation.goodness_of_fit import Score


def added(own: float | None, other: float | None, *, later: tuple[str, ...] = ()) -> tuple[SelectionStep, ...]:
    """A base beside which com_offset and marker_offset are confusable, with these misfits of their refits to 5000
    samples, the step that added com_offset, and those that added `later`."""
    base = story().steps[0]
    ranking = (
        CandidateScore("com_offset", refit_misfit=own, confusable_with=("marker_offset",)),
        CandidateScore("marker_offset", refit_misfit=other, confusable_with=("com_offset",)),
        CandidateScore("yaw_bias", refit_misfit=None),
    )
    steps = [dataclasses.replace(base, ranking=ranking, train=Score(1.0, 1e-3, 1e-3, 5000))]
    for k, name in enumerate(("com_offset", *later)):
        effects = ("com_offset", *later)[: k + 1]
        steps.append(dataclasses.replace(steps[0], change="added", name=name, effects=effects, ranking=ranking[2:]))
    return tuple(steps)


@pytest.mark.parametrize(
    ("own", "other", "twins"),
    [
        (0.997, None, ("marker_offset",)),  # It was not refitted: the score tests cannot tell them apart.
        (0.9970, 0.9978, ("marker_offset",)),  # chi^2 differs by 4,
        (0.9970, 0.9992, ()),  # and by 11: the ratio of the likelihoods is 245.
    ],
)
def test_a_twin_is_confusable_and_fits_whole_runs_as_well(own, other, twins) -> None:
    assert indistinguishable(added(own, other), "com_offset") == twins


@pytest.mark.parametrize(("own", "other", "twins"), [(500.0, 505.0, ("marker_offset",)), (500.0, 511.0, ())])
def test_windows_tell_from_a_twin_that_was_not_refitted_for_them(own, other, twins) -> None:
    first, *rest = added(0.997, None)
    rows = [dataclasses.replace(row, windows_chi2=chi2) for row, chi2 in zip(first.ranking, (own, other), strict=False)]
    steps = (dataclasses.replace(first, ranking=tuple(rows)), *rest)
    assert indistinguishable(steps, "com_offset") == twins


def test_effects_that_both_act_are_no_twins() -> None:
    steps = added(0.997, None, later=("yaw_bias", "marker_offset"))
    assert indistinguishable(steps[:3], "com_offset") == ("marker_offset",)
    assert indistinguishable(steps, "com_offset") == ()


def test_an_effect_that_no_ranking_has_has_no_twin() -> None:
    steps = added(0.997, None)
    assert indistinguishable(steps, "yaw_bias") == ()
    assert indistinguishable(steps[:1], "com_offset") == ()
