"""NEES, NIS and whiteness: against scipy, against known laws, and what must fail does."""

from __future__ import annotations

from collections.abc import Callable

import celestcore as cc
import numpy as np
import pytest
from celestcore.analysis import consistency, nees, nis, whiteness
from celestcore.errors import InputError
from celestcore.solution import Solution
from scipy.stats import chi2, kstest, norm

MakeSolution = Callable[..., Solution]


def test_nees_is_the_squared_mahalanobis_distance() -> None:
    rng = np.random.default_rng(1)
    e = rng.standard_normal((4, 7, 6)) * np.repeat([1e-5, 1e-9], 3)
    root = rng.standard_normal((7, 6, 6)) * np.repeat([1e-5, 1e-9], 3)[:, None]
    p = root @ root.swapaxes(-1, -2)
    found = nees(e, p)
    assert found.shape == (4, 7)
    white = np.linalg.solve(root, e[..., None])[..., 0]
    np.testing.assert_allclose(found, np.sum(white**2, axis=-1), rtol=1e-6)


def test_nees_of_normal_errors_is_chi_square() -> None:
    rng = np.random.default_rng(2)
    root = rng.standard_normal((3, 3))
    values = nees(rng.standard_normal((20_000, 3)) @ root.T, root @ root.T)
    assert kstest(values, chi2(3).cdf).pvalue > 1e-3


@pytest.mark.parametrize(
    ("error", "covariance", "words"),
    [
        ([1.0, 2.0], np.eye(3), "needed is"),
        (np.ones((4, 2)), np.ones((3, 1, 1)) * np.eye(2), "leading axes"),
        ([np.nan, 0.0], np.eye(2), "error: must be finite"),
        ([0.0, 0.0], [[1.0, 2.0], [2.0, 1.0]], "positive definite"),
        ([0.0, 0.0], [[1.0, 0.0], [0.0, 0.0]], "positive definite"),
        ([0.0, 0.0], [[1.0, np.inf], [0.0, 1.0]], "finite"),
    ],
)
def test_bad_errors_are_named(error: object, covariance: object, words: str) -> None:
    with pytest.raises(InputError, match=words):
        nees(error, covariance)  # type: ignore[arg-type]


def test_the_first_bad_covariance_is_named() -> None:
    p = np.tile(np.eye(2), (5, 1, 1))
    p[3, 0, 1] = p[3, 1, 0] = 1.5
    with pytest.raises(InputError) as caught:
        nees(np.ones((5, 2)), p)
    assert caught.value.row == 3


def test_bounds_are_scipys() -> None:
    values = np.random.default_rng(3).chisquare(3, (40, 100))
    result = consistency(values, 3, 0.9)
    low, high = chi2.ppf([0.05, 0.95], 3 * 4000) / (3 * 4000)
    assert result.bounds == pytest.approx((low, high), rel=1e-9)
    low, high = chi2.ppf([0.05, 0.95], 3 * 40) / (3 * 40)
    np.testing.assert_allclose(result.epoch_bounds, np.tile([low, high], (100, 1)), rtol=1e-9)
    assert result.mean == pytest.approx(values.mean() / 3)
    tail = chi2.cdf(values.sum(), 12_000)
    assert result.p_value == pytest.approx(2 * min(tail, 1 - tail), rel=1e-6)
    np.testing.assert_allclose(result.run, values.mean(axis=1) / 3)
    np.testing.assert_allclose(result.epoch, values.mean(axis=0) / 3)


def test_a_consistent_filter_passes_as_often_as_promised() -> None:
    rng = np.random.default_rng(4)
    results = [consistency(rng.chisquare(3, (5, 60)), 3) for _ in range(400)]
    passed = sum(r.consistent for r in results)
    assert norm.cdf((passed - 380) / np.sqrt(400 * 0.95 * 0.05)) > 1e-3
    assert passed < 400
    assert np.mean([r.inside for r in results]) == pytest.approx(0.95, abs=0.006)
    assert kstest([r.p_value for r in results], "uniform").pvalue > 1e-3
    spread = np.std([r.mean for r in results])
    assert np.mean([r.standard_error for r in results]) == pytest.approx(spread, rel=0.15)


def test_an_overconfident_filter_fails() -> None:
    values = 1.1 * np.random.default_rng(5).chisquare(6, (50, 100))
    result = consistency(values, 6)
    assert not result.consistent
    assert result.p_value < 1e-6
    assert result.mean == pytest.approx(1.1, abs=4 * result.standard_error)
    assert "bounds" in str(result)


def test_one_run_has_no_scatter() -> None:
    assert np.isnan(consistency([3.0, 2.0, 4.0], 3).standard_error)


