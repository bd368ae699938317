"""Time scales: an epoch and elapsed seconds to two-part Julian dates, with leap seconds."""

from __future__ import annotations

import functools
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from celestcore._check import FloatArray, array
from celestcore._epoch import Reading, read_epoch
from celestcore.errors import InputError

DAY = 86400.0
TT_TAI = 32.184
"""TT - TAI [s]."""
TAI_GPS = 19.0
JD_MJD = 2400000.5
_J2000_MJD = 51544
_LG = 6.969290134e-10
"""1 - d(TT)/d(TCG), IAU 2000 resolution B1.9."""
_LB = 1.550519768e-8
"""1 - d(TDB)/d(TCB), IAU 2006 resolution B3."""
_TDB0 = -6.55e-5
_T77 = (43144, 32.184)
"""1977-01-01T00:00:32.184, where TT, TCG and TCB agree."""
SCALES = ("TT", "TAI", "UTC", "UT1", "TDB")

# first days (MJD) of TAI - UTC = 10, 11, 12 ... s; IERS Bulletin C
_LEAPS = (
    *(41317, 41499, 41683, 42048, 42413, 42778, 43144, 43509, 43874, 44239, 44786, 45151, 45516),
    *(46247, 47161, 47892, 48257, 48804, 49169, 49534, 50083, 50630, 51179, 53736, 54832, 56109),
    *(57204, 57754),
)


class Instant(NamedTuple):
    """An epoch as TT: day (MJD) and seconds of the day, kept apart so that nothing is rounded."""

    mjd: int
    seconds: float

    def julian(self, t: ArrayLike = 0.0) -> tuple[float, FloatArray]:
        """Return the two-part TT Julian date `t` seconds later: a whole half-day and a rest."""
        return self.mjd + JD_MJD, np.asarray((self.seconds + np.asarray(t)) / DAY)

    def centuries(self, t: ArrayLike = 0.0) -> FloatArray:
        """Return Julian centuries of TT since J2000."""
        days = self.mjd - _J2000_MJD - 0.5 + (self.seconds + np.asarray(t, dtype=float)) / DAY
        return np.asarray(days / 36525.0)


