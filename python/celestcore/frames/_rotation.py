"""Between the inertial frame (GCRS) and the Earth-fixed one (ITRS), by the celestial pole."""

from __future__ import annotations

from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from celestcore._check import FloatArray, array, warn
from celestcore._optional import require
from celestcore.errors import InputError
from celestcore.frames import _iers, _series
from celestcore.frames._time import DAY, JD_MJD, Instant, instant

METHODS = ("erfa", "builtin")
EARTH_RATE = 7.292115146706979e-5
"""Rate of the Earth rotation angle [rad/s of UT1], IERS Conventions (2010) eq. 5.15."""
_STEP = 3600.0
_TT_J2000 = 2451545.0


def choose(method: str | None) -> Any:
    """Return pyerfa's module, or None where the built-in series are to be used.

    Warns, saying what it costs, if pyerfa is missing and nobody chose.
    """
    if method == "erfa":
        return require("erfa", extra="orbit", what="precise frames")
    if method == "builtin":
        return None
    if method is not None:
        raise InputError("must be 'erfa', 'builtin' or None", field="method", value=method)
    try:
        return import_module("erfa")
    except ImportError:
        warn(f"pyerfa is not installed: {_series.COST}; pip install 'celestcore[orbit]'")
        return None


def cip(erfa: Any, start: Instant, t: FloatArray) -> FloatArray:
    """Return X, Y, s (n, 3) [rad] of the model: IAU 2006/2000A, or the built-in series."""
    if erfa is None:
        return _series.pole(start.centuries(t))
    day, rest = start.julian(t)
    return np.stack(erfa.xys06a(day, rest), axis=-1)


def with_offsets(erfa: Any, start: Instant, t: FloatArray, source: str) -> FloatArray:
    """Return X, Y, s with the measured pole offsets dX, dY added."""
    xys = cip(erfa, start, t)
    offsets = _iers.orientation(start, t, source)
    x, y = xys[:, 0] + offsets.dx, xys[:, 1] + offsets.dy
    # s + X Y / 2 depends on the pole only by terms far below a microarcsecond
    s = xys[:, 2] + 0.5 * (xys[:, 0] * xys[:, 1] - x * y)
    return np.stack([x, y, s], axis=-1)


def _cip_at(
    erfa: Any, start: Instant, t: FloatArray, source: str, origin: float | None
) -> FloatArray:
    """Return X, Y, s at any times: from hourly nodes where that is less work.

    With an `origin` always from nodes, counted from there: part of a longer row of times that
    begins at `origin` has the bits that it has in the whole.
    """
    low = float(np.floor(t.min() / _STEP)) - 3.0 if len(t) else 0.0
    count = int(np.ceil(t.max() / _STEP) - low) + 5 if len(t) else 0
    if erfa is None or len(t) <= (0 if origin is not None else count):
        return with_offsets(erfa, start, t, source)
    first = low if origin is None else float(np.floor(origin / _STEP)) - 3.0
    xys = cip(erfa, start, np.asarray(_STEP * (low + np.arange(count)), dtype=np.float64))
    inside = _lagrange(t / _STEP - first, xys, int(low - first))
    offsets = _iers.orientation(start, t, source)
    x, y = inside[:, 0] + offsets.dx, inside[:, 1] + offsets.dy
    s = inside[:, 2] + 0.5 * (inside[:, 0] * inside[:, 1] - x * y)
    return np.stack([x, y, s], axis=-1)


def _lagrange(u: FloatArray, values: FloatArray, skip: int) -> FloatArray:
    """Interpolate rows given at skip, skip + 1 ... to positions u (n,), by 8 points around each."""
    first = np.clip(np.floor(u).astype(int) - 3, skip, skip + len(values) - 8)
    out = np.zeros((len(u), values.shape[1]))
    for j in range(8):
        weight = np.ones_like(u)
        for k in range(8):
            if k != j:
                weight *= (u - first - k) / (j - k)
        out += weight[:, None] * values[first - skip + j]
    return out


def earth_rotation_angle(start: Instant, t: FloatArray, ut1_tt: FloatArray) -> FloatArray:
    """Return the Earth rotation angle [rad] (IERS Conventions (2010) eq. 5.15)."""
    seconds = start.seconds + t + ut1_tt
    fraction = seconds / DAY + 0.5  # of a day since noon: the Julian date ends in .5
    days = (start.mjd + JD_MJD - 0.5 - _TT_J2000) + fraction
    turns = (fraction % 1.0) + 0.7790572732640 + 0.00273781191135448 * days
    # the whole days before 0h count whole turns, the half day of the Julian date is in `fraction`
    return np.asarray(2.0 * np.pi * (turns % 1.0))


