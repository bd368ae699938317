"""The covariance that the filters settle at is the solution of the discrete Riccati equation."""

from __future__ import annotations

import celestcore as cc
import numpy as np
import pytest
from scipy.linalg import solve_discrete_are
from simulate import FloatArray, discretise, exp, multiply

DT, EVERY, FIXES = 0.25, 4, 1000
ARW, RRW = 1e-5, 1e-6
NOISE = np.array([[4.0, 1.0, -0.5], [1.0, 9.0, 2.0], [-0.5, 2.0, 25.0]]) * 1e-10


def riccati(rate: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the covariances just before and just after a fix, in steady state."""
    f, q = np.eye(6), np.zeros((6, 6))
    step, noise = discretise(rate, DT, ARW, RRW)
    for _ in range(EVERY):
        f, q = step @ f, step @ q @ step.T + noise
    units = np.repeat([1e-5, 1e-6], 3)  # or the solver would not see the bias
    h = np.hstack([np.eye(3), np.zeros((3, 3))])
    before = solve_discrete_are(
        (f / units[:, None] * units).T,
        (h * units).T,
        q / np.outer(units, units),
        NOISE,
    ) * np.outer(units, units)
    gain = np.linalg.solve(h @ before @ h.T + NOISE, h @ before).T
    left = np.eye(6) - gain @ h
    return before, left @ before @ left.T + gain @ NOISE @ gain.T


@pytest.mark.parametrize("filter", [cc.EKF(), cc.UKF(), cc.SRUKF()], ids=lambda f: f.kind)
@pytest.mark.parametrize("rate", [(0.0, 0.0, 0.0), (0.5, -0.8, 0.7)], ids=["at rest", "turning"])
def test_settles_at_the_riccati_solution(
    filter: cc.EKF | cc.UKF,  # noqa: A002
    rate: tuple[float, float, float],
) -> None:
    """Perfect measurements, so that every innovation is zero; 0.3 rad a step when it turns."""
    w = np.array(rate)
    t = DT * np.arange(FIXES * EVERY + 1)
    start = np.array([0.5, -0.5, 0.1, 0.7])
    q = multiply(start / np.linalg.norm(start), exp(t[:, None] * w))
    log = cc.SensorLog(
        gyro=(t, np.tile(w, (len(t), 1))),
        star=(t[::EVERY], q[::EVERY], np.tile(NOISE, (FIXES + 1, 1, 1))),
    )
    nav = cc.StarGyroNavigator(filter, cc.Gyro(ARW, RRW))
    sol = nav.run(log, q0=q[0], sigma0=(1e-3, 1e-4), covariance=True)
    assert sol.covariance is not None
    before, after = riccati(w)
    sigma = np.sqrt(np.diag(after))
    off = np.abs(sol.covariance[-1] - after) / np.outer(sigma, sigma)
    print(f"{filter.kind}: {off.max():.1e}, innovation {np.nanmax(np.abs(sol.innovation)):.1e}")
    assert off.max() < 1e-6
    predicted = np.sqrt(np.diag(before)[:3] + np.diag(NOISE))
    np.testing.assert_allclose(sol.innovation_sigma[-1], predicted, rtol=1e-6)
