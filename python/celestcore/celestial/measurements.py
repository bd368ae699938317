"""What a satellite measures of stars and the Earth, with its noise."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass
from typing import Any

import numpy as np

from celestcore._check import number
from celestcore.errors import InputError
from celestcore.units import ARCSEC, DEG

__all__ = ["StarHorizon"]

DISTRIBUTIONS = ("normal", "student_t", "uniform")


@dataclass(frozen=True)
class StarHorizon:
    """Angles between stars and the nadir, or the Earth's limb: star camera and horizon sensor.

    Parameters
    ----------
    sigma_star : float
        1-sigma of each star's direction [rad].
    sigma_nadir : float
        1-sigma of the horizon sensor's nadir direction about each of two axes [rad].
    correlated : bool
        Whether all angles of an epoch share one error of the nadir direction, as those of one
        sensor do. Otherwise each angle has an independent error of both together.
    distribution : {"normal", "student_t", "uniform"}
        Of the errors that are not shared, scaled to their 1-sigma. What is not normal needs
        ``correlated=False``.
    dof : float
        Degrees of freedom of ``"student_t"``, above 2.
    edge : float
        Softness of the edges of ``"uniform"`` in a filter: the likelihood falls off as
        ``exp(-x**2 / 2)`` with ``x`` the distance to the edge over `edge` times the half-width.
    limb : float, optional
        Radius of the sphere whose limb the angles end at [m], for example 6378137 + 40e3; None:
        they go to the nadir. Needs ``correlated=False``; such angles also tell the distance and are
        used one by one.

    Raises
    ------
    InputError
        Names the field and the value.

    Notes
    -----
    Ning and Ma 2010, eq. 3: ``alpha = arccos(-r . s / |r|) + v``. The covariance of an epoch's
    angles is ``own**2 I + shared**2 E E^T`` with the unit tangent directions E; see `own` and
    `shared`.

    Examples
    --------
    >>> StarHorizon().shared == 0.02 * DEG
    True
    >>> StarHorizon(correlated=False).shared
    0.0
    """

    sigma_star: float = 3.0 * ARCSEC
    sigma_nadir: float = 0.02 * DEG
    _: KW_ONLY
    correlated: bool = True
    distribution: str = "normal"
    dof: float = 3.0
    edge: float = 0.05
    limb: float | None = None

    def __post_init__(self) -> None:
        set_number(self, "sigma_star", above=0.0)
        set_number(self, "sigma_nadir", at_least=0.0)
        set_number(self, "edge", above=0.0)
        if self.distribution not in DISTRIBUTIONS:
            raise InputError(
                f"must be one of {', '.join(DISTRIBUTIONS)}",
                field="distribution",
                value=self.distribution,
            )
        set_number(self, "dof", above=2.0)
        if self.distribution != "normal" and self.shared > 0.0:
            raise InputError(
                "needs correlated=False: errors that are not normal have no closed form together "
                "with a shared one",
                field="distribution",
                value=self.distribution,
            )
        if self.limb is not None:
            set_number(self, "limb", above=6.0e6)
            if self.shared > 0.0:
                raise InputError(
                    "needs correlated=False: the error of a limb is not that of a nadir",
                    field="limb",
                    value=self.limb,
                )
        for name in ("sigma_star", "sigma_nadir"):
            if getattr(self, name) > 0.1:
                raise InputError(
                    "is in radians, not degrees", field=name, value=getattr(self, name)
                )

    @property
    def own(self) -> float:
        """1-sigma of what each angle has for itself [rad]."""
        return (
            self.sigma_star
            if self.correlated
            else float(np.hypot(self.sigma_star, self.sigma_nadir))
        )

    @property
    def shared(self) -> float:
        """1-sigma of what all angles of an epoch share, about each of two axes [rad]."""
        return self.sigma_nadir if self.correlated else 0.0

    def _described(self, together: bool) -> tuple[float, float, str, float, float, bool]:
        """Return what the core takes."""
        extra = self.dof if self.distribution == "student_t" else self.edge
        limb = 0.0 if self.limb is None else self.limb
        alike = together and self.limb is None
        return (self.own, self.shared, self.distribution, extra, limb, alike)


def set_number(owner: Any, name: str, **limits: float) -> None:
    """Check a number of a frozen value, and keep it as a float."""
    object.__setattr__(owner, name, number(getattr(owner, name), name, **limits))
