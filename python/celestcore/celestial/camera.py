"""Cameras that look at the stars from an orbit: which ones they see, and when."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from celestcore import _core
from celestcore._check import FloatArray, IntArray, array, number, times
from celestcore.catalogue import StarCatalogue, integer
from celestcore.errors import InputError
from celestcore.units import DEG

__all__ = ["SkyCamera", "StarsInView"]

_EARTH_RADIUS = 6_378_137.0
_KILOMETRES = 1e5
"""Geocentric positions shorter than this [m] are taken for kilometres."""


@dataclass(frozen=True, eq=False)
class StarsInView:
    """Which stars are seen when: one row for each star and epoch, epoch after epoch.

    Attributes
    ----------
    t : ndarray (m,)
        Times [s].
    epoch : ndarray (m,) of int
        Numbers of the epochs.
    row : ndarray (m,) of int
        Rows of the catalogue.
    camera : ndarray (m,) of int
        Numbers of the cameras.
    star : ndarray (m, 3)
        Unit vectors in the catalogue, GCRS.
    counts : ndarray (n,) of int
        Stars at each epoch.

    Examples
    --------
    >>> import celestcore as cc
    >>> camera = SkyCamera(cc.StarCatalogue.random(5000))
    >>> seen = camera.visible([0.0], [[7e6, 0.0, 0.0]], [[0.0, 7.5e3, 0.0]])
    >>> seen.counts, seen.star.shape
    (array([6]), (6, 3))
    """

    t: FloatArray
    epoch: IntArray
    row: IntArray
    camera: IntArray
    star: FloatArray
    counts: IntArray

    def __len__(self) -> int:
        """Return the number of rows."""
        return len(self.t)

    def __repr__(self) -> str:
        n, empty = len(self.counts), int((self.counts == 0).sum())
        return f"StarsInView({len(self)} stars at {n} epochs, {empty} of them without any)"

    @classmethod
    def join(cls, parts: list[StarsInView]) -> StarsInView:
        """Put together what several cameras see at the same epochs.

        Parameters
        ----------
        parts : list of StarsInView
            One for each camera. At each epoch the first camera's stars come first.

        Returns
        -------
        StarsInView
            A star that two cameras see stands twice.

        Examples
        --------
        >>> import celestcore as cc
        >>> sky = cc.StarCatalogue.random(5000)
        >>> views = [
        ...     SkyCamera(sky, boresight=b).visible([0.0], [[7e6, 0, 0]], [[0, 7e3, 0]])
        ...     for b in ((0, 0, -1), (0, 1, 0))
        ... ]
        >>> StarsInView.join(views).counts
        array([12])
        """
        epoch = np.concatenate([p.epoch for p in parts])
        camera = np.concatenate([np.full(len(p), k) for k, p in enumerate(parts)])
        order = np.argsort(epoch, kind="stable")

        def joined(name: str) -> Any:
            return np.concatenate([getattr(p, name) for p in parts])[order]

        return cls(
            t=joined("t"),
            epoch=epoch[order],
            row=joined("row"),
            camera=camera[order],
            star=joined("star"),
            counts=np.asarray(sum(p.counts for p in parts)),
        )


@dataclass(frozen=True, eq=False)
class SkyCamera:
    """A star camera on a satellite that holds its attitude to the orbit, or to the stars.

    Parameters
    ----------
    catalogue : StarCatalogue
        The stars it knows.
    field_of_view : (float, float)
        Full angles of the rectangular field through the boresight, across and along its sides
        [rad]; below a half turn. The detector is flat, behind a pinhole.
    boresight : array_like (3,)
        Where it looks, in the orbital frame ``o`` (x forward, y against the orbit's normal, z to
        the Earth's centre); by default at the zenith.
    along : array_like (3,)
        Direction of the first side, in the same frame; what of it is along the boresight is
        ignored.
    inertial : bool
        Whether `boresight` and `along` are in the GCRS instead: the field stands still among the
        stars.
    brightest : int or None
        So many stars at most are used, the brightest in the field; None: all.
    earth_margin : float
        Stars behind the Earth, a sphere of radius 6378137 m, and this height [m] above it are not
        seen.

    Raises
    ------
    InputError
        Names the field and the value.

    Notes
    -----
    Directions of the catalogue are taken as they are; proper motion and aberration are applied
    where it is made (`StarCatalogue.hipparcos`), or by a `Scenario`. Which star is which is known.

    Examples
    --------
    >>> import celestcore as cc
    >>> sky = cc.StarCatalogue.hipparcos(epoch=2007.5, magnitude=6.0)
    >>> t = np.arange(0.0, 5900.0, 60.0)
    >>> orbit = cc.orbit.propagate(
    ...     cc.orbit.ForceModel.two_body(), None, [7e6, 0, 0], [0, 4e3, 6.4e3], t)
    >>> seen = SkyCamera(sky).visible(orbit.t, orbit.r, orbit.v)
    >>> seen
    StarsInView(... stars at 99 epochs, 0 of them without any)
    >>> int(seen.counts.max())
    6
    """

    catalogue: StarCatalogue
    field_of_view: tuple[float, float] = (10.0 * DEG, 10.0 * DEG)
    _: KW_ONLY
    boresight: ArrayLike = (0.0, 0.0, -1.0)
    along: ArrayLike = (1.0, 0.0, 0.0)
    inertial: bool = False
    brightest: int | None = 6
    earth_margin: float = 100e3

    def __post_init__(self) -> None:
        if not isinstance(self.catalogue, StarCatalogue):
            raise InputError("must be a StarCatalogue", field="catalogue", value=self.catalogue)
        boresight = _unit(self.boresight, "boresight")
        along = _unit(self.along, "along")
        across = along - (along @ boresight) * boresight
        if not float(np.linalg.norm(across)) > 1e-9:
            raise InputError("is along the boresight", field="along", value=self.along)
        values: dict[str, Any] = {
            "field_of_view": _angles(self.field_of_view),
            "boresight": tuple(boresight.tolist()),
            "along": tuple((across / np.linalg.norm(across)).tolist()),
            "inertial": bool(self.inertial),
            "earth_margin": number(self.earth_margin, "earth_margin"),
        }
        if self.brightest is not None:
            values["brightest"] = integer(self.brightest, "brightest", at_least=1)
        if not _EARTH_RADIUS + values["earth_margin"] >= 0.0:
            raise InputError(
                "is below the Earth's centre", field="earth_margin", value=self.earth_margin
            )
        for name, value in values.items():
            object.__setattr__(self, name, value)

    def visible(self, t: ArrayLike, r: ArrayLike, v: ArrayLike) -> StarsInView:
        """Find the stars that are seen from an orbit.

        Parameters
        ----------
        t : array_like (n,)
            Times of the epochs [s], increasing.
        r, v : array_like (n, 3)
            Positions [m] and velocities [m/s] then, GCRS.

        Returns
        -------
        StarsInView
            The brightest first at each epoch.

        Raises
        ------
        InputError
            Names the field and the row: kilometres (|r| < 1e5 m), a velocity along the position.

        Examples
        --------
        >>> import celestcore as cc
        >>> camera = SkyCamera(cc.StarCatalogue.random(5000), boresight=(0, -1, 0))
        >>> camera.visible([0.0, 1.0], [[7e6, 0, 0]] * 2, [[0, 7.5e3, 0]] * 2)
        StarsInView(12 stars at 2 epochs, 0 of them without any)
        """
        at = times(t, "t")
        position, velocity = _states(r, v, len(at))
        stars = self.catalogue
        order = np.argsort(stars.magnitude, kind="stable")
        counts, place = _core.sky_visible(
            self._described(), np.ascontiguousarray(stars.directions[order]), position, velocity
        )
        row = order[place]
        epoch = np.repeat(np.arange(len(at)), counts)
        return StarsInView(
            t=at[epoch],
            epoch=epoch,
            row=row,
            camera=np.zeros_like(row),
            star=stars.directions[row],
            counts=np.asarray(counts),
        )

    def _described(self) -> dict[str, Any]:
        """Return what the core takes."""
        most = len(self.catalogue) if self.brightest is None else self.brightest
        return {
            "boresight": self.boresight,
            "along": self.along,
            "inertial": self.inertial,
            "tangents": [float(np.tan(0.5 * side)) for side in self.field_of_view],
            "brightest": most,
            "opaque": _EARTH_RADIUS + self.earth_margin,
        }


def _unit(value: ArrayLike, field: str) -> FloatArray:
    v = array(value, field, (3,))
    length = float(np.linalg.norm(v))
    if not (np.isfinite(length) and length > 0.0):
        raise InputError("has no direction", field=field, value=v)
    return np.asarray(v / length)


def _angles(value: tuple[float, float]) -> tuple[float, float]:
    sides = array(value, "field_of_view", (2,))
    if not np.all((sides > 0.0) & (sides < np.pi)):
        raise InputError(
            "needs two angles [rad] above 0 and below pi", field="field_of_view", value=sides
        )
    return float(sides[0]), float(sides[1])


def _states(r: ArrayLike, v: ArrayLike, n: int) -> tuple[FloatArray, FloatArray]:
    position, velocity = array(r, "r", (n, 3)), array(v, "v", (n, 3))
    radius = np.linalg.norm(position, axis=1)
    bad = ~(radius >= _KILOMETRES)
    if bad.any():
        row = int(np.argmax(bad))
        raise InputError(
            "is within 100 km of the Earth's centre, or not finite: positions are in metres",
            field="r",
            row=row,
            value=position[row],
        )
    momentum = np.linalg.norm(np.cross(position, velocity), axis=1)
    bad = ~(momentum > 1e-12 * radius * np.linalg.norm(velocity, axis=1))
    if bad.any():
        row = int(np.argmax(bad))
        raise InputError(
            "is along the position, zero or not finite: there is no orbital plane",
            field="v",
            row=row,
            value=velocity[row],
        )
    return position, velocity
