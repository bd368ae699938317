"""`measure`: works, peers and yardsticks in turn."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from celestcore import _core
from celestcore._arguments import count
from celestcore.bench import _instructions, _peers, _works, _yardstick
from celestcore.bench._machine import machine
from celestcore.bench._report import Report
from celestcore.bench._session import Progress, Session
from celestcore.errors import CelestcoreError, InputError

REPEATS = 3
"""Rounds if none are given; one with ``quick``."""


def measure(
    only: Sequence[str] | None = None,
    against: Sequence[str] = (),
    *,
    repeats: int | None = None,
    quick: bool = False,
    instructions: str | os.PathLike[str] | None = None,
    progress: Progress | None = None,
) -> Report:
    """Measure celestcore, and peers on the same work.

    Parameters
    ----------
    only : sequence of str, optional
        Names of works; all of them.
    against : sequence of str
        Names of peers, ``"all"``, and command lines of programs that print
        ``{"task": ..., "peer": ..., "ns": ...}`` a line.
    repeats : int, optional
        Rounds: each measures everything in turn, of all rounds the shortest time counts. 3, or 1
        with `quick`.
    quick : bool
        Small inputs, one run each: a look, too short to judge by.
    instructions : path, optional
        File that ``make instructions`` wrote; its counts go into the report.
    progress : callable, optional
        ``progress(done, total)`` [works].

    Returns
    -------
    Report

    Raises
    ------
    InputError
        An unknown work or peer; a program that does not run or prints something else.
    CelestcoreError
        A debug build of celestcore, which says nothing of speed.

    Examples
    --------
    >>> from celestcore import bench
    >>> bench.measure(["systematic"], ["numpy"], quick=True).rows[0].refused
    {}
    """
    if not _core.release_build:
        raise CelestcoreError(
            "a debug build says nothing of speed: install the release wheel (make wheel)"
        )
    works = _works.chosen(None if only is None else ",".join(only))
    peers, yardsticks = _sorted_out(against)
    rounds = (1 if quick else REPEATS) if repeats is None else count(repeats, "repeats")
    counts = {} if instructions is None else _instructions.read(Path(instructions))
    skipped = {peer.name: why for peer in peers if (why := peer.missing())}
    here = [peer for peer in peers if peer.name not in skipped]
    session = Session(works, here, yardsticks, quick=quick)
    session.run(rounds, progress)
    return Report(
        machine=machine(),
        rows=session.rows,
        peers={peer.name: peer.version for peer in here},
        skipped=skipped,
        yardsticks=yardsticks,
        instructions=counts,
        options={"quick": quick, "repeats": rounds},
    )


def _sorted_out(
    against: Sequence[str],
) -> tuple[list[_peers.Peer], list[_yardstick.Yardstick]]:
    """Tell programs from lists of peers."""
    names: list[str] = []
    yardsticks = []
    for text in against:
        program = _yardstick.program(text)
        if program is not None:
            yardsticks.append(program)
            continue
        found = [name.strip() for name in text.split(",") if name.strip()]
        if not found:
            raise InputError("names no peer and no program", field="--against", value=text)
        names += found
    return _peers.named(names), yardsticks
