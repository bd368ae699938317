"""What the works are done on: made-up logs, the same for celestcore and for every peer."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from celestcore import orbit, quaternion
from celestcore._check import FloatArray
from celestcore.celestial import CelestialLog
from celestcore.log import SensorLog

SEED = 20240607
LANES = 8
"""Logs of a batch."""


@dataclass(frozen=True, eq=False)
class AttitudeInput:
    """A gyro log with a star fix at every second sample.

    The filter starts at the first sample from the fix `q0` and no bias; sample k holds from
    ``t[k]`` to ``t[k + 1]``; fix j after the first is at ``t[2 j + 2]``.
    """

    t: FloatArray
    gyro: FloatArray
    q0: FloatArray
    fix_t: FloatArray
    fix_q: FloatArray
    dt: float = 0.01
    arw: float = 2.5e-5
    rrw: float = 3e-7
    sigma: float = 1.45e-4
    sigma0: tuple[float, float] = (1.45e-4, 1e-3)

    @property
    def steps(self) -> int:
        """Steps of the filter."""
        return len(self.t) - 1

    @property
    def log(self) -> SensorLog:
        """The same as celestcore takes it."""
        times, fixes = [self.t[:1], self.fix_t], [self.q0[None], self.fix_q]
        star = (np.concatenate(times), np.concatenate(fixes))
        return SensorLog(gyro=(self.t, self.gyro), star=star)

    @property
    def noise(self) -> FloatArray:
        """Covariance that a step adds (6, 6), without the turn within the step."""
        a, b, dt = self.arw**2, self.rrw**2, self.dt
        blocks = [[a * dt + b * dt**3 / 3.0, -b * dt**2 / 2.0], [-b * dt**2 / 2.0, b * dt]]
        return np.kron(np.array(blocks), np.eye(3))

    @property
    def covariance0(self) -> FloatArray:
        """Covariance of the start (6, 6)."""
        return np.diag(np.repeat(np.square(self.sigma0), 3))


@lru_cache(maxsize=4)
def attitude(steps: int, seed: int = SEED) -> AttitudeInput:
    """Return a log of so many steps of 10 ms, turning by some hundredths of a radian a second."""
    random = np.random.default_rng(seed)
    dt, n = AttitudeInput.dt, steps + 1
    t = np.asarray(dt * np.arange(n), dtype=np.float64)
    rate = np.stack(
        [0.02 * np.sin(0.1 * t), 0.02 * np.cos(0.13 * t), 0.01 * np.sin(0.07 * t) + 0.01], axis=1
    )
    walk = AttitudeInput.rrw * np.sqrt(dt) * random.standard_normal((n, 3))
    bias = np.array([1e-4, -2e-4, 1.5e-4]) + np.cumsum(walk, axis=0)
    gyro = rate + bias + AttitudeInput.arw / np.sqrt(dt) * random.standard_normal((n, 3))
    truth = quaternion.propagate([1.0, 0.0, 0.0, 0.0], rate[:-1], dt)[::2]
    error = quaternion.exp(AttitudeInput.sigma * random.standard_normal((len(truth), 3)))
    seen = quaternion.multiply(truth, error)
    return AttitudeInput(t, gyro, seen[0], t[2::2], np.ascontiguousarray(seen[1:]))


@lru_cache(maxsize=2)
def batch(steps: int) -> tuple[AttitudeInput, ...]:
    """Return logs of equal length with different noise, as many as there are lanes."""
    return tuple(attitude.__wrapped__(steps, SEED + k) for k in range(LANES))


@dataclass(frozen=True, eq=False)
class OrbitInput:
    """Three star angles to the nadir every 10 s, of a satellite that only J2 disturbs.

    The filter starts at time 0 from ``(r0, v0)``, off the truth; epoch k is at ``(k + 1) period``.
    """

    angle: FloatArray
    star: FloatArray
    truth: FloatArray
    r0: FloatArray
    v0: FloatArray
    accel_psd: float
    sigma0: tuple[float, float]
    period: float = 10.0
    sigma: float = 1e-4

    @property
    def steps(self) -> int:
        """Steps of the filter."""
        return len(self.angle)

    @property
    def log(self) -> CelestialLog:
        """The same as celestcore takes it."""
        t = self.period * np.arange(1, self.steps + 1)
        stars = np.tile(self.star, (self.steps, 1))
        return CelestialLog(horizon=(np.repeat(t, 3), stars, self.angle.ravel()))

    @property
    def constants(self) -> tuple[float, float, float]:
        """Mu [m^3/s^2], radius [m] and J2 of the force."""
        told = orbit.ForceModel.j2()._described()
        return told["mu"], told["radius"], told["j2"]

    @property
    def noise(self) -> FloatArray:
        """Covariance that a step adds (6, 6)."""
        q, dt = self.accel_psd, self.period
        blocks = [[q * dt**3 / 3.0, q * dt**2 / 2.0], [q * dt**2 / 2.0, q * dt]]
        return np.kron(np.array(blocks), np.eye(3))

    @property
    def covariance0(self) -> FloatArray:
        """Covariance of the start (6, 6)."""
        return np.diag(np.repeat(np.square(self.sigma0), 3))


START = np.array([7.0e6, 0.0, 0.0, 0.0, 7546.0 * np.cos(1.2), 7546.0 * np.sin(1.2)])
"""Position [m] and velocity [m/s] of the satellite at time 0."""
STARS = np.array([[0.3, 0.5, 0.81], [-0.7, 0.2, 0.4], [0.1, -0.8, 0.55]])


@lru_cache(maxsize=4)
def sky(steps: int, accel_psd: float = 1e-7, sigma0: float = 1e3) -> OrbitInput:
    """Return so many epochs; `sigma0` is the start's, of its position in m and velocity in mm/s."""
    random = np.random.default_rng(SEED + 1)
    t = OrbitInput.period * np.arange(steps + 1)
    path = orbit.propagate(orbit.ForceModel.j2(), None, START[:3], START[3:], t, method="rk4")
    star = STARS / np.linalg.norm(STARS, axis=1, keepdims=True)
    down = -path.r[1:] / np.linalg.norm(path.r[1:], axis=1, keepdims=True)
    angle = np.arccos(down @ star.T) + OrbitInput.sigma * random.standard_normal((steps, 3))
    off = 0.5 * sigma0 * np.array([1.0, -1.0, 1.0])
    start = (sigma0, 1e-3 * sigma0)
    return OrbitInput(angle, star, path.state[1:], START[:3] + off, START[3:], accel_psd, start)


@lru_cache(maxsize=2)
def weights(count: int) -> FloatArray:
    """Return weights of sum one, as uneven as those of particles after a measurement."""
    w = np.exp(-2.0 * np.random.default_rng(SEED + 2).standard_normal(count) ** 2)
    return np.asarray(w / w.sum())
