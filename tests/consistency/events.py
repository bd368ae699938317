"""A gyro and sensors at their own times: seeded trials, and least squares over all epochs at once.

The gyro reads given numbers ``m``; the body turns at ``m - b(t) - n(t)`` with white noise ``n`` and
a bias ``b`` that walks. Between two events, samples or measurements, attitude and bias move by a
normal ``(d, e)`` whose covariance comes from a matrix exponential (`discretise`). In a gap of the
gyro the rate is the mean of its ends, with more noise. Nothing here is of the core.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, TypeAlias

import celestcore as cc
import numpy as np
from scipy.spatial.transform import Rotation
from simulate import FloatArray, discretise, exp, local, multiply

State: TypeAlias = "tuple[FloatArray, FloatArray]"
Term: TypeAlias = "tuple[list[int], Callable[..., FloatArray], FloatArray]"
UNIT = 1e-2
"""Of the unknowns, and step of the differences, in 1-sigmas of the start."""


@dataclass(frozen=True)
class Plan:
    """When what is measured, and how well."""

    t: FloatArray
    """Of the gyro's samples (n,)."""
    rate: FloatArray
    """Its readings (n, 3) [rad/s]."""
    arw: float
    rrw: float
    sigma0: tuple[float, float]
    cameras: dict[str, tuple[FloatArray, FloatArray, FloatArray]]
    """By name: times (m,), noise covariance in the camera's frame (3, 3), mounting (4,)."""
    directions: dict[str, tuple[FloatArray, float, FloatArray]]
    """By name: times (m,), 1-sigma [rad], the direction in inertial axes (3,)."""
    max_gap: float = np.inf
    gap_rate_sigma: float = 0.0

    @property
    def events(self) -> FloatArray:
        """Times of all samples and measurements, each once."""
        tables = [t for t, *_ in (*self.cameras.values(), *self.directions.values())]
        return np.unique(np.concatenate([self.t, *tables]))

    def inputs(self) -> tuple[FloatArray, FloatArray]:
        """Return rate (m, 3) and angle random walk (m,) between the events."""
        k = np.searchsorted(self.t, self.events[:-1], side="right") - 1
        gap = np.diff(self.t) > self.max_gap
        mean = 0.5 * (self.rate[1:] + self.rate[:-1])
        rate = np.where(gap[:, None], mean, self.rate[:-1])
        extra = np.where(gap, self.gap_rate_sigma**2 * np.diff(self.t), 0.0)
        return rate[k], np.sqrt(self.arw**2 + extra[k])

    def noise(self, bias: FloatArray | float = 0.0) -> tuple[FloatArray, FloatArray]:
        """Return transition and noise (m, 6, 6) between the events."""
        rate, arw = self.inputs()
        parts = [
            discretise(w, dt, a, self.rrw)
            for w, dt, a in zip(rate - bias, np.diff(self.events), arw, strict=True)
        ]
        f, q = zip(*parts, strict=True)
        return np.array(f), np.array(q)

    def navigator(self, filter: Any, gate: float | None = None) -> cc.StarGyroNavigator:  # noqa: A002
        gyro = cc.Gyro(
            self.arw,
            self.rrw,
            max_gap=None if np.isinf(self.max_gap) else self.max_gap,
            gap_rate_sigma=self.gap_rate_sigma,
        )
        stars = {
            name: cc.StarCamera(covariance=r, mounting=mounting)
            for name, (_, r, mounting) in self.cameras.items()
        }
        vectors = {name: cc.VectorSensor(s) for name, (_, s, _) in self.directions.items()}
        return cc.StarGyroNavigator(filter, gyro, stars, vectors or None, gate=gate)


@dataclass(frozen=True)
class Flown:
    """Trials of a plan: truth at the events, and measurements; the leading axis is the trial."""

    plan: Plan
    q: FloatArray
    bias: FloatArray
    q0: FloatArray
    bias0: FloatArray
    fixes: dict[str, FloatArray]
    seen: dict[str, FloatArray]

    def log(self, trial: int) -> cc.SensorLog:
        p = self.plan
        tables = {n: (t, self.fixes[n][trial]) for n, (t, *_) in p.cameras.items()}
        for name, (t, _, known) in p.directions.items():
            tables[f"vector_{name}"] = (t, self.seen[name][trial], np.tile(known, (len(t), 1)))
        return cc.SensorLog(gyro=(p.t, p.rate), **tables)

    def start(self, trial: int) -> dict[str, Any]:
        return {
            "q0": self.q0[trial],
            "bias0": self.bias0[trial],
            "sigma0": self.plan.sigma0,
            "covariance": True,
        }

    def error(self, sol: cc.Solution, trial: int) -> FloatArray:
        """Return true less estimated error state at the solution's rows (n, 6)."""
        k = np.searchsorted(self.plan.events, sol.t)
        turn = local(sol.q, self.q[trial, k])
        return np.hstack([turn, self.bias[trial, k] - sol.bias])


