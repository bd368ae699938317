"""Where windows come from: a log in memory, a stream of a file, or any iterable."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np

from celestcore._columns import parts_from_columns
from celestcore._tables import parts_of
from celestcore.errors import InputError
from celestcore.formats import LogStream
from celestcore.log import SensorLog

Tables = Mapping[str, tuple[Any, ...]]
SAMPLES = 100_000
"""Gyro samples in a window: few enough for memory, enough that what each window costs is little.
Where rows are fewer than samples it holds twice as many."""
WITHOUT_GYRO = 3600.0
_LOOK = 10_000
_KNOWN = 100


class Stretch(NamedTuple):
    """The rows of a window, and a number by which it is known: where it ends, or its place."""

    known: float
    tables: Tables


def stretches(source: Any, seconds: float, reached: float) -> Iterator[Stretch]:
    """Yield the windows of a source; what ends before time `reached` may be left out."""
    if isinstance(source, SensorLog):
        return _of_log(source, seconds)
    if isinstance(source, LogStream):
        return _of_stream(source, seconds, reached)
    if isinstance(source, Iterable):
        return (Stretch(float(k), tables) for k, tables in enumerate(source))
    raise InputError(
        "must be a SensorLog, a LogStream or windows of one", field="source", value=type(source)
    )


def window_of(source: Any, every: int = 1) -> float:
    """Return the length [s] of a window that holds about `SAMPLES` gyro samples, or twice that."""
    t: Any = ()
    if isinstance(source, LogStream):
        t = source._first("gyro").get("t", ())
    elif isinstance(source, SensorLog) and source.gyro is not None:
        t = source.gyro.t
    if len(t) < 2:
        return WITHOUT_GYRO
    seconds = SAMPLES * min(every, 2) * float(np.median(np.diff(t[:_LOOK])))
    return max(float(np.floor(seconds)), 1.0)


def epoch_of(source: Any, epoch: Any) -> Any:
    """Return where the times of a source count from."""
    return source.epoch if isinstance(source, SensorLog | LogStream) else epoch


def names_of(source: Any) -> tuple[str, ...] | None:
    """Return the tables of a source, None if it does not say."""
    if isinstance(source, SensorLog):
        return tuple(source.tables)
    return tuple(source.sensors) if isinstance(source, LogStream) else None


def known_by(source: Any) -> str | None:
    """Return what tells a log from another: a digest of its tables' first rows; None of windows.

    A log that has grown since is the same.
    """
    names = names_of(source)
    if names is None:
        return None
    digest = hashlib.sha256()
    for name in sorted(names):
        digest.update(name.encode())
        if isinstance(source, SensorLog):
            columns = parts_of(source.tables[name])
        else:
            found = source._first(name)
            columns = tuple(found[column] for column in sorted(found))
        for column in columns:
            digest.update(np.ascontiguousarray(column[:_KNOWN]).tobytes())
    return digest.hexdigest()[:16]


def _of_log(log: SensorLog, seconds: float) -> Iterator[Stretch]:
    begin, end = log.span
    parts = {name: parts_of(table) for name, table in log.tables.items()}
    before = dict.fromkeys(parts, 0)
    for k in range(int((end - begin) // seconds) + 1):
        edge = begin + seconds * (k + 1)
        window = {}
        for name, columns in parts.items():
            after = int(np.searchsorted(columns[0], edge))
            window[name] = tuple(column[before[name] : after] for column in columns)
            before[name] = after
        yield Stretch(edge, window)


def _of_stream(stream: LogStream, seconds: float, reached: float) -> Iterator[Stretch]:
    # windows stand at whole multiples of their length: from one of them on they are the same
    start = None if not np.isfinite(reached) else np.floor(reached / seconds) * seconds
    for window in stream.windows(seconds, start=start, ahead=0):
        tables = {name: parts_from_columns(name, c) for name, c in window.tables.items()}
        yield Stretch(window.stop, tables)
