"""Quaternions and the unscented transform in JAX; imports it when first called."""

from __future__ import annotations

from typing import Any

Array = Any


def numpy() -> Any:
    """Return ``jax.numpy`` in double precision."""
    import jax

    jax.config.update("jax_enable_x64", True)
    return jax.numpy


def multiply(a: Array, b: Array) -> Array:
    """Return the product of quaternions."""
    jnp = numpy()
    return jnp.stack(
        [
            a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
            a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
            a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1],
            a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0],
        ]
    )


def exp(v: Array) -> Array:
    """Return the quaternion of a rotation vector."""
    jnp = numpy()
    angle = jnp.sqrt(v @ v + 1e-60)
    return jnp.concatenate([jnp.cos(0.5 * angle)[None], jnp.sin(0.5 * angle) / angle * v])


def between(a: Array, b: Array) -> Array:
    """Return the rotation vector from attitude a to attitude b."""
    jnp = numpy()
    q = multiply(a * jnp.array([1.0, -1.0, -1.0, -1.0]), b)
    q = jnp.where(q[0] < 0.0, -q, q)
    n = jnp.sqrt(q[1:] @ q[1:] + 1e-60)
    return 2.0 * jnp.arctan2(n, q[0]) / n * q[1:]


def matrix(q: Array) -> Array:
    """Return the matrix of a quaternion."""
    jnp = numpy()
    w, x, y, z = q
    return jnp.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def normalised(q: Array) -> Array:
    """Return a unit quaternion."""
    return q / numpy().sqrt(q @ q)


def inverse3(a: Array) -> Array:
    """Return the inverse of a symmetric 3x3 matrix: XLA's solvers cost more than it."""
    jnp = numpy()
    r0 = jnp.cross(a[1], a[2])
    return jnp.stack([r0, jnp.cross(a[2], a[0]), jnp.cross(a[0], a[1])], axis=1) / (a[0] @ r0)


def cholesky6(p: Array) -> Array:
    """Return the lower factor of a 6x6 matrix, unrolled for the same reason."""
    jnp = numpy()
    low: list[list[Array]] = [[0.0] * 6 for _ in range(6)]
    for j in range(6):
        d = p[j, j]
        for k in range(j):
            d = d - low[j][k] * low[j][k]
        low[j][j] = jnp.sqrt(d)
        for i in range(j + 1, 6):
            s = p[i, j]
            for k in range(j):
                s = s - low[i][k] * low[j][k]
            low[i][j] = s / low[j][j]
    return jnp.array([[jnp.asarray(v, dtype=jnp.float64) for v in row] for row in low])


def points(p: Array) -> Array:
    """Return 13 deviations (13, 6) for ``n + kappa = 3``, the centre first."""
    jnp = numpy()
    low = jnp.sqrt(3.0) * cholesky6(p).T
    return jnp.concatenate([jnp.zeros((1, 6)), low, -low])


def weights() -> tuple[Array, Array]:
    """Return the weights of means and of covariances: alpha 1, beta 2."""
    jnp = numpy()
    others = jnp.full(12, 1.0 / 6.0)
    first = jnp.array([-1.0])
    return jnp.concatenate([first, others]), jnp.concatenate([-first, others])
