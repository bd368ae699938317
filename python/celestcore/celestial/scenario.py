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
        object.__setattr__(self, "truth", _at_epochs(self.orbit, values["period"]))

    truth: Trajectory = None  # type: ignore[assignment]

    @cached_property
    def stars(self) -> StarsInView:
        """Which stars are seen when, with the catalogue's directions."""
        truth = self.truth
        return StarsInView.join([c.visible(truth.t, truth.r, truth.v) for c in self.cameras])

