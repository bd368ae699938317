"""CCSDS Attitude and Orbit Ephemeris Messages as the sensors ``star`` and ``gnss`` of a log."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from celestcore._check import FloatArray
from celestcore._columns import SCHEMAS
from celestcore.ccsds import AttitudeMessage, OrbitMessage, read_aem, read_oem
from celestcore.errors import LogFormatError
from celestcore.formats._model import Chunk, Columns, Input, Lane, Source, opened

_MAS = np.pi / 180.0 / 3.6e6
_XI0, _ETA0, _DA0 = -16.617 * _MAS, -6.8192 * _MAS, -14.6 * _MAS
"""Frame bias, IERS Conventions (2010), eqs. 5.21 and 5.33."""
_BIAS = np.array([[1.0, _DA0, -_XI0], [-_DA0, 1.0, -_ETA0], [_XI0, _ETA0, 1.0]])
"""GCRS to the mean equator and equinox of J2000, to first order (7 micro-arcseconds)."""
_CELESTIAL = ("GCRF", "GCRS", "ICRF", "EME2000", "J2000")
_NO_INERTIAL = ("ITRF", "TOD", "TEME", "RTN", "RSW", "LVLH", "TNW", "SC_")


def read(source: Input, *, kind: str, segment: int | None = None) -> Source:
    """Open a message, KVN or XML.

    An AEM gives the table ``star``, a fix of the body; its frames go into the settings. An OEM
    gives ``gnss``, Earth-fixed: from an inertial frame it is turned.

    Parameters
    ----------
    source : Path or binary file
        The message.
    kind : {"aem", "oem"}
        Which message it is.
    segment : int, optional
        Which segment, where there are several.
    """
    path, copied = _on_disk(source)
    try:
        if kind == "aem":
            return _attitude(read_aem(path, segment=segment))
        return _orbit(read_oem(path, segment=segment))
    finally:
        if copied:
            path.unlink()


def _on_disk(source: Input) -> tuple[Path, bool]:
    if isinstance(source, Path):
        return source, False
    handle, name = tempfile.mkstemp()
    with os.fdopen(handle, "wb") as copy, opened(source) as stream:
        copy.write(stream.read())
    return Path(name), True


def _attitude(message: AttitudeMessage) -> Source:
    if message.frame.upper().startswith(_NO_INERTIAL):
        raise LogFormatError(
            "a fix is needed from the body to an inertial frame", field="frame", value=message.frame
        )
    columns = _named("star", message.t, message.q)
    frames = {"inertial": message.frame, "body": message.body}
    return whole({"star": columns}, message.epoch, message.object_name, frames)


def _orbit(message: OrbitMessage) -> Source:
    if message.center.upper() != "EARTH":
        raise LogFormatError("must be EARTH", field="CENTER_NAME", value=message.center)
    frame, r, v = message.frame.upper(), message.r, message.v
    if not frame.startswith("ITRF"):
        if frame not in _CELESTIAL:
            known = ", ".join(("ITRF", *_CELESTIAL))
            raise LogFormatError(f"must be one of {known}", field="REF_FRAME", value=message.frame)
        from celestcore.frames import to_itrs

        if frame in ("EME2000", "J2000"):
            r, v = r @ _BIAS, v @ _BIAS
        r, turned = to_itrs(message.epoch, message.t, r, v)
        assert turned is not None
        v = turned
    columns = _named("gnss", message.t, np.hstack([r, v]))
    return whole({"gnss": columns}, message.epoch, message.object_name, {"earth": "ITRF"})


def _named(table: str, t: FloatArray, values: FloatArray) -> Columns:
    schema = SCHEMAS[table]
    names = [*schema.needed[0], *(schema.optional[0] if table == "gnss" else ())]
    return {"t": t, **dict(zip(names, np.ascontiguousarray(values.T), strict=True))}


def whole(tables: dict[str, Columns], epoch: str, title: str, frames: dict[str, Any]) -> Source:
    """Return columns that are in memory already as a source, one lane each.

    Examples
    --------
    >>> whole({"star": {"t": np.zeros(1)}}, "2026-01-01", "SAT", {}).lanes[0].sensors
    {'star': ('t',)}
    """

    def lane(name: str, columns: Columns) -> Lane:
        def read_chunks(chunk_rows: int) -> Iterator[Chunk]:
            for first in range(0, len(columns["t"]), chunk_rows):
                yield {name: {c: v[first : first + chunk_rows] for c, v in columns.items()}}

        return Lane({name: tuple(columns)}, read_chunks)

    settings = {"log": {"epoch": epoch, "title": title}, "frames": frames}
    return Source(tuple(lane(n, c) for n, c in tables.items()), settings)
