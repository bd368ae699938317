"""Time to simulate, and to run a campaign, of one orbit at 10 Hz (`make bench`).

Nothing is asserted of a time: machines differ and are shared. Figures: `docs/benchmarks.md`.
"""

from __future__ import annotations

import time

import celestcore as cc
import pytest
from celestcore import _core, simulate

pytestmark = pytest.mark.bench

REPEATS = 7
SCENARIO = simulate.Scenario(
    simulate.earth_pointing(5659.4),
    simulate.GyroErrors(1e-7, 1e-10, bias_sigma=1e-5),
    simulate.StarErrors(1e-5, every=2),
)


def test_simulating_an_orbit() -> None:
    flight, taken = SCENARIO._described(), []
    for trial in range(REPEATS):
        begin = time.perf_counter()
        _core.simulate(flight, 1, trial)
        taken.append(time.perf_counter() - begin)
    print(f"{len(SCENARIO.truth)} gyro samples and half as many fixes: {min(taken) * 1e3:.1f} ms")


@pytest.mark.parametrize("kind", [cc.EKF(), cc.UKF()], ids=lambda f: f.kind)
def test_a_campaign(kind: cc.EKF | cc.UKF) -> None:
    nav, trials = SCENARIO.navigator(kind), 32
    for threads in (1, None):
        begin = time.perf_counter()
        found = cc.monte_carlo(SCENARIO, nav, trials, threads=threads)
        taken = (time.perf_counter() - begin) / trials
        core = found[kind.kind].seconds.mean()
        print(
            f"{kind.kind}, threads {threads or 'all'}: {taken * 1e3:.1f} ms a trial; "
            f"the filter took {core * 1e3:.1f} ms"
        )
