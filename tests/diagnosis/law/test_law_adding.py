"""Which steps and laws are kept: those that predict train runs left out, and no step after the best."""

from collections.abc import Callable, Sequence
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from snakejax.core.progress import no_progress
from snakejax.diagnosis.latent_force.missing_force import LatentForce
from snakejax.diagnosis.law import adding, exact_laws, fitting
from snakejax.diagnosis.law.search import ProposedLaw, much_better
from snakejax.diagnosis.law.terms import Family
from snakejax.diagnosis.selection.criteria import CRITERIA
from snakejax.dynamics.law import LawParameter
from snakejax.estimation.goodness_of_fit import largest_noise_misfit


def step(misfit: float) -> Any:
    fit = SimpleNamespace(solution=SimpleNamespace(misfit=misfit))
    return SimpleNamespace(candidate_set=SimpleNamespace(criteria=CRITERIA), step=fit)


@pytest.mark.parametrize(
    ("left_out", "kept"), [([9.0, 4.0, 2.0], 3), ([9.0, 4.0, 5.0], 2), ([9.0, 11.0, 10.0], 1), ([9.0], 1)]
)
def test_no_step_is_kept_after_the_one_that_predicts_best(left_out, kept, monkeypatch) -> None:
    steps = [step(1.5) for _ in left_out]
    told = {id(one.step): misfit for one, misfit in zip(steps, left_out, strict=True)}
    monkeypatch.setattr(fitting, "left_out_misfits", lambda candidate_set, fit: np.full(3, told[id(fit)]))
    assert fitting.predicting_steps(steps, no_progress) == steps[:kept]


def test_each_run_is_predicted_by_a_fit_to_the_others_however_far_the_model_is_from_them() -> None:
    """The values of a fit here are the runs that it was fitted to, and a misfit says which runs they are."""

    class Problem:
        batch = SimpleNamespace(weight=np.array([[[1.0, 1.0, 0.0]], [[1.0, 1.0, 1.0]], [[1.0, 0.0, 0.0]]]))

        def fit(self, values: Any, free: Any, runs: list[int], start: Any, **how: Any) -> Any:
            fitted_to = runs if free else values
            misfit = 100.0 * len(fitted_to) + 10 * sum(fitted_to) + runs[0]
            return SimpleNamespace(values=fitted_to, misfit=np.nan if runs == [3] else misfit)

    residual = np.array([[[3.0, 4.0, 9.0]], [[5.0, 5.0, 5.0]], [[6.0, 7.0, 8.0]]])
    solution = SimpleNamespace(
        values=None,
        free=["D"],
        start=None,
        misfit=2 * CRITERIA.far_misfit,
        linearised=SimpleNamespace(residual=residual),
    )
    fit: Any = SimpleNamespace(solution=solution)

    def candidates(train: list[int]) -> Any:
        return SimpleNamespace(criteria=CRITERIA, problem=Problem(), train=train)

    assert fitting.left_out_misfits(candidates([0, 2, 3]), fit).tolist() == [250.0, 232.0, np.inf]
    # Of one run by hand: present samples with residuals 3 and 4.
    assert fitting.left_out_misfits(candidates([0]), fit).tolist() == [12.5]


@pytest.mark.parametrize(
    ("after", "before", "better"),
    [
        ([1.0, 1.1, 0.9], [30.0, 40.0, 20.0], True),
        ([1.0, 1.0, 1.0], [1.1, 1.1, 1.1], True),
        ([1.0, 1.0, 50.0], [30.0, 3.0, 1.0], False),  # the mean falls, and one run in three is fifty times worse
        ([2.0, 2.0], [1.0, 1.0], False),
        ([1.0, np.inf], [2.0, 2.0], False),
    ],
)
def test_a_law_must_predict_better_by_more_than_its_standard_error(after, before, better) -> None:
    assert fitting.predicts_better(np.array(after), np.array(before)) is better


def proposed(variables: tuple[str, ...], share: float, left_out: float = 1.5) -> ProposedLaw:
    family, none = Family("", "X", variables, ()), np.zeros(0)
    return ProposedLaw("X = a", (), {}, family, none, left_out, left_out, none, share)


