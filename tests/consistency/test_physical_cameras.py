"""Filters on physical star cameras are consistent, with one camera and with two fused.

Trials are independent: the mean over them scatters by its standard error. Bounds are 99.9 % ones of
Student's t, shared among the statements of one test.
"""

from __future__ import annotations

from typing import Any

import celestcore as cc
import numpy as np
import pytest
from celestcore import simulate as sim
from scipy.stats import t as student

TRIALS = 120
SKY = cc.StarCatalogue.random(15_000, seed=5)
GYRO = sim.GyroErrors(1e-6, 1e-7, bias_sigma=1e-6)
START = (1e-4, 1e-6)
EXPECTED = {"nees": 6.0, "nees_attitude": 3.0, "nis": 3.0}


def looking(*boresight: float, **changes: Any) -> cc.CameraModel:
    values: dict[str, Any] = {"sigma": 15 * cc.ARCSEC, "half_angle": 7 * cc.DEG, **changes}
    return cc.CameraModel(SKY, **values, boresight=boresight)


ONE = sim.StarField(looking(0.0, 0.5, -1.0), every=5)
TWO = {
    "star": ONE,
    "star_2": sim.StarField(looking(1.0, 0.3, 0.0, sigma=25 * cc.ARCSEC), period=0.7, offset=0.35),
}
SCENARIOS = {
    "one": sim.Scenario(sim.slews(200.0), GYRO, ONE),
    "two": sim.Scenario(sim.slews(200.0), GYRO, TWO),
}


@pytest.mark.parametrize("name", SCENARIOS)
def test_filters_and_smoother_are_consistent(name: str) -> None:
    scenario = SCENARIOS[name]
    navs = {kind.kind: scenario.navigator(kind) for kind in (cc.EKF(), cc.UKF())}
    found = cc.monte_carlo(
        scenario, navs, TRIALS, 1, start="drawn", sigma0=START, smooth="ekf", skip=10.0
    ).pooled()
    bound = student.ppf(1.0 - 0.5e-3 / len(EXPECTED), TRIALS - 1)
    for kind, pooled in found.items():
        z = {n: (getattr(pooled, n) - x) / pooled.error[n] for n, x in EXPECTED.items()}
        print(name, kind, z, pooled.error["nees"] / 6.0)
        assert max(abs(v) for v in z.values()) < bound, kind
        # sharp enough to mean something
        assert pooled.error["nees"] < 0.04 * 6.0


def test_two_cameras_are_better_where_one_is_weak() -> None:
    rms = [cc.monte_carlo(s, s.navigator(), 40, 2, skip=50.0)["ekf"] for s in SCENARIOS.values()]
    one, two = (r.pooled() for r in rms)
    assert (two.rms < one.rms).all()
    # the roll of each is what the other sees well
    assert two.rms.max() < 0.5 * one.rms.max()


def test_a_camera_that_is_worse_than_it_says_is_found_out() -> None:
    """Centroid noise 1.3 times as large as the covariance of the fixes tells."""
    scenario = SCENARIOS["one"]
    worse = sim.StarField(looking(0.0, 0.5, -1.0, sigma=1.3 * 15 * cc.ARCSEC), every=5)
    log = sim.log(scenario.truth, GYRO, worse, seed=1).log
    star = log.stars["star"]
    assert star.covariance is not None
    nav = scenario.navigator()
    assert np.mean(nav.run(log).nis) < 1.2 * 3.0
    told = cc.SensorLog(gyro=log.gyro, star=(star.t, star.q, star.covariance / 1.69))
    assert np.mean(nav.run(told).nis) > 1.4 * 3.0
