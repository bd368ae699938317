"""What a campaign's file may say: tables, keys, types and units."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from celestcore._check import number
from celestcore.errors import InputError
from celestcore.units import (
    ARCSEC,
    DEG,
    DEG_PER_HOUR,
    DEG_PER_HOUR_PER_SQRT_HOUR,
    DEG_PER_SQRT_HOUR,
)

Tables = dict[str, dict[str, Any]]

UNITS = {
    "_deg_per_hour_per_sqrt_hour": DEG_PER_HOUR_PER_SQRT_HOUR,
    "_deg_per_sqrt_hour": DEG_PER_SQRT_HOUR,
    "_deg_per_hour": DEG_PER_HOUR,
    "_deg_per_s": DEG,
    "_arcsec": ARCSEC,
    "_samples": 1.0,
    "_deg": DEG,
    "_m": 1.0,
    "_s": 1.0,
}
"""What a key may end with, the longest first, and what its value is multiplied with."""

TYPES: dict[str, tuple[str, tuple[type, ...]]] = {
    "text": ("a text", (str,)),
    "number": ("a number", (int, float)),
    "numbers": ("a number or a list of numbers", (int, float, list, tuple)),
    "list": ("a list of numbers", (list, tuple)),
    "whole": ("a whole number", (int,)),
    "flag": ("true or false", (bool,)),
}


def _keys(what: str, *names: str) -> dict[str, str]:
    return dict.fromkeys(names, what)


def _either(name: str, *units: str) -> tuple[str, ...]:
    return (name, *(name + unit for unit in units))


SCORED = _keys("flag", "smooth", "portable") | _keys("text", "title") | _keys("whole", "tries")
CAMPAIGN = (
    _keys("whole", "trials", "seed", "first", "batch")
    | _keys("number", "skip_s")
    | _keys("text", "start")
    | SCORED
)
LOGS = _keys("text", "folder", "pattern")
TIMES = _keys("text", "profile") | _keys("number", "duration_s", "step_s")
PROFILES = {
    "earth_pointing": _keys(
        "number",
        "semi_major_axis_m",
        *_either("inclination", "_deg"),
        *_either("raan", "_deg"),
        *_either("argument_of_latitude", "_deg"),
    ),
    "slews": _keys("number", *_either("angle", "_deg"), "slew_time_s", "hold_time_s")
    | _keys("list", "axes", "q0"),
    "constant_rate": _keys("list", *_either("rate", "_deg_per_s"), "q0"),
}
GYRO = (
    _keys(
        "numbers",
        *_either("arw", "_deg_per_sqrt_hour"),
        *_either("rrw", "_deg_per_hour_per_sqrt_hour"),
        *_either("bias", "_deg_per_hour"),
        *_either("bias_sigma", "_deg_per_hour"),
        *_either("markov_sigma", "_deg_per_hour"),
        "scale",
    )
    | _keys("number", "markov_time_s", *_either("quantisation", "_arcsec"))
    | _keys("list", *_either("misalignment", "_arcsec"), "mounting")
)
STAR = (
    _keys("numbers", *_either("sigma", "_arcsec"))
    | _keys("number", "period_s", "offset_s")
    | _keys("whole", "every", "offset_samples")
    | _keys("list", "covariance", "mounting")
)
FILTERS = ("filter", "gate", "start")
"""Tables of a simulated campaign that go to the filter as they are."""


def plain(key: str) -> str:
    """Return a key without its unit.

    >>> plain("sigma_arcsec"), plain("slew_time_s"), plain("axes")
    ('sigma', 'slew_time', 'axes')
    """
    for ending in UNITS:
        if key.endswith(ending):
            return key.removesuffix(ending)
    return key


def table(name: str, values: Any) -> dict[str, Any]:
    """Return something that must be a table."""
    if not isinstance(values, Mapping):
        raise InputError(f"must be a table, write [{name}]", field=name, value=values)
    return {str(key): value for key, value in values.items()}


def checked(name: str, values: Any, known: Mapping[str, str]) -> dict[str, Any]:
    """Check a table's keys and types, and return it in SI units under keys without units."""
    out: dict[str, Any] = {}
    for key, value in table(name, values).items():
        where = f"{name}.{key}"
        if key not in known:
            raise InputError(f"unknown key; known are {', '.join(known)}", field=where)
        words, kinds = TYPES[known[key]]
        if not isinstance(value, kinds) or (isinstance(value, bool) and bool not in kinds):
            raise InputError(f"must be {words}", field=where, value=value)
        if plain(key) in out:
            raise InputError(f"{plain(key)} is given twice, in different units", field=where)
        out[plain(key)] = _scaled(key, value, where, known[key])
    return out


def _scaled(key: str, value: Any, where: str, kind: str) -> Any:
    if kind in ("text", "flag", "whole"):
        return value
    if isinstance(value, list | tuple):
        return [_scaled(key, item, where, kind) for item in value]
    unit = UNITS[key.removeprefix(plain(key))] if plain(key) != key else 1.0
    if key == "markov_time_s" and value == float("inf"):
        return value
    return number(value, where) * unit