def test_laws_say_what_their_variables_explain(monkeypatch) -> None:
    laws = (proposed(("x", "y"), 0.99), proposed(("rotor_rate",), 0.5), proposed(("heading", "time"), 0.4))
    monkeypatch.setattr("snakejax.diagnosis.latent_force.missing_force.search", lambda windows: laws)
    windows = cast(Any, object())
    runs = cast(Any, (object(), object()))
    shares = (("rotor_rate", 0.6), ("time", 0.3), ("world_position", 0.1))
    force = LatentForce(runs, shares, None, (4.0, 1.0), {}, False, windows=windows).with_laws()
    assert force.depends_on == (("world_position", 0.99), ("rotor_rate", 0.6), ("time", 0.3))
    assert force.left == 1.0 + 3.0 * (1 - 0.99)


def test_a_law_that_was_added_is_among_those_of_its_force_once() -> None:
    """A smooth function is proposed only where no formula is good enough."""
    formula, smooth = (proposed((name,), 0.9)._replace(expression=f"X = {name}") for name in "xy")
    force = LatentForce((), (), None, (4.0, 1.0), {}, False, laws=(formula,))
    assert force.with_also((smooth,)).laws == (smooth, formula)
    assert force.with_also((formula,)).laws == (formula,)


def test_variables_of_the_best_law_come_before_others_that_explain_as_much() -> None:
    shares = (("time", 0.8), ("world_position", 0.1))
    force = LatentForce((), shares, None, None, {}, False).with_found([proposed(("y",), 0.8)])
    assert force.depends_on == (("world_position", 0.8), ("time", 0.8))
    assert force.left == 1.5
    assert LatentForce((), shares, None, None, {}, False).left == np.inf


@pytest.mark.parametrize(("second", "taken"), [(1.1, True), (1.4, False)])
def test_a_second_law_must_take_away_half_of_what_the_first_leaves(second, taken, monkeypatch) -> None:
    found = (proposed(("x",), 0.9, left_out=second),)
    monkeypatch.setattr(adding, "search", lambda windows, beside: found)
    force = cast(Any, SimpleNamespace(windows=object()))
    assert (adding._second(force, proposed(("y",), 0.9, left_out=1.5), no_progress) is not None) is taken
    assert adding._second(force, proposed(("y",), 0.9, left_out=1.01), no_progress) is None


def test_only_rivals_of_the_best_law_are_fitted_to_whole_runs() -> None:
    laws = [proposed((name,), 0.9, left_out) for name, left_out in (("x", 1.3), ("y", 1.2), ("time", 1.7), ("r", 1.35))]
    assert [law.family.variables for law in adding.rivals_of(laws)] == [("x",), ("y",), ("r",)]
    assert adding.rivals_of([]) == []


@pytest.mark.parametrize(("left_out", "kept"), [(1.14, True), (1.16, False)])
def test_a_smooth_function_must_leave_half_of_what_the_best_formula_leaves(left_out, kept) -> None:
    """The formulas leave 0.3 and 0.4 above the noise."""

    def smooth(left: float) -> ProposedLaw:
        law = proposed(("x",), 0.9, left)
        return law._replace(family=law.family._replace(together=(("X", "spline(x, 0, 1, c1, c2)"),)))

    laws = [proposed(("x",), 0.9, 1.3), proposed(("y",), 0.9, 1.4)]
    assert bool(much_better([smooth(left_out)], laws)) is kept
    assert much_better([smooth(1.9)], [])


def test_a_new_law_takes_no_name_of_the_model() -> None:
    like: Any = SimpleNamespace(problem=SimpleNamespace(model=SimpleNamespace(effects={"law_1": None, "law_3": None})))
    assert fitting.law_names(3, like) == ("law_2", "law_4", "law_5")


@pytest.mark.parametrize(("misfit", "more", "simple"), [(1.0208, 2, True), (1.0210, 2, False), (1.0217, 3, True)])
def test_of_laws_that_leave_only_noise_a_simpler_one_comes_first_if_chi_squared_does_not_tell(
    misfit, more, simple
) -> None:
    """The one with more parameters leaves 1.02 of 10 000 samples; each of them must lower chi^2 by 9."""

    def added(count: int, left: float) -> fitting.AddedLaws:
        law = proposed(("x",), 0.9)._replace(parameters=tuple(LawParameter(name, "N") for name in "abc"[:count]))
        fit: Any = SimpleNamespace(solution=SimpleNamespace(misfit=left, samples=10_000))
        return fitting.AddedLaws((law,), cast(Any, None), fit, np.ones(0))

    assert exact_laws.likeliest([added(more, 1.02), added(1, misfit)]).size == (1 if simple else more)


