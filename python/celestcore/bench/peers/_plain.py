"""Quaternions in plain numpy, for peers that bring none."""

from __future__ import annotations

import numpy as np

from celestcore._check import FloatArray


def multiply(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return the product of quaternions."""
    w, x, y, z = a
    left = np.array([[w, -x, -y, -z], [x, w, -z, y], [y, z, w, -x], [z, -y, x, w]])
    return np.asarray(left @ b)


def conjugate(q: FloatArray) -> FloatArray:
    """Return the conjugate."""
    return np.asarray(q * np.array([1.0, -1.0, -1.0, -1.0]))


def exp(v: FloatArray) -> FloatArray:
    """Return the quaternion of a rotation vector."""
    angle = float(np.sqrt(v @ v))
    s = 0.5 if angle < 1e-9 else np.sin(0.5 * angle) / angle
    return np.array([np.cos(0.5 * angle), *(s * v)])


def log(q: FloatArray) -> FloatArray:
    """Return the rotation vector of a quaternion of either sign."""
    q = -q if q[0] < 0.0 else q
    n = float(np.sqrt(q[1:] @ q[1:]))
    k = 2.0 if n < 1e-12 else 2.0 * np.arctan2(n, q[0]) / n
    return np.asarray(k * q[1:])


def matrix(q: FloatArray) -> FloatArray:
    """Return the matrix of a quaternion."""
    w, x, y, z = q
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def rk4(q: FloatArray, rate: FloatArray, dt: float) -> FloatArray:
    """Return the attitude after a Runge-Kutta step of constant rate."""
    turn = np.array([0.0, *(0.5 * rate)])
    k1 = multiply(q, turn)
    k2 = multiply(q + 0.5 * dt * k1, turn)
    k3 = multiply(q + 0.5 * dt * k2, turn)
    k4 = multiply(q + dt * k3, turn)
    out = q + dt / 6.0 * (k1 + 2.0 * (k2 + k3) + k4)
    return np.asarray(out / np.linalg.norm(out))
