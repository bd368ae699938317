"""Many seeded trials of a gyro with star cameras or direction sensors, vectorised over the trials.

The truth is the continuous model itself. Over step ``k`` the gyro reports ``w_k + b_k``, with
``b_k`` the bias when the step begins. The body turns at ``w_k + b_k - b(t) - n(t)``: ``n`` is white
noise of density ``arw`` and the bias ``b(t)`` walks on inside the step with density ``rrw``. So the
attitude moves by ``exp(w_k dt)``, then by ``exp(d_k)``, and the bias by ``e_k``. ``(d_k, e_k)`` is
normal with the covariance that `discretise` takes from a matrix exponential, correlation and
rotation included. Nothing here shares a formula with the core.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

import celestcore as cc
import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

FloatArray: TypeAlias = NDArray[np.float64]
Discretise: TypeAlias = Callable[[FloatArray, float, float, float], "tuple[FloatArray, FloatArray]"]


def multiply(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return the Hamilton product, scalar first."""
    aw, ax, ay, az = a[..., 0], a[..., 1], a[..., 2], a[..., 3]
    bw, bx, by, bz = b[..., 0], b[..., 1], b[..., 2], b[..., 3]
    out = np.empty(np.broadcast_shapes(a.shape, b.shape))
    out[..., 0] = aw * bw - ax * bx - ay * by - az * bz
    out[..., 1] = aw * bx + bw * ax + ay * bz - az * by
    out[..., 2] = aw * by + bw * ay + az * bx - ax * bz
    out[..., 3] = aw * bz + bw * az + ax * by - ay * bx
    return out


def exp(v: FloatArray) -> FloatArray:
    """Return the quaternion of a rotation vector [rad]."""
    half = 0.5 * np.linalg.norm(v, axis=-1, keepdims=True)
    return np.concatenate([np.cos(half), 0.5 * np.sinc(half / np.pi) * v], axis=-1)


