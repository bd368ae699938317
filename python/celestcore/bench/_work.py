"""A work: what is measured, on what, and who else does it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from celestcore.bench._outcome import Agree, Outcome


@dataclass(frozen=True)
class Timed:
    """One measurement of a work by celestcore.

    Attributes
    ----------
    ns : float
        Time for each item [ns].
    outcome : dict
        What came out, for checking peers.
    base : float
        Time of what the work is held against where that is celestcore's own [ns an item]: the core
        without Python, one thread.
    """

    ns: float
    outcome: Outcome = field(default_factory=dict)
    base: float | None = None


@dataclass(frozen=True)
class Target:
    """What the figure is wanted to be.

    Attributes
    ----------
    most : float
        Largest ratio, or largest time [ns].
    of : str
        What the ratio is to: ``"limit"``, the name of another work, ``"base"``, or ``"ns"`` for a
        time.
    """

    most: float
    of: str = "limit"


@dataclass(frozen=True)
class Entry:
    """How a peer does a work.

    Attributes
    ----------
    where : str
        ``module:function``; the function takes the input and returns a call without arguments that
        does the work and returns its outcome.
    size : int
        Items that are enough to measure it.
    """

    where: str
    size: int


@dataclass(frozen=True)
class Work:
    """A row of the table.

    Attributes
    ----------
    name, title : str
        For options and for people.
    item : str
        What the time is divided by.
    size, quick : int
        Items of a run, and of one with ``--quick``.
    make : callable
        Makes the input of so many items.
    run : callable
        Does the work once on an input and measures it.
    agree : callable
        Tells whether a peer's outcome is right.
    task : str, optional
        Name of the work in a yardstick's output; its own name is understood as well.
    target : Target, optional
        What was aimed at.
    base : str, optional
        What `Timed.base` is.
    peers : dict of str to Entry
        Who else does it.
    kernel : str, optional
        Name of the kernel whose instructions are counted.
    count : int
        Items in each unit of its size: logs of a batch, epochs of a cloud.
    once : bool
        Whether one run is long enough to be the only one of a round.
    missing : callable, optional
        Tells why the work cannot be done here, or None.
    """

    name: str
    title: str
    item: str
    size: int
    quick: int
    make: Callable[[int], Any]
    run: Callable[[Any], Timed]
    agree: Agree | None = None
    task: str | None = None
    target: Target | None = None
    base: str | None = None
    peers: Mapping[str, Entry] = field(default_factory=dict)
    kernel: str | None = None
    count: int = 1
    once: bool = False
    missing: Callable[[], str | None] | None = None
