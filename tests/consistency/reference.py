"""Textbook filters in plain numpy: dense, slow, and without a formula of the core.

Transitions and noise come from matrix exponentials (`simulate.discretise`), the kinematics from the
exponential of the quaternion's 4x4 matrix, the Jacobian of a reset from an exponential too. The
unscented filter has the weights as Wan and van der Merwe (2000) print them, the centre's included.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol

import celestcore as cc
import numpy as np
from scipy.linalg import expm
from scipy.spatial.transform import Rotation
from simulate import FloatArray, discretise, exp, local, multiply, skew

N = 6


@dataclass(frozen=True)
class Belief:
    q: FloatArray
    bias: FloatArray
    p: FloatArray

    def moved(self, d: FloatArray) -> Belief:
        """Return the state at the end of an error state; the covariance as it is."""
        return replace(self, q=multiply(self.q, exp(d[:3])), bias=self.bias + d[3:])

    def to(self, other: Belief) -> FloatArray:
        """Return the error state that leads to another state."""
        return np.concatenate([local(self.q, other.q), other.bias - self.bias])


def kinematics(q: FloatArray, rate: FloatArray, dt: float) -> FloatArray:
    """Return attitudes (..., 4) after `dt` at constant body rates: dq/dt = 1/2 Omega q."""
    x, y, z = np.moveaxis(rate, -1, 0)
    o = np.zeros_like(x)
    rows = [[o, -x, -y, -z], [x, o, z, -y], [y, -z, o, x], [z, y, -x, o]]
    omega = np.moveaxis(np.array(rows), (0, 1), (-2, -1))
    q = (expm(0.5 * omega * dt) @ q[..., None])[..., 0]
    return q / np.linalg.norm(q, axis=-1, keepdims=True)


def reset(d: FloatArray) -> FloatArray:
    """Return the Jacobian (6, 6) of the error about ``x + d``: the mean of exp(-[s d]x), s to 1."""
    big = np.zeros((6, 6))
    big[:3, :3], big[:3, 3:] = -skew(d[:3]), np.eye(3)
    out = np.eye(N)
    out[:3, :3] = expm(big)[:3, 3:]
    return out


class Sensor(Protocol):
    """A measurement: what it says of a state, and how far that is from another."""

    noise: FloatArray

    def predict(self, x: Belief) -> FloatArray: ...
    def residual(self, z: FloatArray, about: FloatArray) -> FloatArray: ...
    def jacobian(self, x: Belief) -> FloatArray: ...


@dataclass(frozen=True)
class Star:
    """A fix of a camera that stands in the body as `mounting` says; noise in the camera's frame."""

    noise: FloatArray
    mounting: FloatArray

    def predict(self, x: Belief) -> FloatArray:
        return multiply(x.q, self.mounting)

    def residual(self, z: FloatArray, about: FloatArray) -> FloatArray:
        return local(about, z)

    def jacobian(self, x: Belief) -> FloatArray:
        """Return the body's error seen in the camera's frame."""
        turn = Rotation.from_quat(self.mounting[[1, 2, 3, 0]]).as_matrix().T
        return np.hstack([turn, np.zeros((3, 3))])


@dataclass(frozen=True)
class Direction:
    noise: FloatArray
    inertial: FloatArray

    def predict(self, x: Belief) -> FloatArray:
        return Rotation.from_quat(x.q[[1, 2, 3, 0]]).as_matrix().T @ self.inertial

    def residual(self, z: FloatArray, about: FloatArray) -> FloatArray:
        axis = np.cross(about, z)
        size = np.linalg.norm(axis)
        arc = np.arctan2(size, about @ z) * np.cross(axis, about) / size if size else np.zeros(3)
        return self.across(about) @ arc

    def jacobian(self, x: Belief) -> FloatArray:
        b = self.predict(x)
        return np.hstack([self.across(b) @ skew(b), np.zeros((2, 3))])

    @staticmethod
    def across(b: FloatArray) -> FloatArray:
        """Return two unit vectors across `b`, as rows; which ones makes no difference."""
        u = np.cross(b, np.eye(3)[np.argmin(np.abs(b))])
        u = u / np.linalg.norm(u)
        return np.array([u, np.cross(b, u)])


@dataclass(frozen=True)
class Mekf:
    """Multiplicative EKF: Lefferts, Markley, Shuster (1982), with Joseph's form and the reset."""

    arw: float
    rrw: float

    def predict(self, x: Belief, rate: FloatArray, dt: float) -> Belief:
        f, q = discretise(rate - x.bias, dt, self.arw, self.rrw)
        return Belief(kinematics(x.q, rate - x.bias, dt), x.bias, f @ x.p @ f.T + q)

    def update(self, x: Belief, sensor: Sensor, z: FloatArray) -> tuple[Belief, float]:
        h = sensor.jacobian(x)
        s = h @ x.p @ h.T + sensor.noise
        k = np.linalg.solve(s, h @ x.p).T
        r = sensor.residual(z, sensor.predict(x))
        left = np.eye(N) - k @ h
        j = reset(k @ r)
        p = left @ x.p @ left.T + k @ sensor.noise @ k.T
        return replace(x.moved(k @ r), p=j @ p @ j.T), float(r @ np.linalg.solve(s, r))


