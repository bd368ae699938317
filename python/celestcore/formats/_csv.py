"""CSV: one line per time, all sensors side by side, blank where one has nothing."""

from __future__ import annotations

import contextlib
import io
import itertools
import re
from collections.abc import Iterator
from functools import partial
from typing import Any

import numpy as np

from celestcore._check import warn
from celestcore._csv import NULLS, assign, bad_csv, header
from celestcore._optional import require
from celestcore.errors import LogFormatError
from celestcore.formats._model import ROW, Chunk, Input, Lane, Source, name_of, opened

_CELL = 24
_LEAST_BLOCK = 1 << 20


def read(source: Input) -> Source:
    """Open a CSV file; the time column holds seconds or ISO times."""
    name = name_of(source).rpartition("/")[2]
    with opened(source) as stream:
        names = header(stream, name)
        tables, ignored = assign(names)
        dated = _dated(stream, names)
    require("pyarrow.csv", extra="parquet", what="reading CSV")
    if ignored:
        warn(f"{name}: ignored what is no column of a log: {', '.join(ignored)}")
    sensors = {table: tuple(sorted(c, key="t".__ne__)) for table, c in tables.items()}
    lane = Lane(sensors, partial(_chunks, source, names, tables, dated))
    return Source((lane,), calendar=tuple(sensors) if dated else ())


def _dated(stream: Any, names: list[str]) -> bool:
    """Say whether the first line's time is no number but a calendar time."""
    stream.seek(0)
    stream.readline()
    cells = stream.readline().decode("utf-8", "replace").split(",")
    place = names.index("t") if "t" in names else len(cells)
    cell = cells[place].strip(' "\r\n') if place < len(cells) else ""
    return re.match(r"\d{4}-\d\d-\d\d", cell) is not None


def _chunks(
    source: Input,
    names: list[str],
    tables: dict[str, dict[str, str]],
    dated: bool,
    chunk_rows: int,
) -> Iterator[Chunk]:
    first, filled = 0, False
    for cells in _batches(source, names, tables, dated, chunk_rows):
        chunk: Chunk = {}
        for table, columns in tables.items():
            present = np.zeros(len(cells["t"][0]), dtype=bool)
            for column, cell in columns.items():
                if column != "t":
                    present |= cells[cell][1]
            kept = np.flatnonzero(present)
            if kept.size:
                chunk[table] = {c: cells[cell][0][kept] for c, cell in columns.items()}
                chunk[table][ROW] = kept + first
        first += len(cells["t"][0])
        filled |= bool(chunk)
        yield chunk
    if not first:
        raise LogFormatError("has a header line and no rows")
    if not filled:
        raise LogFormatError("all cells of all sensors are blank")


def _batches(
    source: Input,
    names: list[str],
    tables: dict[str, dict[str, str]],
    dated: bool,
    chunk_rows: int,
) -> Iterator[dict[str, tuple[Any, Any]]]:
    """Yield each column's values, NaN where blank, and where it is not blank."""
    arrow_csv = require("pyarrow.csv", extra="parquet", what="reading CSV")
    pa = require("pyarrow", extra="parquet", what="reading CSV")
    wanted = sorted({cell for cells in tables.values() for cell in cells.values()})
    kinds = {c: pa.string() if dated and c == "t" else pa.float64() for c in wanted}
    convert = arrow_csv.ConvertOptions(
        column_types=kinds, include_columns=wanted, null_values=NULLS, strings_can_be_null=True
    )
    block = max(_LEAST_BLOCK, chunk_rows * len(names) * _CELL)
    options = partial(
        arrow_csv.ReadOptions, column_names=names, use_threads=False, block_size=block
    )
    first = 0
    try:
        with opened(source) as stream:
            reader = arrow_csv.open_csv(
                stream, read_options=options(skip_rows=1), convert_options=convert
            )
            for batch in reader:
                yield {c: _cell(batch.column(c)) for c in wanted}
                first += batch.num_rows
    except (pa.ArrowException, ValueError) as error:
        fault = bad_csv(str(error), names)
        lines = _lines(source, first, fault.row)
        with contextlib.suppress(pa.ArrowException, ValueError):
            if lines:
                whole = arrow_csv.read_csv(
                    io.BytesIO(lines), read_options=options(), convert_options=convert
                )
                yield {c: _cell(whole.column(c).combine_chunks()) for c in wanted}
        raise fault from None


def _lines(source: Input, first: int, end: int | None) -> bytes:
    """Return the lines of some rows: those before a damaged one, in the block that it stands in."""
    if end is None or end <= first:
        return b""
    with opened(source) as stream:
        return b"".join(itertools.islice(stream, first + 1, end + 1))


def _cell(column: Any) -> tuple[Any, Any]:
    return column.to_numpy(zero_copy_only=False), column.is_valid().to_numpy(zero_copy_only=False)
