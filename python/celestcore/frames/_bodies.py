"""Where the Sun and the Moon are, and how fast the Earth moves; tables of it all for a run."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from celestcore._check import FloatArray, array, number
from celestcore.errors import InputError
from celestcore.frames import _iers, _series
from celestcore.frames._rotation import choose, flat_times, tio_locator, with_offsets
from celestcore.frames._time import DAY, JD_MJD, Instant, instant

_EARTH_STEP = 3600.0
_BODY_STEP = 7200.0
_MARGIN = 6.0 * 3600.0


def _sun(erfa: Any, start: Instant, t: FloatArray) -> FloatArray:
    if erfa is None:
        return _series.sun(start.centuries(t))
    heliocentric, _ = erfa.epv00(*start.julian(t))
    return np.asarray(-erfa.DAU * heliocentric["p"])


def _moon(erfa: Any, start: Instant, t: FloatArray) -> FloatArray:
    if erfa is None:
        return _series.moon(start.centuries(t))
    return np.asarray(erfa.DAU * erfa.moon98(*start.julian(t))["p"])


def sun(epoch: Any, t: ArrayLike = 0.0, *, method: str | None = None) -> FloatArray:
    """Geometric position of the Sun from the Earth's centre.

    No light time and no aberration (together 20 arcsec), as third-body gravity needs it.

    Parameters
    ----------
    epoch : str, datetime or astropy Time
        Start of the time line; UTC unless a scale follows.
    t : array_like (...)
        Elapsed SI seconds since the epoch.
    method : {None, "erfa", "builtin"}
        pyerfa's ``epv00`` (2 arcsec at worst), or a short series (40 arcsec); None takes pyerfa
        if it is installed, and otherwise the series with a warning.

    Returns
    -------
    ndarray (..., 3)
        In GCRS [m].

    Raises
    ------
    InputError
        If the epoch is no time.

    Examples
    --------
    >>> float(np.linalg.norm(sun("2026-01-03T17:00:00")).round(-8))
    147100000000.0
    """
    erfa, start = choose(method), instant(epoch)
    flat, shape = flat_times(t)
    return _sun(erfa, start, flat).reshape(*shape, 3)


def moon(epoch: Any, t: ArrayLike = 0.0, *, method: str | None = None) -> FloatArray:
    """Geometric position of the Moon from the Earth's centre.

    Parameters
    ----------
    epoch, t
        As in `sun`.
    method : {None, "erfa", "builtin"}
        pyerfa's ``moon98`` (Meeus' short form of ELP2000, 10 arcsec), or a shorter series (300
        arcsec); None as in `sun`.

    Returns
    -------
    ndarray (..., 3)
        In GCRS [m].

    Raises
    ------
    InputError
        If the epoch is no time.

    Examples
    --------
    >>> moon("2026-01-01", [0.0, 3600.0]).shape
    (2, 3)
    """
    erfa, start = choose(method), instant(epoch)
    flat, shape = flat_times(t)
    return _moon(erfa, start, flat).reshape(*shape, 3)


def earth_velocity(epoch: Any, t: ArrayLike = 0.0, *, method: str | None = None) -> FloatArray:
    """Velocity of the Earth's centre relative to the solar system's barycentre.

    What annual aberration needs: hand it to `aberrate`, with the orbit's velocity added.

    Parameters
    ----------
    epoch, t
        As in `sun`.
    method : {None, "erfa", "builtin"}
        pyerfa's ``epv00``, or the built-in series of the Sun, differentiated (30 m/s, that is 0.02
        arcsec of aberration, because it leaves the planets and the Moon out); None as in `sun`.

    Returns
    -------
    ndarray (..., 3)
        In the axes of the GCRS [m/s].

    Raises
    ------
    InputError
        If the epoch is no time.

    Examples
    --------
    >>> float(np.linalg.norm(earth_velocity("2026-01-03T17:00:00")).round(-2))
    30300.0
    """
    erfa, start = choose(method), instant(epoch)
    flat, shape = flat_times(t)
    if erfa is None:
        moved = _sun(None, start, flat + 300.0) - _sun(None, start, flat - 300.0)
        return (-moved / 600.0).reshape(*shape, 3)
    _, barycentric = erfa.epv00(*start.julian(flat))
    return np.asarray(barycentric["v"] * (erfa.DAU / DAY)).reshape(*shape, 3)


def earth_position(epoch: Any, t: ArrayLike = 0.0, *, method: str | None = None) -> FloatArray:
    """Position of the Earth's centre relative to the solar system's barycentre.

    What annual parallax needs (`StarCatalogue.hipparcos`).

    Parameters
    ----------
    epoch, t
        As in `sun`.
    method : {None, "erfa", "builtin"}
        pyerfa's ``epv00``, or the built-in series of the Sun (which takes the Sun's centre for the
        barycentre, an error of one percent); None as in `sun`.

    Returns
    -------
    ndarray (..., 3)
        In the axes of the GCRS [m].

    Raises
    ------
    InputError
        If the epoch is no time.

    Examples
    --------
    >>> float(np.linalg.norm(earth_position("2026-01-03T17:00:00")).round(-10))
    150000000000.0
    """
    erfa, start = choose(method), instant(epoch)
    flat, shape = flat_times(t)
    if erfa is None:
        return -_sun(None, start, flat).reshape(*shape, 3)
    _, barycentric = erfa.epv00(*start.julian(flat))
    return np.asarray(barycentric["p"] * erfa.DAU).reshape(*shape, 3)


def _nodes(first: float, last: float, step: float) -> FloatArray:
    begin, end = np.floor((first - _MARGIN) / step), np.ceil((last + _MARGIN) / step)
    return np.asarray(step * np.arange(begin, end + 1.0))


def _limits(duration: Any) -> tuple[float, float]:
    ends = array(duration, "duration").reshape(-1)
    if len(ends) not in (1, 2):
        raise InputError("must be one time or a first and a last one", field="duration")
    given = [number(end, "duration") for end in ends]
    first, last = min(*given, 0.0), max(*given, 0.0)
    if last - first > 3.2e9:
        raise InputError("must be below a century of seconds", field="duration", value=last - first)
    return first, last


def environment(
    epoch: Any, duration: ArrayLike, *, orientation: str = "iers", method: str | None = None
) -> dict[str, FloatArray]:
    """Tables of the Earth's orientation, the Sun and the Moon for a run, as propagators use them.

    All that depends on the epoch is computed here once; the propagator only interpolates.

    Parameters
    ----------
    epoch : str, datetime or astropy Time
        The run's ``t = 0``; UTC unless a scale follows.
    duration : float or (float, float)
        How far the run goes [s], negative for one that goes back; or its first and last time.
        Tables cover ``t = 0`` and reach 6 h beyond the run.
    orientation, method
        As in `gcrs_to_itrs`.

    Returns
    -------
    dict of ndarray
        ``earth_t`` (n,) hourly times [s]; ``cip`` (n, 3) X, Y, s [rad]; ``pole`` (n, 2) xp, yp
        [rad]; ``sp`` (n,) s' [rad]; ``ut1`` (2,) two-part UT1 Julian date at ``t = 0``; ``dut1``
        (n,) UT1 - TT less its value at ``t = 0`` [s], so that ``UT1(t) = ut1 + (t + dut1) /
        86400``; ``body_t`` (m,) times every 2 h [s]; ``sun``, ``moon`` (m, 3) GCRS [m].

    Raises
    ------
    InputError
        If the epoch is no time or the run leaves the table of the Earth's orientation.

    Examples
    --------
    >>> tables = environment("2026-01-01T00:00:00", 36000.0)
    >>> tables["cip"].shape, tables["sun"].shape
    ((23, 3), (12, 3))
    """
    first, last = _limits(duration)
    _iers.check(orientation)
    erfa, start = choose(method), instant(epoch)
    earth_t, body_t = _nodes(first, last, _EARTH_STEP), _nodes(first, last, _BODY_STEP)
    eop = _iers.orientation(start, earth_t, orientation)
    at_start = float(_iers.orientation(start, 0.0, orientation).ut1_tt)
    tables = {
        "earth_t": earth_t,
        "cip": with_offsets(erfa, start, earth_t, orientation),
        "pole": np.stack([eop.xp, eop.yp], axis=-1),
        "sp": tio_locator(start, earth_t),
        "ut1": np.array([start.mjd + JD_MJD, (start.seconds + at_start) / DAY]),
        "dut1": eop.ut1_tt - at_start,
        "body_t": body_t,
        "sun": _sun(erfa, start, body_t),
        "moon": _moon(erfa, start, body_t),
    }
    return {name: np.ascontiguousarray(value) for name, value in tables.items()}