@functools.cache
def leap_table() -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Return the first days (MJD) and values of TAI - UTC [s].

    The list of `astropy-iers-data` is used where that is installed and newer than the built-in one.
    """
    days, values = list(_LEAPS), list(range(10, 10 + len(_LEAPS)))
    try:
        path = Path(import_module("astropy_iers_data").IERS_LEAP_SECOND_FILE)
        lines = path.read_text().splitlines()
    except (ImportError, AttributeError, OSError):
        lines = []
    for line in lines:
        if not line.startswith("#") and line.strip():
            day, value = int(float(line.split()[0])), int(line.split()[-1])
            if day > days[-1]:
                days.append(day)
                values.append(value)
    return tuple(days), tuple(values)


def leap_seconds(mjd: ArrayLike) -> FloatArray:
    """Return TAI - UTC [s] on UTC days (MJD) from 1972 on."""
    days, values = leap_table()
    row = np.searchsorted(days, np.floor(mjd), side="right") - 1
    return np.asarray(values, dtype=float)[np.maximum(row, 0)]


def _tai_of_utc(read: Reading, value: Any) -> tuple[int, float]:
    if read.mjd < _LEAPS[0]:
        raise InputError(
            "is before 1972, when UTC had no leap seconds yet: give TAI or TT",
            field="epoch",
            value=str(value),
        )
    # a leap second 23:59:60 stands at the end of the UTC day; an offset moves the clock from it
    mjd, seconds = read.mjd, read.seconds
    if read.offset:
        whole = np.floor((seconds - read.offset) / DAY)
        mjd, seconds = mjd + int(whole), seconds - read.offset - whole * DAY
    step = float(leap_seconds(mjd + 1) - leap_seconds(mjd))
    if seconds >= DAY + step:
        raise InputError("has a leap second where none was", field="epoch", value=str(value))
    return mjd, seconds + float(leap_seconds(mjd))


def tdb_minus_tt(centuries: ArrayLike) -> FloatArray:
    """TDB - TT [s] at the geocentre, good to 30 microseconds from 1980 to 2050.

    The seven largest terms of Fairhead and Bretagnon (1990), as in USNO Circular 179, eq. 2.6.
    """
    t = np.asarray(centuries, dtype=float)
    return np.asarray(
        0.001657 * np.sin(628.3076 * t + 6.2401)
        + 0.000022 * np.sin(575.3385 * t + 4.2970)
        + 0.000014 * np.sin(1256.6152 * t + 6.1969)
        + 0.000005 * np.sin(606.9777 * t + 4.0212)
        + 0.000005 * np.sin(52.9691 * t + 0.4444)
        + 0.000002 * np.sin(21.3299 * t + 5.5431)
        + 0.000010 * t * np.sin(628.3076 * t + 4.2490)
    )


def instant(epoch: Any) -> Instant:
    """Return an epoch of any scale as TT.

    Raises
    ------
    InputError
        If it is no time, is in UTC before 1972, or in UT1 and outside the Earth-orientation table.
    """
    read = read_epoch(epoch)
    scale, mjd, seconds = read.scale, read.mjd, read.seconds
    if scale == "UTC":
        mjd, seconds = _tai_of_utc(read, epoch)
    elif seconds >= DAY:
        raise InputError("only UTC has leap seconds", field="epoch", value=str(epoch))
    if scale in ("UTC", "TAI"):
        seconds += TT_TAI
    elif scale == "GPS":
        seconds += TAI_GPS + TT_TAI
    elif scale != "TT":
        seconds += _other(scale, mjd, seconds)
    whole = np.floor(seconds / DAY)
    return Instant(mjd + int(whole), float(seconds - whole * DAY))


def _other(scale: str, mjd: int, seconds: float) -> float:
    """Return TT less the reading of a scale that runs at another rate [s]."""
    if scale == "UT1":
        from celestcore.frames._iers import tt_minus_ut1

        return tt_minus_ut1(mjd, seconds)
    since = (mjd - _T77[0]) * DAY + (seconds - _T77[1])
    if scale == "TCG":
        return -_LG * since
    tdb = seconds if scale == "TDB" else seconds - _LB * since + _TDB0
    return tdb - seconds - float(tdb_minus_tt(Instant(mjd, tdb).centuries()))


def julian_date(epoch: Any, t: ArrayLike = 0.0, *, scale: str = "TT") -> FloatArray:
    """Two-part Julian dates of an epoch and the seconds after it.

    Parameters
    ----------
    epoch : str, datetime or astropy Time
        An ISO string; UTC unless a scale follows (``TAI``, ``TT``, ``GPS``, ``TDB``, ``TCG``,
        ``TCB``, ``UT1`` or an offset such as ``+02:00``).
    t : array_like (...)
        Elapsed SI seconds since the epoch.
    scale : {"TT", "TAI", "UTC", "UT1", "TDB"}
        Of the result. UTC is the quasi Julian date of SOFA, whose days with a leap second are
        86 401 s long; UT1 needs the extra ``orbit`` and an epoch within its table.

    Returns
    -------
    ndarray (..., 2)
        Add the two to a Julian date, or hand both to SOFA or ERFA; together they resolve a
        nanosecond, the sum only 40 microseconds.

    Raises
    ------
    InputError
        If the epoch is no time, UTC is before 1972, or UT1 outside the table.

    Examples
    --------
    >>> julian_date("2000-01-01T12:00:00 TT", [0.0, 43200.0])
    array([[2.4515445e+06, 5.0000000e-01],
           [2.4515445e+06, 1.0000000e+00]])
    """
    if scale not in SCALES:
        raise InputError(f"must be one of {', '.join(SCALES)}", field="scale", value=scale)
    start, seconds = instant(epoch), array(t, "t")
    day, rest = start.julian(seconds)
    if scale == "TAI":
        rest = (start.seconds - TT_TAI + seconds) / DAY
    elif scale == "TDB":
        rest = rest + tdb_minus_tt(start.centuries(seconds)) / DAY
    elif scale == "UT1":
        from celestcore.frames._iers import orientation

        rest = (start.seconds + seconds + orientation(start, seconds).ut1_tt) / DAY
    elif scale == "UTC":
        return _utc(start, seconds)
    return np.stack([np.full(np.shape(rest), day), rest], axis=-1)


def _utc(start: Instant, t: FloatArray) -> FloatArray:
    seconds = start.seconds - TT_TAI + t
    day = start.mjd + np.floor(seconds / DAY)
    rest = seconds - DAY * np.floor(seconds / DAY)
    # the UTC day is the one before where the TAI - UTC of that day has not passed yet
    before = rest < leap_seconds(day)
    day, rest = day - before, rest + DAY * before - leap_seconds(day - before)
    if bool(np.any(day < _LEAPS[0])):
        raise InputError("UTC has leap seconds from 1972 on only: use another scale", field="scale")
    length = DAY + leap_seconds(day + 1) - leap_seconds(day)
    return np.stack([day + JD_MJD, rest / length], axis=-1)
