"""Scenarios under the stars: what is measured, from what is true."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import celestcore as cc
import numpy as np
import pytest
from celestcore import frames, orbit
from celestcore.celestial import Scenario, SkyCamera
from scipy import stats

SKY = cc.StarCatalogue.random(4559, seed=3)
T = np.arange(0.0, 3600.0, 5.0)
EPOCH = "2007-07-01T12:00:00"
ORBIT = orbit.propagate(orbit.ForceModel.j2(), EPOCH, [7.1e6, 0, 0], [0, 3.2e3, 6.76e3], T)
CAMERA = SkyCamera(SKY)
A = cc.StarHorizon(correlated=False)
SCENARIO = Scenario(ORBIT, CAMERA, A, period=15.0)
SIGMA = float(np.hypot(3.0 * cc.ARCSEC, 0.02 * cc.DEG))


def exact(scenario: Scenario) -> Any:
    """True angles, by the cosine: nobody looks at the zenith itself."""
    r = scenario.truth.r[scenario.stars.epoch]
    cosine = -(r * scenario.stars.star).sum(axis=1) / np.linalg.norm(r, axis=1)
    return np.arccos(np.clip(cosine, -1.0, 1.0))


def errors(scenario: Scenario, seed: int = 0, trial: int = 0) -> Any:
    table = scenario.log(seed, trial).horizon
    assert table is not None
    return table.angle - exact(scenario)


def test_epochs_are_states_of_the_orbit() -> None:
    np.testing.assert_array_equal(SCENARIO.truth.t, T[::3])
    np.testing.assert_array_equal(SCENARIO.truth.r, ORBIT.r[::3])
    log = SCENARIO.log(1)
    assert log.epoch == EPOCH
    assert log.horizon is not None
    np.testing.assert_array_equal(log.horizon.t, SCENARIO.stars.t)
    np.testing.assert_array_equal(log.horizon.star, SCENARIO.stars.star)
    # rounding of a step that has no exact binary number is no gap
    tenths = orbit.propagate(
        orbit.ForceModel.j2(), None, ORBIT.r[0], ORBIT.v[0], np.linspace(0.0, 60.0, 601)
    )
    assert len(Scenario(tenths, CAMERA, A, period=0.3).truth) == 201


def test_independent_errors_are_normal_and_as_large_as_asked() -> None:
    x = np.concatenate([errors(SCENARIO, 5, k) for k in range(30)]) / SIGMA
    assert stats.kstest(x, "norm").pvalue > 1e-3
    assert abs(np.corrcoef(x[:-1], x[1:])[0, 1]) < 5.0 / np.sqrt(len(x))


@pytest.mark.parametrize("name", ["student_t", "uniform"])
def test_other_distributions(name: str) -> None:
    horizon = cc.StarHorizon(correlated=False, distribution=name, dof=3.0)
    scenario = replace(SCENARIO, horizon=horizon)
    x = np.concatenate([errors(scenario, 5, k) for k in range(30)]) / SIGMA
    law = stats.t(3.0, scale=1.0 / np.sqrt(3.0))
    if name == "uniform":
        law = stats.uniform(-np.sqrt(3.0), 2.0 * np.sqrt(3.0))
    assert stats.kstest(x, law.cdf).pvalue > 1e-3


def test_correlated_errors_have_the_covariance_that_filters_assume() -> None:
    """NIS of all angles of an epoch, with R = own^2 I + shared^2 E E^T."""
    horizon = cc.StarHorizon()
    scenario = replace(SCENARIO, horizon=horizon)
    seen, nis, dof = scenario.stars, 0.0, 0
    left = np.stack([errors(scenario, 7, k) for k in range(40)])
    for k in range(0, len(scenario.truth), 5):
        at = seen.epoch == k
        s = seen.star[at]
        n = -scenario.truth.r[k] / np.linalg.norm(scenario.truth.r[k])
        e = s - (s @ n)[:, None] * n
        e /= np.linalg.norm(e, axis=1)[:, None]
        cov = horizon.own**2 * np.eye(len(s)) + horizon.shared**2 * e @ e.T
        x = left[:, at]
        # a star within a degree of the zenith bends the angle: leave such epochs out
        if (exact(scenario)[at] > np.pi - 0.01).any():
            continue
        nis += float(np.einsum("ki,ij,kj->", x, np.linalg.inv(cov), x))
        dof += x.size
    assert dof > 5000
    assert abs(nis / dof - 1.0) < 5.0 * np.sqrt(2.0 / dof)


def test_same_seed_and_trial_same_bits_whatever_else() -> None:
    assert np.array_equal(errors(SCENARIO, 3, 8), errors(SCENARIO, 3, 8))
    for seed, trial in ((3, 9), (4, 8)):
        assert not np.array_equal(errors(SCENARIO, 3, 8), errors(SCENARIO, seed, trial))
    wrong = replace(SCENARIO, outliers=(0.05, 50.0))
    by = errors(wrong, 3, 8) - errors(SCENARIO, 3, 8)
    hit = np.abs(by) > 1e-9
    assert 0.02 < hit.mean() < 0.08
    np.testing.assert_allclose(np.abs(by[hit]), 50.0 * SIGMA, rtol=1e-9)
    for one, other in zip(SCENARIO.start(3, 8), wrong.start(3, 8), strict=True):
        np.testing.assert_array_equal(one, other)


def test_the_start_has_the_error_that_is_asked_for() -> None:
    scenario = replace(SCENARIO, start_sigma=((1e3, 2e3, 3e3), 0.5))
    sigma = np.array([1e3, 2e3, 3e3, 0.5, 0.5, 0.5])
    x = np.stack([np.concatenate(scenario.start(2, k)) for k in range(400)])
    x = (x - scenario.truth.state[0]) / sigma
    assert stats.kstest(x.ravel(), "norm").pvalue > 1e-3
    assert np.abs(np.corrcoef(x.T) - np.eye(6)).max() < 5.0 / 20.0


@pytest.mark.parametrize("kind", ["annual", "annual+orbital"])
def test_aberration_moves_stars_by_the_observers_velocity(kind: str) -> None:
    moved = replace(SCENARIO, aberration=kind)
    by = errors(moved, 1) - errors(SCENARIO, 1)
    v = frames.earth_velocity(EPOCH, SCENARIO.truth.t)
    v = v + SCENARIO.truth.v if kind == "annual+orbital" else v
    epoch, s = SCENARIO.stars.epoch, SCENARIO.stars.star
    n = -SCENARIO.truth.r[epoch] / np.linalg.norm(SCENARIO.truth.r[epoch], axis=1)[:, None]
    beta = v[epoch] / 299792458.0
    across = beta - (beta * s).sum(axis=1)[:, None] * s
    sine = np.linalg.norm(np.cross(s, n), axis=1)
    wanted = -(across * n).sum(axis=1) / sine
    # to first order in the velocity, away from the zenith, where angles bend
    far = sine > 0.02
    np.testing.assert_allclose(by[far], wanted[far], atol=1e-8 / 0.02)
    assert 3.0 * cc.ARCSEC < np.abs(by).max() < 26.0 * cc.ARCSEC
    # a log that knows it has other directions, and the same angles
    told = replace(moved, corrected=kind)
    assert np.array_equal(errors(told, 1), errors(moved, 1))
    log = told.log(1).horizon
    assert log is not None
    shift = np.linalg.norm(log.star - s, axis=1)
    np.testing.assert_allclose(shift, np.linalg.norm(across, axis=1), atol=1e-8)


def test_an_epoch_without_stars_has_no_angle() -> None:
    few = SkyCamera(cc.StarCatalogue(SKY.directions[:300], SKY.magnitude[:300]))
    scenario = Scenario(ORBIT, few, A, period=15.0)
    empty = scenario.stars.counts == 0
    assert 0 < empty.sum() < len(empty)
    log = scenario.log(1).horizon
    assert log is not None
    np.testing.assert_array_equal(log.epochs, scenario.truth.t[~empty])


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"period": 0.0}, "period"),
        ({"period": 7.0}, "orbit.t"),
        ({"period": 1e5}, "orbit.t"),
        ({"orbit": ORBIT[::-1]}, "orbit.t"),
        ({"orbit": "orbit"}, "orbit"),
        ({"cameras": []}, "cameras"),
        ({"cameras": [1]}, "cameras"),
        ({"horizon": 1}, "horizon"),
        ({"start_sigma": (1.0,)}, "start_sigma"),
        ({"start_sigma": (1.0, -1.0)}, "start_sigma"),
        ({"outliers": (1.5, 3.0)}, "outliers"),
        ({"outliers": (0.5, -3.0)}, "outliers"),
        ({"aberration": "orbital"}, "aberration"),
        ({"aberration": "annual", "orbit": replace(ORBIT, epoch=None)}, "orbit.epoch"),
    ],
)
def test_scenarios_that_cannot_be(change: dict[str, Any], field: str) -> None:
    with pytest.raises(cc.InputError) as caught:
        replace(SCENARIO, **change)
    assert caught.value.field == field


@pytest.mark.parametrize("bad", [{"seed": -1}, {"seed": 1.5}, {"trial": 2**56}])
def test_seeds_that_cannot_be(bad: dict[str, Any]) -> None:
    with pytest.raises(cc.InputError) as caught:
        SCENARIO.log(**bad)
    assert caught.value.field == next(iter(bad))