def _celestial(xys: FloatArray) -> FloatArray:
    """Return GCRS to intermediate frame (n, 3, 3): transpose of IERS Conventions eq. 5.10."""
    x, y, s = np.moveaxis(xys, -1, 0)
    a = 1.0 / (1.0 + np.sqrt(1.0 - x * x - y * y))
    q = np.empty((len(x), 3, 3))
    q[:, 0] = np.stack([1.0 - a * x * x, -a * x * y, -x], axis=-1)
    q[:, 1] = np.stack([-a * x * y, 1.0 - a * y * y, -y], axis=-1)
    q[:, 2] = np.stack([x, y, 1.0 - a * (x * x + y * y)], axis=-1)
    return _turn(2, -s) @ q


def _turn(axis: int, angle: FloatArray) -> FloatArray:
    """Return the frame rotations R1, R2 or R3 (n, 3, 3) about axis 0, 1 or 2."""
    out = np.zeros((len(angle), 3, 3))
    j, k = (axis + 1) % 3, (axis + 2) % 3
    out[:, axis, axis] = 1.0
    out[:, j, j] = out[:, k, k] = np.cos(angle)
    out[:, j, k] = np.sin(angle)
    out[:, k, j] = -np.sin(angle)
    return out


def tio_locator(start: Instant, t: FloatArray) -> FloatArray:
    """Return s' [rad] (IERS Conventions (2010) eq. 5.13)."""
    return np.asarray(-47e-6 * start.centuries(t) * np.pi / 648000.0)


