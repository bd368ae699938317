"""`export`: solutions and logs in the formats that other tools read."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from celestcore._files import replacing
from celestcore._optional import require
from celestcore.errors import InputError, LogFormatError
from celestcore.log import SensorLog

_ENDINGS = {
    ".parquet": "parquet",
    ".csv": "csv",
    ".npz": "npz",
    ".h5": "hdf5",
    ".hdf5": "hdf5",
    ".aem": "aem",
    ".oem": "oem",
    ".msopck": "msopck",
    "": "parquet",
}
_LOGS = ("parquet", "csv", "npz", "hdf5")


def export(
    item: Any,
    path: str | os.PathLike[str],
    *,
    format: str | None = None,  # noqa: A002 - what it is called everywhere
    sensor: str | None = None,
    **names: Any,
) -> None:
    """Write a solution or a log for other tools; the file is replaced when it is complete.

    Parameters
    ----------
    item : Solution, GnssStarSolution, OrbitSolution or SensorLog
        What to write.
    path : path
        Where to. Its ending names the format: ``.parquet``, ``.csv``, ``.aem``, ``.oem``,
        ``.msopck``; for logs also ``.npz``, ``.h5``, and none for a directory.
    format : {"parquet", "csv", "npz", "hdf5", "aem", "oem", "msopck"}, optional
        If the ending does not say it.
    sensor : str, optional
        Which star camera of a log; needed where there are several.
    **names
        For messages, as `celestcore.ccsds.write_aem` and `write_oem` take them: ``object_name``
        and ``object_id`` are needed.

    Raises
    ------
    InputError
        If the item does not hold what the format needs, or it cannot be written there.
    MissingDependencyError
        If the package that the format needs is not installed; names it.

    Examples
    --------
    >>> import tempfile
    >>> import celestcore as cc
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     export(cc.sample("fermi"), f"{folder}/fermi.msopck")
    """
    target = Path(path)
    kind = _ENDINGS.get(target.suffix.lower()) if format is None else format
    if kind not in set(_ENDINGS.values()):
        known = ", ".join(e for e in _ENDINGS if e)
        raise InputError(f"must end in one of {known}, or format= say it", field="path", value=path)
    if isinstance(item, SensorLog) and kind in _LOGS:
        from celestcore.io import write_log  # which writes HDF5 by this package

        write_log(item, target)
        return
    try:
        _WRITERS[kind](item, target, sensor, names)
    except KeyError:
        raise InputError(f"is for logs; this is a {type(item).__name__}", field=kind) from None
    except OSError as error:
        raise LogFormatError(
            f"cannot be written: {error.strerror or error}", source=str(target)
        ) from error


def _parquet(item: Any, target: Path, sensor: str | None, names: dict[str, Any]) -> None:
    if hasattr(item, "to_parquet"):
        item.to_parquet(target)
        return
    arrow = require("pyarrow", extra="parquet", what="writing Parquet")
    parquet = require("pyarrow.parquet", extra="parquet", what="writing Parquet")
    note = {b"celestcore": json.dumps({"epoch": item.epoch}).encode()}
    table = arrow.table(item.columns()).replace_schema_metadata(note)
    with replacing(target) as temporary:
        parquet.write_table(table, temporary, compression="zstd")


def _csv(item: Any, target: Path, sensor: str | None, names: dict[str, Any]) -> None:
    arrow = require("pyarrow", extra="parquet", what="writing CSV")
    arrow_csv = require("pyarrow.csv", extra="parquet", what="writing CSV")
    with replacing(target) as temporary:
        options = arrow_csv.WriteOptions(quoting_style="none", quoting_header="none")
        arrow_csv.write_csv(arrow.table(item.columns()), temporary, options)


def _aem(item: Any, target: Path, sensor: str | None, names: dict[str, Any]) -> None:
    from celestcore.ccsds import write_aem

    write_aem(target, _epoch(item), *_attitude(item, sensor), **names)


def _oem(item: Any, target: Path, sensor: str | None, names: dict[str, Any]) -> None:
    from celestcore.ccsds import write_oem

    if not isinstance(item, SensorLog):
        if getattr(item, "r", None) is None:
            raise InputError(f"a {type(item).__name__} has no orbit", field="oem")
        if hasattr(item, "to_oem"):
            item.to_oem(target, **names)
            return
        write_oem(target, _epoch(item), item.t, item.r, item.v, **names)
        return
    table = item.gnss
    if table is None or table.v is None:
        raise InputError("a log needs positions and velocities to make an orbit", field="gnss")
    write_oem(target, _epoch(item), table.t, table.r, table.v, **{"frame": "ITRF", **names})


def _msopck(item: Any, target: Path, sensor: str | None, names: dict[str, Any]) -> None:
    from celestcore.formats._spice import write_msopck

    write_msopck(target, _epoch(item), *_attitude(item, sensor))


def _epoch(item: Any) -> str:
    if item.epoch is None:
        raise InputError("is needed: the format holds calendar times", field="epoch")
    return str(item.epoch)


def _attitude(item: Any, sensor: str | None) -> tuple[Any, Any]:
    """Return times and body-to-inertial quaternions; a camera's mounting is taken out."""
    if not isinstance(item, SensorLog):
        q = getattr(item, "q", None)
        if q is None:
            raise InputError(f"a {type(item).__name__} has no attitude", field="q")
        return item.t, q
    stars = item.stars
    if sensor is None and len(stars) == 1:
        sensor = next(iter(stars))
    if sensor not in stars:
        known = ", ".join(stars) or "none"
        raise InputError(f"must be one of the log's star cameras: {known}", field="sensor")
    from celestcore.config import Settings
    from celestcore.quaternion import conjugate, multiply

    camera = Settings.from_log(item).stars().get(sensor)
    mounting = None if camera is None else camera.mounting
    q = stars[sensor].q
    return stars[sensor].t, q if mounting is None else multiply(q, conjugate(np.array(mounting)))


_WRITERS: dict[str, Callable[[Any, Path, str | None, dict[str, Any]], None]] = {
    "parquet": _parquet,
    "csv": _csv,
    "aem": _aem,
    "oem": _oem,
    "msopck": _msopck,
}
