"""The output of a replay: a folder of tables, each in parts that are complete or not there."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from celestcore._files import replacing
from celestcore._optional import require
from celestcore.errors import InputError
from celestcore.replay._checkpoint import sync_folder

TABLES = ("rows", "measurements", "health", "events")
COMPRESSION = "snappy"
Columns = Mapping[str, Any]


class Parts:
    """Writes the parts of a replay's tables."""

    def __init__(self, folder: str | os.PathLike[str], note: Mapping[str, Any]) -> None:
        self._arrow = require("pyarrow", extra="parquet", what="writing a replay's parts")
        self._parquet = require("pyarrow.parquet", extra="parquet", what="writing parts")
        self.folder = Path(folder)
        self._unsynced: list[Path] = []
        self._note = {b"celestcore": json.dumps(note).encode()}

    def begin(self, complete: int | None) -> None:
        """Keep the first so many parts of every table, and nothing else; None begins anew.

        Raises
        ------
        InputError
            If a new replay finds the parts of another, or parts that should be there are not.
        """
        if self.folder.exists() and not self.folder.is_dir():
            raise InputError("is a file: give a folder", field="out", value=os.fspath(self.folder))
        for table in TABLES:
            own = self.folder / table
            found = sorted(own.glob("part-*.parquet")) if own.is_dir() else []
            if complete is None and found:
                raise InputError(
                    "holds the parts of another replay: give another folder, or resume",
                    field="out",
                    value=os.fspath(self.folder),
                )
            there = {path.stem for path in found}
            gone = [k for k in range(complete or 0) if f"part-{k:06d}" not in there]
            # a replay may have no measurements, but rows and health are in every part
            if gone and (table in ("rows", "health") or there):
                raise InputError(
                    f"lacks {len(gone)} of the {complete} parts of {table} that the checkpoint "
                    f"counts, first part-{gone[0]:06d}: give that replay's folder, or begin anew",
                    field="out",
                    value=os.fspath(self.folder),
                )
            own.mkdir(parents=True, exist_ok=True)
            for path in own.glob(".*.tmp*"):
                path.unlink()
            for path in found:
                if int(path.stem.removeprefix("part-")) >= (complete or 0):
                    path.unlink()  # after the checkpoint: it will be written again

    def write(self, part: int, tables: Mapping[str, Columns]) -> None:
        """Write one part of each table.

        Raises
        ------
        OSError
            If the disk is full; parts that are complete stay.
        """
        for table, columns in tables.items():
            path = self.folder / table / f"part-{part:06d}.parquet"
            made = self._arrow.table(dict(columns)).replace_schema_metadata(self._note)
            with replacing(path) as temporary:
                self._parquet.write_table(made, temporary, **_layout(columns))
            self._unsynced.append(path)

    def sync(self) -> None:
        """Wait until the disk has all parts: a checkpoint must not know more than it."""
        for path in self._unsynced:
            handle = os.open(path, os.O_RDONLY)
            try:
                os.fsync(handle)
            finally:
                os.close(handle)
        for folder in {path.parent for path in self._unsynced}:
            sync_folder(folder)
        self._unsynced.clear()


def _layout(columns: Columns) -> dict[str, Any]:
    """Return how columns are written: small, and fast enough not to hold up the filter.

    Hardly two of the filter's numbers are equal, so a dictionary of them only costs time; their
    bytes, split by place, are alike. Statistics serve readers that look for times or sensors.
    """
    split = [name for name, column in columns.items() if np.asarray(column).dtype == np.float64]
    return {
        "compression": COMPRESSION,
        "use_dictionary": [name for name in columns if name not in split],
        "use_byte_stream_split": split,
        "write_statistics": [name for name in columns if name in ("t", "t_end", "sensor")],
    }


def read(folder: str | os.PathLike[str]) -> dict[str, dict[str, Any]]:
    """Read what a replay has written, as far as it is complete.

    Parameters
    ----------
    folder : path
        The replay's `out`.

    Returns
    -------
    dict of str to dict of str to ndarray
        Tables ``rows`` (as `Solution.columns` or `GnssStarSolution.columns`), ``measurements`` (as
        `Solution.measurement_columns`), ``health`` (each sensor in each part, its noise as the
        filter was told [rad]) and ``events`` (gaps of the gyro, starts anew; their times).

    Raises
    ------
    InputError
        If there is no such output.
    MissingDependencyError
        Without pyarrow.

    Examples
    --------
    >>> read("nowhere")
    Traceback (most recent call last):
    ...
    celestcore.errors.InputError: out, value 'nowhere': holds no replay
    """
    parquet = require("pyarrow.parquet", extra="parquet", what="reading a replay's parts")
    root = Path(folder)
    if not (root / "rows").is_dir():
        raise InputError("holds no replay", field="out", value=os.fspath(folder))
    out: dict[str, dict[str, Any]] = {}
    for table in TABLES:
        parts = [parquet.read_table(p) for p in sorted((root / table).glob("part-*.parquet"))]
        names = parts[0].column_names if parts else []
        out[table] = {
            name: np.concatenate([part[name].to_numpy() for part in parts]) for name in names
        }
    return out
