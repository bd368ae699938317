"""The tables of a log, one per sensor: checked, float64, C order, read-only."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from celestcore._check import (
    QUATERNION_HINT,
    BoolArray,
    FloatArray,
    IntArray,
    array,
    covariances,
    finite_rows,
    number,
    quaternion,
    sigmas,
    times,
    unit_rows,
    warn,
)
from celestcore.errors import InputError

_LARGE_SIGMA = 0.5
"""A 1-sigma noise [rad] above which degrees or arcseconds were probably given."""


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class Table:
    """What all tables share.

    Attributes
    ----------
    t : ndarray (n,)
        Seconds since the log's epoch, strictly increasing.
    missing : int
        How many rows were dropped because the measurement was NaN or infinite.
    kept : ndarray (n,) or None
        The row numbers that were kept; None if nothing was dropped.

    Examples
    --------
    >>> import celestcore as cc
    >>> log = cc.SensorLog(gyro=([0.0, 0.1, 0.2], [[0.0, 0.0, 0.1], [float("nan")] * 3, [0.0] * 3]))
    >>> log.gyro, log.gyro.rows
    (GyroTable(2 rows, 1 missing), array([0, 2]))
    """

    t: FloatArray
    missing: int = 0
    kept: IntArray | None = None

    @property
    def rows(self) -> IntArray:
        """The rows' numbers in the arrays as they were given, counted from 0 (n,)."""
        return np.arange(len(self.t)) if self.kept is None else self.kept

    def __len__(self) -> int:
        return len(self.t)

    def __repr__(self) -> str:
        lost = f", {self.missing} missing" if self.missing else ""
        return f"{type(self).__name__}({len(self)} rows{lost})"

    def _parts(self) -> tuple[FloatArray, ...]:
        """Return the arrays in the order in which `SensorLog` takes them."""
        raise NotImplementedError


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class GyroTable(Table):
    """Gyro samples: `rate` (n, 3) rad/s, gyro frame.

    Examples
    --------
    >>> import celestcore as cc
    >>> cc.SensorLog(gyro=([0.0, 0.1], [[0.0, 0.0, 0.1]] * 2)).gyro.rate.shape
    (2, 3)
    """

    rate: FloatArray

    def _parts(self) -> tuple[FloatArray, ...]:
        return self.t, self.rate


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class StarTable(Table):
    """Star-camera fixes: `q` (n, 4) unit, scalar first, camera to inertial.

    Noise per fix, camera frame: `sigma` (n, 3) rad, or `covariance` (n, 3, 3) rad^2, or neither.

    Examples
    --------
    >>> import celestcore as cc
    >>> log = cc.SensorLog(star=([0.0, 1.0], [[1.0, 0.0, 0.0, 0.0]] * 2, 1e-5))
    >>> log.stars["star"].noise.shape
    (2, 3)
    """

    q: FloatArray
    sigma: FloatArray | None = None
    covariance: FloatArray | None = None

    @property
    def noise(self) -> FloatArray | None:
        """The noise that came with the fixes: `sigma`, `covariance` or None."""
        return self.sigma if self.covariance is None else self.covariance

    def _parts(self) -> tuple[FloatArray, ...]:
        noise = self.noise
        return (self.t, self.q) if noise is None else (self.t, self.q, noise)


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class VectorTable(Table):
    """Directions: `body` (n, 3) unit, sensor frame; `inertial` (n, 3) unit; `sigma` (n,) rad.

    Examples
    --------
    >>> import celestcore as cc
    >>> log = cc.SensorLog(vector_sun=([0.0], [[0.0, 0.0, 1.0]], [[1.0, 0.0, 0.0]]))
    >>> log.vectors["sun"].body
    array([[0., 0., 1.]])
    """

    body: FloatArray
    inertial: FloatArray
    sigma: FloatArray | None = None

    def _parts(self) -> tuple[FloatArray, ...]:
        parts = (self.t, self.body, self.inertial)
        return parts if self.sigma is None else (*parts, self.sigma)


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class GnssTable(Table):
    """GNSS fixes, Earth-fixed: position `r` (n, 3) m and velocity `v` (n, 3) m/s or None.

    Examples
    --------
    >>> import celestcore as cc
    >>> cc.SensorLog(gnss=([0.0], [[7e6, 0.0, 0.0]])).gnss.r.shape
    (1, 3)
    """

    r: FloatArray
    v: FloatArray | None = None

    def _parts(self) -> tuple[FloatArray, ...]:
        return (self.t, self.r) if self.v is None else (self.t, self.r, self.v)


