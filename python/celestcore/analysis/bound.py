"""`posterior_bound`: what no filter can beat along an orbit, for any set of measurements."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from celestcore._arguments import checked
from celestcore._check import FloatArray, number
from celestcore.errors import InputError
from celestcore.filters import EKF
from celestcore.orbit import ForceModel, OrbitDynamics

if TYPE_CHECKING:
    from celestcore.celestial import Scenario, StarHorizon

__all__ = ["PosteriorBound", "posterior_bound"]


@dataclass(frozen=True, eq=False, repr=False)
class PosteriorBound:
    """Smallest covariance that any estimator of an orbit can have, epoch by epoch.

    Attributes
    ----------
    t : ndarray (n,)
        Epochs [s].
    covariance : ndarray (n, 6, 6)
        Of position x, y, z [m] and velocity x, y, z [m/s], GCRS.
    smoother : bool
        Whether measurements after an epoch count as well.

    Examples
    --------
    >>> import numpy as np
    >>> bound = PosteriorBound(np.array([0.0]), np.eye(6)[None], smoother=False)
    >>> bound.position, bound.rms()
    (array([1.73205081]), (1.7320508075688772, 1.7320508075688772))
    """

    t: FloatArray
    covariance: FloatArray
    smoother: bool

    def __repr__(self) -> str:
        what = "smoother" if self.smoother else "filter"
        position, velocity = self.rms()
        return (
            f"PosteriorBound({what}, {len(self.t)} epochs, rms {position:.4g} m, "
            f"{velocity:.4g} m/s)"
        )

    @property
    def position(self) -> FloatArray:
        """Rms length of the position error at each epoch (n,) [m]."""
        return np.asarray(np.sqrt(np.trace(self.covariance[:, :3, :3], axis1=1, axis2=2)))

    @property
    def velocity(self) -> FloatArray:
        """Rms length of the velocity error at each epoch (n,) [m/s]."""
        return np.asarray(np.sqrt(np.trace(self.covariance[:, 3:, 3:], axis1=1, axis2=2)))

    def rms(self, skip: float = 0.0) -> tuple[float, float]:
        """Return the rms position and velocity error over time [m], [m/s].

        Parameters
        ----------
        skip : float
            Time at the start that is left out [s].

        Returns
        -------
        position, velocity : float
            The mean length of an error is about 0.92 times its rms.

        Raises
        ------
        InputError
            If nothing is left.

        Examples
        --------
        >>> import numpy as np
        >>> p = np.eye(6) * np.array([4.0, 1.0])[:, None, None]
        >>> bound = PosteriorBound(np.array([0.0, 10.0]), p, smoother=False)
        >>> round(bound.rms(skip=5.0)[0], 3)
        1.732
        """
        rows = self.t >= self.t[0] + number(skip, "skip", at_least=0.0)
        if not rows.any():
            raise InputError("leaves no epoch", field="skip", value=skip)
        mean = [float(np.sqrt(np.mean(x[rows] ** 2))) for x in (self.position, self.velocity)]
        return mean[0], mean[1]


def posterior_bound(
    scenario: Scenario, dynamics: OrbitDynamics | None = None, *, smoother: bool = False
) -> PosteriorBound:
    """Compute the posterior Cramer-Rao bound of an orbit from what is measured along it.

    The covariance of an extended filter that is linearised at the truth: it starts there, with the
    scenario's uncertainty, and sees measurements without errors. What it says of its own errors is
    then the inverse of the information that dynamics and measurements hold.

    Parameters
    ----------
    scenario : Scenario
        Orbit, cameras and noise.
    dynamics : OrbitDynamics, optional
        What an estimator may know of the motion. Perfect unless given: JGM-3 21x21, Sun, Moon,
        radiation pressure and drag without any noise (J2 alone for an orbit without an epoch:
        that moves the bound by less than a per cent).
    smoother : bool
        The bound of estimates with all measurements, before an epoch and after it.

    Returns
    -------
    PosteriorBound

    Raises
    ------
    InputError
        If the noise is uniform: its edges tell more than any covariance can hold, and there is no
        bound of this kind. If the orbit has no epoch and the forces need one.

    Notes
    -----
    Tichavsky, Muravchik, Nehorai, *IEEE Transactions on Signal Processing* 46 (1998); for
    deterministic motion with the derivatives taken at the truth (Taylor 1979). With noise in the
    dynamics it is the bound of the linearised problem. An angle with Student's t noise of variance
    sigma^2 and f degrees of freedom informs like a normal one of
    ``sigma^2 (f - 2) (f + 3) / (f (f + 1))``: half as large for f = 3.

    Examples
    --------
    >>> import numpy as np
    >>> import celestcore as cc
    >>> j2 = cc.orbit.ForceModel.j2()
    >>> orbit = cc.orbit.propagate(
    ...     j2, None, [7e6, 0, 0], [0, 4e3, 6.4e3], np.arange(0.0, 6e3, 30.0))
    >>> sky = cc.celestial.SkyCamera(cc.StarCatalogue.random(5000))
    >>> scenario = cc.celestial.Scenario(orbit, sky, cc.StarHorizon(), period=30.0)
    >>> bound = posterior_bound(scenario, cc.orbit.OrbitDynamics(j2, 0.0))
    >>> bool(bound.position[-1] < 0.5 * bound.position[0])
    True
    """
    # imported late: the navigator's module needs this package
    from celestcore.celestial import CelestialLog, CelestialNavigator, Scenario

    checked(scenario, "scenario", Scenario)
    if dynamics is None:
        timeless = scenario.orbit.epoch is None
        force = ForceModel.j2() if timeless else ForceModel.high_fidelity()
        dynamics = OrbitDynamics(force, 0.0)
    checked(dynamics, "dynamics", OrbitDynamics)
    truth, stars = scenario.truth, scenario.stars
    log = CelestialLog(
        horizon=(stars.t, stars.star, _angles(stars.star, truth.r[stars.epoch])),
        epoch=scenario.orbit.epoch,
    )
    navigator = CelestialNavigator(EKF(), dynamics, informative(scenario.horizon))
    options: dict[str, Any] = {
        "sigma0": scenario.start_sigma,
        "t0": float(truth.t[0]),
        "t_output": truth.t,
        "covariance": True,
    }
    go = navigator.smooth if smoother else navigator.run
    found = go(log, truth.r[0], truth.v[0], **options)
    assert found.covariance is not None
    return PosteriorBound(found.t, found.covariance, bool(smoother))


def informative(horizon: StarHorizon) -> StarHorizon:
    """Return normal noise with the same Fisher information.

    Raises
    ------
    InputError
        If the noise is uniform.
    """
    if horizon.distribution == "normal":
        return horizon
    if horizon.distribution == "uniform":
        raise InputError(
            "has no Cramer-Rao bound: errors with sharp edges inform without limit",
            field="horizon.distribution",
            value="uniform",
        )
    f = horizon.dof
    factor = float(np.sqrt((f - 2.0) * (f + 3.0) / (f * (f + 1.0))))
    return replace(
        horizon,
        sigma_star=factor * horizon.sigma_star,
        sigma_nadir=factor * horizon.sigma_nadir,
        distribution="normal",
    )


def _angles(star: FloatArray, r: FloatArray) -> FloatArray:
    """Return the angles between stars and the nadir (m,), also for small ones exact [rad]."""
    nadir = -r / np.linalg.norm(r, axis=1, keepdims=True)
    across = np.linalg.norm(np.cross(star, nadir), axis=1)
    return np.asarray(np.arctan2(across, np.sum(star * nadir, axis=1)))
