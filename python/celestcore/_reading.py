"""How a log is to be read, as the words of a command line or a table of a file say it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from fractions import Fraction
from typing import Any

from celestcore.errors import InputError
from celestcore.formats import Stamps

NAMES = ("format", "reorder", "jump", "damaged", "epoch", "stamps", "options")
"""What the tables of files call it; `options` are those of the format."""
_NUMBERS = ("reorder", "jump")
_STAMPS = ("scale", "since", "unit", "bits")
_EXAMPLE = "scale=GPS,since=1980-01-06 or gnss:scale=GPS,since=1980-01-06"


def from_words(
    stamps: Iterable[str] = (), options: Iterable[str] = (), **given: Any
) -> dict[str, Any]:
    """Return what `open_log` takes; what is not given, None, is left out.

    Parameters
    ----------
    stamps : iterable of str
        As ``[SENSOR:]KEY=VALUE,...``.
    options : iterable of str
        Options of the format as ``NAME=VALUE``; a name that comes several times makes a list.
    **given
        The others by name.

    Raises
    ------
    InputError
        Names the option of the command line and the word.

    Examples
    --------
    >>> from_words(["gnss:scale=GPS"], ["kernels=a.tsc", "kernels=b.tls"], reorder=5.0, jump=None)
    {'reorder': 5.0, 'stamps': {'gnss': Stamps(scale='GPS', since=None, unit=1.0, bits=None)}, \
'kernels': ['a.tsc', 'b.tls']}
    """
    out = {name: value for name, value in given.items() if value is not None}
    by_sensor: dict[str, Stamps] = {}
    for word in stamps:
        before, colon, rest = word.partition(":")
        named = bool(colon) and "=" not in before
        sensor, text = (before, rest) if named else ("", word)
        if sensor in by_sensor or (by_sensor and "" in {sensor, *by_sensor}):
            raise InputError(
                "is given twice: give one for all sensors, or each sensor its own, SENSOR:...",
                field="--stamps",
                value=word,
            )
        by_sensor[sensor] = _stamps(_pairs(text, word))
    if by_sensor:
        out["stamps"] = by_sensor.get("", by_sensor)
    several: dict[str, list[Any]] = {}
    for word in options:
        name, equals, value = word.partition("=")
        if not (name and equals):
            raise InputError("must be NAME=VALUE, such as segment=1", field="--option", value=word)
        several.setdefault(name, []).append(_value(value))
    return {**out, **{n: v[0] if len(v) == 1 else v for n, v in several.items()}}


def from_table(name: str, values: Mapping[str, Any]) -> dict[str, Any]:
    """Return what `open_log` takes from a table of a file, keys as in `NAMES`.

    Raises
    ------
    InputError
        Names the table, the key and the value.

    Examples
    --------
    >>> from_table("logs", {"reorder": 5, "stamps": {"scale": "GPS", "since": "1980-01-06"}})
    {'reorder': 5.0, 'stamps': Stamps(scale='GPS', since='1980-01-06', unit=1.0, bits=None)}
    """
    out: dict[str, Any] = {}
    for key, value in values.items():
        where = f"{name}.{key}"
        if key in ("stamps", "options"):
            if not isinstance(value, Mapping):
                raise InputError(f"must be a table, write [{where}]", field=where, value=value)
        elif key in _NUMBERS:
            if isinstance(value, bool) or not isinstance(value, int | float):
                raise InputError("must be a number of seconds", field=where, value=value)
            out[key] = float(value)
        elif not isinstance(value, str):
            raise InputError("must be a text", field=where, value=value)
        else:
            out[key] = value
    if "stamps" in values:
        own = dict(values["stamps"])
        nested = own and all(isinstance(v, Mapping) for v in own.values())
        try:
            out["stamps"] = {s: _stamps(v) for s, v in own.items()} if nested else _stamps(own)
        except InputError as error:
            error.field = f"{name}.{error.field}"
            raise
    return {**out, **values.get("options", {})}


def _pairs(text: str, word: str) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for part in text.split(","):
        key, equals, value = (piece.strip() for piece in part.partition("="))
        if not (key and equals and value):
            raise InputError(
                f"must be [SENSOR:]KEY=VALUE,..., such as {_EXAMPLE}", field="--stamps", value=word
            )
        found[key] = value
    return found


def _stamps(values: Mapping[str, Any]) -> Stamps:
    """Return stamps of texts or numbers; `Stamps` itself says what else is wrong."""
    given = dict(values)
    for key in given:
        if key not in _STAMPS:
            raise InputError(f"unknown key; known are {', '.join(_STAMPS)}", field=f"stamps.{key}")
    for key in ("unit", "bits"):
        if key not in given:
            continue
        try:
            exact = Fraction(str(given[key]))  # 1/32768, too
            given[key] = int(str(given[key])) if key == "bits" else float(exact)
        except (ValueError, ZeroDivisionError):
            words = {"unit": "a number of seconds, or 1/32768", "bits": "a whole number"}[key]
            raise InputError(f"must be {words}", field=f"stamps.{key}", value=given[key]) from None
    for key in ("scale", "since"):
        if key in given:
            given[key] = str(given[key])
    return Stamps(**given)


def _value(text: str) -> Any:
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            continue
    return text
