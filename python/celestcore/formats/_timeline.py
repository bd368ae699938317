"""One sensor's rows in order of time: what comes late, twice, or from a clock that jumped."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from celestcore._check import BoolArray, FloatArray, times
from celestcore.errors import InputError
from celestcore.formats._model import ROW, Columns
from celestcore.formats._stamps import Clock, numbers

_LOOK_AHEAD = 3
"""So many rows in a row whose clock is wrong are strays; more are a clock that jumped."""
_LISTED = 100


@dataclass(frozen=True)
class Jump:
    """A clock that went from one time to another between two rows.

    Attributes
    ----------
    row : int
        The first row after the jump, in the order of the file, those without a time not counted.
    before, after : float
        Times of the rows on both sides [s].

    Examples
    --------
    >>> Jump(10, 9.0, 3609.0).after
    3609.0
    """

    row: int
    before: float
    after: float


@dataclass
class SensorReport:
    """What was found in the times of one sensor during the last pass.

    Attributes
    ----------
    rows : int
        Rows in the file.
    reordered : int
        Rows that came late and were put in place.
    late : int
        Rows that came too late and were left out.
    repeated : int
        Rows that repeat a time and were left out; the first one stays.
    conflicting : int
        Those among them whose values differ from the row that stays.
    undated : int
        Rows without a time, left out.
    stray : int
        Rows with a time far from those around them, left out.
    wraps : int
        How often the counter began again.
    jumped : int
        How often the clock jumped.
    jumps : list of Jump
        The first hundred of these.

    Examples
    --------
    >>> SensorReport(rows=10, late=2).troubles
    {'late': 2}
    """

    rows: int = 0
    reordered: int = 0
    late: int = 0
    repeated: int = 0
    conflicting: int = 0
    undated: int = 0
    stray: int = 0
    wraps: int = 0
    jumped: int = 0
    jumps: list[Jump] = field(default_factory=list)

    @property
    def troubles(self) -> dict[str, int]:
        """The counts that are not zero, without the rows."""
        return {k: v for k, v in vars(self).items() if k not in ("rows", "jumps") and v}


class Timeline:
    """Takes one sensor's chunks as the file has them, gives rows whose times increase.

    With ``reorder=None`` a time that does not increase is an error. Otherwise a row may come up to
    `reorder` seconds after a later one and is put in its place. Whether a row is too late depends
    on the rows before it only, not on how they are cut into chunks.
    """

    def __init__(
        self,
        name: str,
        clock: Clock,
        reorder: float | None,
        jump: float | None,
        report: SensorReport,
        span: tuple[int, int | None] | None = None,
    ) -> None:
        self.name, self.clock, self.report = name, clock, report
        self.reorder, self.jump = reorder, jump
        self._far = max(jump or 0.0, reorder or 0.0)
        self.newest = -np.inf
        self.floor = -np.inf
        """No row before this time is still to come."""
        self._span = span
        self._held: list[Columns] = []
        self._ahead: Columns | None = None
        self._at: float | None = None
        self._dated_rows = 0

    def feed(self, raw: Columns) -> list[Columns]:
        """Take a chunk, return the rows that are now certain, in pieces."""
        columns = self._numbers(raw)
        if self.reorder is None:
            return self._strict(columns)
        columns = self._dated(columns)
        if self.jump is not None:
            columns = self._without_strays(columns, last=False)
        return self._sorted(columns)

    def advance(self, horizon: float) -> list[Columns]:
        """Say that other sensors have come to this time: what is before it need not wait."""
        if self.reorder is None:
            self.floor = max(self.floor, horizon)
            return []
        return self._release(horizon - self.reorder)

    def finish(self) -> list[Columns]:
        """Return what is left at the end."""
        out: list[Columns] = []
        if self._ahead is not None:
            out += self._sorted(self._without_strays(None, last=True))
        out += self._release(np.inf)
        return out

    def _numbers(self, raw: Columns) -> Columns:
        first = self.report.rows
        try:
            columns = {"t": self.clock.seconds(raw["t"])}
            for column, values in raw.items():
                if column != "t":
                    columns[column] = numbers(values, f"{self.name}.{column}")
        except InputError as error:
            if error.row is not None:
                error.row = int(raw[ROW][error.row]) if ROW in raw else error.row + first
            raise
        for column, values in columns.items():
            if len(values) != len(columns["t"]):
                raise InputError(
                    f"has {len(values)} rows but {self.name}.t has {len(columns['t'])}",
                    field=f"{self.name}.{column}",
                )
        self.report.rows += len(columns["t"])
        self.report.wraps = self.clock.wraps
        return columns

    def _strict(self, columns: Columns) -> list[Columns]:
        t = columns["t"]
        if not len(t):
            return []
        if not (t[0] > self.newest and bool((t[1:] > t[:-1]).all()) and np.isfinite(t[-1])):
            self._refuse(columns)
        self.newest = self.floor = float(t[-1])
        return [columns]

    def _refuse(self, columns: Columns) -> None:
        """Raise the error of `SensorLog`, its rows counted in the file."""
        first = self.report.rows - len(columns["t"])
        rows = columns.get(ROW, np.arange(first, self.report.rows)).astype(int).tolist()
        line = columns["t"]
        if np.isfinite(self.newest):
            rows, line = [first - 1, *rows], np.concatenate([[self.newest], line])
        try:
            times(line, f"{self.name}.t")
        except InputError as error:
            at = error.row or 0
            error.row = rows[at]
            error.message = error.message.replace(f"row {at - 1} (", f"row {rows[at - 1]} (")
            raise

    def _dated(self, columns: Columns) -> Columns:
        good = np.isfinite(columns["t"])
        if not good.all():
            self.report.undated += int(np.sum(~good))
            columns = _pick(columns, good)
        first = self._dated_rows
        self._dated_rows += len(columns["t"])
        if self._span is None:
            return columns
        begin, end = self._span
        cut = slice(max(begin - first, 0), None if end is None else max(end - first, 0))
        return _pick(columns, cut)

    def _without_strays(self, columns: Columns | None, *, last: bool) -> Columns:
        """Leave out rows whose clock was wrong for a moment; note where it jumped for good.

        The last rows wait for the next chunk, which tells one from the other.
        """
        pieces = [c for c in (self._ahead, columns) if c is not None]
        columns = join(pieces)
        end = None if self._span is None else self._span[1]
        seen = self._dated_rows if end is None else min(self._dated_rows, end)
        before = seen - len(columns["t"])
        keep, settled = self._judge(columns["t"], before, last)
        self._ahead = None if last else _pick(columns, slice(settled, None))
        return _pick(columns, np.flatnonzero(keep[:settled]))

    def _judge(self, t: FloatArray, first: int, last: bool) -> tuple[BoolArray, int]:
        far = self._far
        keep = np.ones(len(t), dtype=bool)
        settled = len(t) if last else max(len(t) - _LOOK_AHEAD, 0)
        if not settled:
            return keep, 0
        at = self._clock_at(t)
        k = 0
        steps = np.abs(np.diff(t, prepend=at)) > far
        while k < settled:
            if abs(t[k] - at) <= far:
                good = np.flatnonzero(steps[k + 1 : settled])
                k = k + 1 + int(good[0]) if len(good) else settled
                at = t[k - 1]
                continue
            after = t[k + 1 : k + 1 + _LOOK_AHEAD]
            back = np.flatnonzero(np.abs(after - at) <= far)
            if len(back):
                keep[k] = False
                self.report.stray += 1
            else:
                self._note(Jump(first + k, float(at), float(t[k])))
                at = t[k]
            k += 1
        self._at = float(at)
        return keep, settled

    def _clock_at(self, t: FloatArray) -> float:
        """Return what the clock showed last; before the first row, what it was about to show."""
        far = self._far
        if self._at is None and len(t) > 2:
            alone = abs(t[1] - t[0]) > far and abs(t[2] - t[1]) <= far < abs(t[2] - t[0])
            return float(t[1] if alone else t[0])
        return float(t[0]) if self._at is None and len(t) else float(self._at or 0.0)

    def _note(self, jump: Jump) -> None:
        self.report.jumped += 1
        if len(self.report.jumps) < _LISTED:
            self.report.jumps.append(jump)

    def _sorted(self, columns: Columns) -> list[Columns]:
        assert self.reorder is not None
        t = columns["t"]
        if not len(t):
            return []
        ordered = t[0] > self.newest and bool((t[1:] > t[:-1]).all()) and t[0] >= self.floor
        if ordered:
            self._held.append(columns)
        else:
            self._merge(columns)
        self.newest = max(self.newest, float(t[-1] if ordered else t.max()))
        return self._release(self.newest - self.reorder)

    def _merge(self, columns: Columns) -> None:
        """Put rows between those held; leave out the late and the repeated."""
        t = columns["t"]
        before = np.maximum.accumulate(np.concatenate([[self.newest], t[:-1]]))
        late = (before - t > self.reorder) | (t < self.floor)
        self.report.late += int(late.sum())
        self.report.reordered += int(np.sum(~late & (t < before)))
        both = join([*self._held, _pick(columns, ~late)])
        order = np.argsort(both["t"], kind="stable")
        both = _pick(both, order)
        same = np.concatenate([[False], both["t"][1:] == both["t"][:-1]])
        if same.any():
            self._count_repeated(both, same)
            both = _pick(both, ~same)
        self._held = [both]

    def _count_repeated(self, both: Columns, same: BoolArray) -> None:
        kept = np.maximum.accumulate(np.where(same, 0, np.arange(len(same))))
        rows = np.flatnonzero(same)
        self.report.repeated += len(rows)
        differ = np.zeros(len(rows), dtype=bool)
        for column, values in both.items():
            if column not in ("t", ROW):
                a, b = values[rows], values[kept[rows]]
                differ |= (a != b) & ~(np.isnan(a) & np.isnan(b))
        self.report.conflicting += int(differ.sum())

    def _release(self, limit: float) -> list[Columns]:
        """Return the held rows before a time after which nothing can come before it."""
        self.floor = max(self.floor, limit)
        out, keep = [], []
        for piece in self._held:
            t = piece["t"]
            cut = int(np.searchsorted(t, self.floor)) if t[-1] >= self.floor else len(t)
            if cut:
                out.append(piece if cut == len(t) else _pick(piece, slice(0, cut)))
            if cut < len(t):
                keep.append(piece if not cut else _pick(piece, slice(cut, None)))
        self._held = keep
        return out


def _pick(columns: Columns, rows: Any) -> Columns:
    return {name: values[rows] for name, values in columns.items()}


def join(pieces: list[Columns]) -> Columns:
    """Put pieces of one sensor behind one another.

    Examples
    --------
    >>> join([{"t": np.zeros(1)}, {"t": np.ones(2)}])["t"]
    array([0., 1., 1.])
    """
    if len(pieces) == 1:
        return pieces[0]
    return {name: np.concatenate([p[name] for p in pieces]) for name in pieces[0]}
