"""Rows of CCSDS messages: elapsed seconds to calendar strings and back, with leap seconds."""

from __future__ import annotations

import re
from collections.abc import Sequence
from datetime import date
from typing import Any

import numpy as np

from celestcore._check import FloatArray, array, times
from celestcore.errors import InputError
from celestcore.frames._time import DAY, TT_TAI, instant, leap_seconds

_TEXT = re.compile(r"(\d{4})-(?:(\d\d)-(\d\d)|(\d{3}))T(\d\d):(\d\d):(\d\d)(\.\d+)?Z?")
_ORDINAL_MJD = 678576
_NANO = 10**9
_DAY_NANO = 86400 * _NANO
SYSTEMS = ("UTC", "TAI", "TT", "GPS")
"""Time systems that are read: they count SI seconds, UTC with leap seconds."""


def utc_strings(epoch: Any, t: Any, field: str = "t") -> list[str]:
    """Return UTC calendar strings, to the nanosecond, of elapsed SI seconds since an epoch.

    Raises
    ------
    InputError
        If times do not increase, or two are one when rounded to a nanosecond; if the epoch is no
        time or before 1972.

    Examples
    --------
    >>> utc_strings("2016-12-31T23:59:59", [0.0, 1.25, 2.0])
    ['2016-12-31T23:59:59.000', '2016-12-31T23:59:60.250', '2017-01-01T00:00:00.000']
    """
    seconds, start = times(t, field), instant(epoch)
    whole = np.floor(seconds)
    nano = whole.astype(np.int64) * _NANO + np.rint((seconds - whole) * _NANO).astype(np.int64)
    same = nano[1:] <= nano[:-1]
    if same.any():
        row = 1 + int(np.argmax(same))
        raise InputError(
            "is the time before to a nanosecond, which is all a message holds",
            field=field,
            row=row,
            value=seconds[row],
        )
    nano += round((start.seconds - TT_TAI) * _NANO)
    day, rest = start.mjd + nano // _DAY_NANO, nano % _DAY_NANO
    before = rest < leap_seconds(day) * _NANO
    day = day - before
    if day[0] < 41317:
        raise InputError("UTC has leap seconds from 1972 on only", field="epoch", value=str(epoch))
    rest = rest + before * _DAY_NANO - (leap_seconds(day) * _NANO).astype(np.int64)
    digits = next(k for k in (3, 6, 9) if not (rest % 10 ** (9 - k)).any())
    return [_text(d, n, digits) for d, n in zip(day.tolist(), rest.tolist(), strict=True)]


def _text(day: int, nano: int, digits: int) -> str:
    second, part = divmod(nano, _NANO)
    minute = min(second // 60, 1439)  # a leap second belongs to the last minute
    second -= 60 * minute
    fraction = f"{part:09d}"[:digits]
    calendar = date.fromordinal(day + _ORDINAL_MJD).isoformat()
    return f"{calendar}T{minute // 60:02d}:{minute % 60:02d}:{second:02d}.{fraction}"


def elapsed(texts: Sequence[str], system: str, field: str) -> tuple[str, FloatArray]:
    """Return the first of a message's times as an epoch, and SI seconds since it.

    Raises
    ------
    InputError
        If a time cannot be read, or the time system is not one of `SYSTEMS`.

    Examples
    --------
    >>> elapsed(["2016-12-31T23:59:60.5", "2017-001T00:00:01Z"], "UTC", "oem.epoch")
    ('2016-12-31T23:59:60.5', array([0. , 1.5]))
    """
    epoch, day, second = _read(texts, system, field)
    tai = second + (leap_seconds(day) if system == "UTC" else 0.0)
    return epoch, (day - day[0]) * DAY + (tai - tai[0])


def since(epoch: str, texts: Sequence[str], system: str, field: str) -> FloatArray:
    """Return SI seconds since an epoch of the same time system.

    Examples
    --------
    >>> since("2026-01-01T00:00:00", ["2026-01-01T00:01:00"], "UTC", "oem.covariance")
    array([60.])
    """
    text = epoch.split(" ")[0]
    return elapsed([text, *texts], system, field)[1][1:]


def _read(texts: Sequence[str], system: str, field: str) -> tuple[str, FloatArray, FloatArray]:
    """Return the first time as an epoch, and days (MJD) and seconds of the day of all."""
    if system not in SYSTEMS:
        raise InputError(
            f"the time system must be one of {', '.join(SYSTEMS)}", field=field, value=system
        )
    day, second = np.empty(len(texts)), np.empty(len(texts))
    for row, text in enumerate(texts):
        try:
            day[row], second[row] = _parse(text, system)
        except ValueError:
            raise InputError(
                f"is no {system} time such as 2026-01-01T00:00:00.000",
                field=field,
                row=row,
                value=text,
            ) from None
    first = texts[0].strip().rstrip("Z")
    calendar = date.fromordinal(int(day[0]) + _ORDINAL_MJD).isoformat()
    epoch = f"{calendar}{first[first.index('T') :]}"
    return (epoch if system == "UTC" else f"{epoch} {system}"), day, second


def _parse(text: str, system: str) -> tuple[int, float]:
    match = _TEXT.fullmatch(text.strip())
    if match is None:
        raise ValueError(text)
    year, month, day, of_year, hour, minute, second = (
        int(g) if g else 0 for g in match.groups()[:7]
    )
    ordinal = date(year, month or 1, day or 1).toordinal()
    if match[4]:
        ordinal += of_year - 1
        if date.fromordinal(ordinal).year != year or not of_year:
            raise ValueError(text)
    mjd = ordinal - _ORDINAL_MJD
    leap = second == 60 and (hour, minute) == (23, 59) and system == "UTC"
    if hour > 23 or minute > 59 or (second > 59 and not leap):
        raise ValueError(text)
    if leap and not leap_seconds(mjd + 1) > leap_seconds(mjd):
        raise ValueError(text)
    return mjd, 3600.0 * hour + 60.0 * minute + second + float(match[8] or 0.0)


def increasing(texts: list[str], system: str, kind: str) -> tuple[str, FloatArray]:
    epoch, t = elapsed(texts, system, f"{kind}.epoch")
    back = t[1:] <= t[:-1]
    if back.any():
        row = 1 + int(np.argmax(back))
        raise InputError(
            "does not come after the row before", field=f"{kind}.epoch", row=row, value=texts[row]
        )
    return epoch, t


def finite_rows(value: Any, field: str, n: int, width: int = 3) -> FloatArray:
    """Return finite rows (n, width)."""
    rows = array(value, field, (None, width))
    if len(rows) != n:
        raise InputError(f"has {len(rows)} rows for {n} times", field=field)
    bad = ~np.isfinite(rows).all(axis=1)
    if bad.any():
        row = int(np.argmax(bad))
        raise InputError(
            "must be finite; drop the row, a message knows no missing values",
            field=field,
            row=row,
            value=rows[row],
        )
    return rows