def parts(
    epoch: Any,
    t: FloatArray,
    orientation: str,
    method: str | None,
    origin: float | None = None,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return polar motion W, rotation R3(ERA) and C, each (n, 3, 3); `origin` as in `_cip_at`."""
    _iers.check(orientation)
    erfa, start = choose(method), instant(epoch)
    eop = _iers.orientation(start, t, orientation)
    celestial = _celestial(_cip_at(erfa, start, t, orientation, origin))
    spin = _turn(2, earth_rotation_angle(start, t, eop.ut1_tt))
    polar = _turn(0, -eop.yp) @ _turn(1, -eop.xp) @ _turn(2, tio_locator(start, t))
    return polar, spin, celestial


def flat_times(t: ArrayLike) -> tuple[FloatArray, tuple[int, ...]]:
    """Return finite times as one row, and their shape."""
    seconds = array(t, "t")
    flat = seconds.reshape(-1)
    bad = ~np.isfinite(flat)
    if bad.any():
        row = int(np.argmax(bad))
        raise InputError("a time must be finite", field="t", row=row, value=flat[row])
    return flat, seconds.shape


def gcrs_to_itrs(
    epoch: Any, t: ArrayLike = 0.0, *, orientation: str = "iers", method: str | None = None
) -> FloatArray:
    """Rotation matrices that take GCRS components to ITRS components.

    ``R = W R3(ERA) C`` of IERS Conventions (2010) eq. 5.1, with IAU 2006/2000A precession-nutation.

    Parameters
    ----------
    epoch : str, datetime or astropy Time
        Start of the time line; UTC unless a scale follows.
    t : array_like (...)
        Elapsed SI seconds since the epoch.
    orientation : {"iers", "zero"}
        Pole, UT1 and pole offsets from the IERS tables of `astropy-iers-data`, or zeros, with a
        warning.
    method : {None, "erfa", "builtin"}
        Precession-nutation by pyerfa, or by a short series. None takes pyerfa if it is installed
        and otherwise the series, with a warning that says what it costs.

    Returns
    -------
    ndarray (..., 3, 3)

    Raises
    ------
    InputError
        If the epoch is no time or outside the table.

    Examples
    --------
    >>> r_ei = gcrs_to_itrs("2026-01-01T00:00:00", [0.0, 60.0])
    >>> r_ei.shape
    (2, 3, 3)
    """
    flat, shape = flat_times(t)
    if not len(flat):
        return np.empty((*shape, 3, 3))
    polar, spin, celestial = parts(epoch, flat, orientation, method)
    return (polar @ spin @ celestial).reshape(*shape, 3, 3)


def itrs_to_gcrs(
    epoch: Any, t: ArrayLike = 0.0, *, orientation: str = "iers", method: str | None = None
) -> FloatArray:
    """Rotation matrices (..., 3, 3) that take ITRS components to GCRS components.

    The transposes of `gcrs_to_itrs`.

    Parameters
    ----------
    epoch, t, orientation, method
        As `gcrs_to_itrs`.

    Examples
    --------
    >>> r_ie = itrs_to_gcrs("2026-01-01T00:00:00")
    >>> np.allclose(r_ie @ gcrs_to_itrs("2026-01-01T00:00:00"), np.eye(3))
    True
    """
    matrix = gcrs_to_itrs(epoch, t, orientation=orientation, method=method)
    return np.ascontiguousarray(np.swapaxes(matrix, -1, -2))


def _state(
    r: ArrayLike, v: ArrayLike | None, shape: tuple[int, ...]
) -> tuple[FloatArray, FloatArray | None]:
    position = array(r, "r")
    velocity = None if v is None else array(v, "v")
    for name, value in (("r", position), ("v", velocity)):
        if value is not None and value.shape != (*shape, 3):
            raise InputError(f"has shape {value.shape}, needed is {(*shape, 3)}", field=name)
    return position.reshape(-1, 3), None if velocity is None else velocity.reshape(-1, 3)


def _apply(matrix: FloatArray, v: FloatArray) -> FloatArray:
    return np.asarray((matrix @ v[..., None])[..., 0])


def to_itrs(
    epoch: Any,
    t: ArrayLike,
    r: ArrayLike,
    v: ArrayLike | None = None,
    *,
    orientation: str = "iers",
    method: str | None = None,
) -> tuple[FloatArray, FloatArray | None]:
    """Positions, and velocities relative to the turning Earth, from GCRS to ITRS.

    Parameters
    ----------
    epoch, t, orientation, method
        As in `gcrs_to_itrs`.
    r : array_like (..., 3)
        Positions in GCRS [m], one to each time.
    v : array_like (..., 3), optional
        Velocities in GCRS [m/s].

    Returns
    -------
    r_e, v_e : ndarray (..., 3)
        In ITRS; `v_e` is None without velocities. The motion of the pole (below 0.1 mm/s in low
        orbits) is left out of the velocity.

    Raises
    ------
    InputError
        If there is not one row to each time, or the epoch cannot be used.

    Examples
    --------
    >>> r_e, v_e = to_itrs("2026-01-01", [0.0], [[7e6, 0.0, 0.0]], [[0.0, 7.5e3, 0.0]])
    >>> float(np.linalg.norm(v_e).round())
    6990.0
    """
    flat, shape = flat_times(t)
    position, velocity = _state(r, v, shape)
    polar, spin, celestial = parts(epoch, flat, orientation, method)
    turning = _apply(spin @ celestial, position)
    r_e = _apply(polar, turning).reshape(*shape, 3)
    if velocity is None:
        return r_e, None
    relative = _apply(spin @ celestial, velocity) - np.cross([0.0, 0.0, EARTH_RATE], turning)
    return r_e, _apply(polar, relative).reshape(*shape, 3)


def to_gcrs(
    epoch: Any,
    t: ArrayLike,
    r: ArrayLike,
    v: ArrayLike | None = None,
    *,
    orientation: str = "iers",
    method: str | None = None,
) -> tuple[FloatArray, FloatArray | None]:
    """Positions and velocities from ITRS to GCRS: the inverse of `to_itrs`.

    Parameters
    ----------
    epoch, t, r, v, orientation, method
        As `to_itrs`, with Earth-fixed positions and velocities.

    Examples
    --------
    >>> r_e, v_e = to_itrs("2026-01-01", [0.0], [[7e6, 0.0, 0.0]], [[0.0, 7.5e3, 0.0]])
    >>> r, v = to_gcrs("2026-01-01", [0.0], r_e, v_e)
    >>> r.round(3) + 0.0, v.round(6) + 0.0
    (array([[7000000., 0., 0.]]), array([[ 0., 7500., 0.]]))
    """
    flat, shape = flat_times(t)
    position, velocity = _state(r, v, shape)
    polar, spin, celestial = (np.swapaxes(m, 1, 2) for m in parts(epoch, flat, orientation, method))
    turning = _apply(polar, position)
    r_i = _apply(celestial @ spin, turning).reshape(*shape, 3)
    if velocity is None:
        return r_i, None
    absolute = _apply(polar, velocity) + np.cross([0.0, 0.0, EARTH_RATE], turning)
    return r_i, _apply(celestial @ spin, absolute).reshape(*shape, 3)