def local(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return the rotation vector, in the frame of `a`, from attitude `a` to attitude `b` [rad]."""
    turn = multiply(a * [1.0, -1.0, -1.0, -1.0], b)
    turn = turn * np.where(turn[..., :1] < 0.0, -1.0, 1.0)
    size = np.linalg.norm(turn[..., 1:], axis=-1, keepdims=True)
    angle = 2.0 * np.arctan2(size, turn[..., :1])
    return np.where(size > 0.0, angle / np.where(size > 0.0, size, 1.0), 2.0) * turn[..., 1:]


def skew(v: FloatArray) -> FloatArray:
    """Return the matrix of the cross product with `v`, (..., 3, 3)."""
    return np.cross(np.eye(3), v[..., None, :]).swapaxes(-1, -2) * -1.0


def discretise(
    rate: FloatArray, dt: float, arw: float, rrw: float
) -> tuple[FloatArray, FloatArray]:
    """Return transition and noise (..., 6, 6) over steps at constant body rate, by Van Loan (1978).

    Computed in units in which the noise is of order one, or the exponential would lose it.
    """
    unit = max(arw * np.sqrt(dt), rrw * dt**1.5)
    units = np.repeat([unit, unit / dt], 3)
    a = np.zeros((*rate.shape[:-1], 6, 6))
    a[..., :3, :3] = -skew(rate)
    a[..., :3, 3:] = -np.eye(3) / dt
    density = np.diag(np.repeat([arw**2, rrw**2], 3) / units**2)
    big = np.zeros((*rate.shape[:-1], 12, 12))
    big[..., :6, :6] = -a
    big[..., :6, 6:] = density
    big[..., 6:, 6:] = a.swapaxes(-1, -2)
    out = expm(big * dt)
    f = out[..., 6:, 6:].swapaxes(-1, -2)
    q = f @ out[..., :6, 6:]
    q = 0.5 * (q + q.swapaxes(-1, -2))
    return f * units[:, None] / units, q * units[:, None] * units


def discretise_small_angle(
    rate: FloatArray, dt: float, arw: float, rrw: float
) -> tuple[FloatArray, FloatArray]:
    """Return the same for a body that hardly turns in a step (Farrenkopf, 1978)."""
    eye, zero = np.eye(3), np.zeros((3, 3))
    f = np.block([[eye, -dt * eye], [zero, eye]])
    cross = -0.5 * rrw**2 * dt**2 * eye
    attitude = (arw**2 * dt + rrw**2 * dt**3 / 3.0) * eye
    q = np.block([[attitude, cross], [cross, rrw**2 * dt * eye]])
    shape = (*rate.shape[:-1], 6, 6)
    return np.broadcast_to(f, shape), np.broadcast_to(q, shape)


@dataclass(frozen=True)
class Scenario:
    """What is flown and with which sensors; one of `star_every` and `direction_every` may be 0."""

    rate: FloatArray
    """Rate of the body in each step (n, 3) [rad/s]."""
    dt: float
    arw: float
    rrw: float
    sigma0: tuple[float, float]
    """1-sigma of the start, attitude [rad] and bias [rad/s]."""
    star_every: int = 0
    star_sigma: tuple[float, float, float] = (2.5e-5, 5e-5, 1e-4)
    """Of the principal axes of a fix's noise [rad]; they point anywhere, elsewhere for each fix."""
    direction_every: int = 0
    direction_sigma: float = 1e-4
    discretise: Discretise = discretise

    @property
    def steps(self) -> int:
        return len(self.rate)


@dataclass(frozen=True)
class Trials:
    """Truth and measurements; the leading axis is the trial, the next the time."""

    scenario: Scenario
    t: FloatArray
    q: FloatArray
    bias: FloatArray
    rate: FloatArray
    q0: FloatArray
    bias0: FloatArray
    mounting: FloatArray
    star_t: FloatArray
    star_q: FloatArray
    star_covariance: FloatArray
    directions: dict[str, tuple[FloatArray, FloatArray, FloatArray]]
    """By name: times (m,), measured directions (trials, m, 3), known directions (m, 3)."""

    def __len__(self) -> int:
        return len(self.q)

    def log(self, trial: int) -> cc.SensorLog:
        star = None
        if len(self.star_t):
            star = (self.star_t, self.star_q[trial], self.star_covariance)
        vectors = {
            f"vector_{name}": (t, body[trial], inertial)
            for name, (t, body, inertial) in self.directions.items()
        }
        return cc.SensorLog(gyro=(self.t, self.rate[trial]), star=star, **vectors)

    def navigator(self, filter: cc.EKF | cc.UKF) -> cc.StarGyroNavigator:  # noqa: A002
        s = self.scenario
        return cc.StarGyroNavigator(
            filter,
            cc.Gyro(s.arw, s.rrw),
            cc.StarCamera(mounting=self.mounting),
            cc.VectorSensor(s.direction_sigma),
        )

    def run(self, navigator: cc.StarGyroNavigator, trial: int, every: int = 1) -> cc.Solution:
        return navigator.run(
            self.log(trial),
            t0=0.0,
            q0=self.q0[trial],
            bias0=self.bias0[trial],
            sigma0=self.scenario.sigma0,
            every=every,
            covariance=True,
        )


def simulate(scenario: Scenario, trials: int, seed: int | np.random.SeedSequence) -> Trials:
    """Return trials; the same bits for the same seed."""
    rng = np.random.default_rng(seed)
    q, bias = _truth(scenario, trials, rng)
    start = rng.standard_normal((trials, 6)) * np.repeat(scenario.sigma0, 3)
    t = scenario.dt * np.arange(scenario.steps + 1)
    mounting = Rotation.random(random_state=rng).as_quat()[[3, 0, 1, 2]]
    held = np.concatenate([scenario.rate, scenario.rate[-1:]])
    fixes = _fixes(scenario.star_every, scenario.steps)
    noise, star_q = _star(scenario, q[:, fixes], mounting, rng)
    return Trials(
        scenario=scenario,
        t=t,
        q=q,
        bias=bias,
        rate=held + bias,
        # truth = start + error, with the error on the right and drawn from the filter's own P0
        q0=multiply(q[:, 0], exp(-start[:, :3])),
        bias0=bias[:, 0] - start[:, 3:],
        mounting=mounting,
        star_t=t[fixes],
        star_q=star_q,
        star_covariance=noise,
        directions=_directions(scenario, t, q, rng),
    )


def _fixes(every: int, steps: int) -> NDArray[np.intp]:
    return np.arange(0, steps + 1, every) if every else np.arange(0)


def _truth(
    scenario: Scenario, trials: int, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    s = scenario
    rates, which = np.unique(s.rate, axis=0, return_inverse=True)
    _, noise = s.discretise(rates, s.dt, s.arw, s.rrw)
    scale = np.sqrt(np.diagonal(noise, axis1=-2, axis2=-1))
    root = np.linalg.cholesky(noise / (scale[:, :, None] * scale[:, None, :])) * scale[:, :, None]
    white = rng.standard_normal((trials, s.steps, 6, 1))
    drawn = (root[which.reshape(-1)] @ white)[..., 0]
    turn = multiply(exp(s.rate * s.dt), exp(drawn[..., :3]))
    q = np.empty((trials, s.steps + 1, 4))
    q[:, 0] = Rotation.random(trials, random_state=rng).as_quat()[:, [3, 0, 1, 2]]
    for k in range(s.steps):
        step = multiply(q[:, k], turn[:, k])
        q[:, k + 1] = step / np.sqrt(np.sum(step * step, axis=-1, keepdims=True))
    bias = np.zeros((trials, s.steps + 1, 3))
    bias[:, 0] = s.sigma0[1] * rng.standard_normal((trials, 3))
    bias[:, 1:] = bias[:, :1] + np.cumsum(drawn[..., 3:], axis=1)
    return q, bias


def _star(
    scenario: Scenario, q: FloatArray, mounting: FloatArray, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    """Return noise covariances in the camera frame (m, 3, 3) and fixes (trials, m, 4), any sign."""
    trials, count = q.shape[:2]
    axes = Rotation.random(count, random_state=rng).as_matrix() if count else np.zeros((0, 3, 3))
    root = axes * np.asarray(scenario.star_sigma)
    noise = np.einsum("kij,nkj->nki", root, rng.standard_normal((trials, count, 3)))
    sign = rng.choice([-1.0, 1.0], (trials, count, 1))
    return root @ root.swapaxes(-1, -2), sign * multiply(multiply(q, mounting), exp(noise))


def _directions(
    scenario: Scenario, t: FloatArray, q: FloatArray, rng: np.random.Generator
) -> dict[str, tuple[FloatArray, FloatArray, FloatArray]]:
    """Two sensors that see directions which turn in inertial space, each at its own times."""
    every = scenario.direction_every
    if not every:
        return {}
    angle = 2.0 * np.pi * t / t[-1]
    known = {
        "sun": np.stack([np.cos(0.3 * angle), np.sin(0.3 * angle), 0.2 + 0.0 * t], axis=-1),
        "field": np.stack([0.3 * np.sin(7.0 * angle), 0.5 + 0.0 * t, np.cos(7.0 * angle)], axis=-1),
    }
    out = {}
    for name, offset in (("sun", 0), ("field", every // 2)):
        rows = np.arange(offset, len(t), every)
        inertial = known[name][rows]
        inertial = inertial / np.linalg.norm(inertial, axis=-1, keepdims=True)
        back = q[:, rows] * [1.0, -1.0, -1.0, -1.0]
        body = _turned(back, inertial)
        # an arc of normal length, along either axis across the direction
        arc = scenario.direction_sigma * rng.standard_normal(body.shape)
        arc = arc - np.sum(arc * body, axis=-1, keepdims=True) * body
        out[name] = (t[rows], _turned(exp(arc), body), inertial)
    return out


def _turned(q: FloatArray, v: FloatArray) -> FloatArray:
    full = np.concatenate([np.zeros((*v.shape[:-1], 1)), v], axis=-1)
    return multiply(multiply(q, full), q * [1.0, -1.0, -1.0, -1.0])[..., 1:]


def changing_rate(steps: int, size: float, hold: int = 10) -> FloatArray:
    """Return rates (steps, 3) of length about `size`: every `hold` steps another size and axis."""
    k = (np.arange(steps) // hold * hold)[:, None]
    rate = np.cos(k * [0.0131, 0.0177, 0.0239] + [0.0, 1.0, 2.0])
    return size * (0.75 + 0.25 * np.sin(k * 0.0093)) * rate / np.linalg.norm(rate, axis=1)[:, None]
