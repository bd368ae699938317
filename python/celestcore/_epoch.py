"""The epoch of a log: an ISO string, checked without astropy."""

from __future__ import annotations

import re
from datetime import date, datetime, timezone
from typing import Any

from celestcore.errors import InputError

_ISO = re.compile(
    r"(\d{4})-(\d\d)-(\d\d)(?:[T ](\d\d):(\d\d)(?::(\d\d)(?:\.\d+)?)?)?"
    r"\s?(?:Z|[+-]\d\d:?\d\d|UTC|TAI|TT|GPS|TDB|TCB|TCG|UT1)?"
)


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
    year, month, day, hour, minute, second = (int(g) if g else 0 for g in match.groups())
    try:
        datetime(year, month, day, hour, minute, min(second, 59))
    except ValueError:
        return False
    return second <= 60
