"""Campaigns side by side: a cell with a single orbit keeps one processor busy, not all.

And how many runs they have.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_COMPLETED, ThreadPoolExecutor, wait
from threading import Event
from typing import TypeVar

from celestcore._check import warn
from celestcore.errors import InputError

T = TypeVar("T")
Progress = Callable[[int, int], object]
Job = Callable[[Progress], T]

POLL = 0.1  # s between two looks at the progress


def in_parallel(
    jobs: Sequence[Job[T]], threads: int, progress: Progress | None, total: int
) -> list[T]:
    """Run jobs over threads and return their results in order.

    Parameters
    ----------
    jobs : sequence of callable
        Each is called with a progress callback ``(done, total)`` of its own. After Ctrl-C, or when
        another job has failed, the callback raises, so that the job ends soon.
    threads : int
        How many jobs at once.
    progress : callable, optional
        Called on the calling thread with the sum of what is done, and `total`.
    total : int
        What all jobs together will have done.
    """
    stop, counts = Event(), [0] * len(jobs)

    def start(k: int) -> T:
        def heard(done: int, _: int) -> None:
            counts[k] = done
            if stop.is_set():
                raise KeyboardInterrupt

        heard(0, 0)
        return jobs[k](heard)

    with ThreadPoolExecutor(threads) as pool:
        futures = [pool.submit(start, k) for k in range(len(jobs))]
        try:
            waiting = set(futures)
            while waiting:
                done, waiting = wait(waiting, timeout=POLL, return_when=FIRST_COMPLETED)
                for future in done:
                    future.result()
                if progress is not None:
                    progress(sum(counts), total)
        except BaseException:
            stop.set()
            pool.shutdown(wait=True, cancel_futures=True)
            raise
    return [future.result() for future in futures]


def trials(runs: int | None, seed: int, *, quick: bool, defined: tuple[int, int]) -> int:
    """Return how many runs a cell gets, and warn if they are too few.

    Parameters
    ----------
    runs : int or None
        What was asked for.
    seed : int
    quick : bool
    defined : (full, quick)
        Runs for which an experiment is defined, and for a look.

    Raises
    ------
    InputError
        If `runs` or `seed` is out of range.
    """
    full, few = defined
    wanted = (few if quick else full) if runs is None else runs
    if wanted < 1:
        raise InputError("must be at least 1", field="runs", value=wanted)
    if seed < 0:
        raise InputError("must not be negative", field="seed", value=seed)
    if not quick and wanted < full:
        warn(f"{wanted} runs a cell are too few to judge the targets; they are defined for {full}")
    return wanted
