"""numba: attitude loops as one writes them for speed."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from celestcore.bench._inputs import AttitudeInput
from celestcore.bench._outcome import Outcome
from celestcore.bench.peers._compiled import compiled
from celestcore.bench.peers._numba_math import (
    between,
    cholesky6,
    exp,
    gain,
    moments,
    multiply,
    normalise,
)

Array = Any


@compiled
def _propagate(gyro: Array, dt: float, out: Array) -> None:
    turn = np.empty(4)
    for k in range(len(out) - 1):
        exp(dt * gyro[k, 0], dt * gyro[k, 1], dt * gyro[k, 2], turn)
        multiply(out[k], turn, out[k + 1])
        normalise(out[k + 1])


@compiled
def _covariance(p: Array, turn: Array, dt: float, noise: Array, work: Array) -> None:
    """``F P F' + Q`` with ``F = [R', -dt; 0, 1]``, R of the step's turn; work is (15, 6)."""
    w, x, y, z = turn
    r, fp = work[:3], work[3:6]
    r[0, 0], r[0, 1], r[0, 2] = 1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)
    r[1, 0], r[1, 1], r[1, 2] = 2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)
    r[2, 0], r[2, 1], r[2, 2] = 2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)
    for i in range(3):
        for j in range(6):
            fp[i, j] = -dt * p[i + 3, j]
            for k in range(3):
                fp[i, j] += r[i, k] * p[k, j]
    for i in range(3):
        for j in range(3):
            p[i, j] = noise[i, j] - dt * fp[i, j + 3]
            for k in range(3):
                p[i, j] += fp[i, k] * r[j, k]
            p[i, j + 3] = fp[i, j + 3] + noise[i, j + 3]
            p[j + 3, i] = p[i, j + 3]
            p[i + 3, j + 3] += noise[i + 3, j + 3]


