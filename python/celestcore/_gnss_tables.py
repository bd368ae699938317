"""The tables of GNSS receivers: fixes, and baselines between antennas."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from celestcore._check import BoolArray, FloatArray, IntArray, array, times, warn
from celestcore._gnss_checks import check_motion, check_positions
from celestcore._table import (
    Table,
    count_missing,
    drop_missing,
    same_length,
    typical_size,
    unpack,
)
from celestcore.errors import InputError

FEWEST, MOST = 2, 64
"""Baselines of one table."""
_LONG = 1e3
"""Length of a baseline [m] above which its unit, or what it is, is doubtful."""


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class GnssTable(Table):
    """GNSS fixes, Earth-fixed: position `r` (n, 3) m and velocity `v` (n, 3) m/s or None.

    Kilometres, positions inside the Earth, and positions or velocities of an inertial frame are
    errors: they are found by what they look like.

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


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class BaselineTable(Table):
    """Baselines between GNSS antennas: `b` (n, k, 3) m, Earth-fixed.

    ``b[:, j]`` leads from the master antenna to antenna ``j + 1``, always the same one; NaN where a
    baseline is missing. A row counts as missing if all its baselines are.

    Examples
    --------
    >>> import celestcore as cc
    >>> nan = float("nan")
    >>> b = [[[2.0, 0.0, 0.0], [0.0, 1.5, 0.0]], [[2.0, 0.0, 0.0], [nan, nan, nan]]]
    >>> log = cc.SensorLog(baselines=([0.0, 1.0], b))
    >>> log.baselines, log.baselines.present.tolist()
    (BaselineTable(2 rows), [[True, True], [True, False]])
    """

    b: FloatArray

    @property
    def present(self) -> BoolArray:
        """Which baselines are there (n, k)."""
        return np.asarray(np.isfinite(self.b[:, :, 0]))

    def _parts(self) -> tuple[FloatArray, ...]:
        return self.t, self.b


def build_gnss(name: str, parts: Sequence[Any]) -> GnssTable:
    """Check and return GNSS fixes."""
    t_in, r_in, v_in = unpack(name, parts, "t, r, v", 2)
    t = times(t_in, f"{name}.t")
    arrays = [array(r_in, f"{name}.r", (None, 3))]
    if v_in is not None:
        arrays.append(array(v_in, f"{name}.v", (None, 3)))
    for a, column in zip(arrays, "rv", strict=False):
        same_length(f"{name}.{column}", a, t, name)
    good, kept, (t, *arrays) = drop_missing(name, t, *arrays)
    r = arrays[0]
    v = arrays[1] if len(arrays) > 1 else None
    check_positions(r, name, kept)
    check_motion(t, r, v, name)
    return GnssTable(t=t, r=r, v=v, missing=count_missing(good), kept=kept)


def build_baselines(name: str, parts: Sequence[Any]) -> BaselineTable:
    """Check and return baselines; one with a component that is not finite is missing."""
    t_in, b_in = unpack(name, parts, "t, b", 2)
    t, field = times(t_in, f"{name}.t"), f"{name}.b"
    b = array(b_in, field)
    if b.ndim != 3 or b.shape[-1] != 3:
        raise InputError(
            f"has shape {b.shape}, needed is (n, k, 3): a row for each time, in it k vectors from "
            "the master antenna",
            field=field,
        )
    if not FEWEST <= b.shape[1] <= MOST:
        raise InputError(
            f"needs {FEWEST} to {MOST} baselines, of different directions: turns about a single "
            "one cannot be seen",
            field=field,
            value=b.shape[1],
        )
    same_length(field, b, t, name)
    lost = np.asarray(~np.isfinite(b).all(axis=2))
    b[lost] = np.nan
    good = np.asarray(~lost.all(axis=1))
    kept = None if good.all() else np.flatnonzero(good)
    if kept is not None:
        if not kept.size:
            raise InputError(
                f"all {len(t)} rows are missing (NaN or infinite); leave the sensor out", field=name
            )
        t, b = t[kept], b[kept]
    _check_lengths(b, field, kept)
    return BaselineTable(t=t, b=b, missing=count_missing(good), kept=kept)


def _check_lengths(b: FloatArray, field: str, kept: IntArray | None) -> None:
    length = np.abs(b).max(axis=2)
    zero = (length == 0.0).any(axis=1)
    if zero.any():
        k = int(np.argmax(zero))
        raise InputError(
            "a baseline is zero; write NaN if it is missing",
            field=field,
            row=k if kept is None else int(kept[k]),
            value=b[k],
        )
    typical = typical_size(length[np.isfinite(length)])
    if typical > 1e6:
        raise InputError(
            f"has vectors of about {typical:.4g} m: these are positions of antennas; subtract the "
            "master antenna's",
            field=field,
        )
    if typical > _LONG:
        warn(
            f"{field} has vectors of about {typical:.4g} m: baselines are in metres; multiply "
            "millimetres by 1e-3"
        )
