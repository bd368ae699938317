"""Small matrices and quaternions for numba: loops over arrays that are there already."""

from __future__ import annotations

import math
from typing import Any

from celestcore.bench.peers._compiled import compiled

Array = Any


@compiled
def multiply(a: Array, b: Array, out: Array) -> None:
    """Write a quaternion product."""
    w = a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3]
    x = a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2]
    y = a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1]
    z = a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0]
    out[0], out[1], out[2], out[3] = w, x, y, z


@compiled
def normalise(q: Array) -> None:
    """Make a quaternion unit, in place."""
    scale = 1.0 / math.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    for i in range(4):
        q[i] *= scale


@compiled
def exp(x: float, y: float, z: float, out: Array) -> None:
    """Write the quaternion of a rotation vector."""
    angle = math.sqrt(x * x + y * y + z * z)
    s = 0.5 if angle < 1e-9 else math.sin(0.5 * angle) / angle
    out[0], out[1], out[2], out[3] = math.cos(0.5 * angle), s * x, s * y, s * z


@compiled
def between(a: Array, b: Array, out: Array) -> None:
    """Write the rotation vector from attitude a to attitude b."""
    w = a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3]
    x = a[0] * b[1] - a[1] * b[0] - a[2] * b[3] + a[3] * b[2]
    y = a[0] * b[2] + a[1] * b[3] - a[2] * b[0] - a[3] * b[1]
    z = a[0] * b[3] - a[1] * b[2] + a[2] * b[1] - a[3] * b[0]
    sign = 1.0 if w >= 0.0 else -1.0
    n = math.sqrt(x * x + y * y + z * z)
    k = 2.0 * sign if n < 1e-12 else 2.0 * math.atan2(n, sign * w) / n * sign
    out[0], out[1], out[2] = k * x, k * y, k * z


@compiled
def invert3(a: Array, out: Array) -> None:
    """Write the inverse of a symmetric 3x3 matrix."""
    c00 = a[1, 1] * a[2, 2] - a[1, 2] * a[2, 1]
    c01 = a[1, 2] * a[2, 0] - a[1, 0] * a[2, 2]
    c02 = a[1, 0] * a[2, 1] - a[1, 1] * a[2, 0]
    d = 1.0 / (a[0, 0] * c00 + a[0, 1] * c01 + a[0, 2] * c02)
    out[0, 0], out[0, 1], out[0, 2] = c00 * d, c01 * d, c02 * d
    out[1, 0] = out[0, 1]
    out[1, 1] = (a[0, 0] * a[2, 2] - a[0, 2] * a[2, 0]) * d
    out[1, 2] = (a[0, 2] * a[1, 0] - a[0, 0] * a[1, 2]) * d
    out[2, 0], out[2, 1] = out[0, 2], out[1, 2]
    out[2, 2] = (a[0, 0] * a[1, 1] - a[0, 1] * a[1, 0]) * d


@compiled
def cholesky6(p: Array, scale: float, out: Array) -> None:
    """Write the lower factor of ``scale * p``."""
    for j in range(6):
        d = scale * p[j, j]
        for k in range(j):
            d -= out[j, k] * out[j, k]
        out[j, j] = math.sqrt(d)
        for i in range(j + 1, 6):
            s = scale * p[i, j]
            for k in range(j):
                s -= out[i, k] * out[j, k]
            out[i, j] = s / out[j, j]


@compiled
def gain(p: Array, s: Array, cross: Array, innovation: Array, dx: Array, work: Array) -> None:
    """Write the correction ``cross S^-1 y`` and take its part from P; `work` is (9, 3)."""
    invert3(s, work[6:])
    for i in range(6):
        dx[i] = 0.0
        for j in range(3):
            work[i, j] = 0.0
            for k in range(3):
                work[i, j] += cross[i, k] * work[6 + k, j]
            dx[i] += work[i, j] * innovation[j]
    for i in range(6):
        for j in range(i + 1):
            for k in range(3):
                p[i, j] -= work[i, k] * cross[j, k]
            p[j, i] = p[i, j]


@compiled
def moments(d: Array, n: int, e: Array, m: int, mean: Array, out: Array) -> None:
    """Write the mean of e, and the covariance of d and e over 13 points whose first is zero.

    Weights of the unscented transform for ``n + kappa = 3``, alpha 1, beta 2 on six states: 1/6 for
    each point but the centre, whose deviation is minus the mean and whose weight is 1.
    """
    for j in range(m):
        mean[j] = 0.0
        for k in range(1, 13):
            mean[j] += e[k, j] / 6.0
    for i in range(n):
        centre = 0.0
        for k in range(1, 13):
            centre += d[k, i] / 6.0
        for j in range(m):
            out[i, j] = centre * mean[j]
            for k in range(1, 13):
                out[i, j] += d[k, i] * e[k, j] / 6.0
