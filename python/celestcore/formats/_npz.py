"""NPZ: one array per column, read a piece of each at a time without unpacking the whole."""

from __future__ import annotations

import zipfile
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from functools import partial
from typing import Any, TypeVar

import numpy as np

from celestcore._columns import groups_present
from celestcore._tables import table_kind
from celestcore.errors import InputError, LogFormatError
from celestcore.formats._model import (
    Chunk,
    Input,
    Lane,
    Source,
    first_line,
    name_of,
    opened,
    warn_ignored,
)

T = TypeVar("T")
_MAGIC = b"\x93NUMPY"


def read(source: Input) -> Source:
    """Open an NPZ file; keys are ``gyro_t``, ``gyro_wx`` ..."""
    with opened(source) as stream:
        if stream.read(len(_MAGIC)) == _MAGIC:
            raise LogFormatError("holds one bare array; a log is an .npz file with named arrays")
        archive = _try(lambda: zipfile.ZipFile(stream))
        found = [n.removesuffix(".npy") for n in archive.namelist()]
        tables = _tables(found)
        ignored = [k for k in found if k.rpartition("_")[0] not in tables]
        lanes = []
        for table in tables:
            columns = [k.rpartition("_")[2] for k in found if k.rpartition("_")[0] == table]
            groups = groups_present(table, columns, listed=found)
            wanted = ("t", *(c for g in groups if g for c in g))
            ignored += [f"{table}_{c}" for c in columns if c not in wanted]
            _check_shapes(archive, table, wanted)
            lanes.append(Lane({table: wanted}, partial(_chunks, source, table, wanted)))
    warn_ignored(name_of(source).rpartition("/")[2], ignored)
    return Source(tuple(lanes))


def _try(action: Callable[[], T]) -> T:
    try:
        return action()
    except InputError:
        raise
    except Exception as error:  # a damaged file can raise nearly anything in zipfile and numpy
        reason = first_line(error)
        if "not a zip file" in reason:
            reason += ": it is no NPZ file, or was cut off"
        raise LogFormatError(f"cannot be read as NPZ, it may be truncated ({reason})") from None


def _tables(found: list[str]) -> list[str]:
    prefixes = dict.fromkeys(key.rpartition("_")[0] for key in found)
    tables = [p for p in prefixes if table_kind(p) is not None]
    if not tables:
        raise LogFormatError(
            "holds no table of a log; needed are keys such as gyro_t, gyro_wx, star_t, star_qw; "
            f"found: {', '.join(found) or 'nothing'}"
        )
    return tables


class _Column:
    """One array inside the archive."""

    def __init__(self, archive: zipfile.ZipFile, table: str, column: str) -> None:
        self.field = f"{table}.{column}"
        self.stream = archive.open(f"{table}_{column}.npy")
        version = np.lib.format.read_magic(self.stream)
        read = {
            (1, 0): np.lib.format.read_array_header_1_0,
            (2, 0): np.lib.format.read_array_header_2_0,
        }[version]
        self.shape, _, self.dtype = read(self.stream)
        if self.dtype.hasobject:
            raise LogFormatError(
                "cannot be read as NPZ (it holds Python objects instead of numbers)"
            )
        self.left = int(np.prod(self.shape, dtype=np.int64))

    def take(self, rows: int) -> Any:
        """Return so many rows, fewer at the end."""
        rows = min(rows, self.left)
        content = self.stream.read(rows * self.dtype.itemsize)
        if len(content) != rows * self.dtype.itemsize:
            raise LogFormatError(f"cannot be read as NPZ: {self.field} is truncated")
        self.left -= rows
        if not self.left and self.stream.read(1):  # the check sum is compared at the end
            raise LogFormatError(f"cannot be read as NPZ: {self.field} is longer than it says")
        return np.frombuffer(content, dtype=self.dtype)


def _check_shapes(archive: zipfile.ZipFile, table: str, wanted: tuple[str, ...]) -> None:
    lengths = {}
    for name in wanted:
        column = _try(partial(_Column, archive, table, name))
        column.stream.close()
        if len(column.shape) != 1:
            raise InputError(f"has shape {column.shape}, needed is (n,)", field=column.field)
        lengths[name] = column.shape[0]
        if lengths[name] != lengths["t"]:
            raise InputError(
                f"has {lengths[name]} rows but {table}.t has {lengths['t']}", field=column.field
            )


def _chunks(source: Input, table: str, wanted: tuple[str, ...], chunk_rows: int) -> Iterator[Chunk]:
    with ExitStack() as stack:
        stream = stack.enter_context(opened(source))
        archive = _try(lambda: zipfile.ZipFile(stream))
        columns = {c: _try(partial(_Column, archive, table, c)) for c in wanted}
        for column in columns.values():
            stack.callback(column.stream.close)
        while True:
            chunk = {c: _try(partial(a.take, chunk_rows)) for c, a in columns.items()}
            if len(chunk["t"]):
                yield {table: chunk}
            if not columns["t"].left:
                return
