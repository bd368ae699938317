"""Windows of a log joined to pieces that a filter runs over one after the other."""

from __future__ import annotations

from typing import Any

import numpy as np

from celestcore.log import SensorLog
from celestcore.replay._source import Tables

MOST = 1 << 17
"""About so many gyro samples in a piece at most, twice that where not each becomes a row: what they
become takes more memory than they."""


class Piece:
    """A part of a log that a filter runs over; the first gyro sample is the last of the one before.

    `ahead` is the same with what is known beyond its end, for a smoother.
    """

    def __init__(self, tables: Tables, ahead: Tables | None, epoch: str | None) -> None:
        self.log = SensorLog._of_windows(epoch, _filled(tables))
        self.ahead = None if ahead is None else SensorLog._of_windows(epoch, _filled(ahead))


def _filled(tables: Tables) -> dict[str, Any]:
    return {name: parts for name, parts in tables.items() if len(parts[0])}


class Splicer:
    """Takes windows, gives pieces of whole numbers of output rows.

    Measurements after the last gyro sample of a piece wait for the next one.
    """

    def __init__(self, every: int, overlap: float, epoch: str | None) -> None:
        self.every, self.overlap, self.epoch = every, overlap, epoch
        self._waiting: dict[str, list[tuple[Any, ...]]] = {}
        self.reached = -np.inf
        self.before = 0
        """Gyro samples before that of the start: output rows are counted from there."""
        self.late: dict[str, int] = {}

    def push(self, window: Tables) -> None:
        """Add a window; what lies before the time that was reached is counted as late."""
        for name, columns in window.items():
            t = np.asarray(columns[0])
            first = float(t.min()) if len(t) else np.inf  # NaN if one is
            if not (first >= self.reached if name == "gyro" else first > self.reached):
                good = t >= self.reached if name == "gyro" else t > self.reached
                lost = int(np.count_nonzero(~good))
                self.late[name] = self.late.get(name, 0) + lost
                columns = tuple(column[good] for column in columns)
            if len(columns[0]):
                self._waiting.setdefault(name, []).append(tuple(columns))

    def skip(self, window: Tables) -> None:
        """Add a window that had been read before a checkpoint: what was done is left out."""
        late = dict(self.late)
        self.push(window)
        self.late = late

    def look(self) -> SensorLog | None:
        """Return all that waits as a log, None without a gyro sample."""
        joined = {name: stacked(parts) for name, parts in self._waiting.items()}
        return SensorLog(epoch=self.epoch, **_filled(joined)) if "gyro" in joined else None

    def take(self, *, last: bool) -> Piece | None:
        """Return the next piece, None if there is not enough for one; there may be another."""
        joined = {name: stacked(parts) for name, parts in self._waiting.items()}
        gyro = joined.get("gyro")
        if gyro is None:
            return None
        t = gyro[0]
        n = len(t) if last else int(np.searchsorted(t, t[-1] - self.overlap, "right"))
        if not last:
            n = self.before + (n - 1 - self.before) // self.every * self.every + 1
        if n < self.before + 2:
            return None
        most = MOST * min(self.every, 2)
        longest = self.before + max(most // self.every, 1) * self.every + 1
        if n > longest and self.overlap == 0.0:
            n, last = longest, False
        end = float(t[n - 1])
        self.before = 0
        tables, rest = {}, {}
        for name, columns in joined.items():
            cut = n if name == "gyro" else int(np.searchsorted(columns[0], end, "right"))
            cut = len(columns[0]) if last else cut
            tables[name] = tuple(column[:cut] for column in columns)
            keep = n - 1 if name == "gyro" else cut
            rest[name] = tuple(column[keep:] for column in columns)
        self._waiting = {name: [columns] for name, columns in rest.items() if len(columns[0])}
        self.reached = end
        return Piece(tables, joined if self.overlap > 0.0 else None, self.epoch)


def stacked(parts: list[tuple[Any, ...]]) -> tuple[Any, ...]:
    """Return the rows of several tables as one."""
    if len(parts) == 1:
        return parts[0]
    return tuple(np.concatenate(column) for column in zip(*parts, strict=True))
