"""Sums and runs over measurements that come part after part: nothing is kept but what is told."""

from __future__ import annotations

import heapq
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from celestcore._health import BURST
from celestcore.analysis.autocorrelation import Whiteness, tested
from celestcore.solution import Array

MOST = 500
"""So many of the longest bursts and silences are kept of each sensor."""
APART = 10.0
"""Bursts of refused measurements are one stretch if fewer usual steps lie between them."""


class Lags:
    """The autocorrelation of a series about its mean, from its pieces."""

    def __init__(self, lags: int, axes: int) -> None:
        self.lags, self.n = lags, 0
        self._sum = np.zeros(axes)
        self._products = np.zeros((lags + 1, axes))
        self._head, self._tail = np.zeros((0, axes)), np.zeros((0, axes))

    def add(self, z: Array) -> None:
        """Add the next piece (n, axes)."""
        if len(self._head) < self.lags:
            self._head = np.concatenate([self._head, z])[: self.lags]
        both, new = np.concatenate([self._tail, z]), len(self._tail)
        for lag in range(self.lags + 1):
            begin = max(new, lag)
            if begin >= len(both):
                break  # too few have come yet for so long a lag
            self._products[lag] += np.sum(
                both[begin:] * both[begin - lag : len(both) - lag], axis=0
            )
        self._tail = both[-self.lags :]
        self._sum += z.sum(axis=0)
        self.n += len(z)

    def tested(self, probability: float = 0.95) -> Whiteness | None:
        """Return the test of whiteness; None if too few have come, or all are the same."""
        n, k = self.n, self.lags
        if n <= 2 * k:
            return None
        mean = self._sum / n
        ends = np.zeros((k + 1, len(mean)))
        ends[1:] = np.cumsum(self._head, axis=0) + np.cumsum(self._tail[::-1], axis=0)
        left = (n - np.arange(k + 1.0))[:, None]
        centred = self._products - mean * (2.0 * self._sum - ends) + left * mean**2
        if not (np.isfinite(centred).all() and (centred[0] > 0.0).all()):
            return None
        return tested(centred[1:] / centred[0], n, np.zeros(len(mean)), probability)


@dataclass(frozen=True, order=True)
class Burst:
    """Refused measurements running: how many, when, and at which places of all."""

    fixes: int
    begin: float
    end: float
    place: int
    refused: int
    """Refused ones before it."""


@dataclass(frozen=True)
class Stretch:
    """A time in which a sensor was refused: bursts with little between them."""

    begin: float
    end: float
    fixes: int
    rejected: int


class Bursts:
    """Finds where at least `BURST` measurements running were refused."""

    def __init__(self) -> None:
        self.count = self.n = self.refused = 0
        self._open: Burst | None = None
        self._kept: list[Burst] = []

    def add(self, t: Array, accepted: NDArray[np.bool_]) -> None:
        """Add the next piece."""
        if not len(t):
            return
        bad = np.concatenate([[False], ~accepted, [False]]).astype(np.int8)
        begin, end = np.flatnonzero(np.diff(bad) == 1), np.flatnonzero(np.diff(bad) == -1)
        before = np.concatenate([[0], np.cumsum(~accepted)])
        joins = self._open is not None and len(begin) and begin[0] == 0
        if self._open is not None and not joins:
            self._close()
        rows = np.flatnonzero((end - begin >= BURST) | (begin == 0) | (end == len(t)))
        for k in rows.tolist():
            a, b = int(begin[k]), int(end[k])
            one = Burst(
                b - a, float(t[a]), float(t[b - 1]), self.n + a, self.refused + int(before[a])
            )
            if a == 0 and self._open is not None:
                old = self._open
                one = Burst(old.fixes + b, old.begin, one.end, old.place, old.refused)
            self._open = one
            if b < len(t):
                self._close()
        self.n += len(t)
        self.refused += int(before[-1])

    def _close(self) -> None:
        if self._open is not None and self._open.fixes >= BURST:
            self.count += 1
            keep = heapq.heappush if len(self._kept) < MOST else heapq.heappushpop
            keep(self._kept, self._open)
        self._open = None

    @property
    def ends_open(self) -> int:
        """1 if the series ends in a burst, that is not counted yet."""
        return int(self._open is not None and self._open.fixes >= BURST)

    def found(self) -> list[Burst]:
        """Return the bursts so far, longest first."""
        last = [self._open] if self._open is not None and self.ends_open else []
        return sorted([*self._kept, *last], key=lambda b: (-b.fixes, b.begin))

    def stretches(self, step: float) -> list[Stretch]:
        """Return bursts with less than `APART` steps [s] between them as one, in order of time."""
        out: list[tuple[Burst, Burst]] = []
        for burst in sorted(self.found(), key=lambda b: b.begin):
            if out and burst.begin - out[-1][1].end <= APART * step:
                out[-1] = (out[-1][0], burst)
            else:
                out.append((burst, burst))
        return [
            Stretch(
                a.begin,
                b.end,
                b.place + b.fixes - a.place,
                b.refused + b.fixes - a.refused,
            )
            for a, b in out
        ]


class Silences:
    """The longest times between neighbours of a series of times."""

    def __init__(self) -> None:
        self.first: float | None = None
        self.last: float | None = None
        self._kept: list[tuple[float, float, float]] = []

    def add(self, t: Array) -> None:
        """Add the next piece."""
        if not len(t):
            return
        times = t if self.last is None else np.concatenate([[self.last], t])
        step = np.diff(times)
        many = min(MOST, len(step))
        top = np.argpartition(-step, many - 1)[:many] if many else np.zeros(0, dtype=int)
        mine = [(float(step[k]), float(times[k]), float(times[k + 1])) for k in top]
        self._kept = heapq.nlargest(MOST, [*self._kept, *mine])
        self.first = float(t[0]) if self.first is None else self.first
        self.last = float(t[-1])

    def longer(self, least: float) -> list[tuple[float, float]]:
        """Return those longer than so much, in order of time."""
        return sorted((a, b) for length, a, b in self._kept if length > least)

    def longest(self, usual: float) -> dict[str, Any] | None:
        """Return the longest, and the usual step, as JSON has it."""
        if len(self._kept) < 2:
            return None
        _, begin, end = max(self._kept)
        return {"begin": begin, "end": end, "usual": usual}
