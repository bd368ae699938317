"""Parquet: a directory with a file or a dataset per sensor, or one file."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from celestcore._columns import groups_present, schema_of
from celestcore._optional import require
from celestcore._tables import table_kind
from celestcore.errors import InputError, LogFormatError
from celestcore.formats._model import (
    ROW,
    Chunk,
    Columns,
    Input,
    Lane,
    Source,
    first_line,
    warn_ignored,
)

_BUFFER = 1 << 20
_PARTITION = ("sensor", "table")
"""Names by which a partitioned dataset may call its tables: ``sensor=gyro``."""


def read(source: Input, *, table: str | None = None) -> Source:
    """Open Parquet files.

    Parameters
    ----------
    source : Path or binary file
        A directory, or one file.
    table : str, optional
        Which sensor's rows one file holds; its name says it unless this does.
    """
    if not isinstance(source, Path):
        if table is None:
            raise InputError("is needed to read one Parquet file object", field="table")
        return _source({table: [source]})
    if source.is_dir():
        return _source(_tables(source))
    name = source.stem if table is None else table
    if table_kind(name) is None:
        raise LogFormatError(
            "its name is that of no table; give the directory that holds gyro.parquet, "
            "star.parquet ... or say table="
        )
    return _source({name: [source]})


def _source(tables: dict[str, list[Any]]) -> Source:
    lanes, calendar = [], []
    for name, files in tables.items():
        columns, dated = _columns(name, files[0])
        read_all = partial(_chunks, name, files, columns)
        lanes.append(Lane({name: columns}, read_all, read_from=None if dated else read_all))
        calendar += [name] if dated else []
    return Source(tuple(lanes), calendar=tuple(calendar))


def _tables(folder: Path) -> dict[str, list[Any]]:
    """Return the files of each table, in order of time."""
    tables: dict[str, list[Any]] = {}
    ignored = []
    for entry in sorted(folder.iterdir()):
        if entry.name.startswith((".", "_")):
            continue
        files = _dataset(entry) if entry.is_dir() else [entry]
        files = [f for f in files if f.suffix == ".parquet"]
        name = entry.name.removesuffix(".parquet")
        key, equals, value = name.partition("=")
        name = value if equals and key in _PARTITION else name
        if files and table_kind(name) is not None:
            tables.setdefault(name, []).extend(files)
        elif files:
            ignored.append(entry.name)
    if not tables:
        if ignored:
            schema_of(ignored[0].removesuffix(".parquet"))
        found = ", ".join(sorted(p.name for p in folder.iterdir())[:20]) or "nothing"
        raise LogFormatError(f"the directory holds no .parquet files; found: {found}")
    warn_ignored(folder.name, ignored, "table")
    return {name: _in_order(files) for name, files in tables.items()}


def _dataset(folder: Path) -> list[Path]:
    """Return the files below a directory, as pyarrow's datasets take them, numbers as numbers."""
    files = [f for f in folder.rglob("*.parquet") if f.is_file()]
    hidden = [f for f in files if any(p[0] in "._" for p in f.relative_to(folder).parts)]
    return sorted(set(files) - set(hidden), key=_natural)


def _natural(path: Path) -> list[tuple[int, int, str]]:
    words = re.split(r"(\d+)", str(path))
    return [(0, int(w), "") if w.isdigit() else (1, 0, w) for w in words]


def _in_order(files: list[Any]) -> list[Any]:
    """Sort files by their first time where all say it, otherwise leave them."""
    if len(files) < 2:
        return files
    firsts = [_first_time(file) for file in files]
    if any(first is None for first in firsts):
        return files
    order = sorted(range(len(files)), key=lambda k: firsts[k])
    return [files[k] for k in order]


def _first_time(file: Any) -> Any:
    with _open(file) as opened:
        known = [limits[0] for limits in _limits(opened) if limits is not None]
        return min(known, default=None)


