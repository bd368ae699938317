"""HDF5: a group per sensor, in it a dataset per column."""

from __future__ import annotations

import io
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

from celestcore._columns import groups_present
from celestcore._optional import require
from celestcore._tables import table_kind
from celestcore.errors import InputError, LogFormatError
from celestcore.formats._model import (
    Chunk,
    Columns,
    Input,
    Lane,
    Source,
    first_line,
    name_of,
    opened,
    warn_ignored,
)


def read(source: Input) -> Source:
    """Open an HDF5 file; its attributes ``epoch`` and ``title`` are taken as those of the log."""
    lanes = []
    with _open(source) as file:
        names = [n for n in file if table_kind(n) is not None and hasattr(file[n], "keys")]
        found = ", ".join(file) or "nothing"
        if not names:
            raise LogFormatError(
                f"holds no table of a log; needed are groups such as gyro and star; found: {found}"
            )
        ignored = [n for n in file if n not in names]
        for name in names:
            columns = list(file[name])
            groups = groups_present(name, columns)
            wanted = ("t", *(c for g in groups if g for c in g))
            ignored += [f"{name}/{c}" for c in columns if c not in wanted]
            _check(file[name], name, wanted)
            lanes.append(Lane({name: wanted}, partial(_chunks, source, name, wanted)))
        header = {k: str(file.attrs[k]) for k in ("epoch", "title") if k in file.attrs}
    warn_ignored(name_of(source).rpartition("/")[2], ignored)
    return Source(tuple(lanes), {"log": header} if header else {})


@contextmanager
def _open(source: Input) -> Iterator[Any]:
    h5py = require("h5py", extra="hdf5", what="reading HDF5")
    try:
        with opened(source) as stream, h5py.File(stream, "r") as file:
            yield file
    except InputError:
        raise
    except FileNotFoundError:
        raise
    except Exception as error:  # a damaged file can raise nearly anything in HDF5
        raise LogFormatError(
            f"cannot be read as HDF5, it may be truncated ({first_line(error)})"
        ) from None


def _check(group: Any, table: str, wanted: tuple[str, ...]) -> None:
    for column in wanted:
        shape, kind = getattr(group[column], "shape", None), group[column].dtype.kind
        if shape is None or len(shape) != 1:
            raise InputError(f"has shape {shape}, needed is (n,)", field=f"{table}.{column}")
        if shape != group["t"].shape:
            raise InputError(
                f"has {shape[0]} rows but {table}.t has {group['t'].shape[0]}",
                field=f"{table}.{column}",
            )
        if kind not in "fiu":
            raise LogFormatError(
                f"holds {group[column].dtype}, not numbers", field=f"{table}.{column}"
            )


def _chunks(source: Input, table: str, wanted: tuple[str, ...], chunk_rows: int) -> Iterator[Chunk]:
    with _open(source) as file:
        group = file[table]
        for first in range(0, group["t"].shape[0], chunk_rows):
            yield {table: {c: group[c][first : first + chunk_rows] for c in wanted}}


def write_hdf5(path: Path, tables: Mapping[str, Columns]) -> None:
    """Write tables to one file; each dataset carries a check sum.

    The file is made in memory: HDF5 tells of a full disk when it is too late to do something.
    """
    h5py = require("h5py", extra="hdf5", what="writing HDF5")
    content = io.BytesIO()
    with h5py.File(content, "w") as file:
        for name, columns in tables.items():
            group = file.create_group(name)
            for column, values in columns.items():
                group.create_dataset(column, data=values, chunks=True, fletcher32=True)
    path.write_bytes(content.getbuffer())
