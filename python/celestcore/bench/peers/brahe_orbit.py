"""brahe: its spherical harmonics for each position, and its Runge-Kutta on a force in numpy."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from celestcore.bench._inputs import START, sky
from celestcore.bench._orbit import DEGREE, STEP, GravityInput
from celestcore.bench._outcome import Outcome
from celestcore.bench.peers.numpy_orbit import rate


def gravity(given: GravityInput) -> Callable[[], Outcome]:
    """Return a call of `accel_gravity_spherical_harmonics`; the turns to the Earth are given."""
    import brahe

    model = brahe.GravityModel.from_model_type(brahe.GravityModelType.JGM3)
    evaluate = brahe.accel_gravity_spherical_harmonics
    pairs = list(zip(np.ascontiguousarray(given.state[:, :3]), given.to_earth, strict=True))

    def call() -> Outcome:
        return {"a": np.array([evaluate(r, turn, model, DEGREE, DEGREE) for r, turn in pairs])}

    return call


def integrate(t: Any) -> Callable[[], Outcome]:
    """Return a call of `RK4Integrator`, all rows kept."""
    import brahe

    constants = sky(1).constants

    def call() -> Outcome:
        integrator = brahe.RK4Integrator(6, lambda _, x: rate(x, constants))
        out = np.empty((len(t), 6))
        out[0] = START
        for k in range(len(t) - 1):
            out[k + 1] = integrator.step(t[k], out[k], STEP)
        return {"r": out[-1, :3]}

    return call