@pytest.mark.parametrize(
    ("left_out", "sizes", "misfits", "fitted", "exact"),
    [
        ((1.0, 1.001), (1, 1), (1.0,), ["x"], "x"),
        # In the windows they are alike, and a chi^2 of 100 of whole runs tells them apart.
        ((1.0, 1.0005), (1, 1), (1.0, 0.99), ["x", "y"], "y"),
        ((1.0, 1.001), (1, 1), (1.5, 1.0), ["x", "y"], "y"),
        ((1.0, 1.2), (1, 1), (1.5,), ["x"], None),
        ((1.1, 1.2), (1, 1), (), [], None),
        # Noise may leave 1.04, but a chi^2 of 400 tells them apart.
        ((1.0, 1.001), (1, 1), (1.04, 1.0), ["x", "y"], "y"),
        ((1.0, 1.001), (1, 1), (1.04, 1.05), ["x", "y"], "x"),
        # The first leaves nothing, but the second has fewer parameters, and a chi^2 of 5 does not tell them apart.
        ((1.0, 1.001), (2, 1), (1.0, 1.0005), ["x", "y"], "y"),
        ((1.0, 1.001), (2, 1), (1.0, 1.0015), ["x", "y"], "x"),
        # The first leaves no more than noise may, and the second, alike in the windows, less of whole runs.
        ((1.0, 1.0005), (1, 2), (1.03, 1.0), ["x", "y"], "y"),
    ],
)
def test_an_exact_law_leaves_only_noise_in_windows_and_in_whole_runs(
    left_out, sizes, misfits, fitted, exact, monkeypatch
) -> None:
    laws = tuple(
        proposed((name,), 0.9, misfit)._replace(
            parameters=tuple(LawParameter(part, "N") for part in "ab"[:size]), score=10_000 * misfit
        )
        for name, misfit, size in zip("xy", left_out, sizes, strict=True)
    )
    solutions, tried = iter(misfits), []

    def fitted_laws(case, noise, like, effects, missing, laws, goal=np.inf):
        tried.extend(laws[0].family.variables)
        solution = SimpleNamespace(misfit=next(solutions), samples=10_000, loose=())
        return SimpleNamespace(problem=None, train=[]), SimpleNamespace(solution=solution)

    monkeypatch.setattr(exact_laws, "fitted_laws", fitted_laws)
    monkeypatch.setattr(exact_laws, "wider", lambda windows, law: [])
    monkeypatch.setattr(exact_laws, "accept_addition", lambda candidate_set, before, after: True)
    monkeypatch.setattr(exact_laws, "run_misfits", lambda problem, solution, train: np.ones(0))
    base = SimpleNamespace(samples=10_000)
    like: Any = SimpleNamespace(candidate_set=None, step=SimpleNamespace(effects=(), solution=base))
    force = cast(Any, SimpleNamespace(windows=SimpleNamespace(samples=10_000), laws=laws))
    case, noise = cast(Any, None), cast(Any, None)
    added = exact_laws.exact_law(case, noise, like, force, no_progress)
    assert tried == fitted
    assert (None if added is None else added.laws[0].family.variables[0]) == exact


@pytest.mark.parametrize(("first", "tried", "goal"), [(1.0, "xy", 1.0 - 9e-4), (1.2, "xxyy", None)])
def test_after_a_law_that_leaves_nothing_others_are_fitted_once_and_while_they_may_be_likelier(
    first, tried, goal, monkeypatch
) -> None:
    """The other has one parameter more, which costs a chi^2 of 9 of 10 000 samples."""
    parts = [LawParameter(part, "N") for part in "ab"]
    laws = [
        proposed((name,), 0.9, 1.0)._replace(score=10_000.0, parameters=tuple(parts[:size]))
        for name, size in (("x", 1), ("y", 2))
    ]
    calls = []

    def fitted(case, noise, like, missing, law, goal, progress):
        calls.append((law.family.variables[0], goal))
        solution = SimpleNamespace(misfit=first if law.family.variables == ("x",) else 1.3, samples=10_000, loose=())
        return fitting.AddedLaws((law,), cast(Any, None), cast(Any, SimpleNamespace(solution=solution)), np.ones(1))

    monkeypatch.setattr(exact_laws, "_fitted", fitted)
    monkeypatch.setattr(exact_laws, "wider", lambda windows, law: [law])
    monkeypatch.setattr(exact_laws, "explains_train_runs", lambda like, candidate_set, fit: fit.solution.misfit < 1.1)
    like: Any = SimpleNamespace(step=SimpleNamespace(solution=SimpleNamespace(samples=10_000)))
    force = cast(Any, SimpleNamespace(windows=SimpleNamespace(samples=10_000), laws=tuple(laws)))
    exact_laws.exact_law(cast(Any, None), cast(Any, None), like, force, no_progress)
    noise = largest_noise_misfit(10_000)
    assert "".join(name for name, _ in calls) == tried
    assert [reached for _, reached in calls] == pytest.approx([noise, goal] if goal else [noise] * 4)


