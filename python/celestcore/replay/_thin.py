"""Rows of a long table, thinned as they come: extremes stay, so spikes do."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from celestcore._panels import extreme_rows
from celestcore.solution import Array

Columns = dict[str, Any]
Keys = Callable[[Columns], list[Array]]
ROOM = 100_000
"""Rows above which what was kept is thinned once more."""


class Thinned:
    """Keeps the rows with the lowest and the highest values of each stretch, and the ends.

    Parameters
    ----------
    keys : callable
        Gives the columns whose extremes count; NaN is no value.
    buckets : int
        Stretches in each piece.
    even : int
        So many rows evenly spaced in each piece, beside the extremes.
    """

    def __init__(self, keys: Keys, buckets: int, even: int = 0) -> None:
        self._keys, self._buckets, self._even = keys, buckets, even
        self._kept: list[Columns] = []
        self._rows = 0
        self._again = False

    def add(self, columns: Columns) -> None:
        """Add the next piece."""
        self._put(self._thin(columns))
        if self._rows > ROOM:
            self._again = True
            whole = self.columns()
            self._kept, self._rows = [], 0
            self._put(whole)

    def _put(self, columns: Columns) -> None:
        n = len(columns["t"])
        if n:
            self._kept.append(columns)
            self._rows += n

    def _thin(self, columns: Columns) -> Columns:
        n = len(columns["t"])
        if not n:
            return columns
        rows = [np.array([0, n - 1]), *(_extremes(y, self._buckets) for y in self._keys(columns))]
        if self._even:
            rows.append(np.arange(0, n, max(-(-n // self._even), 1)))
        return _taken(columns, rows)

    def columns(self) -> Columns:
        """Return what was kept, in order; nothing at all if nothing came."""
        if not self._kept:
            return {}
        whole = {n: np.concatenate([c[n] for c in self._kept]) for n in self._kept[0]}
        if not self._again:
            return whole
        # stretches of equal time: by rows, what was thinned before would be thinned ever more
        keys, t = self._keys(whole), whole["t"]
        many = max(ROOM // (8 * max(len(keys), 1)), 1)
        place = np.minimum((t - t[0]) / max(t[-1] - t[0], 1e-9) * many, many - 1).astype(int)
        first = np.flatnonzero(np.diff(place, prepend=-1))
        every = [first[:: max(-(-len(first) // (ROOM // 8)), 1)], np.array([0, len(t) - 1])]
        return _taken(whole, [*every, *(_in_places(y, place) for y in keys)])


def _taken(columns: Columns, rows: list[Any]) -> Columns:
    keep = np.unique(np.concatenate(rows))
    return {name: column[keep] for name, column in columns.items()}


def _in_places(y: Array, place: Any) -> Any:
    """Return the rows of the lowest and the highest value in each place; NaN is no value."""
    have = np.flatnonzero(np.isfinite(y))
    have = have[np.lexsort((y[have], place[have]))]
    step = np.diff(place[have])
    return have[np.r_[True, step > 0] | np.r_[step > 0, True]] if len(have) else have


def _extremes(y: Array, buckets: int) -> Any:
    have = np.flatnonzero(np.isfinite(y))
    return have[extreme_rows(y[have], buckets)]
