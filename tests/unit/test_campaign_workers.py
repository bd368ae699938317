"""Workers that die or fail: each costs its own runs only."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from concurrent.futures import Future, ProcessPoolExecutor, ThreadPoolExecutor
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import celestcore as cc
import pytest
from celestcore import campaign
from celestcore.campaign._work import Task

pytest.importorskip("pyarrow.parquet")

CONFIG: dict[str, Any] = {
    "campaign": {"trials": 24, "seed": 2, "tries": 2, "batch": 4},
    "scenario": {"duration_s": 20.0},
    "gyro": {"arw": 2e-5},
    "star": {"sigma_arcsec": 4.0},
}


def plain(table: Any) -> Any:
    return table.drop_columns(["seconds"])


@pytest.fixture(scope="module")
def rows(tmp_path_factory: pytest.TempPathFactory) -> Any:
    return plain(campaign.run(CONFIG, tmp_path_factory.mktemp("c") / "out").table())


def deadly(fn: Callable[[Task], Any], task: Task, trial: int, once: str | None) -> Any:
    """Run a task; the one with the trial takes its process with it, or does so once."""
    if task.first <= trial < task.first + task.runs and not (once and os.path.exists(once)):
        if once:
            Path(once).touch()
        time.sleep(0.05)
        os._exit(1)
    return fn(task)


class Deadly:
    """A pool of processes, one of whose tasks kills."""

    made = 0

    def __init__(self, trial: int, once: str | None = None) -> None:
        self.pool = ProcessPoolExecutor(2, mp_context=get_context("spawn"))
        self._max_workers = 2
        self.trial, self.once = trial, once
        Deadly.made += 1

    def submit(self, fn: Callable[..., Any], /, *args: Any) -> Any:
        return self.pool.submit(deadly, fn, *args, self.trial, self.once)

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        self.pool.shutdown(wait=wait, cancel_futures=cancel_futures)


def test_a_worker_that_died_once_leaves_no_trace(tmp_path: Path, rows: Any) -> None:
    once = str(tmp_path / "died")
    results = campaign.run(CONFIG, tmp_path / "o", executor=lambda: Deadly(9, once))
    assert os.path.exists(once)
    assert results.lost == 0
    assert plain(results.table()).equals(rows)


def test_a_run_that_kills_is_given_up_alone(tmp_path: Path, rows: Any) -> None:
    results = campaign.run(CONFIG, tmp_path / "o", executor=lambda: Deadly(9))
    assert (results.ran, results.lost) == (24, 1)
    table = results.table()
    row = table.slice(9, 1).to_pylist()[0]
    assert row["lost"]
    assert row["failure"].startswith("its worker died, tried 2 times: BrokenProcessPool")
    assert row["nees"] is None
    others = [k for k in range(24) if k != 9]
    assert plain(table).take(others).equals(rows.take(others))
    # the next call tries it once more, and it alone
    again = campaign.run(CONFIG, tmp_path / "o")
    assert (again.ran, again.kept) == (1, 23)
    assert plain(again.table()).equals(rows)


def test_a_broken_pool_that_cannot_be_made_again(tmp_path: Path, rows: Any) -> None:
    pool = Deadly(9)
    with pytest.raises(cc.CelestcoreError, match=r"executor has broken down .* call again with"):
        campaign.run(CONFIG, tmp_path / "o", executor=pool)
    rest = campaign.run(CONFIG, tmp_path / "o", executor=ThreadPoolExecutor(1))
    assert plain(rest.table()).equals(rows)


class Failing:
    """Raises instead of running some trials, so many times."""

    def __init__(self, error: Exception, *trials: int, times: int = 10**9) -> None:
        self.error, self.trials, self.left = error, set(trials), times

    def submit(self, fn: Callable[..., Any], task: Task) -> Any:
        future: Future[Any] = Future()
        hit = self.trials & set(range(task.first, task.first + task.runs))
        if hit and self.left > 0:
            self.left -= 1
            future.set_exception(self.error)
        else:
            future.set_result(fn(task))
        return future


def test_what_fails_is_tried_again(tmp_path: Path, rows: Any) -> None:
    pool = Failing(OSError("stale file handle"), 3, times=2)
    assert plain(campaign.run(CONFIG, tmp_path / "o", executor=pool).table()).equals(rows)
    results = campaign.run(CONFIG, tmp_path / "p", executor=Failing(OSError("stale"), 9, 10))
    assert results.lost == 2
    failures = [f for f in results.table()["failure"].to_pylist() if f]
    assert failures == ["failed, tried 2 times: OSError: stale"] * 2
    assert results.to_dict()["failed"] == 2


class KilledWorker(Exception):  # noqa: N818
    """As Dask's: a task that was out when several workers died."""


def test_what_a_cluster_gives_up_is_tried_alone(tmp_path: Path, rows: Any) -> None:
    pool = Failing(KilledWorker("it"), 3)
    results = campaign.run(CONFIG, tmp_path / "o", executor=pool)
    assert results.lost == 1
    failure = results.table()["failure"][3].as_py()
    assert failure == "its worker died, tried 2 times: KilledWorker: it"


def test_workers_that_cannot_run_anything_end_it(tmp_path: Path) -> None:
    everything = range(24)
    with pytest.raises(cc.CelestcoreError, match="no run has succeeded, tried 2 times: Runtime"):
        campaign.run(CONFIG, tmp_path / "o", executor=Failing(RuntimeError("no"), *everything))
    with pytest.raises(ImportError, match="No module"):
        campaign.run(CONFIG, tmp_path / "o", executor=Failing(ImportError("No module"), 5))
    with pytest.raises(cc.InputError, match="executor: needs submit"):
        campaign.run(CONFIG, tmp_path / "o", executor=3)  # type: ignore[arg-type]


def test_another_celestcore_on_a_worker(tmp_path: Path) -> None:
    class Older:
        def submit(self, fn: Callable[..., Any], task: Task) -> Any:
            with ThreadPoolExecutor(1) as pool:
                return pool.submit(fn, replace(task, version="0.0.9"))

    with pytest.raises(cc.CelestcoreError, match=r"a worker has celestcore .* the campaign 0.0.9"):
        campaign.run(CONFIG, tmp_path / "o", executor=Older())