@pytest.mark.parametrize(("formula", "tried"), [(9_990.0, []), (10_010.0, ["smooth"])])
def test_a_smooth_function_is_fitted_where_the_windows_prefer_it_to_every_formula(formula, tried, monkeypatch) -> None:
    smooth = proposed(("smooth",), 0.9, 1.0)._replace(score=10_000.0)
    laws = (proposed(("x",), 0.9, 1.0)._replace(score=formula),)
    given = []
    monkeypatch.setattr(exact_laws, "smooth_laws", lambda windows: (smooth,))
    monkeypatch.setattr(exact_laws, "smooth_trials", lambda windows, laws, fitted: given.extend(laws) or [])
    force = cast(Any, SimpleNamespace(windows=SimpleNamespace(samples=10_000), laws=laws))
    case, noise = cast(Any, None), cast(Any, None)
    like: Any = SimpleNamespace(step=SimpleNamespace(solution=SimpleNamespace(samples=10_000)))
    assert exact_laws.exact_smooth_law(case, noise, like, force, no_progress) is None
    assert [law.family.variables[0] for law in given] == tried


def fits_that_leave(misfits: Sequence[float | None]) -> tuple[Callable[[ProposedLaw], fitting.AddedLaws | None], list]:
    """A fit that leaves one of `misfits` after the other (None: it fails), and the scores of the laws it is given."""
    values, tried = iter(misfits), []

    def fit(law: ProposedLaw) -> fitting.AddedLaws | None:
        tried.append(law.score)
        misfit = next(values)
        solution: Any = SimpleNamespace(solution=SimpleNamespace(misfit=misfit, samples=10_000, loose=()))
        return None if misfit is None else fitting.AddedLaws((law,), cast(Any, None), solution, np.full(2, misfit))

    return fit, tried


@pytest.mark.parametrize(
    ("misfits", "fitted", "last"),
    [
        # Noise may leave 1.02, but a chi^2 of 200 says that more values are better, and one of 5 that no more are.
        ((1.02, 1.0, 0.9995), [4, 6, 9], 6),
        ((3.0, 2.0, 1.0), [4, 6, 9], 9),
        # More values do not predict better: the next function, of other variables, is tried.
        ((3.0, 3.5, 1.0, 1.0), [4, 6, 40, 60], 40),
        ((3.0, 2.0, 2.5, 5.0, 6.0), [4, 6, 9, 40, 60], 40),
        ((None, 1.0, None), [4, 40, 60], 40),
    ],
)
def test_a_smooth_function_goes_through_more_values_as_long_as_it_is_better(misfits, fitted, last, monkeypatch) -> None:
    """Of two functions proposed; of a third nothing is asked."""
    laws = [proposed((name,), 0.9)._replace(score=score) for name, score in (("x", 4), ("y", 40), ("time", 400))]
    finer = {"x": (6, 9), "y": (60, 90), "time": ()}
    monkeypatch.setattr(
        exact_laws, "finer", lambda windows, law: [law._replace(score=s) for s in finer[law.family.variables[0]]]
    )
    fit, tried = fits_that_leave(misfits)

    trials = exact_laws.smooth_trials(cast(Any, None), laws, fit)
    assert tried == fitted and trials[-1].laws[0].score == last


@pytest.mark.parametrize(
    ("misfits", "fitted", "kept"),
    [
        ((1.0,), [1], 1),  # only noise is left
        ((1.2, 1.0), [1, 2], 2),
        ((1.2, 1.1, 1.0), [1, 2, 4], 4),
        # A chi^2 of 5 is not nearer.
        ((1.2, 1.1995), [1, 2], 1),
        ((1.2, None), [1, 2], 1),
        ((None,), [1], None),
    ],
)
def test_a_law_is_fitted_from_larger_widths_where_it_leaves_more_than_noise(misfits, fitted, kept, monkeypatch) -> None:
    monkeypatch.setattr(exact_laws, "wider", lambda windows, law: [law._replace(score=s) for s in (2, 4)])
    fit, tried = fits_that_leave(misfits)

    best = exact_laws._fitted_from_widths(cast(Any, None), proposed(("x",), 0.9)._replace(score=1), fit)
    assert tried == fitted and (None if best is None else best.laws[0].score) == kept
