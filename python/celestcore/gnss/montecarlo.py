"""Monte Carlo: many trials of a flight with GNSS and star sensor, through several navigators."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np

from celestcore._arguments import checked, count, processors
from celestcore._campaign import (
    Each,
    Executor,
    Progress,
    checked_skip,
    named,
    smoothed_of,
    warn_of_failures,
)
from celestcore.errors import CelestcoreError, InputError
from celestcore.gnss._earth import Earth
from celestcore.gnss._run import DEFAULTS, replay, within
from celestcore.gnss._scores import (
    COLUMNS,
    THREE,
    GnssStarMonteCarlo,
    GnssStarPooled,
    GnssStarScores,
    score,
)
from celestcore.gnss.navigator import GnssStarNavigator
from celestcore.gnss.scenario import GnssStarScenario
from celestcore.orbit.propagate import environment_of
from celestcore.simulate._scenario import whole

__all__ = ["GnssStarMonteCarlo", "GnssStarPooled", "GnssStarScores", "monte_carlo"]

Navigators: TypeAlias = "GnssStarNavigator | Mapping[str, GnssStarNavigator]"


@dataclass(frozen=True)
class _Job:
    """A campaign without its trials; it can be pickled."""

    scenario: GnssStarScenario
    navigators: Mapping[str, GnssStarNavigator]
    each: Each
    seed: int
    skip: float
    tables: dict[str, Any] | None
    earth: Earth

    def __call__(self, trial: int) -> dict[str, dict[str, Any] | str]:
        """Simulate one trial and return each estimator's scores, or why it has none."""
        made = self.scenario.trial(self.seed, trial)
        out: dict[str, dict[str, Any] | str] = {}
        for name, (nav_name, back) in self.each.items():
            nav = self.navigators[nav_name]
            options = {**DEFAULTS, "covariance": True, "t_output": within(nav, made.log, made.t)}
            options |= {"earth_rotation": self.earth, "environment": self.tables}
            try:
                sol = replay(nav, made.log, options, back=back)
            except CelestcoreError as error:
                out[name] = str(error)
                continue
            out[name] = score(sol, made, 0.0 if back else self.skip)
        return out


def run_trials(job: _Job, trials: Collection[int]) -> list[dict[str, dict[str, Any] | str]]:
    """Run some trials, in whatever process."""
    return [job(trial) for trial in trials]


def monte_carlo(
    scenario: GnssStarScenario,
    navigators: Navigators,
    trials: int = 40,
    seed: int = 0,
    *,
    first: int = 0,
    smooth: bool | Collection[str] = False,
    skip: float = 300.0,
    threads: int | None = None,
    executor: Executor | None = None,
    chunk: int | None = None,
    progress: Progress | None = None,
) -> GnssStarMonteCarlo:
    """Run many trials of a scenario through one or several navigators.

    Each trial is simulated once, and every navigator runs on it, started from its own first fixes.
    A trial's result is the same for any number of threads and in any part of a campaign.

    Parameters
    ----------
    scenario : GnssStarScenario
        What is flown and measured.
    navigators : GnssStarNavigator or dict of str to GnssStarNavigator
        The estimators. One alone goes by its filter's name, for example ``"ekf"``.
    trials : int
        How many.
    seed : int
        Chooses the random numbers of all trials, from 0 to 2**64 - 1.
    first : int
        Number of the first trial.
    smooth : bool or collection of str
        Which navigators to smooth as well: all, none, or those of the names. The smoothed ones get
        a name that ends with ``"_smoothed"``.
    skip : float
        Time from the start that is not scored of filters [s]; of smoothers all is scored.
    threads : int, optional
        By default all processors.
    executor : Executor, optional
        Anything with ``submit(fn, *args)`` that returns futures; trials go to it in chunks.
    chunk : int, optional
        Trials in one task of the executor; 4.
    progress : callable, optional
        ``progress(done, total)`` [trials], called as trials end.

    Returns
    -------
    GnssStarMonteCarlo

    Raises
    ------
    InputError
        Names the field and the value.
    KeyboardInterrupt
        On Ctrl-C.

    Warns
    -----
    CelestcoreWarning
        Where a filter broke down in some trials; they count as NaN.

    Examples
    --------
    >>> import celestcore as cc
    >>> scenario = cc.gnss.GnssStarScenario()
    >>> result = monte_carlo(scenario, cc.GnssStarNavigator(), trials=3, seed=1, smooth=True)
    >>> result
    GnssStarMonteCarlo(3 trials of ekf, ekf_smoothed, seed 1)
    """
    checked(scenario, "scenario", GnssStarScenario)
    navs = named(navigators, GnssStarNavigator)
    if progress is not None and not callable(progress):
        raise InputError("must be callable as progress(done, total)", field="progress")
    each = smoothed_of(navs, smooth)
    job = _Job(
        scenario,
        navs,
        each,
        whole(seed, "seed", 64),
        checked_skip(skip, np.array([0.0, scenario.duration]), both_ends=False),
        _tables(scenario, navs),
        Earth(scenario.epoch),
    )
    begins, total = whole(first, "first", 56), count(trials, "trials")
    numbers = list(range(begins, begins + total))
    scenario.trial(job.seed, begins)  # the flight that all share, before they go to threads
    rows = _all(job, numbers, threads, executor, (chunk, progress))
    scores = {name: _gathered(name, numbers, rows) for name in each}
    warn_of_failures(scores)
    return GnssStarMonteCarlo(scores, seed=job.seed, first=begins, trials=total, skip=job.skip)


def _tables(
    scenario: GnssStarScenario, navs: Mapping[str, GnssStarNavigator]
) -> dict[str, Any] | None:
    """Return the forces' tables of the Earth, Sun and Moon, if a navigator needs them."""
    span = np.array([-60.0, scenario.duration + 60.0])
    made = [environment_of(n.dynamics.force, scenario.epoch, span, None) for n in navs.values()]
    return next((tables for tables in made if tables is not None), None)


def _all(
    job: _Job, numbers: list[int], threads: int | None, executor: Executor | None, more: Any
) -> list[dict[str, dict[str, Any] | str]]:
    chunk, progress = more
    size = 4 if chunk is None else count(chunk, "chunk")
    parts = [numbers[k : k + size] for k in range(0, len(numbers), size)]
    rows: list[dict[str, dict[str, Any] | str]] = []
    own = None
    if executor is None:
        own = executor = ThreadPoolExecutor(processors(threads, alone=True))
    try:
        for future in [executor.submit(run_trials, job, part) for part in parts]:
            rows += future.result()
            if progress is not None:
                progress(len(rows), len(numbers))
    finally:
        if own is not None:
            own.shutdown(wait=True, cancel_futures=True)
    return rows


def _gathered(
    name: str, numbers: list[int], rows: list[dict[str, dict[str, Any] | str]]
) -> GnssStarScores:
    failures: dict[int, str] = {}
    columns: dict[str, list[Any]] = {column: [] for column in COLUMNS}
    for number, row in zip(numbers, rows, strict=True):
        found = row[name]
        if isinstance(found, str):
            failures[number] = found
            three = np.full(3, np.nan)
            found = {column: three if column in THREE else np.nan for column in COLUMNS}
        for column in COLUMNS:
            columns[column].append(found[column])
    arrays = {column: np.array(values) for column, values in columns.items()}
    return GnssStarScores(np.array(numbers), **arrays, failures=failures)
