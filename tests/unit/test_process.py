"""StarGyroState.process: a block of gyro samples is its samples one by one, all or none of them."""

from __future__ import annotations

import itertools
import signal
import threading
import time
from collections.abc import Callable
from typing import Any

import celestcore as cc
import numpy as np
import pytest
from celestcore import quaternion as quat
from celestcore.navigator import StarGyroState
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from streams import everything

Array = NDArray[np.float64]
FILTERS = {
    "ekf": cc.EKF(),
    "ukf": cc.UKF(),
    "srukf": cc.SRUKF(),
    "ukf-rk4": cc.UKF(integrator="rk4"),
}
SAMPLINGS = ("hold", "integrated", "average")
IDENTITY = [1.0, 0.0, 0.0, 0.0]
START = ([0.001, 0.002, 0.003], [1e-4, 2e-4, 3e-4])
every_filter = pytest.mark.parametrize("name", FILTERS)


def fresh(kind: Any = None, lag: float | None = None, **gyro: Any) -> StarGyroState:
    sensor = cc.Gyro(1e-6, 1e-8, **gyro)
    nav = cc.StarGyroNavigator(kind, sensor, cc.StarCamera(10 * cc.ARCSEC))
    return nav.start(1.0, quat.exp([0.3, -0.5, 0.8]), sigma0=START, lag=lag)


def samples(n: int, seed: int = 0) -> tuple[Array, Array]:
    """Steps and rates."""
    rng = np.random.default_rng(seed)
    return rng.uniform(0.05, 0.3, n), rng.normal(size=(n, 3)) * 0.1


# the same as predict, and as a run


@every_filter
@pytest.mark.parametrize("lag", [None, 2.0])
@pytest.mark.parametrize("mounted", [False, True])
def test_block_is_its_samples_one_by_one(name: str, lag: float | None, mounted: bool) -> None:
    turn = {"mounting": quat.exp([0.4, -0.7, 1.1])} if mounted else {}
    dt, rates = samples(300)
    one, block = (fresh(FILTERS[name], lag, **turn) for _ in range(2))
    for step, rate in zip(dt, rates, strict=True):
        one.predict(one.t + step, rate)
    for k in range(0, 300, 100):
        assert block.process(rates[k : k + 100], dt[k : k + 100]) is None
    assert everything(block) == everything(one)


