"""Read and write logs: a directory of Parquet files, one NPZ, CSV or HDF5.

==============  ================================================================================
``NAME/``       ``gyro.parquet``, ``star.parquet``, ``star_1.parquet``, ``vector_NAME.parquet``,
                ``gnss.parquet``, ``baselines.parquet``, and ``log.toml``
``NAME.npz``    keys ``gyro_t``, ``gyro_wx`` ..., ``star_t``, ``star_qw`` ...; ``NAME.toml``
``NAME.csv``    one time column ``t``, then ``wx`` ... and ``qw`` ..., or prefixed as in NPZ; blank:
                that sensor has no sample at that time; ``NAME.toml``
``NAME.h5``     groups ``gyro``, ``star`` ..., in each a dataset per column; ``NAME.toml``
==============  ================================================================================

Columns: gyro ``wx wy wz`` rad/s; star ``qw qx qy qz`` and, optionally, ``sx sy sz`` rad or
``cxx cxy cxz cyy cyz czz`` rad^2; vector ``bx by bz ix iy iz`` and, optionally, ``sigma`` rad; gnss
``x y z`` m and, optionally, ``vx vy vz`` m/s; baselines ``x1 y1 z1 x2 y2 z2`` ... m; every table
``t`` s. The TOML file is optional. `read_log` also takes what `celestcore.formats` lists.
"""

from __future__ import annotations

import copy
import os
import shutil
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from celestcore._check import warn
from celestcore._columns import columns_from_table
from celestcore._csv import write_csv
from celestcore._files import replacing
from celestcore._optional import require
from celestcore._tables import table_kind
from celestcore._toml import dump_toml
from celestcore.errors import LogFormatError
from celestcore.formats._hdf5 import write_hdf5
from celestcore.formats._stream import LogStream, open_log
from celestcore.log import SensorLog

__all__ = ["read_log", "write_log"]

_SUFFIXES = (".npz", ".csv", ".h5", ".hdf5")
Columns = dict[str, Any]


def read_log(path: str | os.PathLike[str] | BinaryIO, **options: Any) -> SensorLog:
    """Read a log into memory: a directory of Parquet files, ``.npz``, ``.csv`` or another format.

    Parameters
    ----------
    path : path or binary file
        What to read; a TOML file ``log.toml`` (directory) or of the same name (file) is read too.
    **options
        As `celestcore.formats.open_log` takes them, such as ``format=`` and ``reorder=``. A warning
        says how many rows were left out.

    Returns
    -------
    SensorLog

    Raises
    ------
    LogFormatError
        If something cannot be read or columns are missing; lists what was found.
    InputError
        If a value is wrong; names the file, the field, the row (of the file's data) and the value.
    MissingDependencyError
        If the package that the format needs is not installed.

    Examples
    --------
    >>> import tempfile
    >>> log = SensorLog(gyro=([0.0, 1.0], [[0.0, 0.0, 0.1]] * 2), title="two samples")
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     write_log(log, folder + "/two.npz")
    ...     read_log(folder + "/two.npz")
    SensorLog('two samples', 1 s: gyro 2 rows)
    """
    with open_log(path, **options) as stream:
        log = stream.read()
    warn_left_out(stream)
    return log


def warn_left_out(stream: LogStream) -> None:
    """Warn of the rows that the last pass over a log left out."""
    for name, report in stream.reports.items():
        left_out = {k: n for k, n in report.troubles.items() if k not in ("reordered", "wraps")}
        if left_out:
            counts = ", ".join(f"{n} {k}" for k, n in left_out.items())
            warn(f"{name}: of {report.rows} rows these were not in order: {counts}")


