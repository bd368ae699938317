"""Scenarios: an orbit, cameras and a horizon sensor, and what they measure trial by trial."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from celestcore import _core
from celestcore._arguments import checked, positive
from celestcore._check import FloatArray, array, number
from celestcore.celestial.camera import SkyCamera, StarsInView
from celestcore.celestial.log import CelestialLog
from celestcore.celestial.measurements import StarHorizon
from celestcore.errors import InputError
from celestcore.orbit import Trajectory
from celestcore.simulate._scenario import whole

__all__ = ["Scenario"]

ABERRATIONS = (False, "annual", "annual+orbital")
CLOSE = 1e-6
"""An epoch that is so close to a state of the orbit, in periods, is that state's."""


@dataclass(frozen=True, eq=False)
class Scenario:
    """What is flown, what is seen on the way, and how well it is measured.

    Parameters
    ----------
    orbit : Trajectory
        The true orbit, with a state at every epoch.
    cameras : SkyCamera or sequence of SkyCamera
        The star cameras. A star that two of them see is measured twice.
    horizon : StarHorizon
        The errors of the angles between stars and the nadir.
    period : float
        Time from epoch to epoch [s]; the first is at the orbit's first time.
    start_sigma : (position, velocity)
        1-sigma of the error that estimators start with [m], [m/s], each a number or three.
    outliers : (probability, sigmas), optional
        Each angle is, with this probability, wrong by so many 1-sigma of an angle more, to either
        side.
    aberration : {False, "annual", "annual+orbital"}
        Which aberration displaces the stars in the sky: none, that of the Earth's velocity (20.5
        arcsec), or also that of the orbit's (5 arcsec).
    corrected : {False, "annual", "annual+orbital"}
        Which aberration the star directions in the log already hold. What `aberration` has beyond
        it, the estimators do not know of.

    Attributes
    ----------
    truth : Trajectory
        The orbit at the epochs.
    stars : StarsInView
        Which stars are seen when, with the catalogue's directions.

    Raises
    ------
    InputError
        Names the field and the value: an orbit without a state at an epoch, aberration without an
        epoch.

    Notes
    -----
    The nadir is the direction to the Earth's centre. The error of the horizon sensor turns it by
    normal angles about two axes across it, one turn for each epoch, and angles are measured from
    there; each angle's own error is added. Which stars are in the field follows from the
    catalogue's directions, without aberration. An epoch without stars is an epoch without
    measurements: it is predicted only (``scenario.stars.counts == 0`` tells which).

    Each source of errors of each trial has random numbers of its own: outliers, or another
    distribution, change nothing else.

    Examples
    --------
    >>> import celestcore as cc
    >>> t = np.arange(0.0, 600.0, 15.0)
    >>> orbit = cc.orbit.propagate(cc.orbit.ForceModel.j2(), None, [7e6, 0, 0], [0, 4e3, 6.4e3], t)
    >>> sky = cc.celestial.SkyCamera(cc.StarCatalogue.random(5000))
    >>> scenario = Scenario(orbit, sky, cc.StarHorizon(), period=15.0)
    >>> scenario.log(seed=1)
    CelestialLog(horizon 240 angles in 40 epochs)
    """

    orbit: Trajectory
    cameras: SkyCamera | Sequence[SkyCamera]
    horizon: StarHorizon
    _: KW_ONLY
    period: float
    start_sigma: tuple[ArrayLike, ArrayLike] = (1e3, 1.0)
    outliers: tuple[float, float] | None = None
    aberration: bool | str = False
    corrected: bool | str = False

    def __post_init__(self) -> None:
        checked(self.orbit, "orbit", Trajectory)
        given = [self.cameras] if isinstance(self.cameras, SkyCamera) else self.cameras
        if not isinstance(given, Sequence) or not given:
            raise InputError("needs a SkyCamera or several", field="cameras", value=given)
        cameras = tuple(checked(camera, "cameras", SkyCamera) for camera in given)
        checked(self.horizon, "horizon", StarHorizon)
        values: dict[str, Any] = {
            "cameras": cameras,
            "period": number(self.period, "period", above=0.0),
            "start_sigma": _start_sigma(self.start_sigma),
            "outliers": _outliers(self.outliers),
        }
        for name in ("aberration", "corrected"):
            kind = getattr(self, name)
            if kind not in ABERRATIONS:
                known = ", ".join(repr(a) for a in ABERRATIONS)
                raise InputError(f"must be one of {known}", field=name, value=kind)
            if kind and self.orbit.epoch is None:
                raise InputError(f"is needed for {name}", field="orbit.epoch")
        for name, value in values.items():
            object.__setattr__(self, name, value)
        checked(self.truth, "orbit", Trajectory)  # an epoch without a state is told of here

    @cached_property
    def truth(self) -> Trajectory:
        """The orbit at the epochs."""
        t, period = self.orbit.t, self.period
        n = int(np.floor((t[-1] - t[0]) / period + CLOSE))
        if n < 1 or not (np.diff(t) > 0.0).all():
            raise InputError("must go forward in time, over one period at least", field="orbit.t")
        wanted = t[0] + period * np.arange(n + 1)
        after = np.searchsorted(t, wanted).clip(1, len(t) - 1)
        row = after - (wanted - t[after - 1] < t[after] - wanted)
        far = np.abs(t[row] - wanted) > CLOSE * period
        if far.any():
            first = float(wanted[int(np.argmax(far))])
            raise InputError(
                f"has no state at the epoch {first!r} s; propagate it through all epochs",
                field="orbit.t",
            )
        return self.orbit[row]

    @cached_property
    def stars(self) -> StarsInView:
        """Which stars are seen when, with the catalogue's directions.

        Examples
        --------
        >>> import celestcore as cc
        >>> orbit = cc.orbit.propagate(
        ...     cc.orbit.ForceModel.j2(), None, [7e6, 0, 0], [0, 4e3, 6.4e3], [0.0, 3.0])
        >>> sky = cc.celestial.SkyCamera(cc.StarCatalogue.random(5000))
        >>> Scenario(orbit, sky, cc.StarHorizon(), period=3.0).stars
        StarsInView(12 stars at 2 epochs, 0 of them without any)
        """
        truth = self.truth
        return StarsInView.join([c.visible(truth.t, truth.r, truth.v) for c in self._cameras])

    def log(self, seed: int = 0, trial: int = 0) -> CelestialLog:
        """Return what is measured in one trial.

        Parameters
        ----------
        seed : int
            Chooses the random numbers of all trials, from 0 to 2**64 - 1.
        trial : int
            Number of the trial, from 0 to 2**56 - 1.

        Returns
        -------
        CelestialLog
            The same bits for the same seed and trial.

        Raises
        ------
        InputError
            Names the field and the value.

        Examples
        --------
        >>> import celestcore as cc
        >>> orbit = cc.orbit.propagate(
        ...     cc.orbit.ForceModel.j2(), None, [7e6, 0, 0], [0, 4e3, 6.4e3], [0.0, 3.0])
        >>> sky = cc.celestial.SkyCamera(cc.StarCatalogue.random(5000))
        >>> scenario = Scenario(orbit, sky, cc.StarHorizon(), period=3.0)
        >>> once, again = scenario.log(seed=1, trial=7), scenario.log(seed=1, trial=7)
        >>> bool((once.horizon.angle == again.horizon.angle).all())
        True
        """
        angle, _ = self._simulated(seed, trial)
        flight = self._described
        return CelestialLog(
            horizon=(flight["star_t"], flight["star"], angle),
            epoch=self.orbit.epoch,
            times=self.truth.t,
        )

    def start(self, seed: int = 0, trial: int = 0) -> tuple[FloatArray, FloatArray]:
        """Return what estimators start from in one trial: the truth with an error.

        Parameters
        ----------
        seed, trial : int
            As in `log`.

        Returns
        -------
        r0, v0 : ndarray (3,)
            Position [m] and velocity [m/s] at the first epoch, GCRS; `start_sigma` is the 1-sigma
            of their error.

        Raises
        ------
        InputError
            Names the field and the value.

        Examples
        --------
        >>> import celestcore as cc
        >>> orbit = cc.orbit.propagate(
        ...     cc.orbit.ForceModel.j2(), None, [7e6, 0, 0], [0, 4e3, 6.4e3], [0.0, 3.0])
        >>> sky = cc.celestial.SkyCamera(cc.StarCatalogue.random(5000))
        >>> scenario = Scenario(orbit, sky, cc.StarHorizon(), period=3.0, start_sigma=(1e-3, 1e-6))
        >>> r0, v0 = scenario.start(seed=1)
        >>> r0.round(0) + 0.0
        array([7000000.,       0.,       0.])
        """
        _, state = self._simulated(seed, trial)
        return np.asarray(state[:3]), np.asarray(state[3:])

    @property
    def _cameras(self) -> tuple[SkyCamera, ...]:
        assert isinstance(self.cameras, tuple)
        return self.cameras

    def _simulated(self, seed: int, trial: int) -> tuple[FloatArray, list[float]]:
        return _core.celestial_simulate(
            self._described, whole(seed, "seed", 64), whole(trial, "trial", 56)
        )

    @cached_property
    def _described(self) -> dict[str, Any]:
        """What the core takes."""
        stars, truth = self.stars, self.truth
        return {
            "t": truth.t,
            "state": np.ascontiguousarray(truth.state),
            "star_t": stars.t,
            "star": self._displaced(self.corrected),
            "apparent": self._displaced(self.aberration),
            "noise": self.horizon._described(True)[:5],
            "outliers": self.outliers,
            "start_sigma": np.concatenate([positive(s, "start_sigma") for s in self.start_sigma]),
        }

    def _displaced(self, aberration: bool | str) -> FloatArray:
        """Return the directions of the stars in view with an aberration."""
        stars = self.stars
        if not aberration:
            return np.ascontiguousarray(stars.star)
        from celestcore.frames import aberrate, earth_velocity

        velocity = earth_velocity(self.orbit.epoch, self.truth.t)
        if aberration == "annual+orbital":
            velocity = velocity + self.truth.v
        return np.ascontiguousarray(aberrate(stars.star, velocity[stars.epoch]))


def _start_sigma(value: tuple[ArrayLike, ArrayLike]) -> tuple[tuple[float, ...], ...]:
    if not isinstance(value, Sequence) or len(value) != 2:
        raise InputError("needs (position [m], velocity [m/s])", field="start_sigma", value=value)
    return tuple(tuple(positive(part, "start_sigma").tolist()) for part in value)


def _outliers(value: tuple[float, float] | None) -> tuple[float, float] | None:
    if value is None:
        return None
    pair = array(value, "outliers", (2,))
    if not (0.0 <= pair[0] <= 1.0 and 0.0 <= pair[1] < np.inf):
        raise InputError("needs (probability, 1-sigmas)", field="outliers", value=value)
    return float(pair[0]), float(pair[1])
