"""What works on from a fit needs beside its result: the compiled problem, and its optima with their derivatives."""

from typing import NamedTuple

import numpy as np

from .fit_record import Fit
from .fitted_model import FittedModel, fitted_model
from .goodness_of_fit import run_scores
from .initialisation import with_true_errors
from .problem import Problem, Solution
from .uncertainty import correlation, estimates_of, identifiable_combinations, warnings_about


class FitWorkspace(NamedTuple):
    """A fitted `problem`: its `solution`, and `heldout`, that of the starts of held-out runs (None where none is).

    It stays inside a computation; what is handed out is its `result`.
    """

    problem: Problem
    solution: Solution
    heldout: Solution | None

    @property
    def fitted(self) -> FittedModel:
        """The fitted model in all its runs."""
        return fitted_model(self.problem.fitted(self.solution), self.problem, self.solution, self.heldout)

    def result(self) -> Fit:
        """Statistics, scores of the train runs and of the held-out runs."""
        problem, solution, heldout = self
        estimates = estimates_of(problem, solution)
        combinations = identifiable_combinations(problem, solution, estimates)
        return Fit(
            fitted=self.fitted,
            estimates=estimates,
            correlation=correlation(solution),
            combinations=combinations,
            runs=run_scores(problem, solution, problem.run_indices("train")),
            heldout=() if heldout is None else run_scores(problem, heldout, problem.run_indices("heldout")),
            converged=solution.converged,
            advice=tuple(warnings_about(solution, estimates, combinations)),
            rough=solution.rough,
        )


def fit_workspace(problem: Problem, solution: Solution) -> FitWorkspace:
    """The workspace of `solution`: its true standard errors, and the starts of the held-out runs."""
    solution = with_true_errors(problem, solution, problem.run_indices("train"))
    return FitWorkspace(problem, solution, fit_heldout_starts(problem, solution.values))


def fit_heldout_starts(problem: Problem, values: dict[str, float], role: str = "heldout") -> Solution | None:
    """Fit of the start states alone of the runs of `role`, under fixed `values`; None if there is no such run."""
    runs = problem.run_indices(role)
    return problem.fit(values, (), runs) if runs else None


def problem_of(fit: Fit) -> tuple[Problem, Solution]:
    """The problem and the optimum of a fit made again: one evaluation at its values, nothing is fitted."""
    fitted, free = fit.fitted, tuple(fit.estimates)
    problem = Problem.of(
        fitted.model, fitted.recordings, fitted.noise, free, max(len(free), 1), fitted.accuracy, fitted.threshold
    )
    train, values = problem.run_indices("train"), {name: e.value for name, e in fit.estimates.items()}
    linearised = problem.evaluate(problem.at(values, free, fitted.starts), train)
    samples = problem.samples(train)
    misfit = float((np.asarray(linearised.residual)[train] ** 2).sum() / max(samples, 1))
    held = tuple(name for name, estimate in fit.estimates.items() if estimate.at_bound)
    return problem, Solution(
        values,
        free,
        held,
        np.array(fitted.starts),
        linearised,
        fitted.covariance,
        misfit,
        samples,
        0,
        fit.converged,
        fit.rough,
        fitted.threshold,
    )