def write_log(log: SensorLog, path: str | os.PathLike[str]) -> None:
    """Write a log in the format that the path's ending names; without an ending, a directory.

    What was there is replaced only when everything has been written. Missing rows are not in the
    log any more, so they are not written either.

    Parameters
    ----------
    log : SensorLog
        The log.
    path : path
        ``NAME.npz``, ``NAME.csv``, ``NAME.h5`` or a directory; settings go to a TOML file beside
        or in it.

    Raises
    ------
    InputError
        If the path has another ending or cannot be written.
    MissingDependencyError
        If Parquet or CSV is written without pyarrow.

    Examples
    --------
    >>> import tempfile
    >>> import celestcore as cc
    >>> log = cc.SensorLog(gyro=([0.0, 0.1], [[0.0, 0.0, 0.01]] * 2))
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     write_log(log, f"{folder}/mine.npz")
    ...     read_log(f"{folder}/mine.npz")
    SensorLog(0.1 s: gyro 2 rows)
    """
    target = Path(path)
    kind = _kind(target)
    tables = {name: columns_from_table(table) for name, table in log.tables.items()}
    document = _document(log)
    try:
        if kind == "":
            _write_directory(target, tables, document)
            return
        with replacing(target) as temporary:
            if kind == ".npz":
                _write_npz(temporary, tables)
            elif kind == ".csv":
                write_csv(temporary, tables)
            else:
                write_hdf5(temporary, tables)
            _write_toml(target.with_suffix(".toml"), document)
    except OSError as error:
        raise LogFormatError(
            f"cannot be written: {error.strerror or error}", source=str(target)
        ) from error


def _kind(path: Path) -> str:
    """Return ``.npz``, ``.csv`` or, for a directory, the empty string."""
    suffix = path.suffix.lower()
    if path.is_dir():
        return ""
    if suffix in _SUFFIXES or (not suffix and not path.is_file()):
        return suffix
    hint = "; for Parquet give the directory that holds gyro.parquet, star.parquet ..."
    raise LogFormatError(
        "is no kind of log to write; known are NAME.npz, NAME.csv, NAME.h5 and a directory of "
        "Parquet files" + (hint if suffix in (".parquet", ".toml") else ""),
        source=str(path),
    )


def _document(log: SensorLog) -> dict[str, Any]:
    document = copy.deepcopy(log.settings)
    named = {"title": log.title, "epoch": log.epoch}
    header = {**document.pop("log", {}), **named}
    header = {key: value for key, value in header.items() if value is not None}
    document = {"log": header, **document}
    return {name: table for name, table in document.items() if table}


def _write_toml(path: Path, document: Mapping[str, Any]) -> None:
    """Write settings beside a log; without any, remove those of the log that was there."""
    if document:
        text = dump_toml(document)
        with replacing(path) as temporary:
            temporary.write_text(text, encoding="utf-8")
    else:
        path.unlink(missing_ok=True)


def _write_directory(
    target: Path, tables: Mapping[str, Columns], document: Mapping[str, Any]
) -> None:
    """Write everything into a new directory beside the target, then move it in place."""
    pa = require("pyarrow", extra="parquet", what="writing Parquet")
    pq = require("pyarrow.parquet", extra="parquet", what="writing Parquet")
    if not target.absolute().parent.is_dir():
        raise LogFormatError(
            f"the directory {target.absolute().parent} does not exist: create it first",
            source=str(target),
        )
    fresh = Path(tempfile.mkdtemp(prefix=f".{target.name}.", dir=target.absolute().parent))
    try:
        for name, columns in tables.items():
            file = fresh / f"{name}.parquet"
            pq.write_table(pa.table(columns), file, write_page_checksum=True)
        _write_toml(fresh / "log.toml", document)
        if not target.exists():
            fresh.chmod(0o777 & ~_umask())
            fresh.rename(target)
            return
        for old in target.glob("*.parquet"):
            if table_kind(old.stem) is not None and old.stem not in tables:
                old.unlink()
        for new in fresh.iterdir():
            new.replace(target / new.name)
        if not document:
            (target / "log.toml").unlink(missing_ok=True)
    finally:
        shutil.rmtree(fresh, ignore_errors=True)


def _umask() -> int:
    mask = os.umask(0o022)
    os.umask(mask)
    return mask


def _write_npz(path: Path, tables: Mapping[str, Columns]) -> None:
    arrays = {f"{n}_{c}": v for n, columns in tables.items() for c, v in columns.items()}
    with path.open("wb") as stream:
        np.savez(stream, **arrays)
