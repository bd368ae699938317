"""Times as files have them - calendar, seconds of a scale, ticks that wrap - to elapsed seconds."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np

from celestcore._check import FloatArray, IntArray, array
from celestcore._epoch import read_epoch
from celestcore.errors import InputError
from celestcore.frames._time import DAY, TAI_GPS, TT_TAI, Instant, instant, leap_seconds

_TT_LESS = {"UTC": TT_TAI, "TAI": TT_TAI, "GPS": TT_TAI + TAI_GPS, "TT": 0.0}
"""TT less the reading of each scale [s]; UTC without its leap seconds."""
_MJD_1970 = 40587
_FINEST = 10**12
_DATE = "2026-01-01"
_LEAST_BITS, _MOST_BITS = 4, 62


@dataclass(frozen=True, kw_only=True)
class Stamps:
    """How the times of a sensor count.

    Calendar times (ISO strings, datetimes) are recognised by themselves; only their scale has to be
    said if it is not UTC. Numbers are seconds since the log's epoch unless this says otherwise.

    Parameters
    ----------
    scale : {"UTC", "TAI", "GPS", "TT"}
        What the clock shows. In UTC, calendar times have leap seconds, and numbers count days of
        86 400 s, as Unix time does.
    since : str, optional
        When a number is zero: a calendar time of the same scale, such as ``"1980-01-06"`` of GPS.
    unit : float
        Seconds in one count: ``1e-3`` for milliseconds, ``1 / 32768`` for ticks of 32 768 Hz.
    bits : int, optional
        A counter of so many bits starts again from zero after ``2**bits`` counts. Between two rows
        less than half of that may pass.

    Raises
    ------
    InputError
        If the scale is unknown, or a number cannot be.

    Examples
    --------
    >>> gps = Stamps(scale="GPS", since="1980-01-06")
    >>> Clock(gps, "2026-01-01T00:00:00").seconds([1451260818, 1451260819.5])
    array([0. , 1.5])
    >>> Clock(Stamps(unit=0.1, bits=4), None).seconds([13, 15, 1, 3])
    array([1.3, 1.5, 1.7, 1.9])
    """

    scale: str = "UTC"
    since: str | None = None
    unit: float = 1.0
    bits: int | None = None

    def __post_init__(self) -> None:
        if self.scale not in _TT_LESS:
            known = ", ".join(_TT_LESS)
            raise InputError(f"must be one of {known}", field="stamps.scale", value=self.scale)
        if not (np.isfinite(self.unit) and self.unit > 0.0):
            raise InputError("must be positive", field="stamps.unit", value=self.unit)
        if self.bits is not None and not _LEAST_BITS <= self.bits <= _MOST_BITS:
            raise InputError(
                f"must be from {_LEAST_BITS} to {_MOST_BITS}", field="stamps.bits", value=self.bits
            )
        if self.since is not None:
            read_epoch(self.since, "stamps.since")


def by_sensor(stamps: Any, sensors: list[str]) -> dict[str, Stamps]:
    """Return the stamps of each sensor, of one for all of them or of some by name."""
    if isinstance(stamps, Stamps):
        return dict.fromkeys(sensors, stamps)
    for name in stamps or {}:
        if name not in sensors:
            has = ", ".join(sensors)
            raise InputError(
                f"is no sensor of the log, which has {has}", field="stamps", value=name
            )
    return dict(stamps or {})


def calendar(values: Any) -> bool:
    """Say whether these are calendar times: strings or datetimes."""
    kind = np.asarray(values).dtype.kind
    if kind != "O":
        return kind in "MUS"
    first = next((v for v in values if v is not None), None)
    return isinstance(first, str) or hasattr(first, "isoformat")


class Clock:
    """Turns one sensor's times into seconds since an epoch, chunk after chunk."""

    def __init__(self, stamps: Stamps, epoch: str | None, field: str = "t") -> None:
        self.stamps, self.field = stamps, field
        self.start: Instant | None = None if epoch is None else instant(epoch)
        self.wraps = 0
        self._last: int | None = None
        self._high = 0

    def seconds(self, values: Any) -> FloatArray:
        """Return elapsed SI seconds since the epoch; NaN where there is no time.

        Raises
        ------
        InputError
            Names the first row that is no time.
        """
        stamps = self.stamps
        if calendar(values):
            return self._calendar(values)
        if stamps == Stamps():
            return numbers(values, self.field)
        raw = np.asarray(values)
        if stamps.bits is not None:
            counts: Any = self._unwrapped(raw)
        else:
            counts = raw if raw.dtype.kind in "iu" else numbers(values, self.field)
        if stamps.since is None:
            return np.asarray(np.multiply(counts, stamps.unit, dtype=np.float64))
        since = read_epoch(stamps.since)
        return self._of_scale(counts, stamps.unit, since.mjd, since.seconds)

    def _calendar(self, values: Any) -> FloatArray:
        try:
            nanoseconds, leap = _nanoseconds(values)
        except ValueError:
            return self._slowly(values)
        t = self._of_scale(nanoseconds, 1e-9, _MJD_1970, 0.0, leap)
        t[nanoseconds == np.iinfo(np.int64).min] = np.nan
        return t

    def _slowly(self, values: Any) -> FloatArray:
        """Read calendar times one by one: with offsets, with a scale behind them, or wrong."""
        start = self._need_start()
        t = np.full(len(values), np.nan)
        suffix = "" if self.stamps.scale == "UTC" else f" {self.stamps.scale}"
        for row, value in enumerate(values):
            text = str(getattr(value, "isoformat", lambda v=value: v)()).strip()
            if value is None or not text:
                continue
            try:
                plain = text[-1].isdigit() and read_epoch(text).scale == "UTC" and "+" not in text
                at = instant(text + suffix if plain else text)
            except InputError as error:
                known = error.message.startswith(("has", "is before"))
                raise InputError(
                    error.message if known else f"is no time such as {_DATE}T00:00:00.000",
                    field=self.field,
                    row=row,
                    value=value,
                ) from None
            t[row] = (at.mjd - start.mjd) * DAY + (at.seconds - start.seconds)
        return t

    def _of_scale(
        self, counts: Any, unit: float, mjd: int, seconds: float, leap: Any = 0.0
    ) -> FloatArray:
        """Return seconds since the epoch of counts since a day and second of the scale.

        Whole counts are subtracted as such, so that nanoseconds since 1970 keep their last digits.
        """
        start, scale = self._need_start(), self.stamps.scale
        step = Fraction(unit).limit_denominator(_FINEST)
        before = float(leap_seconds(start.mjd)) if scale == "UTC" else 0.0
        offset = (mjd - start.mjd) * 86400 + _exact(seconds - start.seconds)
        offset += _exact(_TT_LESS[scale] + before)
        zero = round(-offset / step)
        rest = float(zero * step + offset)
        whole = np.asarray(counts).dtype.kind in "iu"
        after = (np.asarray(counts, np.int64) if whole else counts) - zero
        t = np.asarray(after * step.numerator / step.denominator + rest)
        if scale == "UTC":
            clock = np.asarray(counts * float(step.numerator)) / step.denominator + seconds
            t += leap_seconds(mjd + np.floor(np.nan_to_num(clock) / DAY)) - before + leap
        return t

    def _unwrapped(self, raw: Any) -> IntArray:
        assert self.stamps.bits is not None
        size = 1 << self.stamps.bits
        counts = np.rint(numbers(raw, self.field)) if raw.dtype.kind not in "iu" else raw
        if raw.dtype.kind not in "iu" and not np.isfinite(counts).all():
            row = int(np.argmax(~np.isfinite(counts)))
            raise InputError("a counter has no missing values", field=self.field, row=row)
        ticks = np.asarray(counts, dtype=np.int64)
        if not len(ticks):
            return ticks
        first = int(ticks[0]) if self._last is None else self._last
        steps = np.diff(ticks, prepend=first)
        near = (steps + size // 2) % size - size // 2
        self.wraps += int(np.sum(near > steps))
        high = (first if self._last is None else self._high) + np.cumsum(near)
        self._last, self._high = int(ticks[-1]), int(high[-1])
        return np.asarray(high)

    def _need_start(self) -> Instant:
        if self.start is None:
            raise InputError(
                "is needed to place these times: set it in the TOML file beside the log or with "
                "epoch=",
                field="epoch",
            )
        return self.start


def _exact(seconds: float) -> Fraction:
    """Return seconds to the nanosecond, which is what epochs are written to."""
    return Fraction(round(seconds * 10**9), 10**9)


def numbers(values: Any, field: str) -> FloatArray:
    """Return float64 numbers; an array that is already so is not copied."""
    if isinstance(values, np.ndarray) and values.dtype == np.float64 and values.ndim == 1:
        return values
    return array(values, field, (None,))


def _nanoseconds(values: Any) -> tuple[IntArray, Any]:
    """Return nanoseconds since 1970 in days of 86 400 s, and what leap seconds add to that [s]."""
    raw = np.asarray(values)
    if raw.dtype.kind == "M":
        return raw.astype("M8[ns]").astype(np.int64), 0.0
    if raw.dtype.kind == "O" and any(v is None or not isinstance(v, str) for v in raw):
        raise ValueError
    text = np.char.rstrip(np.char.strip(raw.astype(str)), "Z")
    leap = np.char.endswith(np.char.partition(text, ".")[:, 0], ":60")
    if leap.any():
        for row in np.flatnonzero(leap).tolist():
            instant(str(text[row]))  # refuses a leap second where none was
        text = np.where(leap, np.char.replace(text, ":60", ":59"), text)
    zoned = (np.char.find(text, "+") >= 0) | (np.char.rfind(text, "-") >= len(_DATE))
    if (zoned | (np.char.str_len(text) < len(_DATE))).any():
        raise ValueError
    return text.astype("M8[ns]").astype(np.int64), leap.astype(float)


def epoch_of(first: Any, stamps: Stamps) -> str:
    """Return a whole UTC second at or before a first stamp, to serve as the epoch of a log."""
    from celestcore.ccsds._time import utc_strings

    clock = Clock(stamps, "2000-01-01T12:00:00 TT")
    t = clock.seconds(first)
    t = t[np.isfinite(t)]
    if not len(t):
        raise InputError("has no time from which the epoch could be taken", field="epoch")
    text = utc_strings("2000-01-01T12:00:00 TT", [float(t.min())])[0]
    return text.partition(".")[0]
