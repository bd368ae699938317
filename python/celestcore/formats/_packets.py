"""CCSDS space packets: parameters by an XTCE definition, columns by a map."""

from __future__ import annotations

import os
import warnings
from collections.abc import Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from celestcore._check import warn
from celestcore._columns import groups_present
from celestcore._optional import require
from celestcore._toml import load_toml
from celestcore.errors import InputError, LogFormatError
from celestcore.formats._model import Chunk, Columns, Input, Lane, Source, first_line, opened
from celestcore.formats._stamps import Stamps

JPSS = {
    "gnss": {
        "t": {"days": "ADAET1DAY", "ms": "ADAET1MS", "us": "ADAET1US"},
        **{c: f"ADGPSPOS{c.upper()}" for c in "xyz"},
        **{f"v{c}": f"ADGPSVEL{c.upper()}" for c in "xyz"},
    },
    "star": {
        "t": {"days": "ADAET2DAY", "ms": "ADAET2MS", "us": "ADAET2US"},
        **{c: f"ADCFAQ{k}" for c, k in (("qw", 4), ("qx", 1), ("qy", 2), ("qz", 3))},
    },
}
"""Attitude and ephemeris packets of JPSS (APID 11)."""
_MICRO = {"days": 86_400_000_000, "seconds": 1_000_000, "ms": 1000, "us": 1}
_SINCE = "1958-01-01"
_BUFFER = 1 << 20


def read(
    source: Input,
    *,
    definition: str | os.PathLike[str] | None = None,
    columns: str | os.PathLike[str] | Mapping[str, Mapping[str, Any]] | None = None,
    apid: int | None = None,
    skip: int = 0,
    skew: float = 10.0,
) -> Source:
    """Open a file of packets.

    Parameters
    ----------
    source : Path or binary file
        Packets one after another.
    definition : path
        The XTCE file that says what the packets hold.
    columns : dict, path or "jpss"
        For each sensor the parameter that each column is: ``{"star": {"qw": "ADCFAQ4", ...}}``, or
        a TOML file of such tables. A factor may stand with it, ``["RATE_X", 1e-6]``. ``t`` is
        either one parameter in seconds, or the parts of a time code,
        ``{"days": ..., "ms": ..., "us": ..., "since": "1958-01-01", "scale": "UTC"}``; parts are
        ``days``, ``seconds``, ``ms``, ``us`` and ``fraction`` (of a second, with its ``bits``).
    apid : int, optional
        Only packets of this application.
    skip : int
        Bytes in front of each packet.
    skew : float
        How far apart [s] the times within one packet, or of packets side by side, may be.
    """
    if definition is None or columns is None:
        raise InputError(
            "is needed to read packets" + (": the XTCE file" if definition is None else ""),
            field="definition" if definition is None else "columns",
        )
    given: Any = JPSS if columns == "jpss" else columns
    tables: dict[str, Any] = (
        {n: dict(c) for n, c in given.items()} if isinstance(given, Mapping) else load_toml(given)
    )
    if not tables:
        raise InputError("names no sensor", field="columns")
    sensors = {}
    for name, table in tables.items():
        groups = groups_present(name, table)
        sensors[name] = ("t", *(c for g in groups if g for c in g))
    parser = _parser(Path(definition))
    stamps = {n: _stamps(t["t"]) for n, t in tables.items() if isinstance(t["t"], Mapping)}
    chunks = partial(_chunks, source, parser, tables, apid, skip)
    return Source((Lane(sensors, chunks, skew),), stamps=stamps)


def _parser(definition: Path) -> Any:
    library = require("space_packet_parser", extra="packets", what="reading space packets")
    try:
        return library.load_xtce(definition)
    except OSError as error:
        raise LogFormatError(
            f"cannot be read: {error.strerror or error}", source=str(definition)
        ) from None
    except Exception as error:  # a wrong definition can raise nearly anything
        raise LogFormatError(
            f"is no XTCE definition ({first_line(error)})", source=str(definition)
        ) from None


def _stamps(parts: Mapping[str, Any]) -> Stamps:
    scale, since = str(parts.get("scale", "UTC")), str(parts.get("since", _SINCE))
    return Stamps(scale=scale, since=since, unit=1e-9 if "fraction" in parts else 1e-6)


def _packets(stream: Any, parser: Any, apid: int | None, skip: int) -> Iterator[Any]:
    """Yield the packets; a warning of the parser about the end of the file is an error of ours."""
    generators = require(
        "space_packet_parser.generators", extra="packets", what="reading space packets"
    )
    whole = generators.ccsds_generator(
        stream, buffer_read_size_bytes=_BUFFER, skip_header_bytes=skip
    )
    while True:
        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always")
            try:
                raw = next(whole, None)
                wanted = raw is not None and (apid is None or raw.apid == apid)
                packet = parser.parse_bytes(raw) if wanted else None
            except Exception as error:  # damaged packets can raise nearly anything
                raise LogFormatError(f"a packet cannot be read ({first_line(error)})") from None
        if said:
            raise LogFormatError(f"a packet is not complete ({said[0].message})")
        if raw is None:
            return
        if packet is not None:
            yield packet


def _chunks(
    source: Input,
    parser: Any,
    tables: Mapping[str, Any],
    apid: int | None,
    skip: int,
    chunk_rows: int,
) -> Iterator[Chunk]:
    rows: dict[str, list[list[Any]]] = {name: [] for name in tables}
    others = 0
    with opened(source) as stream:
        packets = _packets(stream, parser, apid, skip)
        while True:
            try:
                packet = next(packets, None)
            except LogFormatError:
                yield _columns(rows, tables)
                raise
            if packet is None:
                break
            taken = [_take(packet, table, rows[name]) for name, table in tables.items()]
            others += not any(taken)
            if max(map(len, rows.values())) >= chunk_rows:
                yield _columns(rows, tables)
    yield _columns(rows, tables)
    if others:
        warn(f"{others} packets held none of the parameters that are mapped to columns")


def _take(packet: Any, table: Mapping[str, Any], rows: list[list[Any]]) -> bool:
    """Append one row if the packet holds all of a sensor's parameters."""
    try:
        row = [_value(packet, wanted) for wanted in table.values()]
    except KeyError:
        return False
    rows.append(row)
    return True


def _value(packet: Any, wanted: Any) -> Any:
    if isinstance(wanted, Mapping):
        return _time(packet, wanted)
    if isinstance(wanted, str):
        return float(packet[wanted])
    name, factor = wanted
    return float(packet[name]) * factor


def _time(packet: Any, parts: Mapping[str, Any]) -> int:
    """Return whole microseconds, or nanoseconds where there is a binary fraction."""
    total = sum(int(packet[parts[k]]) * micro for k, micro in _MICRO.items() if k in parts)
    if "fraction" not in parts:
        return total
    fraction = int(packet[parts["fraction"]])
    return 1000 * total + ((fraction * 10**9) >> int(parts.get("bits", 32)))


def _columns(rows: dict[str, list[list[Any]]], tables: Mapping[str, Any]) -> Chunk:
    """Return the rows gathered so far as columns, and begin anew."""
    chunk: Chunk = {}
    for name, table in tables.items():
        if rows[name]:
            columns: Columns = {}
            for column, values in zip(table, zip(*rows[name], strict=True), strict=True):
                kind = np.int64 if isinstance(table[column], Mapping) else np.float64
                columns[column] = np.array(values, dtype=kind)
            chunk[name] = columns
            rows[name] = []
    return chunk
