"""The epoch of a log: an ISO string, checked and read without astropy."""

from __future__ import annotations

import re
from datetime import date, datetime, timezone
from typing import Any, NamedTuple

from celestcore.errors import InputError

_ISO = re.compile(
    r"(\d{4})-(\d\d)-(\d\d)(?:[T ](\d\d):(\d\d)(?::(\d\d)(\.\d+)?)?)?"
    r"\s?(Z|[+-]\d\d:?\d\d|UTC|TAI|TT|GPS|TDB|TCB|TCG|UT1)?"
)
_MJD_OF_ORDINAL_ZERO = -678576


class Reading(NamedTuple):
    """What an epoch's string says: a calendar day, seconds of that day, and a time scale."""

    mjd: int
    seconds: float
    scale: str
    offset: float
    """Seconds that the clock is ahead of UTC; 0 unless the string has an offset."""


def read_epoch(value: Any, field: str = "epoch") -> Reading:
    """Read an epoch; a scale that is not given means UTC.

    Raises
    ------
    InputError
        If it is no time, or there is none.

    Examples
    --------
    >>> read_epoch("2000-01-01T12:00:00 TT")
    Reading(mjd=51544, seconds=43200.0, scale='TT', offset=0.0)
    """
    text = epoch_string(value)
    match = None if text is None else _ISO.fullmatch(text)
    if match is None:
        raise InputError(
            "is needed: an ISO time such as '2026-01-01T00:00:00' (UTC unless a scale follows)",
            field=field,
        )
    year, month, day, hour, minute, second = (int(g) if g else 0 for g in match.groups()[:6])
    seconds = 3600.0 * hour + 60.0 * minute + second + float(match[7] or 0.0)
    scale, offset = match[8] or "UTC", 0.0
    if scale[0] in "+-":
        digits = scale[1:].replace(":", "")
        offset = 3600.0 * int(digits[:2]) + 60.0 * int(digits[2:])
        offset = -offset if scale[0] == "-" else offset
    if scale == "Z" or scale[0] in "+-":
        scale = "UTC"
    mjd = date(year, month, day).toordinal() + _MJD_OF_ORDINAL_ZERO
    return Reading(mjd, seconds, scale, offset)


def epoch_string(value: Any) -> str | None:
    """Return an epoch as an ISO string; one without a time scale means UTC.

    Parameters
    ----------
    value : str, datetime, astropy Time or None
        ``"2026-01-01T00:00:00"``, optionally with ``Z``, an offset or a scale such as ``TAI``.

    Raises
    ------
    InputError
        If it is no time.

    Examples
    --------
    >>> epoch_string("2026-01-01T00:00:00 TAI")
    '2026-01-01T00:00:00 TAI'
    """
    if value is None:
        return None
    if isinstance(value, datetime):
        if value.tzinfo is not None:
            value = value.astimezone(timezone.utc).replace(tzinfo=None)
        return str(value.isoformat())
    if isinstance(value, date):
        return value.isoformat()
    if hasattr(value, "isot") and hasattr(value, "utc"):
        return _astropy(value)
    text = str(value).strip() if isinstance(value, str) or _is_datetime64(value) else ""
    match = _ISO.fullmatch(text)
    if match is None or not _is_real(match):
        raise InputError(
            "must be an ISO time such as '2026-01-01T00:00:00' (UTC unless a scale follows), "
            "an astropy Time or None",
            field="epoch",
            value=str(value),
        )
    return text


def _is_datetime64(value: Any) -> bool:
    return getattr(getattr(value, "dtype", None), "kind", "") == "M"


def _astropy(value: Any) -> str:
    if getattr(value, "shape", ()) != ():
        raise InputError("must be one time, not several", field="epoch", value=str(value))
    precise = value.utc.replicate()
    precise.precision = 9
    return str(precise.isot)


def _is_real(match: re.Match[str]) -> bool:
    year, month, day, hour, minute, second = (int(g) if g else 0 for g in match.groups()[:6])
    try:
        datetime(year, month, day, hour, minute, min(second, 59))
    except ValueError:
        return False
    return second <= 60
