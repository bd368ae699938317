"""What noise does to Allan variances: their mean, and how estimates scatter together.

The angle is a process with stationary second differences, described by its generalised covariance
K(t): the covariance of any two second differences is the sum of K over their nine pairs of points.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
IntArray = NDArray[np.int64]

TERMS = ("arw", "rrw", "bias_instability", "quantisation")
ARW, RRW = 0, 1
_WEIGHT = np.array([1.0, -2.0, 1.0])
_EXACT = 4000
_NODES, _NODE_WEIGHTS = np.polynomial.legendre.leggauss(8)


def slopes(tau: Array) -> Array:
    """Return the Allan variance (k, 4) of a unit of each term: N^2, K^2, B^2 and Q^2.

    IEEE Std 952-1997, annex C: ``N^2 / tau``, ``K^2 tau / 3``, ``B^2 2 ln 2 / pi`` and
    ``3 Q^2 / tau^2``.
    """
    flat = np.full_like(tau, 2.0 * np.log(2.0) / np.pi)
    return np.stack([1.0 / tau, tau / 3.0, flat, 3.0 / tau**2], axis=-1)


def _generalised(t: Array) -> Array:
    """Return K (3, ...) of the angle at lags `t` [s], a unit of each term but quantisation."""
    size = np.abs(t)
    safe = np.where(size > 0.0, size, 1.0)
    return np.stack([-0.5 * size, size**3 / 12.0, size**2 * np.log(safe) / (2.0 * np.pi)])


def scatter(m: IntArray, n: int, dt: float) -> Array:
    """Return how estimates of Allan variances scatter, (4, 4, k, k): a quadratic form in the terms.

    The covariance of the estimates at `m[i]` and `m[j]` samples is the sum over terms a and b, of
    sizes p, of ``p_a p_b scatter[a, b, i, j]``. By Isserlis' theorem, from the covariance of the
    second differences: exactly for Gaussian noise; long sums over lags are done as integrals.
    """
    out = np.zeros((len(TERMS), len(TERMS), len(m), len(m)))
    for i, a in enumerate(m.tolist()):
        for j, b in enumerate(m.tolist()[: i + 1]):
            count = float((n + 1 - 2 * a) * (n + 1 - 2 * b))
            scale = 0.5 / (count * (a * dt) ** 2 * (b * dt) ** 2)
            out[:, :, i, j] = out[:, :, j, i] = scale * _products(a, b, n, dt)
    return out


def _products(a: int, b: int, n: int, dt: float) -> Array:
    """Return the sums (4, 4) over all pairs of second differences of products of covariances."""

    def covariance(lag: Array) -> Array:
        pairs = lag + (a * np.arange(3.0)[:, None, None] - b * np.arange(3.0)[:, None])
        return np.asarray(np.einsum("i,j,aijl->al", _WEIGHT, _WEIGHT, _generalised(pairs * dt)))

    out = np.zeros((len(TERMS), len(TERMS)))
    lag, weight = _lags(a, b, n)
    c = covariance(lag)
    out[:3, :3] = np.einsum("l,al,bl->ab", weight, c, c)
    # quantisation is white in the angle: it correlates only where points coincide
    points = np.subtract.outer(-a * np.arange(3), -b * np.arange(3)).ravel()
    lags, which = np.unique(points, return_inverse=True)
    spike = np.bincount(which.reshape(-1), np.outer(_WEIGHT, _WEIGHT).ravel())
    lag = lags.astype(np.float64)
    spikes = spike * _pairs(lag, a, b, n)
    out[3, 3] = spikes @ spike
    out[:3, 3] = out[3, :3] = covariance(lag) @ spikes
    return out


def _pairs(lag: Array, a: int, b: int, n: int) -> Array:
    """Return how many pairs of second differences are so far apart."""
    first, second = n + 1 - 2 * a, n + 1 - 2 * b
    pairs = np.minimum(first, second + lag) - np.maximum(0.0, lag)
    return np.asarray(np.maximum(pairs, 0.0))


def _lags(a: int, b: int, n: int) -> tuple[Array, Array]:
    """Return lags between second differences, and how many pairs each stands for."""
    first, second = n + 1 - 2 * a, n + 1 - 2 * b
    reach = 2 * (a + b)  # flicker is correlated a little beyond the overlap
    low, high = max(-2 * a - reach, 1 - second), min(2 * b + reach, first - 1)
    if high - low <= _EXACT:
        lag, weight = np.arange(low, high + 1.0), np.ones(high - low + 1)
    else:
        kinks = [b * j - a * i for i in range(3) for j in range(3)]
        edge = np.unique(np.clip([low, high, 0, first - second, *kinks], low, high))
        half, middle = 0.5 * np.diff(edge)[:, None], 0.5 * (edge[1:] + edge[:-1])[:, None]
        lag, weight = (middle + half * _NODES).ravel(), (half * _NODE_WEIGHTS).ravel()
    return lag, weight * _pairs(lag, a, b, n)
