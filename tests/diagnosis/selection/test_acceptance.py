"""The tests that an effect must pass to be added and to stay, against formulas written down independently."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from helpers.linear_problem import LinearProblem, linear_problem
from scipy import stats

from snakejax.diagnosis.selection.acceptance import (
    accept_addition,
    accept_structure,
    chi2_threshold,
    heldout_consistent,
    leave_one_run_out_score,
    wald_significant,
)
from snakejax.diagnosis.selection.candidates import CandidateFit
from snakejax.diagnosis.selection.criteria import CRITERIA
from snakejax.estimation.linearisation import Linearised


def test_the_threshold_is_passed_by_chance_as_often_as_the_level_says():
    """At 1% divided by 25 candidates; for two parameters the tail of chi^2 is exp(-x / 2)."""
    for freed in (1, 3, 5):
        assert stats.chi2.cdf(chi2_threshold(freed), freed) == pytest.approx(1 - 0.01 / 25, abs=1e-12)
    assert chi2_threshold(2) == pytest.approx(-2 * np.log(0.01 / 25))
    assert chi2_threshold(0) == chi2_threshold(1)
    strict = CRITERIA._replace(significance_level=1e-4)
    assert chi2_threshold(2, strict) == pytest.approx(-2 * np.log(1e-4 / 25))


def dense_score(problem: LinearProblem, fitted: CandidateFit) -> float:
    """-2 log density of each run's data, by dense Gaussian densities, less the constant N ln 2 pi."""
    solution = fitted.solution
    X = problem.columns[..., [problem.names.index(name) for name in solution.free]]
    # What the starts explain is taken out by the projector 1 - S S^+.
    out = [np.eye(S.shape[0]) - S @ np.linalg.pinv(S) for S in problem.starts]
    data, X = [P @ y for P, y in zip(out, problem.data, strict=True)], [P @ x for P, x in zip(out, X, strict=True)]
    variance, total = max(solution.misfit, 1.0), 0.0
    for k in range(len(data)):
        others = [j for j in range(len(data)) if j != k]
        J, y = np.concatenate([X[j] for j in others]), np.concatenate([data[j] for j in others])
        values = np.linalg.lstsq(J, y, rcond=None)[0]
        V = variance * (np.eye(len(data[k])) + X[k] @ np.linalg.inv(J.T @ J) @ X[k].T)
        left = data[k] - X[k] @ values
        total += np.linalg.slogdet(V)[1] + left @ np.linalg.solve(V, left)
    return float(total)


@pytest.mark.parametrize("effects", [(), ("a",), ("a", "b", "d")])
def test_the_score_of_runs_left_out_is_that_of_dense_gaussian_densities(effects):
    problem = linear_problem({"D": 3.0, "a": 1.0, "b": 0.5})
    fitted = problem.fit(effects)
    assert leave_one_run_out_score(problem.candidate_set, fitted) == pytest.approx(dense_score(problem, fitted))


def test_a_true_effect_is_accepted_and_a_chance_one_is_not():
    truly = linear_problem({"D": 3.0, "a": 0.5})
    base, chance, true = truly.fit(()), truly.fit(("d",)), truly.fit(("a",))
    assert accept_addition(truly.candidate_set, base, true)
    assert not accept_addition(truly.candidate_set, base, chance)
    assert not accept_addition(truly.candidate_set, true, truly.fit(("a", "d")))


def test_an_effect_that_contradicts_itself_between_runs_is_not_accepted():
    """It lowers chi^2 by far more than chance, with one value in the first run alone: the others do not predict it."""
    problem = linear_problem({"D": 3.0}, runs=3)
    data = problem.data.copy()
    data[0] += 2.0 * problem.columns[0, :, 1]
    problem = problem._replace(data=data)
    base, then = problem.fit(()), problem.fit(("a",))
    fall = base.solution.samples * (base.solution.misfit - then.solution.misfit) / then.solution.misfit
    assert fall > chi2_threshold(1)
    assert not accept_addition(problem.candidate_set, base, then)
    alone: Any = SimpleNamespace(**{**vars(problem.candidate_set), "train": [0]})
    assert accept_addition(alone, base, then), "with one train run the fall of chi^2 is all there is"


