"""The tables and keys that settings may hold: their types, and their units turned to radians."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import date
from typing import Any

from celestcore._check import number
from celestcore._epoch import epoch_string
from celestcore._tables import table_kind
from celestcore.errors import InputError
from celestcore.units import ARCSEC, DEG

FRAMES = ("inertial", "body", "earth")
"""The frames that a log names."""

KEYS: dict[str, dict[str, str]] = {
    "log": dict.fromkeys(("title", "source", "licence"), "text") | {"epoch": "epoch"},
    "frames": dict.fromkeys(FRAMES, "text"),
    "gyro": dict.fromkeys(("arw", "rrw", "max_gap_s", "gap_rate_sigma"), "number")
    | {"sampling": "text", "mounting": "list", "frame": "text"},
    "star": dict.fromkeys(("sigma", "sigma_arcsec"), "numbers")
    | {"covariance": "list", "mounting": "list", "frame": "text", "time_offset": "number"},
    "vector": dict.fromkeys(("sigma", "sigma_deg", "sigma_arcsec"), "number")
    | {"mounting": "list", "frame": "text"},
    "gnss": dict.fromkeys(("sigma", "sigma_velocity"), "numbers")
    | dict.fromkeys(("time_offset", "bias_sigma", "bias_tau", "max_rejected"), "number")
    | {"lever_arm": "list"},
    "orbit": {"gravity": "degree", "field": "text", "sun": "truth", "moon": "truth"}
    | dict.fromkeys(("drag_cd", "drag_area_to_mass", "srp_cr", "srp_area_to_mass"), "number")
    | dict.fromkeys(("accel_psd", "max_step"), "number"),
    "attitude": dict.fromkeys(("jerk_psd", "rate_sigma", "acceleration_sigma"), "number"),
    "lfe": dict.fromkeys(("amplitudes", "amplitudes_arcsec"), "list")
    | dict.fromkeys(("period", "fading_sigma", "fading_sigma_arcsec", "fading_tau"), "number"),
    "filter": dict.fromkeys(("alpha", "beta", "kappa"), "number")
    | {"kind": "text", "integrator": "text"},
    "gate": dict.fromkeys(("probability", "huber", "student_t", "adaptive"), "number"),
    "start": dict.fromkeys(("sigma_attitude", "sigma_attitude_arcsec", "sigma_bias"), "number"),
}
_UNITS = {"_arcsec": ARCSEC, "_deg": DEG}
_CHOICES = {
    "kind": ("ekf", "ukf", "srukf", "iterated", "invariant", "literal"),
    "integrator": ("exponential", "rk4"),
}
_SIGMA_POINT_KEYS = ("alpha", "beta", "kappa")
_SIGMA_POINT_KINDS = ("ukf", "srukf", "literal")


def checked_table(name: str, values: Any) -> dict[str, Any]:
    """Check one table's keys and types and turn its units into radians."""
    kind = table_kind(name)
    kind = name if kind not in ("gyro", "star", "vector") else kind
    if kind not in KEYS:
        known = ", ".join(k + "_NAME" if k == "vector" else k for k in KEYS)
        raise InputError(f"unknown table; known are {known} and star_NAME", field=f"[{name}]")
    if not isinstance(values, Mapping):
        raise InputError(f"must be a table, write [{name}]", field=name, value=values)
    out: dict[str, Any] = {}
    for key, value in values.items():
        where = f"{name}.{key}"
        if key not in KEYS[kind]:
            raise InputError(f"unknown key; known are {', '.join(KEYS[kind])}", field=where)
        plain, value = _convert(str(key), value, where, KEYS[kind][key])
        if plain in out:
            raise InputError(f"{plain} is given twice, in different units", field=where)
        out[plain] = value
    return out


def _convert(key: str, value: Any, where: str, what: str) -> tuple[str, Any]:
    """Return the key without its unit and the value in SI units, of the right type."""
    tolist = getattr(value, "tolist", None)
    value = tolist() if callable(tolist) else value
    single = isinstance(value, int | float) and not isinstance(value, bool)
    fits = {
        "text": isinstance(value, str),
        "number": single,
        "numbers": single or isinstance(value, list | tuple),
        "list": isinstance(value, list | tuple),
        "epoch": isinstance(value, str | date),
        "truth": isinstance(value, bool),
        "degree": single or isinstance(value, str | list | tuple),
    }
    if not fits[what]:
        wanted = {
            "numbers": "a number or a list of three",
            "epoch": "an ISO time",
            "truth": "true or false",
            "degree": "a degree, [degree, order], 'j2' or 'two-body'",
        }
        raise InputError(f"must be {wanted.get(what, 'a ' + what)}", field=where, value=value)
    if what == "epoch":
        return key, epoch_string(value)
    for ending, unit in _UNITS.items():
        if key.endswith(ending):
            return key.removesuffix(ending), _scaled(value, unit, where)
    return key, value


def _scaled(value: Any, unit: float, where: str) -> Any:
    if isinstance(value, list | tuple):
        return [number(v, where) * unit for v in value]
    return number(value, where) * unit


def check_filter(values: Mapping[str, Any], default: str = "") -> None:
    """Check ``[filter]``; a file may leave the kind to the one it is merged with."""
    for key, known in _CHOICES.items():
        if key in values and values[key] not in known:
            raise InputError(
                f"must be one of {', '.join(known)}", field=f"filter.{key}", value=values[key]
            )
    kind = values.get("kind", default)
    for key in _SIGMA_POINT_KEYS if kind and kind not in _SIGMA_POINT_KINDS else ():
        if key in values:
            raise InputError(
                "is an option of the kinds ukf, srukf and literal; set kind or remove it",
                field=f"filter.{key}",
                value=values[key],
            )
