"""Memory of a run beyond its log: bounded for any length (`make long`).

Each run is a process of its own, so that its peak is its own.
"""

from __future__ import annotations

import json
import subprocess
import sys

import pytest

pytestmark = [
    pytest.mark.long,
    pytest.mark.skipif(not sys.platform.startswith("linux"), reason="reads /proc"),
]

SCRIPT = """
import json, re, sys
import numpy as np
import celestcore as cc

n, cameras, mounted = int(sys.argv[1]), int(sys.argv[2]), sys.argv[3] == "mounted"
t = 0.01 * np.arange(n)
rng = np.random.default_rng(1)
rate = np.full((n, 3), 1e-3)
for part in np.array_split(rate, 10):
    part += 2.5e-4 * rng.standard_normal(part.shape)
every = 2 * cameras
angle = 0.5e-3 * 3**0.5 * t
fixes = {}
for k in range(cameras):
    a = angle[2 * k :: every]
    q = np.stack([np.cos(a), *[np.sin(a) / 3**0.5] * 3], axis=1)
    fixes[f"star_{k}"] = (t[2 * k :: every], q) + (((1.5e-4),) if mounted else ())
log = cc.SensorLog(gyro=(t, rate), **fixes)
del t, rate, angle, fixes, a, q
turn = [0.6, 0.0, 0.8, 0.0]
nav = cc.StarGyroNavigator(
    cc.EKF(),
    cc.Gyro(2.5e-5, 3e-7, mounting=turn if mounted else None),
    cc.StarCamera(1.5e-4, mounting=turn if mounted else None),
)

def status(name):
    return int(re.search(name + r":\\s+(\\d+)", open("/proc/self/status").read())[1]) / 1024

nav.run(cc.sample("fermi"), every=1000, innovations="none")  # what is loaded once
open("/proc/self/clear_refs", "w").write("5")
before = status("VmRSS")
sol = nav.run(log, every=1000, innovations="none")
print(json.dumps({"MiB": status("VmHWM") - before, "rows": len(sol), "counts": sol.counts}))
"""


def grown(samples: int, cameras: int, kind: str) -> float:
    """Return by how much the peak memory of a run exceeds that before it [MiB]."""
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT, str(samples), str(cameras), kind],
        capture_output=True,
        text=True,
        check=True,
    )
    found = json.loads(done.stdout)
    assert found["counts"]["fixes"] == samples // 2
    assert found["rows"] == samples // 1000
    return float(found["MiB"])


@pytest.mark.parametrize("kind", ["plain", "mounted"])
@pytest.mark.parametrize("cameras", [1, 2])
def test_run_takes_little_beyond_its_log(cameras: int, kind: str) -> None:
    half, whole = (grown(n, cameras, kind) for n in (5_000_000, 10_000_000))
    print(f"{cameras} cameras, {kind}: {half:.0f} MiB, and twice the length {whole:.0f} MiB")
    assert whole < 200.0
    # with several cameras, little more than a byte a fix
    assert whole - half < (4.0 if cameras == 1 else 8.0)
