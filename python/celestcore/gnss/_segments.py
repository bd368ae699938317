"""A filter over a log in segments: where it refuses all for long, it starts again."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np

from celestcore._check import FloatArray

Begin = tuple[float, FloatArray, FloatArray]
"""Time, state and covariance that a segment starts from."""


class Runs(Protocol):
    """What a filter must do to run in segments; rows are indices of its fixes."""

    def rows(self, t: float) -> Any:
        """Return the rows that are used from a start at time t on."""

    def times(self, rows: Any) -> FloatArray:
        """Return their times."""

    def go(self, stops: slice, start: Begin, rows: Any, *, back: bool) -> dict[str, Any]:
        """Run over some of the stops."""

    def refused(self, out: dict[str, Any], rows: Any) -> tuple[Any, FloatArray]:
        """Return which of those that count were refused, and their times."""

    def left(self, t: Any) -> Any:
        """Return how many fixes there are from some times on."""

    def decided(self, t: float) -> bool:
        """Tell whether a start in the fixes from time t on rests on none that is to come."""

    def lost(self, out: dict[str, Any], rows: Any) -> FloatArray:
        """Return the times from which too many are refused running."""

    def again(self, lost: float, t: float) -> Begin | None:
        """Return a start at time t from the fixes from `lost` on; None if there is none."""


Segment = tuple[dict[str, Any], Any]
"""The core's answer, and the rows that its own row numbers count in."""


FEWEST_LEFT = 3
"""Fixes that must be left to start again from."""
FIRST_LOOK, LONGER = 256, 4
"""Stops that a run looks at after a restart, and how many times more if it is not lost there: with
many restarts each costs what lies between it and the next, not the rest of the log."""


def in_segments(
    runs: Runs, stops: FloatArray, start: Begin, *, back: bool, given: bool = False
) -> tuple[list[Segment], list[float]]:
    """Run over all stops; return the segments and the times at which a new one began.

    `given` says that the start is not from the fixes: if nothing is believed after it, one is.
    """
    segments: list[Segment] = []
    restarts: list[float] = []
    begin = 0
    while True:
        out, rows, lost = _until_lost(runs, stops, start, begin, whole=not restarts)
        again = _again(runs, stops, begin, lost, given=given)
        if again is None and len(lost):
            # no start in what was looked at: later there may be one
            rows = runs.rows(start[0])
            out = runs.go(slice(begin, None), start, rows, back=False)
            again = _again(runs, stops, begin, runs.lost(out, rows), given=given)
        given = False
        if again is None:
            if back:
                out = runs.go(slice(begin, None), start, rows, back=True)
            segments.append((out, rows))
            return segments, restarts
        end = begin + int(np.searchsorted(stops[begin:], again[0]))
        if end > begin:
            rows = runs.rows(start[0])
            before = rows[runs.times(rows) < again[0]]
            segments.append((runs.go(slice(begin, end), start, before, back=back), before))
        start, begin = again, end
        restarts.append(float(stops[end]))


def _until_lost(
    runs: Runs, stops: FloatArray, start: Begin, begin: int, *, whole: bool
) -> tuple[dict[str, Any], Any, FloatArray]:
    """Run forward until the filter is lost, or to the end: the answer, its rows, the times."""
    every = runs.rows(start[0])
    look = len(stops) if whole else FIRST_LOOK
    while True:
        end = min(begin + look, len(stops))
        rows = every
        if end < len(stops):
            rows = every[: np.searchsorted(runs.times(every), stops[end - 1], "right")]
        out = runs.go(slice(begin, end), start, rows, back=False)
        lost = runs.lost(out, rows)
        if len(lost) or end == len(stops):
            return out, rows, lost
        look *= LONGER


def _again(
    runs: Runs, stops: FloatArray, begin: int, lost: FloatArray, *, given: bool
) -> Begin | None:
    """Return the first start that is found where the filter is lost: there, or farther and farther.

    A start in the fixes of which nothing after it is believed would be found again: no use.
    """
    k = 0
    while k < len(lost):
        end = begin + int(np.searchsorted(stops[begin:], lost[k]))
        again = runs.again(float(lost[k]), float(stops[end])) if end > begin or given else None
        if again is not None:
            return again
        k = max(2 * k, k + 1)
    return None


def many_refused(refused: Any, t: FloatArray, most: int | None) -> FloatArray:
    """Return the times at which `most` refused fixes running begin, one after the other."""
    return np.asarray(t[runs_of(refused, most)])


def runs_of(refused: Any, most: int | None) -> Any:
    """Return where `most` refused fixes running begin, one after the other."""
    if most is None or len(refused) < most:
        return np.empty(0, int)
    first = np.flatnonzero(np.convolve(refused, np.ones(most, int), "valid") == most)
    apart = np.diff(first, prepend=-2) > 1
    stretch = first[apart][np.cumsum(apart) - 1]
    return first[(first - stretch) % most == 0]


def listed(restarts: list[float]) -> str:
    """Return the first few times as words."""
    more = " ..." if len(restarts) > 5 else ""
    return ", ".join(f"{t:.6g}" for t in restarts[:5]) + more


def stacked(segments: list[Segment]) -> dict[str, Any]:
    """Return the columns of segments one after the other, and the last one's end."""
    out = dict(segments[-1][0])
    outs = [segment for segment, _ in segments]
    # a segment between two output times has no rows, of no width
    written = [o for o in outs if len(o["t"])] or outs[-1:]
    for name in ("t", "state", "sigma", "covariance"):
        if name in out:
            out[name] = np.concatenate([o[name] for o in written])
    for name in ("nis", "accepted"):
        out[name] = np.concatenate([o[name] for o in outs])
    for name in ("innovation", "innovation_sigma"):
        out[name] = np.concatenate([o[name] for o in outs])
    out["fix"] = np.concatenate([rows[o["row"]] for o, rows in segments])
    for name in ("outside", "log_likelihood", "elapsed_s"):
        out[name] = sum(o[name] for o in outs)
    return out
