"""Runs a campaign, and what comes of it."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Any, TypeAlias

from celestcore._arguments import checked, processors
from celestcore._campaign import Stop
from celestcore._check import warn
from celestcore.campaign import _logs, _simulated
from celestcore.campaign._config import Campaign, Cell
from celestcore.campaign._dask import cluster
from celestcore.campaign._dataset import Dataset
from celestcore.campaign._engine import Engine, Source
from celestcore.campaign._results import Results, columns_of, grid_value
from celestcore.campaign._work import Columns, Task
from celestcore.errors import InputError
from celestcore.solution import package_version

Progress: TypeAlias = Callable[[int, int], object]

SHARE = 0.02
SOONEST, LATEST = 5.0, 120.0
"""A part is written after this share of the time so far, but within these bounds [s]."""
ROWS = 20_000
"""Rows in a part at most."""
TASKS = 64
"""Tasks that a campaign is cut into at least, where it has so many runs."""


def run(
    config: Campaign | Mapping[str, Any] | str | os.PathLike[str],
    out: str | os.PathLike[str],
    *,
    executor: Source | str | None = None,
    threads: int | None = None,
    progress: Progress | None = None,
) -> Results:
    """Run what a campaign's folder does not hold yet.

    A run has the same bits on any executor, any number of threads, in any order and whether the
    campaign was interrupted or not, on processors of one kind; ``portable = true`` in the
    configuration makes them the same on every x86-64 machine.

    Parameters
    ----------
    config : Campaign, mapping or path
        What to run; a path is that of a TOML file.
    out : path
        Folder of the results, made if it is not there. Rows that it holds are not run again. It may
        come from a smaller campaign: more trials, more values in the grid, more logs.
    executor : executor, callable or str, optional
        Anything with ``submit(fn, *args)`` that returns futures; or a function that makes one, and
        is called again when a pool has broken down; or the address of a Dask scheduler
        (``"tcp://..."``). By default threads of this process.
    threads : int, optional
        How many, without an executor; by default all processors.
    progress : callable, optional
        ``progress(done, total)`` [runs], those of earlier calls included.

    Returns
    -------
    Results

    Raises
    ------
    InputError
        If the configuration is wrong, or the folder holds something else or is damaged.
    CelestcoreError
        If the executor is lost. Rows that are finished have been written.
    KeyboardInterrupt
        On Ctrl-C, at once. Rows that are finished have been written.
    MissingDependencyError
        Without pyarrow, or with an address and without dask.

    Warns
    -----
    CelestcoreWarning
        If the folder holds rows of another version of celestcore.

    Notes
    -----
    A run that takes its worker with it is tried again, ``tries`` times in all, then written down
    as failed, with ``lost``; the next call tries it once more. Runs that were out at the same time
    only cost time. A filter that breaks down, or a log that cannot be read, is a row as well: it
    says why in ``failure``.

    Examples
    --------
    >>> import tempfile
    >>> import celestcore as cc
    >>> config = {
    ...     "campaign": {"trials": 4, "seed": 1, "skip_s": 20.0},
    ...     "scenario": {"profile": "earth_pointing", "duration_s": 60.0},
    ...     "gyro": {"arw": 1e-6, "bias_sigma_deg_per_hour": 1.0},
    ...     "star": {"sigma_arcsec": 5.0, "every": 2},
    ...     "grid": {"filter.kind": ["ekf", "ukf"]},
    ... }
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     results = cc.campaign.run(config, folder)
    ...     results.ran, cc.campaign.run(config, folder).ran, results.table().num_rows
    (8, 0, 8)
    """
    campaign = _campaign(config)
    if progress is not None and not callable(progress):
        raise InputError("must be callable as progress(done, total)", field="progress")
    dataset = Dataset(Path(out), columns_of(campaign), campaign.document)
    workers = processors(threads, alone=True)
    dataset.begin()
    with dataset.alone(), ExitStack() as stack:
        ledger = Ledger(campaign, dataset, progress)
        if ledger.missing:
            watches: list[Callable[[], None]] = [ledger.flush_if_due]
            source: Any = executor
            if executor is None:
                source = partial(ThreadPoolExecutor, workers)
            elif isinstance(executor, str):
                source, lost = stack.enter_context(cluster(executor))
                watches.append(lost)
            engine = Engine(source, campaign.tries, watches)
            try:
                engine.run(ledger.tasks(), ledger.deliver)
            finally:
                ledger.flush()
    return ledger.results()


def _campaign(config: Any) -> Campaign:
    if isinstance(config, Mapping):
        return Campaign.from_dict(config)
    if isinstance(config, str | os.PathLike):
        return Campaign.from_toml(config)
    campaign: Campaign = checked(config, "config", Campaign)
    return campaign


class Ledger:
    """Which runs there are, which are finished, and rows that wait to be written."""

    def __init__(self, campaign: Campaign, dataset: Dataset, progress: Progress | None) -> None:
        self._campaign, self._dataset, self._progress = campaign, dataset, progress
        self._names = list(campaign.logs)
        self._idents = self._identities()
        there = dataset.finished()
        self.missing: dict[int, list[int]] = {}
        total = 0
        for number, cell in enumerate(campaign.cells):
            keys = [cell.key(ident) for ident in self._idents]
            left = [k for k, key in enumerate(keys) if key not in there]
            total += len(keys) - len(left)
            if left:
                self.missing[number] = left
        if total < len(there):
            raise InputError(
                f"holds {len(there) - total:,} rows that this campaign does not ask for, of other "
                "settings, trials or logs: give another folder",
                field="out",
                value=os.fspath(dataset.folder),
            )
        dataset.clean()
        self._kept, self._done = total, total
        self._lost = self._waiting = 0
        self._rows: list[Columns] = []
        self._began = self._written = time.monotonic()

    def _identities(self) -> list[str]:
        campaign = self._campaign
        if campaign.logs:
            return [f"{name}\0{_logs.digest(path)}" for name, path in campaign.logs.items()]
        return [str(campaign.first + k) for k in range(campaign.trials)]

    def tasks(self) -> Iterator[Task]:
        """Run over what is missing, cut into tasks."""
        stop, version = Stop(), package_version()
        runs = sum(len(left) for left in self.missing.values())
        for number, left in self.missing.items():
            text = self._campaign.cells[number].text
            if self._names:
                for k in left:
                    log = os.path.abspath(self._campaign.logs[self._names[k]])
                    yield Task(number, text, k, 1, log, stop, version)
                continue
            size = self._campaign.batch or _simulated.batch(text, runs // TASKS)
            first = self._campaign.first
            for begin, many in _stretches(left, size):
                yield Task(number, text, first + begin, many, None, stop, version)

    def deliver(self, task: Task, outcome: Columns | str) -> None:
        """Take a task's columns, or the reason why it was given up."""
        lost = isinstance(outcome, str)
        columns = {"failure": [outcome]} if isinstance(outcome, str) else outcome
        columns = {**columns, **self._known(self._campaign.cells[task.cell], task)}
        given = {"lost": lost, "version": package_version()}
        self._rows.append(  # at once: Ctrl-C may come at any time
            {
                name: columns.get(name, [given.get(name)] * task.runs)
                for name in self._dataset.schema.names
            }
        )
        self._lost += lost
        self._waiting += task.runs
        self._done += task.runs
        if self._progress is not None:
            self._progress(self._done, len(self._campaign))
        self.flush_if_due()

    def _known(self, cell: Cell, task: Task) -> Columns:
        """Return what a row says of its run, whatever came of it."""
        grid = {name: [grid_value(v)] * task.runs for name, v in cell.values.items()}
        if self._names:
            log = self._names[task.first]
            return {**grid, "key": [cell.key(self._idents[task.first])], "log": [log]}
        trials = range(task.first, task.first + task.runs)
        seed = [_simulated.seed_of(cell.text)] * task.runs
        return {**grid, "key": [cell.key(str(k)) for k in trials], "seed": seed, "trial": [*trials]}

    def flush_if_due(self) -> None:
        """Write the rows that wait, now and then."""
        now = time.monotonic()
        due = min(max(SHARE * (now - self._began), SOONEST), LATEST)
        if now - self._written >= due or self._waiting >= ROWS:
            self.flush()

    def flush(self) -> None:
        """Write the rows that wait."""
        self._written = time.monotonic()
        if self._rows:
            self._dataset.write(self._rows)
            self._rows, self._waiting = [], 0
            self._dataset.turn()

    def results(self) -> Results:
        found = Results(
            folder=self._dataset.folder,
            runs=len(self._campaign),
            ran=self._done - self._kept,
            kept=self._kept,
            lost=self._lost,
            seconds=time.monotonic() - self._began,
        )
        other = set(found.table()["version"].to_pylist()) - {package_version()}
        if other:
            words = ", ".join(sorted(other))
            warn(f"{found.folder} also holds rows of celestcore {words}")
        return found


def _stretches(numbers: list[int], size: int) -> Iterator[tuple[int, int]]:
    """Cut increasing numbers into stretches without holes: the first, and how many."""
    begin = 0
    for k in range(1, len(numbers) + 1):
        if k == len(numbers) or numbers[k] != numbers[k - 1] + 1 or k - begin == size:
            yield numbers[begin], k - begin
            begin = k
