"""Reading a long log in windows, against pyarrow alone: speed and peak memory (`pytest -m bench`).

"pyarrow" reads as it does by itself, "lean" with the settings that celestcore gives it, which need
a fraction of the memory. Each run is a process of its own, so that its peak is its own.
CELESTCORE_BENCH_MB sets the size of the log, about 1000 MB unless it is given.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

pytestmark = [
    pytest.mark.bench,
    pytest.mark.skipif(not sys.platform.startswith("linux"), reason="reads /proc"),
]

MEGABYTES = int(os.environ.get("CELESTCORE_BENCH_MB", "1000"))
LEAST_SHARE = 0.70
MOST_MIB = 500.0

SCRIPT = """
import json, re, sys, time
from pathlib import Path
import pyarrow.parquet as pq
import celestcore as cc

folder, how = Path(sys.argv[1]), sys.argv[2]
rows, begin, used = 0, time.perf_counter(), time.process_time()
if how in ("pyarrow", "lean"):
    settings = {"pre_buffer": False, "buffer_size": 1 << 20} if how == "lean" else {}
    for file in sorted(folder.glob("*.parquet")):
        for batch in pq.ParquetFile(file, **settings).iter_batches():
            rows += len([column.to_numpy() for column in batch][0])
elif how == "chunks":
    with cc.open_log(folder) as stream:
        for _, columns in stream:
            rows += len(columns["t"])
else:
    reorder = 5.0 if how == "reorder" else None
    with cc.open_log(folder, reorder=reorder) as stream:
        for window in stream.windows(600.0):
            rows += sum(len(columns["t"]) for columns in window.tables.values())
took, used = time.perf_counter() - begin, time.process_time() - used
peak = int(re.search(r"VmHWM:\\s+(\\d+)", open("/proc/self/status").read())[1]) / 1024
print(json.dumps({"s": took, "cpu": used, "rows": rows, "MiB": peak}))
"""


def table(t: np.ndarray, names: str, seed: int) -> pa.Table:
    rng = np.random.default_rng(seed)
    return pa.table({"t": t, **{n: rng.standard_normal(len(t)) for n in names.split()}})


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write a gyro at 100 Hz, two star cameras at 10 and 4 Hz, and a receiver at 1 Hz."""
    folder = tmp_path_factory.mktemp("long")
    seconds = MEGABYTES * 1e6 / 8 / (100 * 4 + 10 * 5 + 4 * 5 + 7)
    sensors = {
        "gyro": (100.0, "wx wy wz"),
        "star_1": (10.0, "qw qx qy qz"),
        "star_2": (4.0, "qw qx qy qz"),
        "gnss": (1.0, "x y z vx vy vz"),
    }
    part = 1_000_000
    for seed, (name, (rate, names)) in enumerate(sensors.items()):
        count = int(seconds * rate)
        first = table(np.zeros(0), names, 0)
        with pq.ParquetWriter(folder / f"{name}.parquet", first.schema) as writer:
            for begin in range(0, count, part):
                t = np.arange(begin, min(begin + part, count)) / rate
                writer.write_table(table(t, names, seed))
    return folder


def measure(log: Path, how: str) -> dict[str, float]:
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT, str(log), how], check=True, capture_output=True, text=True
    )
    found: dict[str, float] = json.loads(done.stdout)
    return found


def test_windows_are_read_nearly_as_fast_as_pyarrow_reads(log: Path) -> None:
    size = sum(f.stat().st_size for f in log.iterdir()) / 1e6
    best: dict[str, dict[str, float]] = {}
    for _ in range(3):  # in turn, so that a busy machine slows all of them
        for how in ("pyarrow", "lean", "chunks", "windows", "reorder"):
            found = measure(log, how)
            if how not in best or found["s"] < best[how]["s"]:
                best[how] = {**found, "MiB": max(found["MiB"], best.get(how, found)["MiB"])}
    print(f"\n{size:.0f} MB of Parquet")
    for how, found in best.items():
        share = best["pyarrow"]["s"] / found["s"]
        print(
            f"{how:8} {size / found['s']:6.0f} MB/s  {share:5.2f} of pyarrow  "
            f"{found['cpu']:5.2f} s of processor  peak {found['MiB']:4.0f} MiB"
        )
    assert len({found["rows"] for found in best.values()}) == 1
    for how in ("chunks", "windows", "reorder"):
        assert best[how]["MiB"] < MOST_MIB
        assert best["pyarrow"]["s"] / best[how]["s"] > LEAST_SHARE
