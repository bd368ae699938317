"""Textbook filters for two vectors, many runs at once: the forms in which they are published.

They take both vectors in one update with the residual ``b - A r``, unlike the library's own, which
take one direction after the other with the arc across it and so go wrong less often. Only block N
uses them, to tell how much of a failure is the published form's.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from celestcore import quaternion as qt

Array = NDArray[np.float64]


@dataclass(frozen=True)
class TwoVectors:
    """Runs of a body that turns at a constant rate and sees two inertial directions every step."""

    dt: float
    rate: Array
    """Body rate (3,) [rad/s]."""
    q: Array
    """True attitudes (time, run, 4)."""
    gyro: Array
    """Gyro readings (time, run, 3) [rad/s]."""
    seen: Array
    """Measured directions (time, run, 2, 3), body frame, unit."""
    known: Array
    """The directions (run, 2, 3), inertial."""
    start: Array
    """Estimated attitude at the first time (run, 4)."""
    sigma0: tuple[float, float]
    """1 sigma of the start [rad], [rad/s]."""
    arw: float
    rrw: float
    sigma: float
    """Noise of a direction [rad]."""


@dataclass
class _State:
    q: Array
    bias: Array
    p: Array


def mekf(data: TwoVectors, *, reset: bool) -> Array:
    """Multiplicative EKF (Lefferts, Markley, Shuster 1982), Joseph's form.

    Parameters
    ----------
    data : TwoVectors
    reset : bool
        Whether the covariance follows the reset of the error (Markley 2003).

    Returns
    -------
    array, (time, run)
        Angle between estimated and true attitude after each update [rad].
    """

    def update(x: _State, seen: Array) -> _State:
        b = _body(x.q, data.known)
        h = np.concatenate([_skew(b[:, 0]), _skew(b[:, 1])], axis=1)
        step, p = _correct(x.p, h, (seen - b).reshape(len(b), 6), data.sigma)
        if reset:
            j = _identity(len(b))
            j[:, :3, :3] = qt.right_jacobian(step[:, :3])
            p = j @ p @ _t(j)
        return _State(qt.multiply(x.q, qt.exp(step[:, :3])), x.bias + step[:, 3:], p)

    def predict(x: _State, rate: Array) -> _State:
        turn = qt.exp((rate - x.bias) * data.dt)
        f = _identity(len(turn))
        f[:, :3, :3] = _t(qt.to_matrix(turn))
        f[:, :3, 3:] = -data.dt * np.eye(3)
        return _State(qt.multiply(x.q, turn), x.bias, f @ x.p @ _t(f) + _noise(data))

    return _run(data, predict, update)


def invariant(data: TwoVectors) -> Array:
    """Right-invariant EKF (Barrau and Bonnabel 2017): the attitude error stands in inertial axes.

    Its measurement matrix does not depend on the estimate. Parameters and result as in `mekf`.
    """
    h = np.concatenate([_skew(data.known[:, 0]), _skew(data.known[:, 1])], axis=1)

    def update(x: _State, seen: Array) -> _State:
        turned = qt.rotate(x.q[:, None], seen)
        step, p = _correct(x.p, h, (turned - data.known).reshape(len(h), 6), data.sigma)
        return _State(qt.multiply(qt.exp(step[:, :3]), x.q), x.bias + step[:, 3:], p)

    def predict(x: _State, rate: Array) -> _State:
        f = _identity(len(x.q))
        f[:, :3, 3:] = -data.dt * qt.to_matrix(x.q)
        q = qt.multiply(x.q, qt.exp((rate - x.bias) * data.dt))
        return _State(q, x.bias, f @ x.p @ _t(f) + _noise(data))

    return _run(data, predict, update)


def usque(data: TwoVectors) -> Array:
    """Unscented quaternion estimator (Crassidis and Markley 2003): a = 1, f = 4, lambda = 1.

    Parameters and result as in `mekf`. The points of a prediction serve the next update.
    """
    weight = np.array([1.0 / 7.0] + [1.0 / 14.0] * 12)
    carried: list[Array] = []

    def points(p: Array) -> Array:
        root = _t(np.linalg.cholesky(7.0 * p))
        return np.concatenate([np.zeros_like(root[:, :1]), root, -root], axis=1)

    def update(x: _State, seen: Array) -> _State:
        d = carried.pop() if carried else points(x.p)
        about = qt.multiply(x.q[:, None], _from_rodrigues(d[..., :3]))
        each = qt.rotate(qt.conjugate(about)[:, :, None], data.known[:, None]).reshape(*d.shape)
        mean, z = np.einsum("k,rki->ri", weight, d), np.einsum("k,rki->ri", weight, each)
        dx, dz = d - mean[:, None], each - z[:, None]
        s = np.einsum("k,rki,rkj->rij", weight, dz, dz) + data.sigma**2 * np.eye(6)
        cross = np.einsum("k,rki,rkj->rij", weight, dx, dz)
        gain = _t(np.linalg.solve(s, _t(cross)))
        step = mean + (gain @ (seen.reshape(len(z), 6) - z)[..., None])[..., 0]
        p = x.p - gain @ s @ _t(gain)
        q = qt.multiply(x.q, _from_rodrigues(step[:, :3]))
        return _State(q, x.bias + step[:, 3:], 0.5 * (p + _t(p)))

    def predict(x: _State, rate: Array) -> _State:
        half = 0.5 * _noise(data)
        d = points(x.p + half)
        turn = qt.exp((rate[:, None] - x.bias[:, None] - d[..., 3:]) * data.dt)
        moved = qt.multiply(qt.multiply(x.q[:, None], _from_rodrigues(d[..., :3])), turn)
        about = np.asarray(moved[:, 0])
        error = _to_rodrigues(qt.multiply(qt.conjugate(about)[:, None], moved))
        after = np.concatenate([error, d[..., 3:]], axis=-1)
        mean = np.einsum("k,rki->ri", weight, after)
        off = after - mean[:, None]
        carried.append(after)
        p = np.einsum("k,rki,rkj->rij", weight, off, off) + half
        return _State(about, x.bias, p)

    return _run(data, predict, update)


def _run(
    data: TwoVectors,
    predict: Callable[[_State, Array], _State],
    update: Callable[[_State, Array], _State],
) -> Array:
    runs = data.q.shape[1]
    variance = np.repeat(np.square(data.sigma0), 3)
    x = _State(data.start, np.zeros((runs, 3)), np.tile(np.diag(variance), (runs, 1, 1)))
    error = np.empty(data.q.shape[:2])
    for k in range(len(data.q)):
        if k:
            x = predict(x, data.gyro[k - 1])
        x = update(x, data.seen[k])
        x.q = x.q / np.linalg.norm(x.q, axis=1, keepdims=True)
        error[k] = qt.angle_between(x.q, data.q[k])
    return error


def _correct(p: Array, h: Array, residual: Array, sigma: float) -> tuple[Array, Array]:
    """Return the step and the covariance of a linear update; `h` is about the attitude alone."""
    full = np.concatenate([h, np.zeros_like(h)], axis=2)
    s = full @ p @ _t(full) + sigma**2 * np.eye(h.shape[1])
    gain = _t(np.linalg.solve(s, full @ p))
    left = np.eye(6) - gain @ full
    step = (gain @ residual[..., None])[..., 0]
    return step, left @ p @ _t(left) + sigma**2 * gain @ _t(gain)


def _noise(data: TwoVectors) -> Array:
    return np.diag(np.repeat([data.arw**2 * data.dt, data.rrw**2 * data.dt], 3))


def _body(q: Array, known: Array) -> Array:
    return np.asarray(qt.rotate(qt.conjugate(q)[:, None], known))


def _identity(runs: int) -> Array:
    return np.tile(np.eye(6), (runs, 1, 1))


def _t(m: NDArray[np.floating[Any]]) -> Array:
    return np.asarray(np.swapaxes(m, -1, -2))


def _skew(v: Array) -> Array:
    return np.asarray(np.cross(v[..., None, :], np.eye(3)).swapaxes(-1, -2))


def _from_rodrigues(p: Array) -> Array:
    square = np.sum(p * p, axis=-1, keepdims=True)
    w = (16.0 - square) / (16.0 + square)
    return np.concatenate([w, 0.25 * (1.0 + w) * p], axis=-1)


def _to_rodrigues(q: Array) -> Array:
    q = q * np.where(q[..., :1] < 0.0, -1.0, 1.0)
    return np.asarray(4.0 * q[..., 1:] / (1.0 + q[..., :1]))
