"""JAX: the unscented filter as a `scan`, its sigma points by `vmap`."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from celestcore.bench._inputs import OrbitInput
from celestcore.bench._outcome import Outcome
from celestcore.bench.peers import _jax_math as m

Array = Any


def _rate(x: Array, constants: tuple[float, float, float]) -> Array:
    (mu, re, j2), r = constants, x[:3]
    inverse = 1.0 / (r @ r)
    g, k, z = -mu * inverse**1.5, 1.5 * j2 * re * re * inverse, 5.0 * r[2] ** 2 * inverse
    pull = g * (1.0 + k * (m.numpy().array([1.0, 1.0, 3.0]) - z))
    return m.numpy().concatenate([x[3:], pull * r])


def _rk4(x: Array, constants: tuple[float, float, float], h: float) -> Array:
    k1 = _rate(x, constants)
    k2 = _rate(x + 0.5 * h * k1, constants)
    k3 = _rate(x + 0.5 * h * k2, constants)
    return x + h / 6.0 * (k1 + 2.0 * (k2 + k3) + _rate(x + h * k3, constants))


def ukf(given: OrbitInput) -> Callable[[], Outcome]:
    """Return a call of the unscented filter."""
    import jax

    jnp, (wm, wc) = m.numpy(), m.weights()
    star, noise, constants = jnp.asarray(given.star), jnp.asarray(given.noise), given.constants

    def angles(x: Array) -> Array:
        return jnp.arccos(-(star @ x[:3]) / jnp.sqrt(x[:3] @ x[:3]))

    def step(state: Any, seen: Array) -> Any:
        x, p = state
        xs = jax.vmap(lambda d: _rk4(x + d, constants, given.period))(m.points(p))
        d = xs - xs[0]
        mean = wm @ d
        x, d = xs[0] + mean, d - mean
        p = (wc * d.T) @ d + noise
        d = m.points(p)
        z = jax.vmap(lambda e: angles(x + e))(d)
        centre = z[0]
        zm = wm @ (z - centre)
        z = z - centre - zm
        cross = (wc * d.T) @ z
        gain = cross @ m.inverse3((wc * z.T) @ z + given.sigma**2 * jnp.eye(3))
        return (x + gain @ (seen - centre - zm), p - gain @ cross.T), None

    compiled = jax.jit(lambda x, p, z: jax.lax.scan(step, (x, p), z)[0])
    x0 = jnp.concatenate([jnp.asarray(given.r0), jnp.asarray(given.v0)])
    p0, seen = jnp.asarray(given.covariance0), jnp.asarray(given.angle)

    def call() -> Outcome:
        x, p = (np.asarray(part) for part in compiled(x0, p0, seen))
        return {"r": x[:3], "sigma": np.sqrt(np.diag(p))}

    return call
