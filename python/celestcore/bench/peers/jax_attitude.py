"""JAX: filters as a `scan`, sigma points and batches by `vmap`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from celestcore.bench._inputs import AttitudeInput
from celestcore.bench._outcome import Outcome
from celestcore.bench.peers import _jax_math as m

Array = Any


def propagation(given: AttitudeInput) -> Callable[[], Outcome]:
    """Return a call that propagates the readings: products in a tree, which is not sequential."""
    import jax

    jnp = m.numpy()

    def every(rates: Array) -> Array:
        turns = jax.vmap(lambda w: m.exp(given.dt * w))(rates)
        first = jnp.array([[1.0, 0.0, 0.0, 0.0]])
        product = jax.vmap(m.multiply)
        return jax.lax.associative_scan(product, jnp.concatenate([first, turns]))

    compiled, rates = jax.jit(every), jnp.asarray(given.gyro[:-1])
    return lambda: {"q": np.asarray(compiled(rates).block_until_ready()[-1])}


def _mekf_predict(q: Array, bias: Array, p: Array, rate: Array, dt: float, noise: Array) -> Any:
    jnp = m.numpy()
    turn = m.exp(dt * (rate - bias))
    top = jnp.concatenate([m.matrix(turn).T, -dt * jnp.eye(3)], axis=1)
    f = jnp.concatenate([top, jnp.eye(3, 6, 3)])
    return m.multiply(q, turn), bias, f @ p @ f.T + noise


def _mekf_update(q: Array, bias: Array, p: Array, fix: Array, r: float) -> Any:
    jnp = m.numpy()
    gain = p[:, :3] @ m.inverse3(p[:3, :3] + r * jnp.eye(3))
    dx = gain @ m.between(q, fix)
    kept = jnp.eye(6) - gain @ jnp.eye(3, 6)
    q = m.normalised(m.multiply(q, m.exp(dx[:3])))
    return q, bias + dx[3:], kept @ p @ kept.T + r * gain @ gain.T


def _rk4(q: Array, rate: Array, dt: float) -> Array:
    turn = m.numpy().concatenate([m.numpy().zeros(1), 0.5 * rate])
    k1 = m.multiply(q, turn)
    k2 = m.multiply(q + 0.5 * dt * k1, turn)
    k3 = m.multiply(q + 0.5 * dt * k2, turn)
    k4 = m.multiply(q + dt * k3, turn)
    return m.normalised(q + dt / 6.0 * (k1 + 2.0 * (k2 + k3) + k4))


def _ukf_predict(q: Array, bias: Array, p: Array, rate: Array, dt: float, noise: Array) -> Any:
    import jax

    jnp, d, (wm, wc) = m.numpy(), m.points(p), m.weights()

    def moved(e: Array) -> Array:
        return _rk4(m.multiply(q, m.exp(e[:3])), rate - bias - e[3:], dt)

    qs = jax.vmap(moved)(d)
    x = jnp.concatenate([jax.vmap(lambda to: m.between(qs[0], to))(qs), d[:, 3:]], axis=1)
    mean = wm @ x
    x = x - mean
    q = m.normalised(m.multiply(qs[0], m.exp(mean[:3])))
    return q, bias + mean[3:], (wc * x.T) @ x + noise


def _ukf_update(q: Array, bias: Array, p: Array, fix: Array, r: float) -> Any:
    import jax

    jnp, d, (wm, wc) = m.numpy(), m.points(p), m.weights()
    z = jax.vmap(lambda e: m.between(fix, m.multiply(q, m.exp(e[:3]))))(d)
    mean = wm @ z
    z = z - mean
    cross = (wc * d.T) @ z
    gain = cross @ m.inverse3((wc * z.T) @ z + r * jnp.eye(3))
    dx = -gain @ mean
    q = m.normalised(m.multiply(q, m.exp(dx[:3])))
    return q, bias + dx[3:], p - gain @ cross.T


def _filter(
    predict: Callable[..., Any], update: Callable[..., Any], given: Sequence[AttitudeInput]
) -> Callable[[], Outcome]:
    """Return a call over logs side by side: two predictions and an update in each step."""
    import jax

    jnp, one = m.numpy(), given[0]
    noise, dt, r = jnp.asarray(one.noise), one.dt, one.sigma**2

    def run(q: Array, p: Array, rates: Array, fixes: Array) -> Any:
        def step(state: Any, seen: Any) -> Any:
            pair, fix = seen
            for rate in pair:
                state = predict(*state, rate, dt, noise)
            return update(*state, fix, r), None

        return jax.lax.scan(step, (q, jnp.zeros(3), p), (rates, fixes))[0]

    compiled = jax.jit(jax.vmap(run))
    pairs = one.steps // 2
    gyro = np.stack([g.gyro[: 2 * pairs].reshape(pairs, 2, 3) for g in given])
    columns = (
        jnp.asarray(np.stack([g.q0 for g in given])),
        jnp.asarray(np.stack([g.covariance0 for g in given])),
        jnp.asarray(gyro),
        jnp.asarray(np.stack([g.fix_q[:pairs] for g in given])),
    )

    def call() -> Outcome:
        q, _, p = (np.asarray(part) for part in compiled(*columns))
        return {"q": q, "sigma": np.sqrt(np.diagonal(p, axis1=1, axis2=2))}

    return call


def mekf(given: AttitudeInput) -> Callable[[], Outcome]:
    """Return a call of the multiplicative extended Kalman filter."""
    return _filter(_mekf_predict, _mekf_update, [given])


def ukf(given: AttitudeInput) -> Callable[[], Outcome]:
    """Return a call of the unscented filter."""
    return _filter(_ukf_predict, _ukf_update, [given])


def mekf_batch(given: Sequence[AttitudeInput]) -> Callable[[], Outcome]:
    """Return a call of as many extended filters as there are logs."""
    return _filter(_mekf_predict, _mekf_update, given)


def ukf_batch(given: Sequence[AttitudeInput]) -> Callable[[], Outcome]:
    """Return a call of as many unscented filters as there are logs."""
    return _filter(_ukf_predict, _ukf_update, given)
