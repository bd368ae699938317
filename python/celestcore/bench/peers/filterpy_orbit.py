"""filterpy: its unscented filter, with the model in numpy."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from celestcore.bench._inputs import OrbitInput
from celestcore.bench._outcome import Outcome
from celestcore.bench.peers.numpy_orbit import angles, rk4, start


def ukf(given: OrbitInput) -> Callable[[], Outcome]:
    """Return a call of `UnscentedKalmanFilter`."""
    from filterpy.kalman import MerweScaledSigmaPoints, UnscentedKalmanFilter

    constants = given.constants

    def call() -> Outcome:
        kf = UnscentedKalmanFilter(
            6,
            3,
            given.period,
            hx=lambda x: angles(x, given.star),
            fx=lambda x, dt: rk4(x, constants, dt),
            points=MerweScaledSigmaPoints(6, alpha=1.0, beta=2.0, kappa=-3.0),
        )
        kf.x, kf.P, kf.Q = start(given), given.covariance0, given.noise
        kf.R = given.sigma**2 * np.eye(3)
        for seen in given.angle:
            kf.predict()
            kf.update(seen)
        return {"r": kf.x[:3], "sigma": np.sqrt(np.diag(kf.P))}

    return call
