"""A filter with restarts that gets a log bit by bit, and does what it does on the whole log.

On the whole log a filter that refuses `most` fixes running starts again at the first of them, if a
start is found there; if not, later, at the second, third, fifth, ninth ... such place. So a run of
refused fixes is not done with before it is known whether it gets so long, and a restart not before
all fixes that its start looks at are there: what is not decided is held back. But not for ever: a
sensor that falls silent at such a place would hold back all that follows.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from celestcore._check import FloatArray
from celestcore.gnss._segments import FEWEST_LEFT, Begin, Runs, Segment, runs_of

MOST_HELD = 10800.0
"""How long anything is held back [s]."""


@dataclass(frozen=True)
class Track:
    """Where a filter stands."""

    t: float
    state: FloatArray
    covariance: FloatArray
    goes_on: bool = False
    """Whether what is measured at time `t` is in it."""
    seen: int = 0
    """Places since its start at which it refused too many fixes running."""
    next: int = 0
    """Number of the place at which to look for a start."""
    running: int = 0
    """Fixes refused running at its end, less those of places that are in `seen`."""
    waited: bool = False
    """Whether those were held back for so long that they are done, whatever may follow."""
    unsure: bool = False
    """Whether anything was done that is otherwise on the whole log, perhaps."""

    @property
    def begin(self) -> Begin:
        """Return it as the core takes it."""
        return self.t, self.state, self.covariance

    def stops(self, later: FloatArray) -> FloatArray:
        """Return the stops of a run from here."""
        return np.append(self.t, later) if self.goes_on else later


@dataclass(frozen=True)
class Advance:
    """How far a filter came."""

    segments: list[Segment]
    restarts: list[float]
    done: int
    """How many of the stops are done."""
    track: Track


@dataclass(frozen=True)
class _Cut:
    """Where a segment ends."""

    end: int
    again: Begin | None
    next: int
    places: FloatArray
    waited: bool = False
    unsure: bool = False


def advance(
    runs: Runs, stops: FloatArray, track: Track, most: int | None, *, last: bool, until: int
) -> Advance:
    """Run over the stops before number `until`, as far as all is decided.

    Fixes and stops beyond `until` are looked at, not done. `last`: nothing comes after the stops.
    """
    segments: list[Segment] = []
    restarts: list[float] = []
    begin = 0
    while True:
        rows = runs.rows(track.t)
        out = runs.go(slice(begin, None), track.begin, rows, back=False)
        cut = _cut(runs, stops, begin, track, (out, rows), most, last=last, until=until)
        if cut.end > begin + track.goes_on:
            if cut.end < len(stops):
                rows = rows[runs.times(rows) < stops[cut.end]]
                out = runs.go(slice(begin, cut.end), track.begin, rows, back=False)
            segments.append((out, rows))
            track = _after(runs, track, (out, rows), most, cut)
        if cut.again is None:
            return Advance(segments, restarts, cut.end, track)
        restarts.append(float(stops[cut.end]))
        track, begin = Track(*cut.again, unsure=track.unsure or cut.unsure), cut.end


def _cut(
    runs: Runs,
    stops: FloatArray,
    begin: int,
    track: Track,
    found: Segment,
    most: int | None,
    *,
    last: bool,
    until: int,
) -> _Cut:
    """Return where a segment ends: at a restart, or where what comes next is not decided."""
    refused, t = runs.refused(*found)
    if most is None or not len(t):
        return _Cut(until, None, track.next, np.empty(0))
    index = runs_of(_with(track.running, refused), most) - track.running
    # one that began before was looked at, or its begin is done because it was held back too long
    places = t[np.maximum(index, 0) if track.waited else index[index >= 0]]
    newest = stops[-1]
    if last:
        places = places[runs.left(places) >= FEWEST_LEFT]
    following = track.next
    for number, place in enumerate(places, track.seen):
        end = begin + int(np.searchsorted(stops[begin:], place))
        if end >= until:
            return _Cut(until, None, following, places)
        if number != following:
            continue
        sure = last or runs.decided(float(place))
        if not sure and newest - place <= MOST_HELD:
            return _Cut(end, None, following, places)
        # a start in the fixes of which nothing after it is believed would be found again: no use
        again = runs.again(float(place), float(stops[end])) if end > begin else None
        if again is not None:
            return _Cut(end, again, following, places, unsure=not sure)
        following = max(2 * following, following + 1)
    if not last:
        waiting = min(_running(track.running, refused) % most, len(t))
        if waiting:
            first = t[len(t) - waiting]
            if newest - first > MOST_HELD:
                return _Cut(until, None, following, places, waited=True)
            end = begin + int(np.searchsorted(stops[begin:], first))
            return _Cut(min(end, until), None, following, places)
    return _Cut(until, None, following, places)


def _after(runs: Runs, track: Track, found: Segment, most: int | None, cut: _Cut) -> Track:
    """Return where the filter stands after a segment."""
    out, _ = found
    size = len(track.covariance)
    refused, _ = runs.refused(*found)
    return replace(
        track,
        t=float(out["final_t"]),
        state=out["final_state"],
        covariance=out["final_covariance"].reshape(size, size),
        goes_on=True,
        seen=track.seen + int(np.count_nonzero(cut.places <= out["final_t"])),
        next=cut.next,
        running=0 if most is None else _running(track.running, refused) % most,
        # a run that goes on over an outage stays one
        waited=cut.waited or (track.waited and bool(np.all(refused))),
        unsure=track.unsure or cut.waited,
    )


def _with(running: int, refused: Any) -> Any:
    return np.concatenate([np.ones(running, bool), refused])


def _running(before: int, refused: Any) -> int:
    """Return how many are refused running at the end."""
    used = np.flatnonzero(~refused)
    return before + len(refused) if not len(used) else len(refused) - 1 - int(used[-1])
