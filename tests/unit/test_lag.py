"""Fixed-lag smoothing of a stream: the smoother of the log so far, and copies that keep it."""

from __future__ import annotations

import copy
import pickle
from collections.abc import Callable
from typing import Any

import celestcore as cc
import numpy as np
import pytest
from celestcore import quaternion as quat
from celestcore.navigator import StarGyroState
from numpy.typing import NDArray

Array = NDArray[np.float64]
SIGMA = 5 * cc.ARCSEC
FILTERS = {"ekf": cc.EKF(), "ukf": cc.UKF(), "srukf": cc.SRUKF(), "plain": cc.EKF(reset=False)}
every_filter = pytest.mark.parametrize("name", FILTERS)
Q0 = quat.exp([0.3, -0.5, 0.8])
START = (1e-3, 1e-5)
SUN = np.array([0.0, 0.6, 0.8])


def navigator(name: str = "ekf", **options: Any) -> cc.StarGyroNavigator:
    given: dict[str, Any] = {
        "gyro": cc.Gyro(1e-6, 1e-8),
        "star": cc.StarCamera(SIGMA),
        "vector": cc.VectorSensor(1e-3),
        "gate": 0.999999,
    }
    return cc.StarGyroNavigator(FILTERS[name], **{**given, **options})


def make_log(n: int = 120, seed: int = 0) -> cc.SensorLog:
    """Irregular gyro samples; fixes at samples and between them, one of them wrong; directions."""
    rng = np.random.default_rng(seed)
    t = np.concatenate([[0.0], np.cumsum(rng.uniform(0.1, 0.3, n - 1))])
    rate = 0.1 * np.sin(0.3 * t[:, None] + [0.0, 1.0, 2.0])
    q = quat.propagate(Q0, rate[:-1], np.diff(t))
    k = np.arange(4, n - 1, 7)
    fix_t = np.sort(np.concatenate([t[1::3], t[k] + 0.4 * np.diff(t)[k]]))
    at = np.searchsorted(t, fix_t, side="right") - 1
    turned = quat.exp(rate[at] * (fix_t - t[at])[:, None] + SIGMA * rng.normal(size=(len(at), 3)))
    fix_q = quat.multiply(q[at], turned)
    fix_q[20] = quat.multiply(fix_q[20], quat.exp([0.1, 0.0, 0.0]))
    body = quat.rotate(quat.conjugate(q[2::5]), SUN)
    return cc.SensorLog(
        gyro=(t, rate + 1e-5 + 2e-6 * rng.normal(size=(n, 3))),
        star=(fix_t, fix_q),
        vector_sun=(t[2::5], body, np.tile(SUN, (len(body), 1))),
    )


def events(log: cc.SensorLog) -> list[tuple[float, int, int]]:
    """Time, kind (star, vector, then the gyro sample at that time), row."""
    assert log.gyro is not None
    tables = (log.stars["star"].t, log.vectors["sun"].t, log.gyro.t)
    rows = [(t, kind, k) for kind, ts in enumerate(tables) for k, t in enumerate(ts.tolist())]
    # a sample at a fix's time moves the state there
    return sorted(rows, key=lambda e: (e[0], -(e[1] == 2), e[1]))


def feed(state: StarGyroState, log: cc.SensorLog, event: tuple[float, int, int]) -> None:
    t, kind, k = event
    assert log.gyro is not None
    if kind == 2:
        state.predict(t, log.gyro.rate[k])
    elif kind == 0:
        state.update(t, log.stars["star"].q[k])
    else:
        sun = log.vectors["sun"]
        state.update_direction(t, sun.body[k], sun.inertial[k])


def cut(log: cc.SensorLog, end: float) -> cc.SensorLog:
    assert log.gyro is not None
    gyro, star, sun = log.gyro, log.stars["star"], log.vectors["sun"]
    a, b, c = (np.searchsorted(table.t, end, side="right") for table in (gyro, star, sun))
    return cc.SensorLog(
        gyro=(gyro.t[:a], gyro.rate[:a]),
        star=(star.t[:b], star.q[:b]),
        vector_sun=(sun.t[:c], sun.body[:c], sun.inertial[:c]),
    )


def run_until(
    nav: cc.StarGyroNavigator, log: cc.SensorLog, end: float, lag: float | None
) -> StarGyroState:
    state = nav.start(0.0, Q0, sigma0=START, lag=lag)
    for event in events(log):
        if event[0] <= end:
            feed(state, log, event)
    return state


