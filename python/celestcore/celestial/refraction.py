"""Starlight refraction: how the air bends the light of stars close to the Earth's limb."""

from __future__ import annotations

import functools
from dataclasses import KW_ONLY, dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from celestcore import _core
from celestcore._arguments import checked
from celestcore._check import FloatArray, array, number, unit_rows
from celestcore.celestial.measurements import set_number
from celestcore.errors import InputError
from celestcore.frames import gcrs_to_itrs
from celestcore.units import ARCSEC

__all__ = ["Atmosphere", "Rays", "StarRefraction"]

_KILOMETRES = 1e5
"""Geocentric positions shorter than this [m] are taken for kilometres."""


class Atmosphere:
    """Air over height, and how much it bends a ray that grazes the Earth.

    Without arguments the US Standard Atmosphere 1976 up to 86 km, an exponential above. Otherwise a
    smooth curve through a table: a cubic spline of the density's logarithm, exponential beyond both
    ends. The refractivity is ``n - 1 = 2.26e-4 rho``, with the density in kg/m3.

    Parameters
    ----------
    height : array_like (n,), optional
        Heights [m], increasing, from -5e3 to 150e3; three at least.
    density : array_like (n,), optional
        Density there [kg/m3], falling with the height.

    Raises
    ------
    InputError
        Names the field and the value.

    Notes
    -----
    Rays are traced once, over a sphere of 6378137 m: Bouguer's rule, the integral by Gauss and
    Legendre's. *US Standard Atmosphere 1976*, eqs 23, 33 and 42; where its temperature gradient
    jumps (20.1, 32.2, 47.4 km), the table smooths the bending's vertical tangent: 0.1 % within
    500 m, 3e-5 elsewhere.

    Examples
    --------
    >>> import celestcore as cc
    >>> (Atmosphere().bending([20e3, 25e3, 30e3, 40e3, 50e3]) / cc.ARCSEC).round(1)
    array([334.4, 148.8,  67.6,  14.1,   3.4])
    """

    def __init__(self, height: ArrayLike | None = None, density: ArrayLike | None = None) -> None:
        if (height is None) != (density is None):
            raise InputError("needs height and density together", field="density")
        self._table: tuple[FloatArray, FloatArray] | None = None
        if height is not None and density is not None:
            self._table = (array(height, "height", (None,)), array(density, "density", (None,)))
        self._core = _core.RefractionTable(self._table)

    def __repr__(self) -> str:
        if self._table is None:
            return "Atmosphere()"
        low, high = self._table[0][[0, -1]] / 1e3
        return f"Atmosphere({len(self._table[0])} rows from {low:g} to {high:g} km)"

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Atmosphere):
            return NotImplemented
        if self._table is None or other._table is None:
            return self._table is other._table
        return all(map(np.array_equal, self._table, other._table))

    def __hash__(self) -> int:
        return hash(None if self._table is None else tuple(a.tobytes() for a in self._table))

    def __reduce__(self) -> tuple[Any, ...]:
        return Atmosphere, self._table or ()

    def density(self, height: ArrayLike) -> FloatArray:
        """Density of the air.

        Parameters
        ----------
        height : array_like (...)
            [m] above the ground.

        Returns
        -------
        ndarray (...)
            [kg/m3].

        Examples
        --------
        >>> float(Atmosphere().density(0.0).round(4))
        1.225
        """
        return _each(self._core.density, height, "height")

    def bending(self, height: ArrayLike) -> FloatArray:
        """Angle by which a ray is bent.

        Parameters
        ----------
        height : array_like (...)
            Of the ray's lowest point [m], 0 to 120e3; beyond, what an exponential gives.

        Returns
        -------
        ndarray (...)
            [rad].

        Examples
        --------
        >>> float(Atmosphere().bending(25e3).round(6))
        0.000721
        """
        return _each(self._core.bending, height, "height")

    def height(self, angle: ArrayLike) -> FloatArray:
        """Height at which a ray is bent by an angle: the inverse of `bending`.

        Parameters
        ----------
        angle : array_like (...)
            [rad], positive.

        Returns
        -------
        ndarray (...)
            Of the ray's lowest point [m].

        Examples
        --------
        >>> float(Atmosphere().height(Atmosphere().bending(31e3)).round(3))
        31000.0
        """
        return _each(self._core.height, angle, "angle")


