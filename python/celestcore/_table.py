"""What all tables of a log share: their base, and the checks of their parts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from celestcore._check import BoolArray, FloatArray, IntArray, finite_rows
from celestcore.errors import InputError


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


def unpack(name: str, parts: Sequence[Any], what: str, least: int) -> list[Any]:
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


def same_length(field: str, values: FloatArray, t: FloatArray, table: str) -> None:
    if len(values) != len(t):
        raise InputError(f"has {len(values)} rows but {table}.t has {len(t)}", field=field)


def drop_missing(
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


def count_missing(good: BoolArray | None) -> int:
    return 0 if good is None else int(len(good) - np.count_nonzero(good))


def typical_size(values: FloatArray) -> float:
    """Return about the median: that of a thousand rows, without a warning if it overflows."""
    with np.errstate(over="ignore"):
        rows = np.atleast_1d(values)
        return float(np.median(rows[:: 1 + len(rows) // 1000]))