def test_nis_of_a_solution(make_solution: MakeSolution) -> None:
    sol = make_solution(6001, sensors=3)
    assert len(nis(sol)) == sol.accepted.sum()
    used = sol.accepted & (sol.sensor == 2)
    np.testing.assert_array_equal(nis(sol, "vector_sun"), sol.nis[used])
    result = consistency(sol)
    assert result.consistent
    assert set(np.unique(result.epoch_bounds[:, 1]).round(3)) == {
        round(chi2.ppf(0.975, k) / k, 3) for k in (2, 3)
    }
    assert consistency(sol, sensor="star").mean == pytest.approx(nis(sol, "star").mean() / 3)
    with pytest.raises(InputError, match="star_1"):
        nis(sol, "star_9")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (([], 3), "not empty"),
        (([-1.0], 3), "negative"),
        (([np.nan], 3), "finite"),
        (([1.0, 2.0],), "dof"),
        (([1.0, 2.0], [3, 3, 3]), "dof"),
        (([1.0, 2.0], 0), "dof"),
        (([1.0, 2.0], 3, 1.0), "probability"),
    ],
)
def test_bad_values_are_named(arguments: tuple[object, ...], words: str) -> None:
    with pytest.raises(InputError, match=words):
        consistency(*arguments)  # type: ignore[arg-type]


def test_arguments_that_do_not_go_together(solution: Solution) -> None:
    with pytest.raises(InputError, match="dof"):
        consistency(solution, 3)
    for function in (consistency, whiteness):
        with pytest.raises(InputError, match="sensor"):
            function(np.ones(50), sensor="star")


def test_white_noise_passes_as_often_as_promised() -> None:
    rng = np.random.default_rng(6)
    results = [whiteness(rng.standard_normal((2000, 3)), lags=15) for _ in range(300)]
    p_values = np.array([r.p_value for r in results])
    assert kstest(p_values.ravel(), "uniform").pvalue > 1e-3
    assert np.mean([r.inside for r in results]) == pytest.approx(0.95, abs=0.006)
    assert kstest(np.array([r.mean for r in results]).ravel(), "norm").pvalue > 1e-3
    assert sum(r.white for r in results) > 270


def test_correlated_noise_fails_and_says_how_much() -> None:
    rng = np.random.default_rng(7)
    z = rng.standard_normal((20_000, 2))
    z[1:, 1] += 0.3 * z[:-1, 1]
    result = whiteness(z, lags=5)
    assert not result.white
    assert result.p_value[0] > 1e-3
    assert result.p_value[1] < 1e-12
    assert result.autocorrelation[0, 1] == pytest.approx(0.3 / 1.09, abs=0.03)
    assert "not white" in str(result)


def test_ljung_box_by_hand() -> None:
    z = np.array([1.0, -2.0, 0.5, 1.5, -1.0])
    r1 = (-2.0 - 1.0 + 0.75 - 1.5) / np.sum(z**2)
    result = whiteness(z, lags=1)
    assert result.autocorrelation[0, 0] == pytest.approx(r1)
    assert result.ljung_box[0] == pytest.approx(5 * 7 * r1**2 / 4)
    assert result.p_value[0] == pytest.approx(chi2.sf(5 * 7 * r1**2 / 4, 1))
    assert result.bound == pytest.approx(norm.ppf(0.975) / np.sqrt(5))


def run(arw: float) -> Solution:
    """Return a run with right noise but for the gyro's, tuned to `arw` where 1e-5 is true."""
    rng = np.random.default_rng(8)
    n, dt = 6001, 0.5
    drift = np.cumsum(1e-5 * np.sqrt(dt) * rng.standard_normal((n, 3)), axis=0)
    rate = np.diff(drift, axis=0, append=drift[-1:]) / dt
    t = dt * np.arange(n)
    fixes = cc.quaternion.exp(2e-5 * rng.standard_normal((n, 3)))
    log = cc.SensorLog(gyro=(t, rate), star=(t, fixes))
    # the truth stands still: the reading is noise alone, so the drift is the gyro's error
    return cc.StarGyroNavigator(cc.EKF(), cc.Gyro(arw, 1e-9), cc.StarCamera(2e-5)).run(log)


def test_a_filter_with_the_right_noise_is_white_and_another_is_not() -> None:
    right, stiff = run(1e-5), run(2e-6)
    assert whiteness(right).white
    assert consistency(right).consistent
    assert not whiteness(stiff).white
    assert consistency(stiff).mean > consistency(stiff).bounds[1]


def test_whiteness_needs_one_sensor_and_enough(make_solution: MakeSolution) -> None:
    sol = make_solution(2001, sensors=3)
    with pytest.raises(InputError, match="say which"):
        whiteness(sol)
    assert whiteness(sol, sensor="vector_sun").p_value.shape == (2,)
    assert whiteness(sol, sensor="star").p_value.shape == (3,)
    with pytest.raises(InputError, match="more than 20"):
        whiteness(np.ones(20))
    with pytest.raises(InputError, match="zero"):
        whiteness(np.zeros(30))
    with pytest.raises(InputError) as caught:
        whiteness(np.where(np.arange(30) == 7, np.nan, 1.0))
    assert caught.value.row == 7
