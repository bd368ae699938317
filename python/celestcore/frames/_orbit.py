"""Frames and events along an orbit: orbital frame, eclipse, ground track; aberration."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from celestcore._check import BoolArray, FloatArray, array, number
from celestcore.errors import InputError
from celestcore.frames._rotation import to_itrs
from celestcore.quaternion import continuous, from_matrix

WGS84_RADIUS = 6378137.0
WGS84_FLATTENING = 1.0 / 298.257223563
SUN_RADIUS = 6.957e8
"""Nominal solar radius [m], IAU 2015 resolution B3."""
LIGHT = 299792458.0


class Eclipse(NamedTuple):
    """How much of the Sun a satellite sees; each (...).

    Attributes
    ----------
    lit : ndarray
        Part of the Sun's disc that is not covered, 1 in full sun and 0 in the umbra.
    umbra, penumbra : ndarray of bool
        All of the disc covered; a part of it.

    Examples
    --------
    >>> Eclipse(np.array(0.0), np.array(True), np.array(False)).umbra
    array(True)
    """

    lit: FloatArray
    umbra: BoolArray
    penumbra: BoolArray


class GroundTrack(NamedTuple):
    """Geodetic coordinates on the WGS84 ellipsoid; each (...).

    Attributes
    ----------
    latitude : ndarray
        [rad].
    longitude : ndarray
        [rad], east, from -pi to pi.
    height : ndarray
        [m] above the ellipsoid.

    Examples
    --------
    >>> GroundTrack(np.array(0.1), np.array(0.2), np.array(5e5)).height
    array(500000.)
    """

    latitude: FloatArray
    longitude: FloatArray
    height: FloatArray


def _vectors(value: ArrayLike, field: str, *, zero: bool = False) -> FloatArray:
    v = array(value, field)
    if v.ndim == 0 or v.shape[-1] != 3:
        raise InputError(f"needs a last axis of 3, got shape {v.shape}", field=field)
    rows = v.reshape(-1, 3)
    bad = ~np.isfinite(rows).all(axis=1)
    if not zero:
        bad |= ~rows.any(axis=1)
    if bad.any():
        row = int(np.argmax(bad))
        raise InputError(
            "must be finite" + ("" if zero else " and not zero"),
            field=field,
            row=row if v.ndim > 1 else None,
            value=rows[row],
        )
    return v


def _pair(
    a: ArrayLike, b: ArrayLike, names: tuple[str, str], *, zero: bool = False
) -> tuple[FloatArray, FloatArray]:
    x, y = _vectors(a, names[0]), _vectors(b, names[1], zero=zero)
    try:
        x, y = np.broadcast_arrays(x, y)
    except ValueError:
        raise InputError(f"shapes {x.shape} and {y.shape} do not fit", field=names[1]) from None
    return x, y


def _norm(v: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.norm(v, axis=-1, keepdims=True))


def orbital(r: ArrayLike, v: ArrayLike) -> FloatArray:
    """Attitude of the orbital frame: z to the Earth's centre, y against the orbit's normal.

    ``z = -r / |r|``, ``y = -h / |h|`` with ``h = r x v``, ``x = y x z`` (along-track).

    Parameters
    ----------
    r, v : array_like (..., 3)
        Inertial positions [m] and velocities [m/s].

    Returns
    -------
    ndarray (..., 4)
        ``q_io``, orbital to inertial; sign-continuous along the last but one axis.

    Raises
    ------
    InputError
        If a row is not finite, or its velocity is zero or along the position.

    Examples
    --------
    >>> import celestcore as cc
    >>> q_io = orbital([7e6, 0.0, 0.0], [0.0, 7.5e3, 0.0])
    >>> cc.quaternion.rotate(q_io, [1.0, 0.0, 0.0]).round(12) + 0.0
    array([0., 1., 0.])
    """
    position, velocity = _pair(r, v, ("r", "v"))
    h = np.cross(position, velocity)
    flat = ~(_norm(h) > 1e-12 * _norm(position) * _norm(velocity))[..., 0].reshape(-1)
    if flat.any():
        row = int(np.argmax(flat))
        raise InputError("is along the position: there is no orbital plane", field="v", row=row)
    z, y = -position / _norm(position), -h / _norm(h)
    q = from_matrix(np.stack([np.cross(y, z), y, z], axis=-1))
    return continuous(q) if q.ndim > 1 else q


def eclipse(
    r: ArrayLike,
    sun: ArrayLike,
    *,
    radius: float = WGS84_RADIUS,
    sun_radius: float = SUN_RADIUS,
) -> Eclipse:
    """How much of the Sun's disc the Earth covers, by cones of umbra and penumbra.

    The Earth is a sphere, without atmosphere; light takes no time (the Sun moves by 20 arcsec in
    it). Montenbruck and Gill, *Satellite Orbits* (2000), section 3.4.2.

    Parameters
    ----------
    r : array_like (..., 3)
        Positions of the satellite from the Earth's centre [m].
    sun : array_like (..., 3)
        Positions of the Sun from the Earth's centre, in the same frame [m].
    radius, sun_radius : float
        Of the Earth and the Sun [m].

    Returns
    -------
    Eclipse
        `lit`, `umbra` and `penumbra`, each (...).

    Raises
    ------
    InputError
        If a position is not finite or inside the Earth.

    Examples
    --------
    >>> seen = eclipse([[-7e6, 0.0, 0.0], [7e6, 0.0, 0.0]], [1.496e11, 0.0, 0.0])
    >>> seen.lit
    array([0., 1.])
    """
    position, star = _pair(r, sun, ("r", "sun"))
    earth = number(radius, "radius", above=0.0)
    distance = _norm(position)[..., 0]
    inside = ~(distance >= earth).reshape(-1)
    if inside.any():
        row = int(np.argmax(inside))
        raise InputError(
            f"is inside the Earth, whose radius is {earth:.0f} m (positions are in metres)",
            field="r",
            row=row,
            value=distance.reshape(-1)[row],
        )
    to_sun = star - position
    a = np.arcsin(number(sun_radius, "sun_radius", above=0.0) / _norm(to_sun)[..., 0])
    b = np.arcsin(earth / distance)
    across = _norm(np.cross(position, to_sun))[..., 0]
    c = np.arctan2(across, -(position * to_sun).sum(axis=-1))
    lit = 1.0 - _overlap(a, b, c) / (np.pi * a * a)
    umbra = c <= b - a
    lit = np.where(umbra, 0.0, np.where(c >= a + b, 1.0, np.clip(lit, 0.0, 1.0)))
    return Eclipse(lit, umbra, (c < a + b) & ~umbra)


def _overlap(a: FloatArray, b: FloatArray, c: FloatArray) -> FloatArray:
    """Return the area that discs of radii a and b have in common at a distance c."""
    near = np.minimum(np.maximum(c, np.abs(a - b)), a + b)  # inside one another, or touching
    near = np.maximum(near, 1e-300)
    x = (near * near + a * a - b * b) / (2.0 * near)
    y = np.sqrt(np.maximum(a * a - x * x, 0.0))
    area = a * a * np.arctan2(y, x) + b * b * np.arctan2(y, near - x) - near * y
    return np.where(c <= np.abs(a - b), np.pi * np.minimum(a, b) ** 2, area)


def geodetic(r_e: ArrayLike) -> GroundTrack:
    """Geodetic latitude, longitude and height of Earth-fixed positions (WGS84).

    Bowring's iteration for the reduced latitude (*The accuracy of geodetic latitude and height
    equations*, Survey Review 28, 1985), repeated until nothing changes.

    Parameters
    ----------
    r_e : array_like (..., 3)
        Positions in ITRS [m].

    Returns
    -------
    GroundTrack

    Raises
    ------
    InputError
        If a position is not finite, or within 100 km of the Earth's centre (kilometres?).

    Examples
    --------
    >>> place = geodetic([0.0, 0.0, 6356752.3142 + 500e3])
    >>> float(place.latitude.round(9)), float(place.height.round(3))
    (1.570796327, 500000.0)
    """
    v = _vectors(r_e, "r_e")
    low = (_norm(v)[..., 0] < 1e5).reshape(-1)
    if low.any():
        row = int(np.argmax(low))
        raise InputError(
            "is within 100 km of the Earth's centre: positions are in metres, not kilometres",
            field="r_e",
            row=row,
            value=v.reshape(-1, 3)[row],
        )
    f, a = WGS84_FLATTENING, WGS84_RADIUS
    square = f * (2.0 - f)
    p, z = np.hypot(v[..., 0], v[..., 1]), v[..., 2]
    reduced = np.arctan2(z, (1.0 - f) * p)
    for _ in range(6):
        up = z + square / (1.0 - f) * a * np.sin(reduced) ** 3
        out = p - square * a * np.cos(reduced) ** 3
        latitude = np.arctan2(up, out)
        reduced = np.arctan2((1.0 - f) * np.sin(latitude), np.cos(latitude))
    sine = np.sin(latitude)
    height = p * np.cos(latitude) + z * sine - a * np.sqrt(1.0 - square * sine * sine)
    return GroundTrack(latitude, np.arctan2(v[..., 1], v[..., 0]), height)


def from_geodetic(latitude: ArrayLike, longitude: ArrayLike, height: ArrayLike) -> FloatArray:
    """Earth-fixed positions (..., 3) [m] of geodetic coordinates (...), WGS84.

    Parameters
    ----------
    latitude, longitude : array_like (...)
        [rad].
    height : array_like (...)
        [m] above the ellipsoid.

    Examples
    --------
    >>> from_geodetic(0.0, 0.0, 500e3).round(3)
    array([6878137.,       0.,       0.])
    """
    lat, lon = array(latitude, "latitude"), array(longitude, "longitude")
    h = array(height, "height")
    square = WGS84_FLATTENING * (2.0 - WGS84_FLATTENING)
    curvature = WGS84_RADIUS / np.sqrt(1.0 - square * np.sin(lat) ** 2)
    across = (curvature + h) * np.cos(lat)
    up = (curvature * (1.0 - square) + h) * np.sin(lat)
    return np.stack(
        np.broadcast_arrays(across * np.cos(lon), across * np.sin(lon), up), axis=-1
    ).astype(np.float64)


def ground_track(
    epoch: Any,
    t: ArrayLike,
    r: ArrayLike,
    *,
    orientation: str = "iers",
    method: str | None = None,
) -> GroundTrack:
    """Where a satellite stands above the Earth.

    Parameters
    ----------
    epoch, t, orientation, method
        As in `gcrs_to_itrs`.
    r : array_like (..., 3)
        Positions in GCRS [m], one to each time.

    Returns
    -------
    GroundTrack
        `latitude`, `longitude` [rad] and `height` [m] on WGS84, each (...).

    Raises
    ------
    InputError
        If a position or the epoch cannot be used.

    Examples
    --------
    >>> track = ground_track("2026-01-01", [0.0, 60.0], [[7e6, 0.0, 0.0]] * 2)
    >>> track.height.round(-3)
    array([622000., 622000.])
    """
    r_e, _ = to_itrs(epoch, t, r, orientation=orientation, method=method)
    return geodetic(r_e)


def aberrate(directions: ArrayLike, velocity: ArrayLike) -> FloatArray:
    """Apparent directions of stars for an observer who moves.

    The exact Lorentz transformation of a direction (IERS Conventions and SOFA's ``ab``, without the
    light bent by the Sun). The velocity is all there is to it: hand over `earth_velocity` for
    annual aberration (20.5 arcsec), and add the orbit's velocity (5 arcsec in low orbits).
    The opposite velocity takes the aberration off again.

    Parameters
    ----------
    directions : array_like (..., 3)
        Directions to the stars in the inertial frame; they need not be unit vectors.
    velocity : array_like (..., 3)
        Of the observer relative to the solar system's barycentre, in the same axes [m/s].

    Returns
    -------
    ndarray (..., 3)
        Unit vectors.

    Raises
    ------
    InputError
        If a direction is zero or the speed is not below that of light.

    Examples
    --------
    >>> seen = aberrate([1.0, 0.0, 0.0], [0.0, 29.8e3, 0.0])
    >>> float((seen[1] / np.pi * 648000).round(2))  # arcsec
    20.5
    """
    star, moving = _pair(directions, velocity, ("directions", "velocity"), zero=True)
    u, beta = star / _norm(star), moving / LIGHT
    square = (beta * beta).sum(axis=-1, keepdims=True)
    fast = ~(square < 1.0).reshape(-1)
    if fast.any():
        row = int(np.argmax(fast))
        raise InputError("must be below the speed of light", field="velocity", row=row)
    lag = np.sqrt(1.0 - square)
    along = (u * beta).sum(axis=-1, keepdims=True)
    seen = lag * u + (1.0 + along / (1.0 + lag)) * beta
    return np.asarray(seen / _norm(seen))