def with_misfit(fitted: CandidateFit, misfit: float, samples: int = 10_000) -> CandidateFit:
    return fitted._replace(solution=fitted.solution._replace(misfit=misfit, samples=samples))


def test_an_effect_must_bring_a_share_of_the_excess_unless_it_reaches_the_noise():
    problem = linear_problem({"D": 3.0})
    one_run: Any = SimpleNamespace(**{**vars(problem.candidate_set), "train": [0]})
    base, then = with_misfit(problem.fit(()), 11.0), problem.fit(("a",))
    assert not accept_addition(one_run, base, with_misfit(then, 10.51))  # 4.9% of the excess of 10
    assert accept_addition(one_run, base, with_misfit(then, 10.49))
    assert not accept_addition(one_run, base, with_misfit(then, float("nan")))


def test_a_change_of_structure_must_lower_chi2_by_more_than_chance():
    fitted = linear_problem({"D": 3.0}).fit(())
    fall = chi2_threshold(1) / 10_000
    assert accept_structure(with_misfit(fitted, 2.0), with_misfit(fitted, 2.0 - 1.01 * fall))
    assert not accept_structure(with_misfit(fitted, 2.0), with_misfit(fitted, 2.0 - 0.99 * fall))


def test_a_wald_statistic_of_a_thousand_makes_a_refit_without_the_effect_needless():
    problem = linear_problem({"D": 3.0, "a": 1.0, "b": 1.0})
    fitted, known = problem.fit(("a", "b")), problem.candidate_set
    variance = fitted.solution.covariance[1, 1]
    for wald, sure in ((999.0, False), (1001.0, True)):
        values = fitted.solution.values | {"effects.a.p": -np.sqrt(wald * variance)}
        assert wald_significant(known, fitted._replace(solution=fitted.solution._replace(values=values)), "a") is sure
    far = fitted._replace(solution=fitted.solution._replace(values=values, misfit=9.0))
    assert not wald_significant(known, far, "a"), "errors far from the noise say nothing"
    held = fitted._replace(solution=fitted.solution._replace(values=values, held=("effects.a.p",)))
    assert not wald_significant(known, held, "a"), "a parameter on its bound has no error"


def test_a_held_out_misfit_may_exceed_noise_by_what_the_parameters_leave_open():
    """The expected rise is trace(J cov J^T) with the columns of the held-out run."""
    problem = linear_problem({"D": 3.0, "a": 1.0}, runs=4)
    train = problem._replace(data=problem.data[:3], columns=problem.columns[:3] / 20, starts=problem.starts[:3]).fit(
        ("a",)
    )
    J = problem.columns[3, :, :2]
    solution = train.solution
    start = np.zeros((4, 2))
    left_over = solution.samples - 2 - start.size
    rise = float(np.trace(J @ solution.covariance @ J.T)) * max(1.0, solution.misfit * solution.samples / left_over)
    jacobian = np.zeros((4, 40, 3, 7))
    jacobian[3, ..., :2] = -J.reshape(40, 3, 2)
    n = 120
    allowed = 1 + 4 * np.sqrt(2 / n) + 4 * rise / n
    refits = []

    def refit(values, free, runs, start):
        refits.append(list(runs))
        return solution._replace(misfit=2.0)

    fakes: dict[str, Any] = {
        "run_indices": lambda role: [3],
        "at": lambda *_: None,
        "evaluate": lambda *_: Linearised(np.zeros((4, 40, 3)), jacobian),
        "fit": refit,
    }
    known: Any = SimpleNamespace(problem=SimpleNamespace(**fakes), free=problem.free, train=[0, 1, 2])
    judged = train._replace(solution=solution._replace(start=start))
    seen = solution._replace(samples=n, start=start)
    assert heldout_consistent(known, judged, None)
    assert heldout_consistent(known, judged, seen._replace(misfit=allowed - 1e-6)) and not refits
    assert not heldout_consistent(known, judged, seen._replace(misfit=allowed + 1e-6))
    assert refits == [[0, 1, 2, 3]], "beyond that, one set of parameters is fitted to all runs"
