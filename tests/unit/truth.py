"""A body whose true attitude is known, logs of its sensors, and what two runs have in common."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import celestcore as cc
import numpy as np
import pytest
from celestcore import quaternion as quat
from numpy.typing import NDArray

Array = NDArray[np.float64]
SIGMA = 10 * cc.ARCSEC
ARW, RRW = 1e-6, 1e-8
GYRO, CAMERA = cc.Gyro(ARW, RRW), cc.StarCamera(SIGMA)
FILTERS = {"ekf": cc.EKF(), "ukf": cc.UKF(), "srukf": cc.SRUKF()}
PER_ROW = ("t", "q", "rate", "bias", "sigma")
PER_FIX = ("measurement_t", "sensor", "nis", "dof", "accepted", "innovation", "innovation_sigma")
every_filter = pytest.mark.parametrize("name", FILTERS)


@dataclass
class Truth:
    """A gyro whose rates hold between its samples, and the attitude that follows from them."""

    n: int = 400
    dt: float = 0.125
    seed: int = 0
    noisy: bool = True
    t: Array = field(init=False)
    rate: Array = field(init=False)
    measured: Array = field(init=False)
    bias: Array = field(init=False)
    q: Array = field(init=False)

    def __post_init__(self) -> None:
        self.rng = np.random.default_rng(self.seed)
        self.t = self.dt * np.arange(self.n)
        phase = 0.3 * self.t[:, None] + [0.0, 1.0, 2.0]
        self.rate = 0.05 * np.sin(phase) + [0.01, 0.0, 0.02]
        steps = np.r_[[[2e-5, -1e-5, 3e-5]], RRW * self.dt**0.5 * self.noise(self.n - 1, 3)]
        self.bias = np.cumsum(steps, axis=0)
        self.measured = self.rate + self.bias + ARW / self.dt**0.5 * self.noise(self.n, 3)
        self.q = quat.propagate(quat.exp([0.3, -0.5, 0.8]), self.rate[:-1], self.dt)

    def noise(self, *shape: int) -> Array:
        return self.rng.normal(size=shape) * self.noisy

    def at(self, t: Array) -> Array:
        """Attitude at any times."""
        k = np.searchsorted(self.t, t, side="right") - 1
        turned = quat.exp(self.rate[k] * (t - self.t[k])[:, None])
        return quat.multiply(self.q[k], turned)

    def fixes(self, t: Array, sigma: Any = SIGMA) -> Array:
        return quat.multiply(self.at(t), quat.exp(sigma * self.noise(len(t), 3)))

    def log(self, each: int = 2, **tables: Any) -> cc.SensorLog:
        given: dict[str, Any] = {"gyro": (self.t, self.measured)}
        if each:
            t = self.t[::each]
            given["star"] = (t, self.fixes(t))
        return cc.SensorLog(**{**given, **tables})


def navigator(filter: Any = None, **options: Any) -> cc.StarGyroNavigator:  # noqa: A002
    return cc.StarGyroNavigator(filter, **{"gyro": GYRO, "star": CAMERA, **options})


def same_bits(a: cc.Solution, b: cc.Solution, names: tuple[str, ...]) -> None:
    for name in names:
        assert np.array_equal(getattr(a, name), getattr(b, name), equal_nan=True), name


def same_end(a: cc.Solution, b: cc.Solution) -> None:
    for name in ("t", "q", "bias", "sigma", "covariance"):
        assert np.array_equal(a.final[name], b.final[name]), name


def close(a: cc.Solution, b: cc.Solution, tolerance: float = 1e-12) -> None:
    """Attitudes and biases agree absolutely, sigmas relatively."""
    assert np.array_equal(a.t, b.t)
    assert quat.angle_between(a.q, b.q).max() < tolerance
    assert np.abs(a.bias - b.bias).max() < tolerance
    assert np.abs(a.sigma / b.sigma - 1.0).max() < 1e3 * tolerance


def errors(sol: cc.Solution, truth: Truth) -> Array:
    return quat.angle_between(sol.q, truth.at(sol.t))


def directions(truth: Truth, t: Array, inertial: Any, sigma: float = 1e-3) -> tuple[Array, Array]:
    """Noisy directions in the body frame, and what they are in the inertial frame."""
    i = np.broadcast_to(np.asarray(inertial), (len(t), 3))
    b = quat.rotate(quat.conjugate(truth.at(t)), i) + sigma * truth.noise(len(t), 3)
    return b / np.linalg.norm(b, axis=1, keepdims=True), i


def with_outliers(truth: Truth, rows: Any, size: float) -> cc.SensorLog:
    t = truth.t[::2]
    q = truth.fixes(t)
    bad = q.copy()
    bad[rows] = quat.multiply(q[rows], quat.exp(size * np.ones(3) / 3**0.5))
    return truth.log(star=(t, bad))
