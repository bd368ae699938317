"""Peak memory of a replay in parts: the same for any length of log (`make long`).

CELESTCORE_REPLAY_GB sets the size of the longer log, 1 GB of gyro samples unless it is given;
CELESTCORE_REPLAY_RATE the gyro's rate, 100 Hz. Each replay is a process of its own, so that its
peak is its own. The log, and a part of that size of results, must fit beside it on the disk.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("pyarrow")

pytestmark = [
    pytest.mark.long,
    pytest.mark.timeout(0),  # of the true size it takes minutes
    pytest.mark.skipif(not sys.platform.startswith("linux"), reason="reads /proc"),
]

GIGABYTES = float(os.environ.get("CELESTCORE_REPLAY_GB", "1"))
RATE = float(os.environ.get("CELESTCORE_REPLAY_RATE", "100"))
MOST_MIB = 500.0
SCRIPT = """
import json, re, sys
sys.path.insert(0, sys.argv[1])
import celestcore as cc
from long_log import navigator

with cc.open_log(sys.argv[2]) as stream:
    done = cc.replay.run(
        stream, navigator(), sys.argv[3], every=int(sys.argv[4]),
        checkpoint=sys.argv[3] + ".checkpoint",
    )
peak = int(re.search(r"VmHWM:\\s+(\\d+)", open("/proc/self/status").read())[1]) / 1024
print(json.dumps({"MiB": peak, "s": done.elapsed_s, "samples": done.samples, "rows": done.rows}))
"""


def replayed(folder: Path, days: int, every: int) -> dict[str, float]:
    from long_log import write

    log, out = folder / "log", folder / "out"
    write(log, days, RATE)
    size = sum(f.stat().st_size for f in log.rglob("*.parquet")) / 1e9
    try:
        done = subprocess.run(
            [sys.executable, "-c", SCRIPT, os.path.dirname(__file__), log, out, str(every)],
            check=True,
            capture_output=True,
            text=True,
        )
    finally:
        shutil.rmtree(log)
        shutil.rmtree(out, ignore_errors=True)
    found: dict[str, float] = json.loads(done.stdout)
    print(
        f"\n{size:5.2f} GB, {found['samples']:,} samples, every={every}: {found['MiB']:.0f} MiB, "
        f"{found['s']:.1f} s, {found['samples'] / found['s'] / 1e6:.2f} million samples/s"
    )
    return found


@pytest.mark.parametrize("every", [1, 10])
def test_memory_does_not_grow_with_the_log(tmp_path: Path, every: int) -> None:
    days = max(4, round(GIGABYTES * 1e9 / (32.0 * RATE * 86400.0)))
    quarter = replayed(tmp_path, days // 4, every)
    whole = replayed(tmp_path, days, every)
    assert whole["samples"] == pytest.approx(days * 86400.0 * RATE, rel=1e-4)
    assert whole["MiB"] < MOST_MIB
    assert whole["MiB"] < 1.1 * quarter["MiB"] + 10.0
