"""Time that a call takes, whatever else the machine does."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TypeVar

T = TypeVar("T")

CLOCK = (
    "the shorter of processor and wall-clock time (kernels inside the core: wall clock), "
    "shortest of all runs"
)


def clocked(call: Callable[[], T]) -> tuple[float, T]:
    """Return a call's time [s] and what it returns.

    Processor time where one thread works, which other programs do not lengthen; wall-clock time
    where several do, whose processor times add up to more.

    Examples
    --------
    >>> taken, found = clocked(lambda: 1 + 1)
    >>> taken >= 0.0, found
    (True, 2)
    """
    wall, processor = time.perf_counter(), time.process_time()
    found = call()
    return min(time.process_time() - processor, time.perf_counter() - wall), found
