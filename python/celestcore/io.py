"""Read and write logs: a directory of Parquet files, one NPZ, or one CSV.

==============  ================================================================================
``NAME/``       ``gyro.parquet``, ``star.parquet``, ``star_1.parquet``, ``vector_NAME.parquet``,
                ``gnss.parquet``, ``baselines.parquet``, and ``log.toml``
``NAME.npz``    keys ``gyro_t``, ``gyro_wx`` ..., ``star_t``, ``star_qw`` ...; ``NAME.toml``
``NAME.csv``    one time column ``t``, then ``wx`` ... and ``qw`` ..., or prefixed as in NPZ; blank:
                that sensor has no sample at that time; ``NAME.toml``
==============  ================================================================================

Columns: gyro ``wx wy wz`` rad/s; star ``qw qx qy qz`` and, optionally, ``sx sy sz`` rad or
``cxx cxy cxz cyy cyz czz`` rad^2; vector ``bx by bz ix iy iz`` and, optionally, ``sigma`` rad; gnss
``x y z`` m and, optionally, ``vx vy vz`` m/s; baselines ``x1 y1 z1 x2 y2 z2`` ... m; every table
``t`` s. The TOML file is optional.
"""

from __future__ import annotations

import copy
import os
import shutil
import tempfile
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from celestcore._check import warn
from celestcore._columns import columns_from_table, groups_present, parts_from_columns, schema_of
from celestcore._csv import read_csv, write_csv
from celestcore._files import replacing
from celestcore._optional import require
from celestcore._tables import table_kind
from celestcore._toml import dump_toml, load_toml
from celestcore.config import Settings
from celestcore.errors import InputError, LogFormatError
from celestcore.log import SensorLog

__all__ = ["read_log", "write_log"]

_SUFFIXES = (".npz", ".csv")
Columns = dict[str, Any]


def read_log(path: str | os.PathLike[str]) -> SensorLog:
    """Read a log: a directory of Parquet files, a ``.npz`` or a ``.csv``.

    Parameters
    ----------
    path : path
        What to read; a TOML file ``log.toml`` (directory) or of the same name (file) is read too.

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
        If Parquet or CSV is read without pyarrow.

    Examples
    --------
    >>> import tempfile
    >>> log = SensorLog(gyro=([0.0, 1.0], [[0.0, 0.0, 0.1]] * 2), title="two samples")
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     write_log(log, folder + "/two.npz")
    ...     read_log(folder + "/two.npz")
    SensorLog('two samples', 1 s: gyro 2 rows)
    """
    source = Path(path)
    kind = _kind(source)
    if not source.exists():
        raise LogFormatError("there is no such file or directory", source=str(source))
    try:
        rows: dict[str, Any] = {}
        if kind == "":
            tables = _read_directory(source)
        elif kind == ".npz":
            tables = _read_npz(source)
        else:
            tables, rows = read_csv(source)
        return _build(source, tables, rows)
    except InputError as error:
        raise (error if error.source else error.located(str(source))) from None
    except OSError as error:
        raise LogFormatError(
            f"cannot be read: {error.strerror or error}", source=str(source)
        ) from error