def table_kind(name: str) -> str | None:
    """Return ``gyro``, ``star``, ``vector`` or ``gnss`` for a table's name, None if unknown.

    Examples
    --------
    >>> table_kind("star_2"), table_kind("vector_sun"), table_kind("stars")
    ('star', 'vector', None)
    """
    kind, underscore, rest = name.partition("_")
    if kind in ("gyro", "gnss"):
        return None if underscore else kind
    named = bool(rest) and rest.isascii() and rest.replace("_", "").isalnum()
    if kind == "star" and (named or not underscore):
        return kind
    return kind if kind == "vector" and named else None


def build_table(name: str, parts: Sequence[Any], *, scalar_first: bool = True) -> Table:
    """Check the arrays of one sensor, drop the rows with a missing measurement, freeze.

    Raises
    ------
    InputError
        Names the field (``star.q``), the row and the value.
    """
    kind = table_kind(name)
    if kind == "gyro":
        table: Table = _gyro(name, parts)
    elif kind == "star":
        table = _star(name, parts, scalar_first)
    elif kind == "vector":
        table = _vector(name, parts)
    elif kind == "gnss":
        table = _gnss(name, parts)
    else:
        raise InputError(
            "is no table of a log; known are gyro, star, star_NAME, vector_NAME and gnss",
            field=name,
        )
    for value in vars(table).values():
        if isinstance(value, np.ndarray):
            value.flags.writeable = False
    return table


def _unpack(name: str, parts: Sequence[Any], what: str, least: int) -> list[Any]:
    """Return as many parts as `what` lists, None for optional ones left out."""
    names = what.split(", ")
    known = isinstance(parts, tuple | list)
    if not known or not least <= len(parts) <= len(names):
        optional = f"; {', '.join(names[least:])} may be left out" if least < len(names) else ""
        got = f"{len(parts)} parts" if known else type(parts).__name__
        raise InputError(f"must be a tuple ({what}){optional}; got {got}", field=name)
    if any(p is None for p in parts[:least]):
        raise InputError(f"one of {', '.join(names[:least])} is None", field=name)
    return [*parts, *[None] * (len(names) - len(parts))]


def _same_length(field: str, values: FloatArray, t: FloatArray, table: str) -> None:
    if len(values) != len(t):
        raise InputError(f"has {len(values)} rows but {table}.t has {len(t)}", field=field)


def _drop_missing(
    name: str, t: FloatArray, *arrays: FloatArray
) -> tuple[BoolArray | None, IntArray | None, list[FloatArray]]:
    """Return which rows are good (None: all), their numbers and the arrays without the others."""
    good = finite_rows(*arrays)
    if good is None:
        return None, None, [t, *arrays]
    kept = np.flatnonzero(good)
    if not kept.size:
        raise InputError(
            f"all {len(t)} rows are missing (NaN or infinite); leave the sensor out", field=name
        )
    return good, kept, [t[kept], *(a[kept] for a in arrays)]


def _count(good: BoolArray | None) -> int:
    return 0 if good is None else int(len(good) - np.count_nonzero(good))


def _gyro(name: str, parts: Sequence[Any]) -> GyroTable:
    t_in, rate_in = _unpack(name, parts, "t, rate", 2)
    t = times(t_in, f"{name}.t")
    rate = array(rate_in, f"{name}.rate", (None, 3))
    _same_length(f"{name}.rate", rate, t, name)
    good, kept, (t, rate) = _drop_missing(name, t, rate)
    return GyroTable(t=t, rate=rate, missing=_count(good), kept=kept)


def _star(name: str, parts: Sequence[Any], scalar_first: bool) -> StarTable:
    t_in, q_in, noise_in = _unpack(name, parts, "t, q, sigma", 2)
    t = times(t_in, f"{name}.t")
    q = quaternion(q_in, f"{name}.q", scalar_first=scalar_first)
    if q.ndim != 2:
        raise InputError(f"has shape {q.shape}, needed is (n, 4)", field=f"{name}.q")
    _same_length(f"{name}.q", q, t, name)
    n = len(t)
    good, kept, (t, q) = _drop_missing(name, t, q)
    unit_rows(q, f"{name}.q", what="quaternion", hint=QUATERNION_HINT, rows=kept)
    sigma, covariance = _star_noise(noise_in, f"{name}.sigma", n, kept)
    return StarTable(t=t, q=q, sigma=sigma, covariance=covariance, missing=_count(good), kept=kept)


