"""The CSV form of a log: all sensors share one time column, blank means no sample."""

from __future__ import annotations

import csv
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from celestcore._check import warn
from celestcore._columns import SCHEMAS, groups_present, is_column
from celestcore._optional import require
from celestcore._tables import table_kind
from celestcore.errors import LogFormatError

Columns = dict[str, Any]
NULLS = ["", "NA", "N/A", "null", "NULL"]
_PLAIN = {c: table for table in ("gyro", "star") for c in SCHEMAS[table].columns() if c != "t"}


def header(stream: BinaryIO, name: str) -> list[str]:
    """Return the names of the columns; warn if the last line has no end.

    Raises
    ------
    LogFormatError
        If there is no header line, or it names a column twice.
    """
    line = stream.readline()
    stream.seek(0, 2)
    size = stream.tell()
    stream.seek(max(size - 1, 0))
    complete = stream.read(1) in (b"\n", b"\r")
    try:
        text = line.decode("utf-8-sig").strip()
    except UnicodeDecodeError:
        raise LogFormatError("is no text file in UTF-8") from None
    if not text:
        raise LogFormatError("is empty" if size == 0 else "has no header line with column names")
    try:
        names = [name.strip() for name in next(csv.reader([text], skipinitialspace=True))]
    except csv.Error as error:
        raise LogFormatError(f"has no header line that can be read ({error})") from None
    if not complete:
        warn(f"{name}: the last line has no end; if the file was cut off, drop that line")
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise LogFormatError(f"has several columns named {', '.join(twice)}")
    return names


def assign(header: list[str]) -> tuple[dict[str, dict[str, str]], list[str]]:
    """Say which cell of the file holds which column of which table, and what is ignored."""
    tables: dict[str, dict[str, str]] = {}
    ignored = []
    for cell in header:
        table, _, column = cell.rpartition("_")
        if cell in _PLAIN:
            table, column = _PLAIN[cell], cell
        kind = table_kind(table)
        if column == "t" and kind is not None:
            raise LogFormatError(
                "has a time column of its own; in a CSV log all sensors share the one column t",
                field=cell,
            )
        if kind is not None and is_column(kind, column):
            if column in tables.setdefault(table, {}):
                raise LogFormatError(f"column {column} of {table} is given twice", field=cell)
            tables[table][column] = cell
        elif cell != "t":
            ignored.append(cell)
    if not tables:
        raise LogFormatError(
            "has no columns of a log; needed are t and, for example, wx, wy, wz, qw, qx, qy, qz; "
            f"found: {', '.join(header)}"
        )
    for table, cells in tables.items():
        if "t" in header:
            cells["t"] = "t"
        groups_present(table, cells, listed=header)
    return tables, ignored


def bad_csv(reason: str, header: list[str]) -> LogFormatError:
    """Turn pyarrow's message into one that names the column, the row and the value."""
    reason = reason.strip().splitlines()[0]
    column = re.search(r"CSV column #(\d+)", reason)
    row = re.search(r"Row #(\d+)", reason)
    value = re.search(r"invalid value '(.*)'", reason)
    counted = re.search(r"Expected (\d+) columns, got (\d+)", reason)
    if "Empty CSV" in reason:
        return LogFormatError("has a header line and no rows")
    if counted:
        message = f"has {counted[2]} cells where {counted[1]} are needed; was the file cut off?"
    elif value:
        message = "is no number; leave the cell blank if it is missing"
    else:
        message = f"cannot be read as CSV ({reason})"
    return LogFormatError(
        message,
        field=header[int(column[1])] if column else None,
        row=int(row[1]) - 2 if row else None,
        value=value[1] if value else None,
    )


def write_csv(path: Path, tables: Mapping[str, Columns]) -> None:
    """Write tables to one CSV on the union of their times, blank where a sensor has no sample."""
    arrow_csv = require("pyarrow.csv", extra="parquet", what="writing CSV")
    pa = require("pyarrow", extra="parquet", what="writing CSV")
    t = np.unique(np.concatenate([columns["t"] for columns in tables.values()]))
    cells: Columns = {"t": t}
    plain = set(tables) <= {"gyro", "star"}
    for table, columns in tables.items():
        at = np.searchsorted(t, columns["t"])
        blank = np.ones(len(t), dtype=bool)
        blank[at] = False
        for column, values in columns.items():
            if column == "t":
                continue
            spread = np.zeros(len(t))
            spread[at] = values
            empty = blank | np.isnan(spread)
            cells[column if plain else f"{table}_{column}"] = pa.array(spread, mask=empty)
    with path.open("wb") as stream:
        stream.write((",".join(cells) + "\n").encode())
        options = arrow_csv.WriteOptions(include_header=False, quoting_style="none")
        arrow_csv.write_csv(pa.table(cells), stream, options)