def _each(call: Any, value: ArrayLike, field: str) -> FloatArray:
    given = array(value, field)
    return np.asarray(call(given.reshape(-1))).reshape(given.shape)


class Rays(NamedTuple):
    """Rays from stars to a satellite, through the air; each has the shape of the input.

    Attributes
    ----------
    angle : ndarray (...)
        Refraction [rad]: by how much the star is seen too high. Zero for a star that is not beyond
        the Earth.
    height : ndarray (...)
        Of the ray's lowest point [m].
    by_position : ndarray (..., 3)
        Derivative of the refraction to the satellite's position [rad/m], GCRS.
    by_density : ndarray (...)
        Derivative to the logarithm of the density [rad]; less than the angle itself, since denser
        air shows a ray that passes higher.

    Examples
    --------
    >>> rays = StarRefraction(oblate=False).rays([7.138e6, 0, 0], [-0.4405, 0.8977, 0.0])
    >>> rays.by_position.shape, bool(rays.by_density < rays.angle)
    ((3,), True)
    """

    angle: FloatArray
    height: FloatArray
    by_position: FloatArray
    by_density: FloatArray


@dataclass(frozen=True)
class StarRefraction:
    """Refraction of stars that a satellite sees through the air over the limb.

    Parameters
    ----------
    sigma : float
        1-sigma of a refraction's own error [rad].
    density_sigma : float
        Relative 1-sigma of the air's density: drawn for each pass of a star through the band in
        simulations, held to be each angle's own by filters.
    band : (float, float)
        Lowest and greatest height of rays that are measured [m], within 0 to 120e3.
    oblate : bool
        Whether heights count from the WGS84 ellipsoid, or from a sphere as large as its equator.
    atmosphere : Atmosphere, optional
        The air; the standard atmosphere unless given.

    Raises
    ------
    InputError
        Names the field and the value.

    Notes
    -----
    A satellite at r sees star s, with ``u = -r . s``, by a ray of impact parameter
    ``b = sqrt(r**2 - u**2) cos R + u sin R``; its lowest height h follows from
    ``b = n(h) (Re + h)`` and ``R = R(h)``. White, Thurman and Barnes, *Autonomous satellite
    navigation using observations of starlight atmospheric refraction*, Navigation 32 (1985).

    Over the ellipsoid the sphere is the one that osculates it below the ray's lowest point, in the
    ray's direction: ``Re = a / (W (1 + e'**2 (s . k)**2))``, ``W**2 = 1 - e**2 sin(latitude)**2``,
    with the pole k. Against rays traced through ellipsoidal air it is wrong by less than
    0.3 m of height (21 to 30 km, all latitudes and azimuths).

    Examples
    --------
    >>> import celestcore as cc
    >>> sensor = StarRefraction(3 * cc.ARCSEC, density_sigma=0.01)
    >>> rays = sensor.rays([7.138e6, 0.0, 0.0], [-0.4405, 0.8977, 0.0])
    >>> float((rays.angle / cc.ARCSEC).round()), float(rays.height.round(-2))
    (59.0, 30800.0)
    """

    sigma: float = 3.0 * ARCSEC
    density_sigma: float = 0.01
    _: KW_ONLY
    band: tuple[float, float] = (20e3, 50e3)
    oblate: bool = True
    atmosphere: Atmosphere | None = None

    def __post_init__(self) -> None:
        set_number(self, "sigma", above=0.0)
        set_number(self, "density_sigma", at_least=0.0)
        if self.sigma > 0.1:
            raise InputError("is in radians, not degrees", field="sigma", value=self.sigma)
        if self.density_sigma > 0.5:
            raise InputError(
                "is a part of one, for example 0.01",
                field="density_sigma",
                value=self.density_sigma,
            )
        band = array(self.band, "band", (2,))
        if not 0.0 <= band[0] < band[1] <= 120e3:
            raise InputError(
                "must be two heights [m], the lower one first, within 0 to 120e3",
                field="band",
                value=band.tolist(),
            )
        object.__setattr__(self, "band", tuple(band.tolist()))
        object.__setattr__(self, "oblate", bool(self.oblate))
        if self.atmosphere is not None:
            checked(self.atmosphere, "atmosphere", Atmosphere)

    @property
    def air(self) -> Atmosphere:
        """The atmosphere."""
        return _standard() if self.atmosphere is None else self.atmosphere

    def rays(
        self,
        r: ArrayLike,
        star: ArrayLike,
        *,
        epoch: Any = None,
        t: float = 0.0,
        scale: float = 1.0,
    ) -> Rays:
        """Trace the light of stars to a satellite.

        Parameters
        ----------
        r : array_like (..., 3)
            Positions [m], GCRS.
        star : array_like (..., 3)
            Unit vectors to the stars, GCRS, as they are seen without air.
        epoch : str, astropy Time or None
            When: says where the pole of an oblate Earth is. None: along the z axis of the GCRS,
            wrong by 20 arcsec for each year from 2000, 2 m of height.
        t : float
            Seconds since the epoch.
        scale : float
            The air has so many times its density.

        Returns
        -------
        Rays
            Whatever the height: below the ground the air is carried on.

        Raises
        ------
        InputError
            Kilometres for metres, a star that is not a unit vector, shapes that do not fit.

        Examples
        --------
        >>> r, stars = [7.138e6, 0, 0], [[-0.44, 0.898, 0], [0.44, 0.898, 0]]
        >>> StarRefraction().rays(r, stars / np.linalg.norm(stars, axis=1)[:, None]).angle > 0
        array([ True, False])
        """
        position, direction = array(r, "r"), array(star, "star")
        for name, value in (("r", position), ("star", direction)):
            if value.ndim == 0 or value.shape[-1] != 3:
                raise InputError(f"needs a last axis of 3, got {value.shape}", field=name)
        checked_rows(position.reshape(-1, 3), direction.reshape(-1, 3))
        try:
            shape = np.broadcast_shapes(position.shape, direction.shape)
        except ValueError:
            what = f"shapes {position.shape} and {direction.shape} do not fit"
            raise InputError(what, field="star") from None
        at, to = (
            np.ascontiguousarray(np.broadcast_to(a, shape)).reshape(-1, 3)
            for a in (position, direction)
        )
        pole = self._pole(epoch, t)
        out = self.air._core.rays(at, to, pole, number(scale, "scale", above=0.0))
        angle, height, by_position, by_density = out
        lead = shape[:-1]
        return Rays(
            angle.reshape(lead),
            height.reshape(lead),
            by_position.reshape(shape),
            by_density.reshape(lead),
        )

    def _pole(self, epoch: Any, t: float = 0.0) -> tuple[float, float, float] | None:
        """Return the Earth's pole in the GCRS; None for a sphere."""
        if not self.oblate:
            return None
        if epoch is None:
            return (0.0, 0.0, 1.0)
        x, y, z = gcrs_to_itrs(epoch, [t])[0, 2].tolist()
        return (x, y, z)

    def _described(self, epoch: Any, t: float = 0.0) -> tuple[Any, ...]:
        """Return what the core takes."""
        return (self.sigma, self.density_sigma, self._pole(epoch, t), self.air._core)


def checked_rows(position: FloatArray, star: FloatArray) -> None:
    """Check positions (n, 3) and unit vectors (m, 3)."""
    length = np.linalg.norm(position, axis=1)
    bad = ~(length >= _KILOMETRES) | ~np.isfinite(length)
    if bad.any():
        row = int(np.argmax(bad))
        raise InputError(
            "is no geocentric position in metres", field="r", row=row, value=position[row]
        )
    unit_rows(star, "star", what="star direction", hint="normalise it")


@functools.cache
def _standard() -> Atmosphere:
    return Atmosphere()