def _limits(opened: Any) -> list[tuple[Any, Any] | None]:
    """Return the first and last time of each row group, None where the file does not say."""
    names = opened.schema_arrow.names
    if "t" not in names:
        return [None] * opened.num_row_groups
    groups = [opened.metadata.row_group(g) for g in range(opened.num_row_groups)]
    found = [g.column(names.index("t")).statistics for g in groups]
    return [(s.min, s.max) if s is not None and s.has_min_max else None for s in found]


@contextmanager
def _open(file: Any) -> Iterator[Any]:
    """Open one file; whatever pyarrow says of a damaged one becomes one kind of error."""
    pq = require("pyarrow.parquet", extra="parquet", what="reading Parquet")
    try:
        with pq.ParquetFile(
            file, page_checksum_verification=True, buffer_size=_BUFFER, pre_buffer=False
        ) as opened:
            yield opened
    except InputError as error:
        raise (error if error.source or not _named(file) else error.located(str(file))) from None
    except FileNotFoundError:
        raise LogFormatError("the file has vanished", source=str(file)) from None
    except Exception as error:  # a damaged file can raise nearly anything in pyarrow
        raise LogFormatError(
            f"cannot be read as Parquet, it may be truncated ({first_line(error)})",
            source=str(file) if _named(file) else None,
        ) from None


def _named(file: Any) -> bool:
    return isinstance(file, Path)


def _columns(table: str, file: Any) -> tuple[tuple[str, ...], bool]:
    """Return the columns to read, and whether the times are a calendar's."""
    types = require("pyarrow.types", extra="parquet", what="reading Parquet")
    with _open(file) as opened:
        schema = opened.schema_arrow
        found = list(schema.names)
        groups = groups_present(table, found)
        wanted = ("t", *(c for g in groups if g for c in g))
        where = file.name if _named(file) else "file"
        warn_ignored(where, [c for c in found if c not in wanted])
        dated = False
        for name in wanted:
            kind = schema.field(name).type
            if name == "t" and (types.is_timestamp(kind) or types.is_string(kind)):
                dated = True
            elif not (types.is_floating(kind) or types.is_integer(kind) or types.is_null(kind)):
                raise LogFormatError(f"holds {kind}, not numbers", field=f"{table}.{name}")
        return wanted, dated


def _chunks(
    table: str,
    files: list[Any],
    columns: tuple[str, ...],
    chunk_rows: int,
    start: float | None = None,
) -> Iterator[Chunk]:
    row = 0
    for file in files:
        with _open(file) as opened:
            if file is not files[0]:
                _check_like(opened, table, columns, files[0])
            for groups, rows in _runs(opened, start):
                if groups:
                    for batch in opened.iter_batches(
                        batch_size=chunk_rows,
                        row_groups=groups,
                        columns=list(columns),
                    ):
                        batch.validate(full=True)
                        chunk = _numpy(batch, columns)
                        if start is not None:
                            chunk[ROW] = np.arange(row, row + batch.num_rows)
                        row += batch.num_rows
                        yield {table: chunk}
                else:
                    row += rows


def _runs(opened: Any, start: float | None) -> list[tuple[list[int], int]]:
    """Return runs of row groups to be read, and numbers of rows before `start` to be left out."""
    every = list(range(opened.num_row_groups))
    if start is None:
        return [(every, 0)]
    runs: list[tuple[list[int], int]] = []
    for group, limits in zip(every, _limits(opened), strict=True):
        rows = opened.metadata.row_group(group).num_rows
        if limits is not None and limits[1] < start:
            runs.append(([], rows))
        elif runs and runs[-1][0]:
            runs[-1][0].append(group)
        else:
            runs.append(([group], 0))
    return runs


def _check_like(opened: Any, table: str, columns: tuple[str, ...], first: Any) -> None:
    found = list(opened.schema_arrow.names)
    groups_present(table, found)
    missing = [c for c in columns if c not in found]
    if missing:
        raise LogFormatError(f"has no {', '.join(missing)}, as {first} has", field=table)


def _numpy(batch: Any, columns: tuple[str, ...]) -> Columns:
    return {c: batch.column(c).to_numpy(zero_copy_only=False) for c in columns}
