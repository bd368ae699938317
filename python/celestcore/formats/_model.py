"""What a reader gives: lanes, each of which goes once through a file, a chunk at a time."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, BinaryIO

from celestcore._check import warn
from celestcore.errors import InputError, LogFormatError, MissingDependencyError
from celestcore.formats._stamps import Stamps

Columns = dict[str, Any]
"""The columns of one sensor by name, arrays of equal length."""
Chunk = dict[str, Columns]
"""A stretch of a file: the columns of each sensor that has rows in it."""
Input = Path | BinaryIO
ROW = "row"
"""A column that a reader may add: the row in the file, for messages."""
CHUNK_ROWS = 65536


@dataclass(frozen=True)
class Lane:
    """One pass over a file, or a part of it, that brings one sensor's rows or several's.

    Sensors that a file holds one after another need a lane each, so that they can be read side by
    side. Sensors that a file holds mixed share a lane.

    Parameters
    ----------
    sensors : dict
        Names of the tables (``gyro``, ``star_1``), and of their columns, ``t`` first.
    read : callable
        ``read(chunk_rows)`` starts at the beginning and yields dictionaries of sensor to columns,
        in the order of the file, of about so many rows at most. It may be called again.
    skew : float
        By how much [s] the times of the lane's sensors may be apart at one place of the file.
    read_from : callable, optional
        ``read_from(chunk_rows, start)`` as `read`, but it may leave out stretches of the file that
        lie before `start` [s since the epoch] altogether. It is used where times need no
        conversion.

    Examples
    --------
    >>> import numpy as np
    >>> def read(chunk_rows):
    ...     yield {"gyro": {"t": np.arange(2.0), **dict.fromkeys(("wx", "wy", "wz"), np.ones(2))}}
    >>> Lane({"gyro": ("t", "wx", "wy", "wz")}, read).skew
    0.0
    """

    sensors: Mapping[str, tuple[str, ...]]
    read: Callable[[int], Iterator[Chunk]]
    skew: float = 0.0
    read_from: Callable[[int, float], Iterator[Chunk]] | None = None


@dataclass(frozen=True)
class Source:
    """What a reader returns: the lanes of a log, and what the file says of itself.

    Parameters
    ----------
    lanes : tuple of Lane
        Between them they hold every sensor once.
    settings : dict
        As in ``log.toml``: ``{"log": {"epoch": ...}, "frames": {...}}``. A TOML file beside the
        log wins over it.
    stamps : dict
        How the times of a sensor count, where they are not seconds since the epoch.
    calendar : tuple of str
        Sensors whose times are strings or datetimes.

    Examples
    --------
    >>> Source((Lane({"gyro": ("t", "wx", "wy", "wz")}, lambda rows: iter([])),)).settings
    {}
    """

    lanes: tuple[Lane, ...]
    settings: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    stamps: Mapping[str, Stamps] = field(default_factory=dict)
    calendar: tuple[str, ...] = ()


def name_of(source: Any) -> str:
    """Return the name of a path or a file object, for messages.

    Examples
    --------
    >>> import io
    >>> name_of(Path("a.csv")), name_of(io.BytesIO())
    ('a.csv', '<BytesIO>')
    """
    if isinstance(source, str | os.PathLike):
        return os.fspath(source)
    name = getattr(source, "name", None)
    return name if isinstance(name, str) else f"<{type(source).__name__}>"


@contextmanager
def opened(source: Input) -> Iterator[BinaryIO]:
    """Open a path for reading, or go to the beginning of a file object and leave it open."""
    if isinstance(source, Path):
        with source.open("rb") as stream:
            yield stream
        return
    try:
        source.seek(0)
    except (AttributeError, OSError):
        raise LogFormatError("cannot be read again: give a path or a seekable file") from None
    yield source


@contextmanager
def faults(name: str) -> Iterator[None]:
    """Give errors the name of the file, and make what the system says an error of the family."""
    try:
        yield
    except MissingDependencyError:
        raise
    except InputError as error:
        raise (error if error.source else error.located(name)) from None
    except OSError as error:
        raise LogFormatError(f"cannot be read: {error.strerror or error}", source=name) from error


def first_line(error: BaseException) -> str:
    """Return the first line of another library's message."""
    return (str(error).strip().splitlines() or [type(error).__name__])[0]


def warn_ignored(file: str, names: list[str], what: str = "column") -> None:
    """Warn of what a file holds and a log does not know."""
    if names:
        warn(f"{file}: ignored what is no {what} of a log: {', '.join(names)}")
