"""filterpy: its Kalman filters on the error of an attitude that is kept beside them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from celestcore._check import FloatArray
from celestcore.bench._inputs import AttitudeInput
from celestcore.bench._outcome import Outcome
from celestcore.bench.peers import _plain as plain


def mekf(given: AttitudeInput) -> Callable[[], Outcome]:
    """Return a call of `KalmanFilter` on attitude error and bias."""
    from filterpy.kalman import KalmanFilter

    def call() -> Outcome:
        kf = KalmanFilter(dim_x=6, dim_z=3)
        kf.P, kf.Q, kf.H = given.covariance0, given.noise, np.eye(3, 6)
        kf.R = given.sigma**2 * np.eye(3)
        kf.F[:3, 3:] = -given.dt * np.eye(3)
        q, bias = given.q0, np.zeros(3)
        for k in range(given.steps):
            turn = plain.exp(given.dt * (given.gyro[k] - bias))
            q = plain.multiply(q, turn)
            kf.F[:3, :3] = plain.matrix(turn).T
            kf.x = np.zeros((6, 1))
            kf.predict()
            if k % 2 == 1:
                kf.update(plain.log(plain.multiply(plain.conjugate(q), given.fix_q[k // 2])))
                dx = kf.x[:, 0]
                q = plain.multiply(q, plain.exp(dx[:3]))
                q, bias = q / np.linalg.norm(q), bias + dx[3:]
        return {"q": q, "sigma": np.sqrt(np.diag(kf.P))}

    return call


def ukf(given: AttitudeInput) -> Callable[[], Outcome]:
    """Return a call of `UnscentedKalmanFilter` on attitude error and bias."""
    from filterpy.kalman import MerweScaledSigmaPoints, UnscentedKalmanFilter

    def step(x: FloatArray, dt: float, before: FloatArray, after: FloatArray, rate: Any) -> Any:
        q = plain.rk4(plain.multiply(before, plain.exp(x[:3])), rate - x[3:], dt)
        return np.array([*plain.log(plain.multiply(plain.conjugate(after), q)), *x[3:]])

    def see(x: FloatArray, expected: FloatArray) -> Any:
        return plain.log(plain.multiply(expected, plain.exp(x[:3])))

    def call() -> Outcome:
        points = MerweScaledSigmaPoints(6, alpha=1.0, beta=2.0, kappa=-3.0)
        kf = UnscentedKalmanFilter(6, 3, given.dt, hx=see, fx=step, points=points)
        kf.x, kf.P, kf.Q = np.zeros(6), given.covariance0, given.noise
        kf.R = given.sigma**2 * np.eye(3)
        q = given.q0
        for k in range(given.steps):
            after = plain.rk4(q, given.gyro[k] - kf.x[3:], given.dt)
            kf.predict(before=q, after=after, rate=given.gyro[k])
            q = after
            if k % 2 == 1:
                fix = plain.conjugate(given.fix_q[k // 2])
                kf.update(np.zeros(3), expected=plain.multiply(fix, q))
            q = plain.multiply(q, plain.exp(kf.x[:3]))
            q /= np.linalg.norm(q)
            kf.x[:3] = 0.0
        return {"q": q, "sigma": np.sqrt(np.diag(kf.P))}

    return call
