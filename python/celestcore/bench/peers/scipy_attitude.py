"""scipy: loops over `Rotation`."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from celestcore.bench._inputs import AttitudeInput
from celestcore.bench._outcome import Outcome


def propagation(given: AttitudeInput) -> Callable[[], Outcome]:
    """Return a call that propagates the readings."""
    from scipy.spatial.transform import Rotation

    def call() -> Outcome:
        turns = Rotation.from_rotvec(given.dt * given.gyro[:-1])
        attitude, history = Rotation.identity(), np.empty((len(given.gyro), 4))
        history[0] = attitude.as_quat()
        for k in range(len(turns)):
            attitude = attitude * turns[k]
            history[k + 1] = attitude.as_quat()
        return {"q": np.roll(history[-1], 1)}

    return call


def mekf(given: AttitudeInput) -> Callable[[], Outcome]:
    """Return a call of the multiplicative extended Kalman filter, Joseph's form."""
    from scipy.spatial.transform import Rotation

    noise, r = given.noise, given.sigma**2 * np.eye(3)
    h, one = np.eye(3, 6), np.eye(6)

    def call() -> Outcome:
        attitude = Rotation.from_quat(np.roll(given.q0, -1))
        fixes = Rotation.from_quat(np.roll(given.fix_q, -1, axis=1))
        bias, p, f = np.zeros(3), given.covariance0, np.eye(6)
        f[:3, 3:] = -given.dt * np.eye(3)
        for k in range(given.steps):
            turn = Rotation.from_rotvec(given.dt * (given.gyro[k] - bias))
            attitude = attitude * turn
            f[:3, :3] = turn.as_matrix().T
            p = f @ p @ f.T + noise
            if k % 2 == 1:
                innovation = (attitude.inv() * fixes[k // 2]).as_rotvec()
                gain = np.linalg.solve(p[:3, :3] + r, p[:3]).T
                kept = one - gain @ h
                p = kept @ p @ kept.T + gain @ r @ gain.T
                dx = gain @ innovation
                attitude = attitude * Rotation.from_rotvec(dx[:3])
                bias = bias + dx[3:]
        return {"q": np.roll(attitude.as_quat(), 1), "sigma": np.sqrt(np.diag(p))}

    return call
