"""The jackknife over runs, against fits that leave each run out and against the scatter of many draws."""

import numpy as np

from snakejax.estimation.jackknife import left_out_sd


def test_errors_that_last_a_run_are_in_the_standard_error():
    """Where every run has a push of its own, estimates scatter as the jackknife says, not as single samples would."""
    draw, run = np.random.default_rng(0), np.repeat(np.arange(6), 200)
    columns = draw.normal(size=(1200, 2)) + 1.0
    found, told = [], []
    for _ in range(400):
        residual = draw.normal(size=1200) + draw.normal(size=6)[run]
        change = np.linalg.lstsq(columns, residual, rcond=None)[0]
        found.append(change)
        told.append(left_out_sd(columns, residual - columns @ change, run))
    scatter, white = np.std(found, axis=0), np.sqrt(2 * np.diag(np.linalg.inv(columns.T @ columns)))
    assert (scatter > 3 * white).all()
    typical = np.sqrt(np.mean(np.square(told), axis=0))
    assert (typical > 0.9 * scatter).all() and (typical < 1.6 * scatter).all()


def test_the_jackknife_is_that_of_fits_without_each_run():
    draw, run = np.random.default_rng(1), np.repeat(np.arange(5), 40)
    columns, residual = draw.normal(size=(200, 3)), draw.normal(size=200)
    whole = np.linalg.lstsq(columns, residual, rcond=None)[0]
    left = [np.linalg.lstsq(columns[run != k], residual[run != k], rcond=None)[0] - whole for k in range(5)]
    sd = np.sqrt(0.8 * np.square(left).sum(axis=0))
    np.testing.assert_allclose(left_out_sd(columns, residual - columns @ whole, run), sd, rtol=1e-9)
    assert (left_out_sd(columns, residual, np.zeros(200, int)) == 0).all()