def write_log(log: SensorLog, path: str | os.PathLike[str]) -> None:
    """Write a log in the format that the path's ending names; without an ending, a directory.

    What was there is replaced only when everything has been written. Missing rows are not in the
    log any more, so they are not written either.

    Parameters
    ----------
    log : SensorLog
        The log.
    path : path
        ``NAME.npz``, ``NAME.csv`` or a directory; settings go to a TOML file beside or in it.

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
            else:
                write_csv(temporary, tables)
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
        "is no kind of log; known are NAME.npz, NAME.csv and a directory of Parquet files"
        + (hint if suffix in (".parquet", ".toml") else ""),
        source=str(path),
    )


def _build(source: Path, tables: Mapping[str, Columns], rows: Mapping[str, Any]) -> SensorLog:
    """Make the log; a row in an error becomes the row in the file."""
    sidecar = source / "log.toml" if source.is_dir() else source.with_suffix(".toml")
    settings = load_toml(sidecar) if sidecar.is_file() else {}
    try:
        Settings.from_dict(settings)
    except InputError as error:
        raise error.located(str(sidecar)) from None
    parts: dict[str, Any] = {
        name: parts_from_columns(name, columns) for name, columns in tables.items()
    }
    try:
        return SensorLog(settings=settings, **parts)
    except InputError as error:
        table = (error.field or "").partition(".")[0]
        if table in rows and error.row is not None:
            error.row = int(rows[table][error.row])
        raise


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


def _read_directory(source: Path) -> dict[str, Columns]:
    files = sorted(source.glob("*.parquet"))
    if not files:
        found = ", ".join(sorted(p.name for p in source.iterdir())[:20]) or "nothing"
        raise LogFormatError(f"the directory holds no .parquet files; found: {found}")
    known = [file for file in files if table_kind(file.stem) is not None]
    if not known:
        schema_of(files[0].stem)
    tables = {file.stem: _read_parquet(file) for file in known}
    _warn_ignored(source.name, [file.name for file in files if file not in known], "table")
    return tables


def _read_parquet(file: Path) -> Columns:
    pq = require("pyarrow.parquet", extra="parquet", what="reading Parquet")
    try:
        with pq.ParquetFile(file, page_checksum_verification=True) as opened:
            found = list(opened.schema_arrow.names)
            groups = groups_present(file.stem, found)
            wanted = ["t", *(c for g in groups if g for c in g)]
            _warn_ignored(file.name, [c for c in found if c not in wanted])
            table = opened.read(columns=wanted)
            table.validate(full=True)
        return {name: _from_arrow(table.column(name), file.stem, name) for name in wanted}
    except InputError as error:
        raise (error if error.source else error.located(str(file))) from None
    except Exception as error:  # a damaged file can raise nearly anything in pyarrow
        reason = (str(error).strip().splitlines() or [type(error).__name__])[0]
        raise LogFormatError(
            f"cannot be read as Parquet, it may be truncated ({reason})", source=str(file)
        ) from None


def _from_arrow(column: Any, table: str, name: str) -> Any:
    values = column.to_numpy()
    if values.dtype.kind not in "fiu" and column.null_count < len(column):
        raise LogFormatError(f"holds {column.type}, not numbers", field=f"{table}.{name}")
    return values


def _warn_ignored(file: str, names: list[str], what: str = "column") -> None:
    if names:
        warn(f"{file}: ignored what is no {what} of a log: {', '.join(names)}")


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


def _read_npz(source: Path) -> dict[str, Columns]:
    def load(action: Callable[[], Any]) -> Any:
        try:
            return action()
        except Exception as error:  # a damaged file can raise nearly anything in zipfile and numpy
            reason = (str(error).strip().splitlines() or [type(error).__name__])[0]
            if "pickle" in reason.lower():
                reason = "it is no NPZ file, or holds Python objects instead of numbers"
            raise LogFormatError(f"cannot be read as NPZ, it may be truncated ({reason})") from None

    with source.open("rb") as stream:
        opened = load(lambda: np.load(stream, allow_pickle=False))
        if not isinstance(opened, np.lib.npyio.NpzFile):
            raise LogFormatError("holds one bare array; a log is an .npz file with named arrays")
        found = list(opened.files)
        tables = _npz_tables(found)
        ignored = [k for k in found if k.rpartition("_")[0] not in tables]
        out: dict[str, Columns] = {}
        for table in tables:
            columns = [k.rpartition("_")[2] for k in found if k.rpartition("_")[0] == table]
            groups = groups_present(table, columns, listed=found)
            wanted = ["t", *(c for g in groups if g for c in g)]
            ignored += [f"{table}_{c}" for c in columns if c not in wanted]
            out[table] = {c: load(partial(opened.__getitem__, f"{table}_{c}")) for c in wanted}
    _warn_ignored(source.name, ignored)
    return out


def _npz_tables(found: list[str]) -> list[str]:
    prefixes = dict.fromkeys(key.rpartition("_")[0] for key in found)
    tables = [p for p in prefixes if table_kind(p) is not None]
    if not tables:
        raise LogFormatError(
            "holds no table of a log; needed are keys such as gyro_t, gyro_wx, star_t, star_qw; "
            f"found: {', '.join(found) or 'nothing'}"
        )
    return tables