@compiled
def _mekf(gyro: Array, fixes: Array, q: Array, p: Array, noise: Array, dt: float, r: float) -> None:
    bias, dx, z = np.zeros(3), np.empty(6), np.empty(3)
    turn, s, cross = np.empty(4), np.empty((3, 3)), np.empty((6, 3))
    work = np.empty((15, 6))
    small = np.empty((9, 3))
    for k in range(len(gyro) - 1):
        rate = gyro[k]
        exp(dt * (rate[0] - bias[0]), dt * (rate[1] - bias[1]), dt * (rate[2] - bias[2]), turn)
        multiply(q, turn, q)
        _covariance(p, turn, dt, noise, work)
        if k % 2 == 1:
            between(q, fixes[k // 2], z)
            for i in range(6):
                for j in range(3):
                    cross[i, j] = p[i, j]
            for i in range(3):
                for j in range(3):
                    s[i, j] = p[i, j]
                s[i, i] += r
            gain(p, s, cross, z, dx, small)
            exp(dx[0], dx[1], dx[2], turn)
            multiply(q, turn, q)
            normalise(q)
            for i in range(3):
                bias[i] += dx[i + 3]


@compiled
def _rk4(q: Array, x: float, y: float, z: float, dt: float, work: Array) -> None:
    """Runge-Kutta on ``dq/dt = q (0, rate) / 2``, in place; work is (6, 4)."""
    turn, at = work[4], work[5]
    turn[0], turn[1], turn[2], turn[3] = 0.0, 0.5 * x, 0.5 * y, 0.5 * z
    multiply(q, turn, work[0])
    for i in range(4):
        at[i] = q[i] + 0.5 * dt * work[0, i]
    multiply(at, turn, work[1])
    for i in range(4):
        at[i] = q[i] + 0.5 * dt * work[1, i]
    multiply(at, turn, work[2])
    for i in range(4):
        at[i] = q[i] + dt * work[2, i]
    multiply(at, turn, work[3])
    for i in range(4):
        q[i] += dt / 6.0 * (work[0, i] + 2.0 * (work[1, i] + work[2, i]) + work[3, i])
    normalise(q)


@compiled
def _points(p: Array, q: Array, low: Array, qs: Array, db: Array, turn: Array) -> None:
    """Write 13 sigma points: attitudes, and deviations of the bias."""
    cholesky6(p, 3.0, low)
    for k in range(13):
        sign = 1.0 if k < 7 else -1.0
        c = (k - 1) % 6
        for i in range(3):
            db[k, i] = 0.0 if k == 0 else sign * low[i + 3, c]
        if k == 0:
            exp(0.0, 0.0, 0.0, turn)
        else:
            exp(sign * low[0, c], sign * low[1, c], sign * low[2, c], turn)
        multiply(q, turn, qs[k])


@compiled
def _ukf(gyro: Array, fixes: Array, q: Array, p: Array, noise: Array, dt: float, r: float) -> None:
    """Sigma points as deviations from the centre's image, drawn anew for each update."""
    bias, dx, mean, zm = np.zeros(3), np.empty(6), np.empty(6), np.empty(3)
    turn, low, s, cross = np.empty(4), np.zeros((6, 6)), np.empty((3, 3)), np.empty((6, 3))
    qs, d, z, db = np.empty((13, 4)), np.zeros((13, 6)), np.zeros((13, 3)), np.empty((13, 3))
    work, small = np.empty((6, 4)), np.empty((9, 3))
    for k in range(len(gyro) - 1):
        rate = gyro[k]
        _points(p, q, low, qs, db, turn)
        for n in range(13):
            x, y = rate[0] - bias[0] - db[n, 0], rate[1] - bias[1] - db[n, 1]
            _rk4(qs[n], x, y, rate[2] - bias[2] - db[n, 2], dt, work)
            between(qs[0], qs[n], d[n, :3])
            for i in range(3):
                d[n, i + 3] = db[n, i]
        moments(d, 6, d, 6, mean, p)
        for i in range(6):
            for j in range(6):
                p[i, j] += noise[i, j]
        exp(mean[0], mean[1], mean[2], turn)
        multiply(qs[0], turn, q)
        normalise(q)
        for i in range(3):
            bias[i] += mean[i + 3]
        if k % 2 == 1:
            _points(p, q, low, qs, db, turn)
            for n in range(13):
                between(fixes[k // 2], qs[n], z[n])
                between(q, qs[n], d[n, :3])
                for i in range(3):
                    d[n, i + 3] = db[n, i]
            c = z[0].copy()
            for n in range(13):
                for i in range(3):
                    z[n, i] -= c[i]
            moments(z, 3, z, 3, zm, s)
            moments(d, 6, z, 3, mean, cross)
            for i in range(3):
                s[i, i] += r
                zm[i] = -(zm[i] + c[i])
            gain(p, s, cross, zm, dx, small)
            exp(dx[0], dx[1], dx[2], turn)
            multiply(q, turn, q)
            normalise(q)
            for i in range(3):
                bias[i] += dx[i + 3]


def propagation(given: AttitudeInput) -> Callable[[], Outcome]:
    """Return a call that propagates the readings."""
    out = np.empty((len(given.gyro), 4))

    def call() -> Outcome:
        out[0] = [1.0, 0.0, 0.0, 0.0]
        _propagate(given.gyro, given.dt, out)
        return {"q": out[-1]}

    return call


def _filter(loop: Callable[..., None], given: AttitudeInput) -> Callable[[], Outcome]:
    def call() -> Outcome:
        q, p = given.q0.copy(), given.covariance0
        loop(given.gyro, given.fix_q, q, p, given.noise, given.dt, given.sigma**2)
        return {"q": q, "sigma": np.sqrt(np.diag(p))}

    return call


def mekf(given: AttitudeInput) -> Callable[[], Outcome]:
    """Return a call of the multiplicative extended Kalman filter."""
    return _filter(_mekf, given)


def ukf(given: AttitudeInput) -> Callable[[], Outcome]:
    """Return a call of the unscented filter, points drawn anew for each update."""
    return _filter(_ukf, given)
