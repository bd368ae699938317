"""What an executor is handed: a few runs of one cell."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from celestcore._campaign import Stop
from celestcore.errors import CelestcoreError
from celestcore.solution import package_version

Columns = dict[str, list[Any]]


@dataclass(frozen=True)
class Task:
    """Some runs of a cell. It is small, and can be pickled.

    Attributes
    ----------
    cell : int
        Number of the cell in this campaign.
    text : str
        Its settings.
    first, runs : int
        The trials; of a log, its number and 1.
    log : str or None
        Path of the log.
    stop : Stop
        Ends it, if it runs in this process.
    version : str
        Of the celestcore that asks.
    tries, scares : int
        How often it was alone when its worker died, or failed; and how often it was out when a
        pool broke.
    """

    cell: int
    text: str
    first: int
    runs: int
    log: str | None
    stop: Stop
    version: str
    tries: int = 0
    scares: int = 0

    def again(self) -> Task:
        """Return the same task for one more try."""
        return replace(self, tries=self.tries + 1)

    def scared(self) -> Task:
        """Return the same task, which was out when a pool broke."""
        return replace(self, scares=self.scares + 1)

    def one_by_one(self) -> list[Task]:
        """Return a task for each run."""
        return [replace(self, first=self.first + k, runs=1) for k in range(self.runs)]


def perform(task: Task) -> Columns:
    """Run a task, in whatever process.

    Raises
    ------
    CelestcoreError
        If this process has another celestcore: its bits may differ.
    """
    if package_version() != task.version:
        raise CelestcoreError(
            f"a worker has celestcore {package_version()}, the campaign {task.version}: "
            "give all the same"
        )
    task.stop(0, task.runs)
    try:
        return _run(task, task.stop)
    except KeyboardInterrupt:
        task.stop.set()  # Ctrl-C reached this worker, which would go on with what it was handed
        raise


def _run(task: Task, progress: Callable[[int, int], object]) -> Columns:
    from celestcore.campaign import _logs, _simulated

    if task.log is not None:
        return _logs.row(task.text, task.log, progress)
    return _simulated.rows(task.text, task.first, task.runs, progress)
