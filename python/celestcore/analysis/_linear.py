"""The linear system behind attitude and gyro bias, and its Riccati equation; arrays batched.

Error state: attitude (body-frame rotation vector, rad), bias (rad/s). Leading axes are cases.
"""

from __future__ import annotations

from math import factorial

import numpy as np
from numpy.typing import ArrayLike, NDArray

from celestcore.errors import NumericalError

Array = NDArray[np.float64]

_DOUBLINGS = 64


def _coefficients(theta2: float) -> tuple[float, float, float, float]:
    """Return (1-cos t)/t^2, (t-sin t)/t^3, (1/2-c1)/t^2, (1/3-2 c2)/t^2 of the squared angle."""
    if theta2 < 0.25:
        terms = [(-theta2) ** k for k in range(9)]
        c1, c2 = (sum(x / factorial(2 * k + n) for k, x in enumerate(terms)) for n in (2, 3))
        c3, c4 = (sum(x / factorial(2 * k + n) for k, x in enumerate(terms)) for n in (4, 5))
        return c1, c2, c3, 2.0 * c4
    t = np.sqrt(theta2)
    c1 = 2.0 * np.sin(0.5 * t) ** 2 / theta2
    c2 = (t - np.sin(t)) / (theta2 * t)
    return c1, c2, (0.5 - c1) / theta2, (1.0 / 3.0 - 2.0 * c2) / theta2


def gyro_step(arw: ArrayLike, rrw: float, rate: Array, dt: float) -> tuple[Array, Array]:
    """Return transition (6, 6) and noise (..., 6, 6) over `dt` at a constant body rate, exactly.

    The same closed forms as the filter's own; their limit for slow rotation is Farrenkopf (1978).
    """
    x, y, z = rate * dt
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    square, eye = cross @ cross, np.eye(3)
    c1, c2, c3, c4 = _coefficients(float(x * x + y * y + z * z))
    theta2 = x * x + y * y + z * z
    f = np.eye(6)
    f[:3, :3] = eye - (1.0 - c2 * theta2) * cross + c1 * square  # sin t / t = 1 - c2 t^2
    f[:3, 3:] = -dt * (eye - c1 * cross + c2 * square)
    a2, w2 = np.square(np.asarray(arw, dtype=np.float64))[..., None, None], rrw * rrw
    q = np.zeros((*a2.shape[:-2], 6, 6))
    q[..., :3, :3] = a2 * dt * eye + w2 * dt**3 * (eye / 3.0 + c4 * square)
    q[..., :3, 3:] = w2 * dt**2 * (-0.5 * eye + c2 * cross - c3 * square)
    q[..., 3:, :3] = np.swapaxes(q[..., :3, 3:], -1, -2)
    q[..., 3:, 3:] = w2 * dt * eye
    return f, q


def farrenkopf(
    arw: ArrayLike, rrw: float, sigma: ArrayLike, dt: float
) -> tuple[Array, Array, Array, Array]:
    """Return variances of one axis at rest: attitude before and after a fix, bias the same.

    Farrenkopf (1978) in the form of Markley and Crassidis, *Fundamentals of Spacecraft Attitude
    Determination and Control*, 2014, section 6.3, without readout noise.
    """
    sigma = np.asarray(sigma, dtype=np.float64)
    su, sv = rrw * dt**1.5 / sigma, np.asarray(arw) * np.sqrt(dt) / sigma
    # zeta + 1/zeta - 2, kept apart so that small noise does not cancel
    square = 0.25 * sv * sv + su * su / 48.0
    excess = 0.5 * su + 2.0 * square / (1.0 + np.sqrt(1.0 + square))
    less = 0.5 * (excess + np.sqrt(excess * (excess + 4.0)))  # zeta - 1
    zeta = 1.0 + less
    before = less * (zeta + 1.0)
    bias = su * before / zeta - 0.5 * su * su
    variance = sigma * sigma
    after_bias = variance * bias / dt**2
    return variance * before, variance * before / zeta**2, after_bias + rrw**2 * dt, after_bias


def transposed(a: Array) -> Array:
    return np.swapaxes(a, -1, -2)


def symmetric(a: Array) -> Array:
    return np.asarray(0.5 * (a + transposed(a)))


def riccati(f: Array, q: Array, information: Array) -> Array:
    """Return the covariance (..., n, n) just before a fix, in steady state.

    ``P = F P (I + J P)^-1 F' + Q`` with J the information of a fix, by structured doubling: each
    round squares the number of fixes (Chu, Fan, Lin and Wang, *Structure-preserving algorithms for
    periodic discrete-time algebraic Riccati equations*, Int. J. Control 77, 2004).

    Raises
    ------
    NumericalError
        If it does not settle.
    """
    a, g, h = np.broadcast_arrays(transposed(f), information, q)
    eye = np.eye(f.shape[-1])
    for _ in range(_DOUBLINGS):
        w = eye + g @ h
        solved_a, solved_g = np.linalg.solve(w, a), np.linalg.solve(w, g)
        step = transposed(a) @ h @ solved_a
        a, g, h = a @ solved_a, symmetric(g + a @ solved_g @ transposed(a)), symmetric(h + step)
        size = np.abs(h).max(axis=(-1, -2))
        if np.all(np.abs(step).max(axis=(-1, -2)) <= 1e-16 * size):
            return h
        if not np.isfinite(size).all():
            break
    raise NumericalError("the covariance does not settle: the noises differ by too many orders")


def updated(p: Array, noise: Array) -> tuple[Array, Array]:
    """Return covariance after a fix of the first three states, and gain (..., n, 3)."""
    s = p[..., :3, :3] + noise
    gain = transposed(np.asarray(np.linalg.solve(s, p[..., :3, :])))
    left = np.broadcast_to(np.eye(p.shape[-1]), p.shape).copy()
    left[..., :, :3] -= gain
    joseph = left @ p @ transposed(left) + gain @ noise @ transposed(gain)
    return symmetric(joseph), gain


def smoothed(f: Array, q: Array, after: Array, before: Array) -> Array:
    """Return the fixed point of the Rauch-Tung-Striebel recursion at fixes.

    ``X = P+ + C (X - P-) C'`` (Rauch, Tung and Striebel 1965, eq. 3.31), summed by doubling.
    """
    gain = transposed(np.asarray(np.linalg.solve(before, f @ after)))
    left = np.eye(f.shape[-1]) - gain @ f
    x = symmetric(left @ after @ transposed(left) + gain @ q @ transposed(gain))
    power = gain
    for _ in range(_DOUBLINGS):
        step = power @ x @ transposed(power)
        x, power = symmetric(x + step), power @ power
        if np.all(np.abs(step).max(axis=(-1, -2)) <= 1e-17 * np.abs(x).max(axis=(-1, -2))):
            break
    return x
