"""A campaign on a Dask cluster: two worker processes, the same bits as the threads."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import celestcore as cc
import numpy as np
import pytest
from celestcore import simulate

distributed = pytest.importorskip("distributed")
# what Dask warns of within is no fault of ours; celestcore's own warnings stay errors
pytestmark = [
    pytest.mark.filterwarnings("ignore"),
    pytest.mark.filterwarnings("error::celestcore.CelestcoreWarning"),
]

SCENARIO = simulate.Scenario(
    simulate.slews(60.0, 0.1),
    simulate.GyroErrors(2e-5, 1e-7, bias_sigma=1e-4),
    simulate.StarErrors((2e-5, 2e-5, 1e-4), every=2),
)
NAVS = {"ekf": SCENARIO.navigator(cc.EKF()), "ukf": SCENARIO.navigator(cc.UKF())}


@pytest.fixture(scope="module")
def client() -> Iterator[Any]:
    with (
        distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None
        ) as cluster,
        distributed.Client(cluster) as client,
    ):
        yield client


def test_the_same_bits_on_a_cluster(client: Any) -> None:
    told: list[tuple[int, int]] = []
    here = cc.monte_carlo(SCENARIO, NAVS, 20, seed=5, first=3)
    there = cc.monte_carlo(
        SCENARIO,
        NAVS,
        20,
        seed=5,
        first=3,
        executor=client.get_executor(),
        chunk=3,
        progress=lambda *x: told.append(x),
    )
    assert told[-1] == (20, 20)
    for name in NAVS:
        for column in ("trial", "rms", "rms_all", "rms_bias", "nees", "nis", "final_error"):
            a, b = getattr(here[name], column), getattr(there[name], column)
            np.testing.assert_array_equal(a, b, err_msg=f"{name} {column}")


def test_both_workers_take_part(client: Any) -> None:
    def used() -> dict[str, int]:
        logs = client.run(lambda dask_worker: dask_worker.state.executed_count)
        return {name: int(n) for name, n in logs.items()}

    before = used()
    cc.monte_carlo(SCENARIO, NAVS, 200, executor=client.get_executor(), chunk=5)
    after = used()
    assert len(after) == 2
    ran = [after[name] - before[name] for name in after]
    assert sum(ran) == 40
    assert min(ran) > 0


def test_bad_input_on_a_worker_comes_back_as_itself(client: Any) -> None:
    with pytest.raises(cc.InputError, match="counted from 0"):
        cc.monte_carlo(SCENARIO, NAVS, 2, first=2**56 - 1, executor=client.get_executor())
