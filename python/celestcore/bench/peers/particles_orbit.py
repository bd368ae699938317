"""particles: its bootstrap filter, with the model in numpy."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from celestcore.bench._orbit import Cloud
from celestcore.bench._outcome import Outcome
from celestcore.bench.peers.numpy_orbit import angles, rk4, start


def bootstrap(given: Cloud) -> Callable[[], Outcome]:
    """Return a call of the bootstrap filter."""
    import particles
    from particles import distributions, state_space_models

    log, constants = given.log, given.log.constants

    class Flat(distributions.ProbDist):  # type: ignore[misc]
        """What is seen at the start: nothing."""

        def logpdf(self, _: Any) -> Any:
            return np.zeros(given.particles)

    class Orbit(state_space_models.StateSpaceModel):  # type: ignore[misc]
        """A satellite from time 0, which has no angles, on."""

        def PX0(self) -> Any:  # noqa: N802
            return distributions.MvNormal(loc=start(log), cov=log.covariance0)

        def PX(self, t: int, xp: Any) -> Any:  # noqa: N802
            return distributions.MvNormal(loc=rk4(xp, constants, log.period), cov=log.noise)

        def PY(self, t: int, xp: Any, x: Any) -> Any:  # noqa: N802
            if t == 0:
                return Flat()
            return distributions.MvNormal(loc=angles(x, log.star), cov=log.sigma**2 * np.eye(3))

    model = state_space_models.Bootstrap(ssm=Orbit(), data=[np.zeros(3), *log.angle])

    def call() -> Outcome:
        cloud = particles.SMC(fk=model, N=given.particles, resampling="systematic", ESSrmin=1.0)
        cloud.run()
        return {"r": cloud.W @ cloud.X[:, :3]}

    return call
