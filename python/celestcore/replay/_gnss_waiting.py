"""Rows of GNSS, star and gyro tables that wait for their turn."""

from __future__ import annotations

from typing import Any

import numpy as np

from celestcore._gnss_checks import check_positions
from celestcore._gnss_tables import GnssTable
from celestcore._tables import KNOWN, table_kind
from celestcore.errors import InputError
from celestcore.gnss import GnssStarNavigator
from celestcore.log import SensorLog
from celestcore.replay._gnss_track import MOST_HELD
from celestcore.replay._source import Tables
from celestcore.replay._windows import stacked

Columns = tuple[Any, ...]
MEASURED = {"gnss": slice(1, 3), "star": slice(1, 2), "gyro": slice(1, 2)}
"""Columns of which a row needs all: those without are missing."""


class Waiting:
    """Takes windows, and gives the rows up to a time at which no more can come."""

    def __init__(self, nav: GnssStarNavigator, names: tuple[str, ...] | None) -> None:
        self.nav = nav
        self.names = [name for name in names or () if self._used(name)]
        """In the order in which they count, which must not depend on the windows."""
        self.reached = -np.inf
        self.late: dict[str, int] = {}
        self.waited = False
        """Whether something was not waited for any longer."""
        self._rows: dict[str, list[Columns]] = {}
        self._newest = -np.inf
        self._last: dict[str, float] = {}

    def _used(self, name: str) -> bool:
        kind = table_kind(name)
        if kind is None:
            raise InputError(f"is no table of a log; known are {KNOWN}", field=name)
        has = {"baselines": self.nav.antennas is not None, "gyro": self.nav.gyro is not None}
        return has.get(kind, kind in ("gnss", "star"))

    def offset(self, name: str) -> float:
        """Return what a table's tags are ahead of the log's time [s]."""
        if table_kind(name) == "star":
            return self.nav.star_time_offset
        return 0.0 if name == "gyro" else self.nav.gnss.time_offset

    @property
    def oriented(self) -> bool:
        """Whether there is a table that tells attitudes."""
        return any(table_kind(name) in ("star", "baselines") for name in self.names)

    @property
    def reading_from(self) -> float:
        """Time tag from which on rows are needed [s]."""
        return self.reached + min((self.offset(name) for name in self.names), default=0.0)

    def push(self, window: Tables) -> None:
        """Add a window; what lies before the time that was reached is counted as late."""
        for name, columns in window.items():
            if not self._used(name) or not len(columns[0]):
                continue
            if name not in self.names:
                self.names.append(name)
            t = np.asarray(columns[0], dtype=np.float64)
            self._newest = max(self._newest, float(t[-1]))
            # what comes before a row of the same table that came earlier is late, too
            good = (t - self.offset(name) > self.reached) & (t > self._last.get(name, -np.inf))
            self._last[name] = max(self._last.get(name, -np.inf), float(t[-1]))
            lost = int(np.count_nonzero(~good))
            if lost:
                self.late[name] = self.late.get(name, 0) + lost
            seen = _present(name, columns)
            good &= seen
            if good.all():
                self._rows.setdefault(name, []).append(tuple(columns))
            elif good.any():
                kept = tuple(np.asarray(column)[good] for column in columns)
                self._rows.setdefault(name, []).append(kept)

    def skip(self, window: Tables) -> None:
        """Add a window that had been read before a checkpoint: what was done is left out."""
        late = dict(self.late)
        self.push(window)
        self.late = late

    def complete(self) -> float:
        """Return the time up to which all is there that a run needs, and nothing more can come."""
        end = self._newest - max((self.offset(name) for name in self.names), default=0.0)
        if np.any(self.nav.gnss.lever_arm):
            # the body's attitude at a fix lies between two star fixes
            own = [n for n in self._rows if table_kind(n) == "star"]
            newest = [self._rows[n][-1][0][-1] - self.offset(n) for n in own]
            known = max(newest, default=-np.inf)
            # a start needs two of them; after it a sensor that falls silent is not waited for long
            if np.isfinite(self.reached) and known < end - MOST_HELD:
                known, self.waited = end - MOST_HELD, True
            end = min(end, known)
        if self.nav.gyro is not None:
            # what holds after a sample depends on the next one
            rows = self._rows.get("gyro")
            end = min(end, np.nextafter(rows[-1][0][-1], -np.inf) if rows else -np.inf)
        return float(end)

    def take(self, end: float) -> dict[str, Columns]:
        """Return the rows up to a time; of a gyro one more."""
        out = {}
        for name in self.names:
            if name not in self._rows:
                continue
            whole = stacked(self._rows[name])
            self._rows[name] = [whole]
            cut = int(np.searchsorted(whole[0] - self.offset(name), end, "right"))
            cut += name == "gyro"
            if cut:
                out[name] = tuple(column[:cut] for column in whole)
        return out

    def drop(self, end: float) -> None:
        """Leave out what is done; the gyro's last sample up to there is still needed."""
        self.reached = end
        for name, rows in list(self._rows.items()):
            whole = stacked(rows)
            first = int(np.searchsorted(whole[0] - self.offset(name), end, "right"))
            first -= name == "gyro" and first > 0
            rest = tuple(column[first:] for column in whole)
            self._rows[name] = [rest]
            if not len(rest[0]):
                del self._rows[name]

    def gyro(self) -> tuple[Any, Any] | None:
        """Return the gyro's sample at or before the time that was reached."""
        rows = self._rows.get("gyro")
        if rows is None or rows[0][0][0] > self.reached:
            return None
        return rows[0][0][:1], rows[0][1][:1]

    def put_gyro(self, sample: tuple[Any, Any] | None) -> None:
        """Put the sample back that `gyro` returned."""
        if sample is not None:
            self._rows["gyro"] = [sample]


def _present(name: str, columns: Columns) -> Any:
    """Return which rows are not missing, as a log counts them."""
    if name == "baselines":
        return np.isfinite(np.asarray(columns[1])).all(axis=2).any(axis=1)
    good = np.ones(len(columns[0]), bool)
    for column in columns[MEASURED[str(table_kind(name))]]:
        if column is not None:
            good &= np.isfinite(np.asarray(column)).all(axis=1)
    return good


def log_of(tables: dict[str, Columns], epoch: str | None, *, first: bool) -> SensorLog:
    """Return rows as a log.

    What only shows in many fixes together, velocities in another frame, is looked for in the first
    ones: a window in which most fixes are wrong must not end a long replay.
    """
    filled: dict[str, Any] = dict(tables)
    if not first and "gnss" in tables:
        t, r, *v = (np.ascontiguousarray(column, dtype=np.float64) for column in tables["gnss"])
        check_positions(r, "gnss", None)
        filled["gnss"] = GnssTable(t=t, r=r, v=v[0] if v else None)
    return SensorLog(epoch=epoch, **filled)
