"""The tables of a log, one per sensor: checked, float64, C order, read-only."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from celestcore._check import (
    QUATERNION_HINT,
    FloatArray,
    IntArray,
    array,
    covariances,
    number,
    quaternion,
    sigmas,
    times,
    unit_rows,
    warn,
)
from celestcore._gnss_tables import BaselineTable, GnssTable, build_baselines, build_gnss
from celestcore._table import (
    Table,
    count_missing,
    drop_missing,
    same_length,
    typical_size,
    unpack,
)
from celestcore.errors import InputError

__all__ = [
    "BaselineTable",
    "GnssTable",
    "GyroTable",
    "StarTable",
    "Table",
    "VectorTable",
    "build_table",
    "parts_of",
    "table_kind",
    "typical_size",
    "warn_if_large",
]

KNOWN = "gyro, star, star_NAME, vector_NAME, gnss and baselines"
_LARGE_SIGMA = 0.5
"""A 1-sigma noise [rad] above which degrees or arcseconds were probably given."""


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


def table_kind(name: str) -> str | None:
    """Return the kind of a table by its name, such as ``star``; None if unknown.

    Examples
    --------
    >>> table_kind("star_2"), table_kind("vector_sun"), table_kind("stars")
    ('star', 'vector', None)
    """
    kind, underscore, rest = name.partition("_")
    if kind in ("gyro", "gnss", "baselines"):
        return None if underscore else kind
    named = bool(rest) and rest.isascii() and rest.replace("_", "").isalnum()
    if kind == "star" and (named or not underscore):
        return kind
    return kind if kind == "vector" and named else None


def build_table(
    name: str, parts: Sequence[Any], *, scalar_first: bool = True, copy: bool = True
) -> Table:
    """Check the arrays of one sensor, drop the rows with a missing measurement, freeze.

    Without `copy` a gyro's arrays, which are many and need no change, are taken as they are.

    Raises
    ------
    InputError
        Names the field (``star.q``), the row and the value.
    """
    kind = table_kind(name)
    if kind == "gyro":
        table: Table = _gyro(name, parts, copy)
    elif kind == "star":
        table = _star(name, parts, scalar_first)
    elif kind == "vector":
        table = _vector(name, parts)
    elif kind == "gnss":
        table = build_gnss(name, parts)
    elif kind == "baselines":
        table = build_baselines(name, parts)
    else:
        raise InputError(f"is no table of a log; known are {KNOWN}", field=name)
    for value in vars(table).values():
        if isinstance(value, np.ndarray):
            value.flags.writeable = False
    return table


def _gyro(name: str, parts: Sequence[Any], copy: bool) -> GyroTable:
    t_in, rate_in = unpack(name, parts, "t, rate", 2)
    t = times(t_in, f"{name}.t", copy=copy)
    rate = array(rate_in, f"{name}.rate", (None, 3), copy=copy)
    same_length(f"{name}.rate", rate, t, name)
    good, kept, (t, rate) = drop_missing(name, t, rate)
    return GyroTable(t=t, rate=rate, missing=count_missing(good), kept=kept)


def _star(name: str, parts: Sequence[Any], scalar_first: bool) -> StarTable:
    t_in, q_in, noise_in = unpack(name, parts, "t, q, sigma", 2)
    t = times(t_in, f"{name}.t")
    q = quaternion(q_in, f"{name}.q", scalar_first=scalar_first)
    if q.ndim != 2:
        raise InputError(f"has shape {q.shape}, needed is (n, 4)", field=f"{name}.q")
    same_length(f"{name}.q", q, t, name)
    n = len(t)
    good, kept, (t, q) = drop_missing(name, t, q)
    unit_rows(q, f"{name}.q", what="quaternion", hint=QUATERNION_HINT, rows=kept)
    sigma, covariance = _star_noise(noise_in, f"{name}.sigma", n, kept)
    return StarTable(
        t=t, q=q, sigma=sigma, covariance=covariance, missing=count_missing(good), kept=kept
    )


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


def warn_if_large(sigma: FloatArray, field: str) -> None:
    """Warn if 1-sigma angles [rad] are so large that degrees or arcseconds were meant."""
    typical = typical_size(sigma)
    if typical > _LARGE_SIGMA:
        warn(
            f"{field} is {typical:.4g} rad, which is {np.degrees(typical):.4g} degrees: sigmas "
            "are in radians; multiply arcseconds by celestcore.ARCSEC, degrees by celestcore.DEG"
        )


def _vector(name: str, parts: Sequence[Any]) -> VectorTable:
    t_in, body_in, inertial_in, sigma_in = unpack(name, parts, "t, body, inertial, sigma", 3)
    t = times(t_in, f"{name}.t")
    n = len(t)
    body = array(body_in, f"{name}.body", (None, 3))
    inertial = array(inertial_in, f"{name}.inertial", (None, 3))
    same_length(f"{name}.body", body, t, name)
    same_length(f"{name}.inertial", inertial, t, name)
    good, kept, (t, body, inertial) = drop_missing(name, t, body, inertial)
    for v, column in ((body, "body"), (inertial, "inertial")):
        hint = "only its direction is used, so divide each by its length"
        unit_rows(v, f"{name}.{column}", what="vector", hint=hint, rows=kept)
    sigma = None
    if sigma_in is not None:
        sigma = array(sigma_in, f"{name}.sigma")
        if sigma.ndim == 0:
            sigma = np.full(n, number(sigma, f"{name}.sigma", above=0.0))
        sigma = array(sigma, f"{name}.sigma", (None,))
        same_length(f"{name}.sigma", sigma, np.empty(n), name)
        sigma = sigma if kept is None else sigma[kept]
        sigma = sigmas(sigma, f"{name}.sigma", sigma.shape, rows=kept)
        warn_if_large(sigma, f"{name}.sigma")
    return VectorTable(
        t=t, body=body, inertial=inertial, sigma=sigma, missing=count_missing(good), kept=kept
    )


def parts_of(table: Table) -> tuple[FloatArray, ...]:
    """Return a table's arrays in the order in which `build_table` takes them."""
    return table._parts()