@dataclass(frozen=True)
class PlainUkf:
    """Unscented filter on the manifold with standard scaled weights; an update draws new points."""

    arw: float
    rrw: float
    alpha: float
    beta: float
    kappa: float

    def predict(self, x: Belief, rate: FloatArray, dt: float) -> Belief:
        points = [x.moved(d) for d in self.points(x.p)]
        bias = np.array([point.bias for point in points])
        turned = kinematics(np.array([point.q for point in points]), rate - bias, dt)
        images = [replace(point, q=q) for point, q in zip(points, turned, strict=True)]
        mean, p = self.moments(np.array([images[0].to(image) for image in images]))
        j = reset(mean)
        _, q = discretise(rate - x.bias, dt, self.arw, self.rrw)
        return replace(images[0].moved(mean), p=j @ p @ j.T + q)

    def update(self, x: Belief, sensor: Sensor, z: FloatArray) -> tuple[Belief, float]:
        points = self.points(x.p)
        about = sensor.predict(x)
        seen = np.array([sensor.residual(sensor.predict(x.moved(d)), about) for d in points])
        mean, s = self.moments(seen)
        s = s + sensor.noise
        _, wc = self.weights()
        cross = (points * wc[:, None]).T @ (seen - mean)
        k = np.linalg.solve(s, cross.T).T
        r = sensor.residual(z, about) - mean
        j = reset(k @ r)
        p = x.p - k @ s @ k.T
        return replace(x.moved(k @ r), p=j @ p @ j.T), float(r @ np.linalg.solve(s, r))

    @property
    def spread(self) -> float:
        """``n + lambda``."""
        return self.alpha**2 * (N + self.kappa)

    def points(self, p: FloatArray) -> FloatArray:
        root = np.linalg.cholesky(self.spread * p).T
        return np.vstack([np.zeros((1, N)), root, -root])

    def weights(self) -> tuple[FloatArray, FloatArray]:
        """Return the weights of the mean and of the covariance."""
        wm = np.full(2 * N + 1, 0.5 / self.spread)
        wm[0] = (self.spread - N) / self.spread
        wc = wm.copy()
        wc[0] += 1.0 - self.alpha**2 + self.beta
        return wm, wc

    def moments(self, deviations: FloatArray) -> tuple[FloatArray, FloatArray]:
        wm, wc = self.weights()
        mean = wm @ deviations
        about = deviations - mean
        return mean, (about * wc[:, None]).T @ about


@dataclass(frozen=True)
class Run:
    """What a reference run gives: rows at the gyro samples, and the NIS of each measurement."""

    q: FloatArray
    bias: FloatArray
    covariance: FloatArray
    nis: FloatArray


def replay(
    filter: Mekf | PlainUkf,  # noqa: A002
    log: cc.SensorLog,
    start: Belief,
    cameras: dict[str, cc.StarCamera],
) -> Run:
    """Run a log whose gyro samples are held, every fix with its own covariance or sigma."""
    assert log.gyro is not None
    events: list[tuple[float, int, FloatArray, Sensor | None]] = [
        (t, 1, rate, None) for t, rate in zip(log.gyro.t, log.gyro.rate, strict=True)
    ]
    for name, star in log.stars.items():
        mounting = np.asarray(cameras[name].mounting, dtype=float)
        assert star.covariance is not None
        for t, q, r in zip(star.t, star.q, star.covariance, strict=True):
            events.append((t, 0, q, Star(r, mounting)))
    for table in log.vectors.values():
        assert table.sigma is not None
        for t, b, i, s in zip(table.t, table.body, table.inertial, table.sigma, strict=True):
            events.append((t, 0, b, Direction(s**2 * np.eye(2), i)))
    events.sort(key=lambda event: event[:2])  # at equal times measurements come first

    x, now, rate = start, log.gyro.t[0], log.gyro.rate[0]
    rows: list[Belief] = []
    nis: list[float] = []
    for t, _, value, sensor in events:
        if t > now:
            x, now = filter.predict(x, rate, t - now), t
        if sensor is None:
            rate = value
            rows.append(x)
        else:
            x, square = filter.update(x, sensor, value)
            nis.append(square)
    q, bias, p = (np.array([getattr(row, name) for row in rows]) for name in ("q", "bias", "p"))
    return Run(q, bias, p, np.array(nis))