def same(late: Any, sol: cc.Solution, rounding: float = 1e-12) -> None:
    """The rows of a fixed lag at gyro samples are those of the smoother."""
    both, i, j = np.intersect1d(late.t, sol.t, return_indices=True)
    assert len(both) > 3
    assert np.array_equal(both, sol.t[-len(both) :])  # every sample of the lag is there
    assert sol.covariance is not None
    assert quat.angle_between(late.q[i], sol.q[j]).max() < 1e-14
    np.testing.assert_allclose(late.bias[i], sol.bias[j], rtol=0.0, atol=1e-16)
    np.testing.assert_allclose(late.sigma[i], sol.sigma[j], rtol=rounding)
    scale = sol.sigma[j][:, :, None] * sol.sigma[j][:, None, :]
    assert np.abs((late.covariance[i] - sol.covariance[j]) / scale).max() < rounding


@every_filter
@pytest.mark.parametrize("lag", [1.0, 5.0, 1e3])
def test_smoothed_is_the_smoother_of_the_log_so_far(name: str, lag: float) -> None:
    log, nav = make_log(), navigator(name)
    assert log.gyro is not None
    # a stream carries the square root itself, the smoother of a log draws one from the covariance
    rounding = 2e-10 if name == "srukf" else 1e-12
    for end in log.gyro.t[[10, 61, 119]].tolist():
        late = run_until(nav, log, end, lag).smoothed()
        sol = nav.smooth(cut(log, end), q0=Q0, sigma0=START, covariance=True)
        same(late, sol, rounding)
        assert np.all(np.diff(late.t) > 0.0)
        assert late.t[-1] == end


@every_filter
def test_first_row_is_a_lag_old(name: str) -> None:
    """The latest state at least that old; before there is one, the start."""
    log, nav = make_log(), navigator(name)
    state = nav.start(0.0, Q0, sigma0=START, lag=4.0)
    assert state.lag == 4.0
    times = sorted({event[0] for event in events(log)})
    for event in events(log):
        feed(state, log, event)
        first = state.smoothed().t[0]
        past = [t for t in times if t <= state.t - 4.0]
        assert first == (past[-1] if past else 0.0)


@every_filter
def test_a_lag_changes_nothing_else(name: str) -> None:
    log, nav = make_log(), navigator(name)
    a, b = (run_until(nav, log, 1e9, lag) for lag in (None, 5.0))
    assert np.array_equal(a.q, b.q)
    assert np.array_equal(a.covariance, b.covariance)
    before = b._snapshot()
    b.smoothed()
    after = b._snapshot()
    assert np.array_equal(before[3], after[3])
    assert np.array_equal(before[6], after[6])


def test_rows_of_smoothed() -> None:
    log, nav = make_log(), navigator()
    state = run_until(nav, log, 10.0, 3.0)
    late = state.smoothed()
    n = len(late.t)
    assert (late.q.shape, late.bias.shape, late.sigma.shape) == ((n, 4), (n, 3), (n, 6))
    assert late.covariance is not None
    assert late.covariance.shape == (n, 6, 6)
    assert np.array_equal(late.q[-1], state.q)
    assert np.array_equal(late.covariance[-1], state.covariance)
    assert np.isnan(late.rate[-1]).all()
    assert log.gyro is not None
    both, i, j = np.intersect1d(late.t[:-1], log.gyro.t, return_indices=True)
    assert len(both) > 5
    np.testing.assert_allclose(late.rate[i] + late.bias[i], log.gyro.rate[j], rtol=0, atol=1e-15)


def test_the_start_alone() -> None:
    state = navigator().start(2.0, Q0, sigma0=START, lag=5.0)
    late = state.smoothed()
    assert np.array_equal(late.t, [2.0])
    assert np.array_equal(late.q[0], state.q)
    assert np.array_equal(late.covariance[0], state.covariance)
    state.update(2.0, Q0)
    assert np.array_equal(state.smoothed().covariance[0], state.covariance)
    state.predict(2.0, [0.0, 0.0, 0.1])  # no time has passed
    assert len(state.smoothed().t) == 1


def test_smoothing_with_a_lag_pays() -> None:
    """A few seconds later more is known: by the numbers and by the truth."""
    log, nav = make_log(400), navigator()
    assert log.gyro is not None
    rate = 0.1 * np.sin(0.3 * log.gyro.t[:, None] + [0.0, 1.0, 2.0])
    q = quat.propagate(Q0, rate[:-1], np.diff(log.gyro.t))
    state = nav.start(0.0, Q0, sigma0=START, lag=5.0)
    now, then = [], []
    for event in events(log):
        feed(state, log, event)
        if event[1] != 2 or event[0] < 20.0:
            continue
        late = state.smoothed()
        k = np.searchsorted(log.gyro.t, late.t[0])
        if log.gyro.t[k] != late.t[0]:
            continue
        assert np.all(late.sigma[0] < state.sigma)
        now.append(quat.angle_between(state.q, q[event[2]]))
        then.append(quat.angle_between(late.q[0], q[k]))
    assert len(then) > 200
    assert np.sqrt(np.mean(np.square(then)) / np.mean(np.square(now))) < 0.9


