"""Standard errors of a fit to windows of a car that wanders hold the truth."""

import numpy as np
import pytest
from helpers.wandering_car import CONSTANTS, windows

from snakejax.core.parameter import parameters
from snakejax.dynamics.model import Model, no_traction
from snakejax.estimation import fit
from snakejax.recording.run import Noise
from snakejax.vehicles.car import DART, Car

NOISE = Noise(np.asarray(1e-3), np.asarray(3e-3), "stated")
"""What the car does not repeat is several times larger."""


HOLDS = 1.5
"""Of 16 errors the root mean square in standard errors is below this in 99.7% where these hold."""


@pytest.mark.long
def test_standard_errors_hold_where_a_car_wanders() -> None:
    truth = Model(Car(**DART, **CONSTANTS, creep_speed=0.1, unknown=tuple(CONSTANTS)), no_traction(), "ideal")
    names = [f"board.{name}" for name in CONSTANTS]
    true = np.array([float(parameters(truth)[name].value) for name in names])
    off, white = [], []
    for seed in range(4):
        found = fit(truth, windows(truth, recordings=6, heldout=0, seed=seed).runs, NOISE, names)
        assert found.train_score.misfit > 3
        estimates = [found.estimates[name] for name in names]
        away = np.array([e.value for e in estimates]) - true
        off.append(away / np.array([e.sd for e in estimates]))
        # What the standard errors would be if every sample differed by itself.
        plain = np.sqrt(np.diag(found.fitted.covariance)) * found.fitted.spread
        relative = plain[[found.fitted.loose.index(name) for name in names]]
        white.append(away / (relative * np.abs(true)))
    assert 0.5 < np.sqrt(np.mean(np.square(off))) < HOLDS
    assert np.sqrt(np.mean(np.square(white))) > HOLDS
