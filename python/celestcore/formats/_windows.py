"""All sensors side by side, one stretch of time after another, in bounded memory."""

from __future__ import annotations

import queue
import threading
from collections import deque
from collections.abc import Generator, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, Generic, TypeVar

import numpy as np

from celestcore._columns import parts_from_columns
from celestcore.formats._flow import Flow
from celestcore.formats._model import ROW, Columns
from celestcore.formats._timeline import join
from celestcore.log import SensorLog

T = TypeVar("T")
_POLL = 0.1


@dataclass(frozen=True)
class Window:
    """The rows of all sensors from one time to another.

    Attributes
    ----------
    start, stop : float
        Seconds since the epoch; the rows have ``start <= t < stop``.
    tables : dict of dict
        The columns of each sensor that has rows in it, float64.
    settings : dict
        Those of the whole log.

    Examples
    --------
    >>> import numpy as np
    >>> gyro = {"t": np.arange(2.0), "wx": np.zeros(2), "wy": np.zeros(2), "wz": np.ones(2)}
    >>> Window(0.0, 10.0, {"gyro": gyro}).log()
    SensorLog(1 s: gyro 2 rows)
    """

    start: float
    stop: float
    tables: dict[str, Columns]
    settings: Mapping[str, Any] = field(default_factory=dict)

    def log(self) -> SensorLog:
        """Return the rows as a log, checked.

        Returns
        -------
        SensorLog

        Raises
        ------
        InputError
            If a value is wrong.

        Examples
        --------
        >>> import celestcore as cc
        >>> with cc.formats.open_log(cc.sample_path("noaa20")) as stream:
        ...     next(stream.windows(60.0, start=0.0)).log()
        SensorLog('NOAA-20, 2021-04-09...', ...: star 60 rows, gnss 60 rows)
        """
        parts: dict[str, Any] = {n: parts_from_columns(n, c) for n, c in self.tables.items()}
        return SensorLog(settings=self.settings, **parts)


class _Feed:
    """One lane and the rows of it that no window has taken yet."""

    def __init__(self, flow: Flow) -> None:
        self.flow = flow
        self.waiting: dict[str, deque[Columns]] = {name: deque() for name in flow.lane.sensors}
        self.done = False

    def fill(self, stop: float) -> None:
        """Read on until nothing before `stop` can come any more."""
        while not self.done and self.flow.floor() < stop:
            pieces = self.flow.pull()
            if pieces is None:
                self.done = True
                return
            self.done = not self.flow.lines
            for name, several in pieces.items():
                self.waiting[name].extend(several)

    def skip(self, start: float) -> None:
        """Leave out what is before `start`, without keeping it until then."""
        while not self.done and self.flow.floor() < start:
            self.fill(np.nextafter(self.flow.floor(), np.inf))
            self.take(start)
        self.take(start)

    def first(self) -> float | None:
        """Return the time of the first row that waits, reading on if none does."""
        while not any(self.waiting.values()) and not self.done:
            self.fill(np.nextafter(self.flow.floor(), np.inf))
        starts = [float(pieces[0]["t"][0]) for pieces in self.waiting.values() if pieces]
        return min(starts, default=None)

    def take(self, stop: float) -> dict[str, Columns]:
        """Return the rows before `stop`."""
        out = {}
        for name, pieces in self.waiting.items():
            taken = []
            while pieces and pieces[0]["t"][0] < stop:
                piece = pieces.popleft()
                cut = int(np.searchsorted(piece["t"], stop))
                if cut < len(piece["t"]):
                    pieces.appendleft({c: v[cut:] for c, v in piece.items()})
                    piece = {c: v[:cut] for c, v in piece.items()}
                taken.append(piece)
            if taken:
                out[name] = {c: v for c, v in join(taken).items() if c != ROW}
        return out


def windows(
    flows: list[Flow], seconds: float, first: float | None, settings: Mapping[str, Any]
) -> Iterator[Window]:
    """Yield the windows that hold rows, whole multiples of their length from `first` or 0."""
    feeds = [_Feed(flow) for flow in flows]
    origin = 0.0 if first is None else first
    if first is not None:
        for feed in feeds:
            feed.skip(first)
    while True:
        low = _lowest(feeds)
        if low is None:
            return
        k = int((low - origin) // seconds)
        k -= origin + k * seconds > low
        k += origin + (k + 1) * seconds <= low
        start, stop = origin + k * seconds, origin + (k + 1) * seconds
        for feed in feeds:
            feed.fill(stop)
        tables = {n: c for feed in feeds for n, c in feed.take(stop).items()}
        yield Window(start, stop, tables, settings)


def _lowest(feeds: list[_Feed]) -> float | None:
    """Return the first time of all rows to come."""
    low = None
    while True:
        starts = [s for s in (feed.first() for feed in feeds) if s is not None]
        if not starts or min(starts) == low:
            return low
        low = min(starts)
        for feed in feeds:
            feed.fill(low)


class Ahead(Generic[T]):
    """Runs an iterator in a thread of its own, a few items ahead of who takes them."""

    def __init__(self, items: Iterator[T], ahead: int) -> None:
        self._items = items
        self._queue: queue.Queue[tuple[str, Any]] = queue.Queue(maxsize=ahead)
        self._stopped = threading.Event()
        self._thread = threading.Thread(target=self._run, name="celestcore-reader", daemon=True)

    def _run(self) -> None:
        try:
            for item in self._items:
                if not self._put(("item", item)):
                    return
            self._put(("end", None))
        except BaseException as error:  # handed to the thread that reads
            self._put(("error", error))

    def _put(self, entry: tuple[str, Any]) -> bool:
        while not self._stopped.is_set():
            try:
                self._queue.put(entry, timeout=_POLL)
            except queue.Full:
                continue
            return True
        return False

    def __iter__(self) -> Generator[T, None, None]:
        self._thread.start()
        try:
            while not self._stopped.is_set():
                try:
                    kind, value = self._queue.get(timeout=_POLL)
                except queue.Empty:
                    continue
                if kind == "end":
                    return
                if kind == "error":
                    raise value
                yield value
        finally:
            self.stop()

    def stop(self) -> None:
        """End the thread; nothing more is given."""
        self._stopped.set()
        if self._thread.is_alive():
            self._thread.join()
