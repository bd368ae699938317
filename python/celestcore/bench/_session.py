"""Measuring: celestcore, peers and a yardstick in turn, and of each the shortest time."""

from __future__ import annotations

import math
import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, TypeAlias

from celestcore.bench._clock import clocked
from celestcore.bench._outcome import Outcome
from celestcore.bench._peers import Peer, loaded
from celestcore.bench._work import Entry, Timed, Work
from celestcore.bench._yardstick import Yardstick

Progress: TypeAlias = Callable[[int, int], object]
LONG = 0.3
"""Time that each round gives a candidate [s]; with ``--quick`` it is one run."""
FEWEST, MOST = 3, 2000
"""Runs of a candidate in a round, however long or short they are."""


@dataclass
class Row:
    """What was measured of a work.

    Attributes
    ----------
    work : Work
    ns : float
        Celestcore's shortest time [ns an item]; not a number before it was measured.
    base : float or None
        Shortest time of what the work is held against [ns an item].
    peers : dict of str to float
        The peers' shortest times [ns an item].
    refused : dict of str to str
        Peers whose result is not celestcore's, and how it differs.
    left_out : str or None
        Why the work was not measured.
    """

    work: Work
    ns: float = math.nan
    base: float | None = None
    peers: dict[str, float] = field(default_factory=dict)
    refused: dict[str, str] = field(default_factory=dict)
    left_out: str | None = None

    def add(self, made: Timed) -> None:
        """Keep the shorter times, each for itself."""
        self.ns = made.ns if math.isnan(self.ns) else min(self.ns, made.ns)
        if made.base is not None:
            self.base = made.base if self.base is None else min(self.base, made.base)


class Session:
    """Works with the peers that do them, measured in rounds.

    Parameters
    ----------
    works : sequence of Work
    peers : sequence of Peer
        Installed ones.
    yardsticks : sequence of Yardstick
        Programs that run once a round.
    quick : bool
        Small inputs, one run.
    """

    def __init__(
        self,
        works: tuple[Work, ...],
        peers: list[Peer],
        yardsticks: list[Yardstick],
        *,
        quick: bool = False,
    ) -> None:
        self.rows = [Row(work) for work in works]
        self.yardsticks = yardsticks
        self.quick = quick
        self._peers = peers
        self._calls: dict[tuple[str, str], Callable[[], Outcome]] = {}
        for row in self.rows:
            row.left_out = row.work.missing() if row.work.missing else None

    def run(self, rounds: int, progress: Progress | None = None) -> None:
        """Measure everything so many times, in turn.

        Raises
        ------
        InputError
            A yardstick that does not work; celestcore's own errors pass.
        """
        total = rounds * (len(self.rows) + len(self.yardsticks))
        for done in range(rounds):
            for k, row in enumerate(self.rows):
                if progress:
                    progress(done * total // rounds + k, total)
                if row.left_out is None:
                    self._measure(row)
            for yardstick in self.yardsticks:
                yardstick.run()
        if progress:
            progress(total, total)

    def _measure(self, row: Row) -> None:
        work = row.work
        given = work.make(work.quick if self.quick else work.size)
        self._often(lambda: row.add(work.run(given)), once=work.once)
        for peer in self._peers:
            entry = work.peers.get(peer.name)
            if entry is not None and peer.name not in row.refused:
                self._peer(row, peer.name, entry)

    def _peer(self, row: Row, name: str, entry: Entry) -> None:
        """Measure a peer; its first run, which may compile, is the one that is checked."""
        size = min(entry.size, row.work.quick) if self.quick else entry.size
        key = (row.work.name, name)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            if key not in self._calls:
                given = row.work.make(size)
                call = loaded(entry)(given)
                problem = checked(row.work, given, call())
                if problem is not None:
                    row.refused[name] = problem
                    return
                self._calls[key] = call
            call = self._calls[key]

            def once() -> None:
                ns = 1e9 * clocked(call)[0] / (size * row.work.count)
                row.peers[name] = min(ns, row.peers.get(name, math.inf))

            self._often(once)

    def _often(self, work: Callable[[], Any], *, once: bool = False) -> None:
        """Call for the round's time, or a single time."""
        single = self.quick or once
        end = time.perf_counter() + LONG
        for done in range(1, MOST + 1):
            work()
            if single or (done >= FEWEST and time.perf_counter() >= end):
                return


def checked(work: Work, given: Any, outcome: Outcome) -> str | None:
    """Return what is wrong with a peer's outcome, or None."""
    if work.agree is None:
        return None
    return work.agree(given, work.run(given).outcome, outcome)
