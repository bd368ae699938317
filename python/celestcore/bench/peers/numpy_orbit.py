"""numpy: one orbit in a loop, or all particles at once."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from celestcore._check import FloatArray
from celestcore.bench._inputs import START, OrbitInput, sky
from celestcore.bench._orbit import STEP, Cloud
from celestcore.bench._outcome import Outcome

Constants = tuple[float, float, float]


def rate(x: FloatArray, constants: Constants) -> FloatArray:
    """Return the derivative of states (..., 6) under J2."""
    (mu, re, j2), r, v = constants, x[..., :3], x[..., 3:]
    inverse = 1.0 / np.sum(r * r, axis=-1, keepdims=True)
    g, k = -mu * inverse * np.sqrt(inverse), 1.5 * j2 * re * re * inverse
    z = 5.0 * r[..., 2:] ** 2 * inverse
    side = g * (1.0 + k * (1.0 - z))
    return np.concatenate([v, side * r[..., :2], g * (1.0 + k * (3.0 - z)) * r[..., 2:]], axis=-1)


def rk4(x: FloatArray, constants: Constants, h: float) -> FloatArray:
    """Return states (..., 6) after a step."""
    k1 = rate(x, constants)
    k2 = rate(x + 0.5 * h * k1, constants)
    k3 = rate(x + 0.5 * h * k2, constants)
    k4 = rate(x + h * k3, constants)
    return np.asarray(x + h / 6.0 * (k1 + 2.0 * (k2 + k3) + k4))


def angles(x: FloatArray, star: FloatArray) -> FloatArray:
    """Return angles (..., 3) between stars and the nadir."""
    r = x[..., :3]
    return np.asarray(np.arccos(-(r @ star.T) / np.linalg.norm(r, axis=-1, keepdims=True)))


def start(log: OrbitInput) -> FloatArray:
    """Return the state that a filter starts with."""
    return np.concatenate([log.r0, log.v0])


def integrate(t: Any) -> Callable[[], Outcome]:
    """Return a call that integrates an orbit, all rows kept."""
    constants = sky(1).constants

    def call() -> Outcome:
        out = np.empty((len(t), 6))
        out[0] = START
        for k in range(len(t) - 1):
            out[k + 1] = rk4(out[k], constants, STEP)
        return {"r": out[-1, :3]}

    return call


def bootstrap(given: Cloud) -> Callable[[], Outcome]:
    """Return a call of the bootstrap filter."""
    log, n, random = given.log, given.particles, np.random.default_rng(1)
    constants, root = log.constants, np.linalg.cholesky(log.noise)
    first = np.sqrt(np.diag(log.covariance0))

    def call() -> Outcome:
        x = start(log) + first * random.standard_normal((n, 6))
        for seen in log.angle:
            x = rk4(x, constants, log.period) + random.standard_normal((n, 6)) @ root.T
            off = (seen - angles(x, log.star)) / log.sigma
            logs = -0.5 * np.sum(off * off, axis=1)
            w = np.exp(logs - logs.max())
            reached = np.cumsum(w / w.sum())
            reached[-1] = 1.0
            points = (np.arange(n) + random.random()) / n
            x = x[np.searchsorted(reached, points, side="right")]
        return {"r": x[:, :3].mean(axis=0)}

    return call
