"""Filters that never stop: no drift of the quaternion's length, no decay of the covariance."""

from __future__ import annotations

from time import perf_counter

import celestcore as cc
import numpy as np
import pytest
from simulate import exp, multiply

CHUNK, DT, FIX = 2_000_000, 0.1, 10
ARW, RRW, SIGMA = 1e-5, 1e-8, 3e-5
FILTERS = [cc.EKF(), cc.UKF(), cc.SRUKF()]


class Spacecraft:
    """Turns at orbit rate and wobbles; goes on where the last chunk ended."""

    def __init__(self, seed: int) -> None:
        self.rng = np.random.default_rng(seed)
        self.done = 0
        self.q = np.array([0.5, 0.5, -0.5, 0.5])
        self.bias = np.array([1e-5, -2e-5, 3e-5])

    def chunk(self, steps: int) -> cc.SensorLog:
        """Return the next steps; a fix in the middle of each ten."""
        t = DT * np.arange(self.done, self.done + steps + 1)
        wobble = np.stack([np.sin(0.01 * t), np.cos(0.013 * t), np.sin(0.007 * t + 1.0)], axis=1)
        rate = np.array([0.0, -1.1e-3, 0.0]) + 2e-2 * wobble
        q = cc.quaternion.propagate(self.q, rate[:-1], DT)
        white = self.rng.standard_normal((2, steps + 1, 3))
        bias = self.bias + np.cumsum(RRW * np.sqrt(DT) * white[0], axis=0)
        fixes = slice(FIX // 2, None, FIX)
        seen = multiply(q[fixes], exp(SIGMA * self.rng.standard_normal(q[fixes, 1:].shape)))
        log = cc.SensorLog(
            gyro=(t, rate + bias + ARW / np.sqrt(DT) * white[1]), star=(t[fixes], seen)
        )
        self.done, self.q, self.bias = self.done + steps, q[-1], bias[-1]
        return log


def check(sol: cc.Solution) -> float:
    """Check every row; return the smallest eigenvalue, of correlations, so units do not matter."""
    assert sol.covariance is not None
    assert np.abs(np.sqrt(np.sum(sol.q**2, axis=1)) - 1.0).max() < 1e-12
    np.testing.assert_array_equal(sol.covariance, sol.covariance.swapaxes(1, 2))
    sigma = np.sqrt(np.diagonal(sol.covariance, axis1=1, axis2=2))
    smallest = np.linalg.eigvalsh(sol.covariance / (sigma[:, :, None] * sigma[:, None, :]))[:, 0]
    assert smallest.min() > 0.0
    return float(smallest.min())


def fly(filter: cc.EKF | cc.UKF, chunks: int, every: int) -> None:  # noqa: A002
    craft = Spacecraft(seed=7)
    nav = cc.StarGyroNavigator(filter, cc.Gyro(ARW, RRW), cc.StarCamera(SIGMA))
    covariance = np.diag(np.repeat([1e-4, 1e-5], 3) ** 2)
    q, bias = craft.q, np.zeros(3)
    begin, core, smallest = perf_counter(), 0.0, 1.0
    for _ in range(chunks):
        sol = nav.run(
            craft.chunk(CHUNK),
            q0=q,
            bias0=bias,
            covariance0=covariance,
            every=every,
            covariance=True,
        )
        smallest = min(smallest, check(sol))
        q, bias, covariance = (sol.final[k] for k in ("q", "bias", "covariance"))
        core += sol.elapsed_s
    print(
        f"{filter.kind}: {chunks * CHUNK:.3g} steps, {perf_counter() - begin:.0f} s, "
        f"of it core {core:.0f} s, "
        f"smallest eigenvalue {smallest:.3g}, | |q| - 1 | {abs(np.linalg.norm(q) - 1.0):.1g}"
    )
    # still on the truth, within six sigmas
    missed = cc.quaternion.angle_between(q, craft.q) / np.linalg.norm(sol.final["sigma"][:3])
    assert missed < 6.0
    assert np.all(np.abs(bias - craft.bias) < 6.0 * sol.final["sigma"][3:])


@pytest.mark.parametrize("filter", FILTERS, ids=lambda f: f.kind)
def test_two_million_steps(filter: cc.EKF | cc.UKF) -> None:  # noqa: A002
    fly(filter, chunks=1, every=20)


@pytest.mark.long
@pytest.mark.parametrize("filter", FILTERS, ids=lambda f: f.kind)
def test_hundred_million_steps(filter: cc.EKF | cc.UKF) -> None:  # noqa: A002
    fly(filter, chunks=50, every=100)


@pytest.mark.long
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("filter", FILTERS, ids=lambda f: f.kind)
def test_a_billion_steps(filter: cc.EKF | cc.UKF) -> None:  # noqa: A002
    """More than three years at 10 Hz."""
    fly(filter, chunks=500, every=1000)
