"""The named columns of each table: how a log looks on disk, and as a data frame or dict."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from celestcore._check import FloatArray, array
from celestcore._gnss_tables import FEWEST, MOST
from celestcore._tables import (
    KNOWN,
    BaselineTable,
    GnssTable,
    GyroTable,
    StarTable,
    Table,
    VectorTable,
    table_kind,
)
from celestcore.errors import InputError, LogFormatError

_COVARIANCE = ("cxx", "cxy", "cxz", "cyy", "cyz", "czz")
_UPPER = np.triu_indices(3)
_NUMBERED = re.compile(r"[xyz]([1-9]\d?)")


@dataclass(frozen=True)
class Schema:
    """Groups of columns that make one array each: those needed and those that may be absent."""

    needed: tuple[tuple[str, ...], ...]
    optional: tuple[tuple[str, ...], ...] = ()

    def columns(self) -> tuple[str, ...]:
        """Return the names of all columns, the time first."""
        return ("t", *(c for group in self.needed + self.optional for c in group))


SCHEMAS = {
    "gyro": Schema((("wx", "wy", "wz"),)),
    "star": Schema((("qw", "qx", "qy", "qz"),), (("sx", "sy", "sz"), _COVARIANCE)),
    "vector": Schema((("bx", "by", "bz"), ("ix", "iy", "iz")), (("sigma",),)),
    "gnss": Schema((("x", "y", "z"),), (("vx", "vy", "vz"),)),
}


def _baselines(number: int) -> Schema:
    """Return the columns of so many baselines: ``x1 y1 z1 x2 ...``."""
    return Schema(tuple((f"x{k}", f"y{k}", f"z{k}") for k in range(1, number + 1)))


def _number_of(column: str) -> int:
    """Return which baseline a column belongs to, 0 if it is no column of baselines."""
    match = _NUMBERED.fullmatch(column)
    number = int(match[1]) if match else 0
    return number if number <= MOST else 0


def schema_of(table: str, found: Iterable[str] = ()) -> Schema:
    """Return the columns of a table; an error for an unknown name lists the known ones.

    The columns that were found say how many baselines there are.
    """
    kind = table_kind(table)
    if kind is None:
        raise LogFormatError(f"is no table of a log; known are {KNOWN}", field=table)
    if kind == "baselines":
        return _baselines(max([FEWEST, *map(_number_of, found)]))
    return SCHEMAS[kind]


def is_column(kind: str, column: str) -> bool:
    """Say whether a table of this kind may have such a column."""
    if kind == "baselines":
        return column == "t" or _number_of(column) > 0
    return column in SCHEMAS[kind].columns()


def groups_present(
    table: str, found: Iterable[str], *, listed: Iterable[str] | None = None
) -> list[tuple[str, ...] | None]:
    """Return the column groups that are there, None for an optional one that is not.

    Raises
    ------
    LogFormatError
        If a needed column, or a part of an optional group, is missing: lists what was found.
    """
    names = list(found)
    schema = schema_of(table, names)
    started = [g for g in schema.optional if any(c in names for c in g)]
    wanted = [c for g in (("t",), *schema.needed, *started) for c in g]
    missing = [c for c in wanted if c not in names]
    if missing:
        shown = ", ".join(names if listed is None else listed) or "none"
        raise LogFormatError(
            f"column{'s' * (len(missing) > 1)} {', '.join(missing)} missing; found: {shown}",
            field=table,
        )
    if len(started) > 1:
        raise LogFormatError(
            f"has both {started[0][0]}... and {started[1][0]}...; keep one kind of noise",
            field=table,
        )
    return [*schema.needed, *(g if g in started else None for g in schema.optional)]


def parts_from_columns(table: str, columns: Mapping[str, Any]) -> tuple[FloatArray, ...]:
    """Put named columns together to the arrays that `SensorLog` takes.

    Examples
    --------
    >>> t, rate = parts_from_columns("gyro", {"t": [0], "wx": [1], "wy": [2], "wz": [3]})
    >>> rate
    array([[1., 2., 3.]])
    """
    groups = groups_present(table, [str(c) for c in columns])
    t = array(columns["t"], f"{table}.t", (None,), copy=False)  # a log copies what it takes
    parts = [t]
    for group in groups:
        if group is None:
            continue
        values = [array(columns[c], f"{table}.{c}", (None,), copy=False) for c in group]
        for name, value in zip(group, values, strict=True):
            if len(value) != len(t):
                raise InputError(
                    f"has {len(value)} rows but {table}.t has {len(t)}", field=f"{table}.{name}"
                )
        if group is _COVARIANCE:
            parts.append(_unpack_covariance(values))
        elif group == ("sigma",):
            parts.append(values[0])
        else:
            parts.append(np.stack(values, axis=1))
    if table_kind(table) == "baselines":
        return t, np.stack(parts[1:], axis=1)
    return tuple(parts)


def _unpack_covariance(values: list[FloatArray]) -> FloatArray:
    out = np.empty((len(values[0]), 3, 3))
    for i, j, value in zip(*_UPPER, values, strict=True):
        out[:, i, j] = out[:, j, i] = value
    return out


def columns_from_table(table: Table) -> dict[str, FloatArray]:
    """Return a table's named columns, the inverse of `parts_from_columns`."""
    out = {"t": table.t}

    def add(names: tuple[str, ...], values: FloatArray | None) -> None:
        if values is not None:
            out.update(zip(names, np.ascontiguousarray(values.T), strict=True))

    if isinstance(table, GyroTable):
        add(SCHEMAS["gyro"].needed[0], table.rate)
    elif isinstance(table, StarTable):
        add(SCHEMAS["star"].needed[0], table.q)
        add(SCHEMAS["star"].optional[0], table.sigma)
        packed = table.covariance
        add(_COVARIANCE, None if packed is None else packed[:, _UPPER[0], _UPPER[1]])
    elif isinstance(table, VectorTable):
        add(SCHEMAS["vector"].needed[0], table.body)
        add(SCHEMAS["vector"].needed[1], table.inertial)
        add(("sigma",), None if table.sigma is None else table.sigma[:, None])
    elif isinstance(table, GnssTable):
        add(SCHEMAS["gnss"].needed[0], table.r)
        add(SCHEMAS["gnss"].optional[0], table.v)
    elif isinstance(table, BaselineTable):
        for k, names in enumerate(_baselines(table.b.shape[1]).needed):
            add(names, table.b[:, k])
    return out