@every_filter
@pytest.mark.parametrize("sampling", SAMPLINGS)
def test_rows_are_the_states_between(name: str, sampling: str) -> None:
    dt, rates = samples(100)
    for every in (1, 7, 100, 101):
        one, block = (fresh(FILTERS[name], sampling=sampling, max_gap=0.29) for _ in range(2))
        rows = block.process(rates, dt, every=every, covariance=True)
        assert rows.covariance is not None
        assert rows.t.shape == (100 // every,)
        for k, (step, rate) in enumerate(zip(dt, rates, strict=True)):
            one.predict(one.t + step, rate)
            if (k + 1) % every:
                continue
            row = (k + 1) // every - 1
            assert rows.t[row] == one.t
            assert np.array_equal(rows.q[row], one.q)
            assert np.array_equal(rows.bias[row], one.bias)
            assert one.rate is not None
            assert np.array_equal(rows.rate[row], one.rate)
            assert np.array_equal(rows.sigma[row], one.sigma)
            assert np.array_equal(rows.covariance[row], one.covariance)
        assert everything(block) == everything(one)


@every_filter
@pytest.mark.parametrize("sampling", SAMPLINGS)
def test_blocks_and_fixes_are_those_of_a_run(name: str, sampling: str) -> None:
    dt, rates = samples(400)
    t = np.cumsum(dt)
    q = quat.propagate(quat.exp([0.3, -0.5, 0.8]), rates[:-1], np.diff(t))
    log = cc.SensorLog(gyro=(t, rates), star=(t[50::50], q[50::50]))
    gyro = cc.Gyro(1e-6, 1e-8, sampling=sampling, max_gap=10.0)
    nav = cc.StarGyroNavigator(FILTERS[name], gyro, cc.StarCamera(10 * cc.ARCSEC))
    sol = nav.run(log, q0=q[0], sigma0=START)
    state = nav.start(t[0], q[0], sigma0=START)
    state.process(rates[:51], t=t[:51])
    for k in range(50, 400, 50):
        state.update(t[k], q[k])
        state.process(rates[k + 1 : k + 51], t=t[k + 1 : k + 51])
    assert np.array_equal(np.abs(state.q), np.abs(sol.final["q"]))
    assert np.array_equal(state.bias, sol.final["bias"])
    assert np.array_equal(state.covariance, sol.final["covariance"])


@settings(max_examples=40, deadline=None)
@given(
    cuts=st.lists(st.integers(0, 60), max_size=6),
    kind=st.sampled_from(sorted(FILTERS)),
    seed=st.integers(0, 2**20),
    how=st.sampled_from(["dt", "t", "one dt"]),
    lag=st.sampled_from([None, 0.5, 100.0]),
)
def test_any_cut_into_blocks_is_the_same(
    cuts: list[int], kind: str, seed: int, how: str, lag: float | None
) -> None:
    dt, rates = samples(60, seed)
    if how == "one dt":
        dt[:] = 0.1
    one = fresh(FILTERS[kind], lag)
    t = np.empty(60)
    for k in range(60):
        t[k] = one.t + dt[k]
        one.predict(t[k], rates[k])
    block = fresh(FILTERS[kind], lag)
    edges = [0, *sorted(cuts), 60]
    for first, last in itertools.pairwise(edges):
        part = slice(first, last)
        if how == "t":
            if first < last:
                block.process(rates[part], t=t[part])
        else:
            block.process(rates[part], 0.1 if how == "one dt" else dt[part])
    assert everything(block) == everything(one)


# what is taken


def test_kinds_of_arguments() -> None:
    dt, rates = samples(20)
    wide = np.zeros((40, 6))
    wide[::2, ::2] = rates
    kinds: list[Any] = [
        rates,
        rates.tolist(),
        np.asfortranarray(rates),
        rates.astype(">f8"),
        wide[::2, ::2],
        np.ma.MaskedArray(rates),
    ]
    found = set()
    for kind in kinds:
        before = np.array(kind)
        state = fresh()
        state.process(kind, dt)
        assert np.array_equal(before, np.array(kind))
        found.add(everything(state))
    for steps in (dt.tolist(), dt.astype(">f8"), tuple(dt)):
        state = fresh()
        state.process(rates, steps)
        found.add(everything(state))
    assert len(found) == 1
    same: set[Any] = set()
    for step in (1, 1.0, np.float64(1.0), np.array(1.0), np.float32(1.0), [1.0] * 20):
        state = fresh()
        state.process(rates, step)
        same.add(everything(state))
    assert len(same) == 1


def test_first_time_may_be_that_of_the_state() -> None:
    one, block = fresh(), fresh()
    block.process([[0.0, 0.0, 0.1], [0.0, 0.0, 0.2]], t=[1.0, 2.0])
    one.predict(1.0, [0.0, 0.0, 0.1])
    one.predict(2.0, [0.0, 0.0, 0.2])
    assert everything(block) == everything(one)


def test_nothing_is_done_with_no_samples() -> None:
    state = fresh()
    before = everything(state)
    state.process(np.zeros((0, 3)), 0.1)
    rows = state.process(np.zeros((0, 3)), 0.1, every=3)
    assert rows.q.shape == (0, 4)
    assert rows.covariance is None
    assert everything(state) == before


# errors leave the state as it was

GOOD = np.full((5, 3), 0.01)


def changed(row: int, value: Any) -> Array:
    out = GOOD.copy()
    out[row] = value
    return out


BAD: dict[str, tuple[Callable[[StarGyroState], Any], str]] = {
    "nan": (lambda s: s.process(changed(3, np.nan), 0.1), "rates, row 3, value nan.*finite"),
    "inf": (lambda s: s.process(changed(0, [0.0, np.inf, 0.0]), 0.1), "rates, row 0, value inf"),
    "masked": (
        lambda s: s.process(np.ma.masked_equal(changed(2, 1.0), 1.0), 0.1),
        "rates, row 2, value nan",
    ),
    "two columns": (lambda s: s.process(GOOD[:, :2], 0.1), r"rates: has shape \(5, 2\)"),
    "one sample": (lambda s: s.process(GOOD[0], 0.1), r"rates: has shape \(3,\).*one row"),
    "no rows": (lambda s: s.process(GOOD, 0.1, every=0), "every.*at least 1"),
    "words": (lambda s: s.process([["a", "b", "c"]], 0.1), "rates.*not real numbers"),
    "zero step": (lambda s: s.process(GOOD, 0.0), r"dt, value 0\.0: must be positive"),
    "negative": (lambda s: s.process(GOOD, -0.1), r"dt, value -0\.1: must be positive"),
    "nan step": (lambda s: s.process(GOOD, np.nan), "dt, value nan: must be positive"),
    "inf step": (lambda s: s.process(GOOD, np.inf), "dt, value inf: must be positive"),
    "zero step 2": (lambda s: s.process(GOOD, [0.1, 0.1, 0.0, 0.1, 0.1]), "dt, row 2, value 0.0"),
    "tiny": (lambda s: s.process(GOOD, 1e-30), "dt, value 1e-30: is too short to move the time"),
    "steps": (lambda s: s.process(GOOD, [0.1] * 4), "dt: has 4 rows, but 5 are needed"),
    "square": (lambda s: s.process(GOOD, [[0.1] * 5]), "dt: has shape"),
    "back": (
        lambda s: s.process(GOOD, t=[2.0, 3.0, 2.5, 4.0, 5.0]),
        "t, row 2, value 2.5.*after 3",
    ),
    "repeated": (lambda s: s.process(GOOD, t=[2.0, 3.0, 3.0, 4.0, 5.0]), "t, row 2, value 3.0"),
    "early": (
        lambda s: s.process(GOOD, t=[0.5, 3.0, 3.5, 4.0, 5.0]),
        "t, row 0, value 0.5.*before",
    ),
    "nan time": (lambda s: s.process(GOOD, t=[2.0, np.nan, 3.5, 4.0, 5.0]), "t, row 1, value nan"),
    "inf time": (lambda s: s.process(GOOD, t=[2.0, 3.0, 3.5, 4.0, np.inf]), "t, row 4, value inf"),
    "times": (lambda s: s.process(GOOD, t=[2.0, 3.0]), "t: has 2 rows, but 5 are needed"),
    "both": (lambda s: s.process(GOOD, 0.1, t=[2.0]), "dt or times t"),
    "neither": (lambda s: s.process(GOOD), "dt or times t"),
    "half a row": (lambda s: s.process(GOOD, 0.1, every=1.5), "every.*whole number"),  # type: ignore[call-overload]
    "numerics": (lambda s: s.process(changed(3, 1e300), 0.1), "step 6.*not positive definite"),
}


@pytest.mark.parametrize("case", BAD)
def test_errors_leave_the_state_as_it_was(case: str) -> None:
    call, message = BAD[case]
    state = fresh(lag=10.0)
    state.process(GOOD[:2], 0.1)
    before = everything(state)
    with pytest.raises(cc.CelestcoreError, match=message):
        call(state)
    assert everything(state) == before


def test_error_knows_field_row_and_value() -> None:
    with pytest.raises(cc.InputError) as found:
        fresh().process(changed(4, [0.0, 0.0, -np.inf]), 0.1)
    assert (found.value.field, found.value.row, found.value.value) == ("rates", 4, -np.inf)


def test_ctrl_c_leaves_the_state_as_it_was() -> None:
    state = fresh(cc.SRUKF(), lag=1.0)
    before = everything(state)
    rates = np.zeros((3_000_000, 3))
    begin = time.perf_counter()
    threading.Timer(0.3, signal.raise_signal, [signal.SIGINT]).start()
    with pytest.raises(KeyboardInterrupt):
        state.process(rates, 0.01)
    assert time.perf_counter() - begin < 2.0
    assert everything(state) == before


def test_other_threads_run_meanwhile() -> None:
    state, n = fresh(cc.SRUKF()), [0]
    work = threading.Thread(target=state.process, args=(np.zeros((200_000, 3)), 0.01))
    work.start()
    while work.is_alive():
        n[0] += 1
        time.sleep(0.001)
    assert n[0] > 20
    assert state.t == pytest.approx(2001.0)
