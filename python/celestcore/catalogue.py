"""Catalogues of stars: directions and magnitudes."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from celestcore import _core
from celestcore._check import FloatArray, array, directions, number
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

    Attributes
    ----------
    directions : ndarray (n, 3)
        Unit vectors.
    magnitude : ndarray (n,)

    Raises
    ------
    InputError
        Names the row of a star without a direction or a magnitude.

    Examples
    --------
    >>> len(StarCatalogue([[1.0, 0.0, 0.0], [0.0, 2.0, 0.0]], [1.5, 2.0]))
    2
    """

    def __init__(self, directions: ArrayLike, magnitude: ArrayLike) -> None:
        self.directions = _unit(array(directions, "directions", (None, 3)), "directions")
        self.magnitude = array(magnitude, "magnitude", (len(self.directions),))
        bad = ~np.isfinite(self.magnitude)
        if bad.any():
            row = int(np.argmax(bad))
            raise InputError(
                "must be finite; leave the star out", field="magnitude", row=row, value=np.nan
            )
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
