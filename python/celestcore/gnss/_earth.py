"""How the Earth is turned at the fixes: by the IERS' tables, or by matrices of the user."""

from __future__ import annotations

from typing import Any

import numpy as np

from celestcore._check import FloatArray
from celestcore.errors import InputError
from celestcore.frames._rotation import EARTH_RATE, parts
from celestcore.quaternion import conjugate, from_matrix, log, multiply


class Earth:
    """Matrices from the Earth-fixed frame to the GCRS, and the axis that the Earth turns about.

    What was asked for once is kept: in a campaign the same times come in every trial. It can be
    pickled. With an `origin`, the first of a log's times [s], some of them have the bits that they
    have among all of them.
    """

    def __init__(self, epoch: str, origin: float | None = None) -> None:
        self.epoch, self.origin = epoch, origin
        self._known: dict[bytes, tuple[FloatArray, FloatArray]] = {}

    def at(self, t: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return matrices (n, 3, 3) and turning rates in Earth-fixed axes (n, 3) [rad/s].

        The axis is that of the intermediate pole, which stands up to half an arcsecond from the
        frame's z: a millimetre per second in low orbit.
        """
        key = t.tobytes()
        if key not in self._known:
            polar, spin, celestial = parts(self.epoch, t, "iers", None, self.origin)
            r_ie = np.ascontiguousarray(np.swapaxes(polar @ spin @ celestial, 1, 2))
            self._known[key] = r_ie, np.ascontiguousarray(EARTH_RATE * polar[:, :, 2])
        return self._known[key]


class GivenEarth:
    """The same from the user's matrices from the GCRS to the Earth-fixed frame."""

    def __init__(self, given: Any) -> None:
        self.given = given

    def at(self, t: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return matrices (n, 3, 3) and turning rates in Earth-fixed axes (n, 3) [rad/s]."""
        matrices = self.given(t) if callable(self.given) else self.given
        r_ei = checked_rotations(np.asarray(matrices, dtype=np.float64), t)
        r_ie = np.ascontiguousarray(np.swapaxes(r_ei, 1, 2))
        return r_ie, self._turn(t, r_ie)

    def _turn(self, t: FloatArray, r_ie: FloatArray) -> FloatArray:
        """Return turning rates from each matrix to the next."""
        if len(t) < 2:
            return np.tile([0.0, 0.0, EARTH_RATE], (len(t), 1))
        q = from_matrix(r_ie)
        angle = log(multiply(conjugate(q[:-1]), q[1:])) / np.diff(t)[:, None]
        return np.concatenate([angle, angle[-1:]])


def earth_of(epoch: str, given: Any) -> Earth | GivenEarth:
    """Return how the Earth is turned, as a run's option says it."""
    if isinstance(given, Earth):
        return given
    return Earth(epoch) if given is None else GivenEarth(given)


def checked_rotations(given: FloatArray, t: FloatArray) -> FloatArray:
    """Return matrices, one for each time, if they are rotations.

    Raises
    ------
    InputError
        Names the row that is none.
    """
    if given.shape != (len(t), 3, 3):
        raise InputError(
            f"has shape {given.shape}; one matrix for each GNSS fix is needed, {(len(t), 3, 3)}",
            field="earth_rotation",
        )
    off = np.abs(given @ np.swapaxes(given, -1, -2) - np.eye(3)).max(axis=(1, 2))
    bad = ~((off < 1e-9) & (np.linalg.det(given) > 0.0))
    if bad.any():
        row = int(np.argmax(bad))
        raise InputError(
            "is no rotation matrix: its rows must be unit vectors, across each other and "
            "right-handed (determinant +1)",
            field="earth_rotation",
            row=row,
            value=given[row],
        )
    return given
