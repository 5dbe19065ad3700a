"""Checks of a model that leaves only noise: the bands of each run, and runs that differ from the others."""

import numpy as np

from snakejax.core.parameter import parameters
from snakejax.estimation.fitted_model import FittedModel

from .explanation import RunBand, run_bands
from .odd_runs import OddRun, odd_runs, run_grams
from .selection.candidates import CandidateFit, CandidateSet
from .selection.score_test import projected
from .selection.screening import window_sensitivities


def bands_of(fitted: FittedModel) -> tuple[RunBand, ...]:
    """The share of each run inside the bands of 95%, which are those of the noise alone."""
    sd = np.asarray(fitted.noise.channels)
    residuals = [residual * sd for residual in fitted.residuals]
    return run_bands(fitted.recordings, residuals, [np.broadcast_to(sd, residual.shape) for residual in residuals])


def odd_runs_beside(candidate_set: CandidateSet, step: CandidateFit) -> tuple[OddRun, ...]:
    """The train runs to which the fit `step` does not apply, by the sensitivities of whole runs."""
    values, problem = step.solution.values, candidate_set.problem
    rest = projected(window_sensitivities(candidate_set, values, step.solution.start, windows=False))
    if rest.run is None:
        return ()
    columns = {name: k for k, name in enumerate(problem.names)}
    fitted = [columns[name] for name in candidate_set.free(step.effects) if name not in step.solution.held]
    runs = [problem.runs[k].name for k in candidate_set.train]
    known = parameters(problem.model)
    shifts = odd_runs(run_grams(rest.residual, -rest.columns, rest.run), runs, columns, fitted)
    return tuple(shift.in_units(known[shift.parameter].domain, float(values[shift.parameter])) for shift in shifts)
