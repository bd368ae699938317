"""numba: orbit loops as one writes them for speed."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from celestcore.bench._inputs import START, OrbitInput, sky
from celestcore.bench._orbit import STEP, Cloud
from celestcore.bench._outcome import Outcome
from celestcore.bench.peers._compiled import compiled
from celestcore.bench.peers._numba_math import cholesky6, gain, moments
from celestcore.bench.peers.numba_resampling import draw_systematic

Array = Any


@compiled
def _rate(x: Array, mu: float, re: float, j2: float, out: Array) -> None:
    inverse = 1.0 / (x[0] * x[0] + x[1] * x[1] + x[2] * x[2])
    g, k = -mu * inverse * math.sqrt(inverse), 1.5 * j2 * re * re * inverse
    z = 5.0 * x[2] * x[2] * inverse
    side = g * (1.0 + k * (1.0 - z))
    out[0], out[1], out[2] = x[3], x[4], x[5]
    out[3], out[4], out[5] = side * x[0], side * x[1], g * (1.0 + k * (3.0 - z)) * x[2]


@compiled
def _rk4(x: Array, mu: float, re: float, j2: float, h: float, out: Array, work: Array) -> None:
    """Write the state after a step; work is (5, 6)."""
    at = work[4]
    _rate(x, mu, re, j2, work[0])
    for i in range(6):
        at[i] = x[i] + 0.5 * h * work[0, i]
    _rate(at, mu, re, j2, work[1])
    for i in range(6):
        at[i] = x[i] + 0.5 * h * work[1, i]
    _rate(at, mu, re, j2, work[2])
    for i in range(6):
        at[i] = x[i] + h * work[2, i]
    _rate(at, mu, re, j2, work[3])
    for i in range(6):
        out[i] = x[i] + h / 6.0 * (work[0, i] + 2.0 * (work[1, i] + work[2, i]) + work[3, i])


@compiled
def _integrate(out: Array, mu: float, re: float, j2: float, h: float) -> None:
    work = np.empty((5, 6))
    for k in range(len(out) - 1):
        _rk4(out[k], mu, re, j2, h, out[k + 1], work)


@compiled
def _angles(x: Array, star: Array, out: Array) -> None:
    inverse = -1.0 / math.sqrt(x[0] * x[0] + x[1] * x[1] + x[2] * x[2])
    for i in range(3):
        c = (star[i, 0] * x[0] + star[i, 1] * x[1] + star[i, 2] * x[2]) * inverse
        out[i] = math.acos(c)


@compiled
def _points(x: Array, p: Array, low: Array, out: Array) -> None:
    cholesky6(p, 3.0, low)
    for k in range(13):
        sign = 1.0 if k < 7 else -1.0
        for i in range(6):
            out[k, i] = x[i] if k == 0 else x[i] + sign * low[i, (k - 1) % 6]


@compiled
def _ukf(
    angle: Array, star: Array, x: Array, p: Array, noise: Array, force: Array, h: float, r: float
) -> None:
    """Unscented filter, points drawn anew for each update."""
    mu, re, j2 = force[0], force[1], force[2]
    low, xs, d = np.zeros((6, 6)), np.empty((13, 6)), np.empty((13, 6))
    z, zm, mean, dx = np.empty((13, 3)), np.empty(3), np.empty(6), np.empty(6)
    s, cross = np.empty((3, 3)), np.empty((6, 3))
    work, small = np.empty((5, 6)), np.empty((9, 3))
    for k in range(len(angle)):
        _points(x, p, low, xs)
        for n in range(13):
            _rk4(xs[n], mu, re, j2, h, d[n], work)
        for i in range(6):
            x[i] = d[0, i]
        for n in range(13):
            for i in range(6):
                d[n, i] -= x[i]
        moments(d, 6, d, 6, mean, p)
        for i in range(6):
            x[i] += mean[i]
            for j in range(6):
                p[i, j] += noise[i, j]
        _points(x, p, low, xs)
        for n in range(13):
            _angles(xs[n], star, z[n])
            for i in range(6):
                d[n, i] = xs[n, i] - x[i]
        c = z[0].copy()
        for n in range(13):
            for i in range(3):
                z[n, i] -= c[i]
        moments(z, 3, z, 3, zm, s)
        moments(d, 6, z, 3, zm, cross)
        for i in range(3):
            s[i, i] += r
            zm[i] = angle[k, i] - c[i] - zm[i]
        gain(p, s, cross, zm, dx, small)
        for i in range(6):
            x[i] += dx[i]


@compiled
def _bootstrap(
    angle: Array, star: Array, xs: Array, root: Array, force: Array, h: float, r: float
) -> None:
    """Particles moved, weighed and resampled at each epoch."""
    n, work, z, white = len(xs), np.empty((5, 6)), np.empty(3), np.empty(6)
    after, w, chosen = np.empty_like(xs), np.empty(len(xs)), np.empty(len(xs), np.int64)
    for k in range(len(angle)):
        most = -np.inf
        for p in range(n):
            x = after[p]
            _rk4(xs[p], force[0], force[1], force[2], h, x, work)
            for i in range(6):
                white[i] = np.random.standard_normal()  # noqa: NPY002
                for j in range(i + 1):
                    x[i] += root[i, j] * white[j]
            _angles(x, star, z)
            w[p] = 0.0
            for i in range(3):
                w[p] -= 0.5 * (angle[k, i] - z[i]) ** 2 / r
            most = max(most, w[p])
        total = 0.0
        for p in range(n):
            w[p] = math.exp(w[p] - most)
            total += w[p]
        for p in range(n):
            w[p] /= total
        draw_systematic(w, np.random.random(), chosen)  # noqa: NPY002
        for p in range(n):
            for i in range(6):
                xs[p, i] = after[chosen[p], i]


def integrate(t: Any) -> Callable[[], Outcome]:
    """Return a call that integrates an orbit, all rows kept."""
    mu, re, j2 = sky(1).constants
    out = np.empty((len(t), 6))

    def call() -> Outcome:
        out[0] = START
        _integrate(out, mu, re, j2, STEP)
        return {"r": out[-1, :3]}

    return call


def ukf(given: OrbitInput) -> Callable[[], Outcome]:
    """Return a call of the unscented filter."""
    noise, force = given.noise, np.array(given.constants)

    def call() -> Outcome:
        x, p = np.concatenate([given.r0, given.v0]), given.covariance0
        _ukf(given.angle, given.star, x, p, noise, force, given.period, given.sigma**2)
        return {"r": x[:3], "sigma": np.sqrt(np.diag(p))}

    return call


def bootstrap(given: Cloud) -> Callable[[], Outcome]:
    """Return a call of the bootstrap filter."""
    log, random = given.log, np.random.default_rng(1)
    force, root = np.array(log.constants), np.linalg.cholesky(log.noise)
    start, first = np.concatenate([log.r0, log.v0]), np.sqrt(np.diag(log.covariance0))

    def call() -> Outcome:
        xs = start + first * random.standard_normal((given.particles, 6))
        _bootstrap(log.angle, log.star, xs, root, force, log.period, log.sigma**2)
        return {"r": xs[:, :3].mean(axis=0)}

    return call
