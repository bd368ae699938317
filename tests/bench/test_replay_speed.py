"""A replay in parts against its two halves, reading and filtering (`pytest -m bench`).

In the same run: pyarrow alone reading the log, the filter over arrays in memory, and the replay
from disk to disk. Reading, filtering and writing go on side by side, so the slower one should set
the pace: 70 % of what pyarrow alone reads, or 75 % of the filter's speed. Whether that is met is
printed, not asserted: it depends on the processors that are free. The work of all threads together
must fit into the time; what it needs is printed beside it. CELESTCORE_BENCH_DAYS sets the length
of the log, 7 days unless it is given.
"""

from __future__ import annotations

import os
import shutil
import time
from collections.abc import Callable
from pathlib import Path

import celestcore as cc
import pytest

pq = pytest.importorskip("pyarrow.parquet")
long_log = pytest.importorskip("long_log")

pytestmark = pytest.mark.bench

DAYS = int(os.environ.get("CELESTCORE_BENCH_DAYS", "7"))
ROUNDS = 5
OF_READING, OF_FILTER = 0.70, 0.75
EVERY = (1, 10, 100)


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder: Path = tmp_path_factory.mktemp("speed") / "log"
    long_log.write(folder, DAYS)
    return folder


def alone(log: Path) -> None:
    for file in sorted(log.rglob("*.parquet")):
        for batch in pq.ParquetFile(file).iter_batches():
            [column.to_numpy() for column in batch]


def in_parts(log: Path, out: Path, every: int) -> cc.replay.Summary:
    shutil.rmtree(out, ignore_errors=True)
    with cc.open_log(log) as stream:
        return cc.replay.run(stream, long_log.navigator(), out, every=every)


def best(works: dict[str, Callable[[], object]]) -> dict[str, tuple[float, float]]:
    """Return the least time and the least processor time of each; in turn, for a busy machine."""
    found: dict[str, tuple[float, float]] = {}
    for _ in range(ROUNDS):
        for name, work in works.items():
            begin, used = time.perf_counter(), time.process_time()
            work()
            took, used = time.perf_counter() - begin, time.process_time() - used
            least = found.get(name, (took, used))
            found[name] = (min(least[0], took), min(least[1], used))
    return found


def test_the_slower_of_reading_and_filtering_sets_the_pace(log: Path, tmp_path: Path) -> None:
    whole, nav, out = cc.read_log(log), long_log.navigator(), tmp_path / "out"
    assert whole.gyro is not None
    samples = len(whole.gyro)
    done = {every: in_parts(log, out, every) for every in EVERY}
    works: dict[str, Callable[[], object]] = {"pyarrow alone": lambda: alone(log)}
    for every in EVERY:
        works[f"filter, every={every}"] = lambda every=every: nav.run(whole, every=every)
        works[f"parts, every={every}"] = lambda every=every: in_parts(log, out, every)
    found = best(works)
    size = sum(f.stat().st_size for f in log.rglob("*.parquet")) / 1e6
    print(f"\n{samples:,} samples, {size:.0f} MB, {os.cpu_count()} processors")
    for name, (took, used) in found.items():
        print(f"{name:18} {samples / took / 1e6:6.2f} million/s  {used:5.2f} s of processor")
    for every in EVERY:
        took, used = found[f"parts, every={every}"]
        reading = found["pyarrow alone"][0] / took
        filtering = found[f"filter, every={every}"][0] / took
        met = reading >= OF_READING or filtering >= OF_FILTER
        # what all threads together work, over the time that the target leaves them
        needs = used / (found[f"filter, every={every}"][1] / OF_FILTER)
        print(
            f"every={every}: {filtering:.2f} of the filter, {reading:.2f} of pyarrow, "
            f"{'met' if met else 'not met'}; the target takes {needs:.1f} processors of its own"
        )
        assert done[every].samples == samples