COPIES: dict[str, Callable[[StarGyroState], StarGyroState]] = {
    "copy()": lambda s: s.copy(),
    "copy.copy": copy.copy,
    "copy.deepcopy": copy.deepcopy,
    "pickle": lambda s: pickle.loads(pickle.dumps(s)),
}


def everything(state: StarGyroState) -> tuple[Any, ...]:
    late = state.smoothed()
    parts = (late.t, late.q, late.bias, late.covariance, state.covariance)
    return (state.lag, state.t, *(np.asarray(part).tobytes() for part in parts))


@every_filter
@pytest.mark.parametrize("how", COPIES)
def test_copies_keep_the_history(name: str, how: str) -> None:
    log, nav = make_log(60), navigator(name)
    order = events(log)
    state = nav.start(0.0, Q0, sigma0=START, lag=3.0)
    copies = []
    for k, event in enumerate(order):
        if k in (0, 1, 25, 26, 60):
            copies.append((k, COPIES[how](state), everything(state)))
        feed(state, log, event)
    for k, other, then in copies:
        assert everything(other) == then  # untouched by what the first one did since
        for event in order[k:]:
            feed(other, log, event)
        assert everything(other) == everything(state)


BAD: dict[str, Callable[[StarGyroState], Any]] = {
    "back in time": lambda s: s.predict(0.5, [0.0, 0.0, 0.0]),
    "nan rate": lambda s: s.predict(9.0, [0.0, np.nan, 0.0]),
    "overflow": lambda s: s.predict(1e300, [0.0, 0.0, 0.0]),
    "late fix, bad noise": lambda s: s.update_star(9.0, Q0.tolist(), [-1.0, 0, 0, -1.0, 0, -1.0]),
    "fix, bad noise": lambda s: s.update_star(s.t, Q0.tolist(), [-1.0, 0, 0, -1.0, 0, -1.0]),
    "nan fix": lambda s: s.update(9.0, [np.nan, 0.0, 0.0, 0.0]),
}


@every_filter
@pytest.mark.parametrize("case", BAD)
def test_a_failed_step_leaves_the_history(name: str, case: str) -> None:
    log = make_log()
    for lag in (0.05, 3.0):  # a lag that holds one step, too
        state = run_until(navigator(name), log, 5.0, lag)
        before, past = everything(state), state._snapshot()[6].tobytes()
        with pytest.raises(cc.CelestcoreError):
            BAD[case](state)
        assert state._snapshot()[6].tobytes() == past
        assert everything(state) == before


def test_rejected_fixes_move_the_state_and_not_more() -> None:
    log, nav = make_log(), navigator()
    state = run_until(nav, log, 5.0, 3.0)
    other = state.copy()
    assert log.gyro is not None
    t = float(log.gyro.t[log.gyro.t > 5.0][0])
    used = state.update(t, quat.multiply(state.q, quat.exp([0.5, 0.0, 0.0])))
    assert not used.accepted
    assert state.t == t
    late = state.smoothed()
    assert late.t[-1] == t
    kept = np.isin(late.t, other.smoothed().t)
    assert np.count_nonzero(kept) == len(late.t) - 1
    before = other.smoothed()
    again = np.isin(before.t, late.t)
    np.testing.assert_allclose(late.sigma[kept], before.sigma[again], rtol=1e-12)


def test_sampling_and_errors_of_the_gyro_are_those_of_the_smoother() -> None:
    log = make_log()
    assert log.gyro is not None
    t, q = log.gyro.t[1::3], log.stars["star"].q[: len(log.gyro.t[1::3])]
    log = cc.SensorLog(gyro=log.gyro, star=(t, q), vector_sun=log.vectors["sun"])
    errors = np.array([[1e-3, 2e-3, 0.0], [0.0, -1e-3, 5e-4], [-3e-4, 0.0, 2e-3]])
    for sampling in ("hold", "integrated", "average"):
        gyro = cc.Gyro(1e-6, 1e-8, sampling=sampling, errors=errors)
        nav = navigator(gyro=gyro, gate=None)
        late = run_until(nav, log, 1e9, 5.0).smoothed()
        same(late, nav.smooth(log, q0=Q0, sigma0=START, covariance=True))