def _star_noise(
    value: Any, field: str, n: int, kept: IntArray | None
) -> tuple[FloatArray | None, FloatArray | None]:
    """Return sigma (n, 3) or covariance (n, 3, 3) of the kept rows; the other is None."""
    if value is None:
        return None, None
    noise = array(value, field)
    if noise.ndim == 0:
        noise = np.full((n, 3), number(noise, field, above=0.0))
    elif noise.shape == (n,):
        noise = np.repeat(noise[:, None], 3, axis=1)
    if noise.shape not in ((n, 3), (n, 3, 3)):
        raise InputError(
            f"has shape {noise.shape} for {n} fixes; needed is ({n},), ({n}, 3) or, for "
            f"covariances, ({n}, 3, 3); noise that is the same for all goes into StarCamera",
            field=field,
        )
    noise = noise if kept is None else noise[kept]
    if noise.ndim == 3:
        return None, covariances(noise, field.replace("sigma", "covariance"), len(noise), rows=kept)
    noise = sigmas(noise, field, noise.shape, rows=kept)
    warn_if_large(noise, field)
    return noise, None


def typical_size(values: FloatArray) -> float:
    """Return about the median: that of a thousand rows, without a warning if it overflows."""
    with np.errstate(over="ignore"):
        rows = np.atleast_1d(values)
        return float(np.median(rows[:: 1 + len(rows) // 1000]))


def warn_if_large(sigma: FloatArray, field: str) -> None:
    """Warn if 1-sigma angles [rad] are so large that degrees or arcseconds were meant."""
    typical = typical_size(sigma)
    if typical > _LARGE_SIGMA:
        warn(
            f"{field} is {typical:.4g} rad, which is {np.degrees(typical):.4g} degrees: sigmas "
            "are in radians; multiply arcseconds by celestcore.ARCSEC, degrees by celestcore.DEG"
        )


def _vector(name: str, parts: Sequence[Any]) -> VectorTable:
    t_in, body_in, inertial_in, sigma_in = _unpack(name, parts, "t, body, inertial, sigma", 3)
    t = times(t_in, f"{name}.t")
    n = len(t)
    body = array(body_in, f"{name}.body", (None, 3))
    inertial = array(inertial_in, f"{name}.inertial", (None, 3))
    _same_length(f"{name}.body", body, t, name)
    _same_length(f"{name}.inertial", inertial, t, name)
    good, kept, (t, body, inertial) = _drop_missing(name, t, body, inertial)
    for v, column in ((body, "body"), (inertial, "inertial")):
        hint = "only its direction is used, so divide each by its length"
        unit_rows(v, f"{name}.{column}", what="vector", hint=hint, rows=kept)
    sigma = None
    if sigma_in is not None:
        sigma = array(sigma_in, f"{name}.sigma")
        if sigma.ndim == 0:
            sigma = np.full(n, number(sigma, f"{name}.sigma", above=0.0))
        sigma = array(sigma, f"{name}.sigma", (None,))
        _same_length(f"{name}.sigma", sigma, np.empty(n), name)
        sigma = sigma if kept is None else sigma[kept]
        sigma = sigmas(sigma, f"{name}.sigma", sigma.shape, rows=kept)
        warn_if_large(sigma, f"{name}.sigma")
    return VectorTable(
        t=t, body=body, inertial=inertial, sigma=sigma, missing=_count(good), kept=kept
    )


def _gnss(name: str, parts: Sequence[Any]) -> GnssTable:
    t_in, r_in, v_in = _unpack(name, parts, "t, r, v", 2)
    t = times(t_in, f"{name}.t")
    arrays = [array(r_in, f"{name}.r", (None, 3))]
    if v_in is not None:
        arrays.append(array(v_in, f"{name}.v", (None, 3)))
    for a, column in zip(arrays, "rv", strict=False):
        _same_length(f"{name}.{column}", a, t, name)
    good, kept, (t, *arrays) = _drop_missing(name, t, *arrays)
    r = arrays[0]
    typical = typical_size(np.abs(r).max(axis=1))
    if 3.0e3 < typical < 5.0e5:
        warn(
            f"{name}.r has components of about {typical:.4g} m, inside the Earth: "
            "positions are in metres; multiply kilometres by celestcore.KM"
        )
    v = arrays[1] if len(arrays) > 1 else None
    return GnssTable(t=t, r=r, v=v, missing=_count(good), kept=kept)


def parts_of(table: Table) -> tuple[FloatArray, ...]:
    """Return a table's arrays in the order in which `build_table` takes them."""
    return table._parts()