def fly(plan: Plan, trials: int, seed: int, outliers: float = 0.0) -> Flown:
    """Return trials; a share of the fixes are wrong by a hundred sigma if `outliers` says so."""
    rng = np.random.default_rng(seed)
    rate, _ = plan.inputs()
    _, noise = plan.noise()
    dt = np.diff(plan.events)
    scale = np.sqrt(np.diagonal(noise, axis1=1, axis2=2))
    root = np.linalg.cholesky(noise / (scale[:, :, None] * scale[:, None, :])) * scale[:, :, None]
    drawn = (root @ rng.standard_normal((trials, len(dt), 6, 1)))[..., 0]
    q = np.empty((trials, len(dt) + 1, 4))
    bias = np.empty((trials, len(dt) + 1, 3))
    q[:, 0] = Rotation.random(trials, random_state=rng).as_quat()
    bias[:, 0] = plan.sigma0[1] * rng.standard_normal((trials, 3))
    for i in range(len(dt)):
        step = multiply(exp((rate[i] - bias[:, i]) * dt[i]), exp(drawn[:, i, :3]))
        q[:, i + 1] = multiply(q[:, i], step)
        q[:, i + 1] /= np.linalg.norm(q[:, i + 1], axis=1, keepdims=True)
        bias[:, i + 1] = bias[:, i] + drawn[:, i, 3:]
    first = rng.standard_normal((trials, 6)) * np.repeat(plan.sigma0, 3)
    fixes, seen = {}, {}
    for name, (t, r, mounting) in plan.cameras.items():
        now = q[:, np.searchsorted(plan.events, t)]
        error = rng.standard_normal((trials, len(t), 3)) @ np.linalg.cholesky(r).T
        wrong = rng.random((trials, len(t), 1)) < outliers
        error = np.where(wrong, 100.0 * np.sqrt(np.trace(r)), error)
        fixes[name] = multiply(multiply(now, mounting), exp(error))
    for name, (t, sigma, known) in plan.directions.items():
        now = q[:, np.searchsorted(plan.events, t)]
        back = Rotation.from_quat(now.reshape(-1, 4)[:, [1, 2, 3, 0]]).inv()
        b = back.apply(known)
        arc = sigma * rng.standard_normal(b.shape)
        arc -= np.sum(arc * b, axis=1, keepdims=True) * b  # across the direction, normal in length
        seen[name] = Rotation.from_rotvec(arc).apply(b).reshape(trials, len(t), 3)
    return Flown(
        plan=plan,
        q=q,
        bias=bias,
        q0=multiply(q[:, 0], exp(-first[:, :3])),
        bias0=bias[:, 0] - first[:, 3:],
        fixes=fixes,
        seen=seen,
    )


def least_squares(
    flown: Flown, trial: int, guess: tuple[FloatArray, FloatArray]
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return attitudes (m, 4), biases (m, 3) and covariances (m, 6, 6) at all events.

    Gauss-Newton on all states together: residuals of the start, of every step and of every fix,
    each whitened by its covariance; derivatives by differences; normal equations, dense. Cameras
    only. `guess` is where it begins.
    """
    plan = flown.plan
    q, bias = guess
    n = len(plan.events)
    unit = np.repeat(plan.sigma0, 3) * UNIT
    for _ in range(10):
        normal, right = np.zeros((6 * n, 6 * n)), np.zeros(6 * n)
        for states, residual, white in _terms(flown, trial, bias):
            r, jac = _linear(states, residual, white, (q, bias), unit)
            at = np.concatenate([np.arange(6 * s, 6 * s + 6) for s in states])
            normal[np.ix_(at, at)] += jac.T @ jac
            right[at] -= jac.T @ r
        move = (np.linalg.solve(normal, right).reshape(n, 6)) * unit
        q, bias = multiply(q, exp(move[:, :3])), bias + move[:, 3:]
        if np.abs(move / unit).max() < 1e-4:
            break
    full = np.linalg.inv(normal)
    blocks = np.array([full[6 * i : 6 * i + 6, 6 * i : 6 * i + 6] for i in range(n)])
    return q, bias, blocks * unit[:, None] * unit


def _linear(
    states: list[int],
    residual: Callable[..., FloatArray],
    white: FloatArray,
    at: State,
    unit: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Return a whitened residual and its derivative to the states it sees, in units."""
    q, bias = at
    here = [(q[s], bias[s]) for s in states]
    d = np.vstack([np.diag(unit), -np.diag(unit)])
    columns = []
    for place, (turn, walk) in enumerate(here):
        moved = list(here)
        moved[place] = (multiply(turn, exp(d[:, :3])), walk + d[:, 3:])
        sides = residual(*moved) @ white.T
        columns.append(0.5 * (sides[:6] - sides[6:]))
    return white @ residual(*here), np.concatenate(columns).T


def _terms(flown: Flown, trial: int, bias: FloatArray) -> Iterator[Term]:
    """Yield, for every residual, the events it sees, itself and what whitens it."""
    plan = flown.plan
    rate, _ = plan.inputs()
    dt = np.diff(plan.events)
    q0, b0 = flown.q0[trial], flown.bias0[trial]

    def white(p: FloatArray) -> FloatArray:
        scale = np.sqrt(np.diag(p))
        return np.linalg.inv(np.linalg.cholesky(p / np.outer(scale, scale))) / scale

    def start(x: State) -> FloatArray:
        return np.concatenate([local(q0, x[0]), x[1] - b0], axis=-1)

    yield [0], start, np.diag(1.0 / np.repeat(plan.sigma0, 3))
    _, noise = plan.noise(bias[:-1].mean(axis=0))
    for i in range(len(dt)):

        def step(x: State, y: State, i: int = i) -> FloatArray:
            there = multiply(x[0], exp((rate[i] - x[1]) * dt[i]))
            return np.concatenate([local(there, y[0]), y[1] - x[1]], axis=-1)

        yield [i, i + 1], step, white(noise[i])
    for name, (t, r, mounting) in plan.cameras.items():
        for k, s in enumerate(np.searchsorted(plan.events, t)):
            z = flown.fixes[name][trial, k]

            def fix(x: State, z: FloatArray = z, mounting: FloatArray = mounting) -> FloatArray:
                return local(multiply(x[0], mounting), z)

            yield [int(s)], fix, white(r)
