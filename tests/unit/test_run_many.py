"""StarGyroNavigator.run_many: the same as `run`, log by log."""

from __future__ import annotations

import warnings
from typing import Any

import celestcore as cc
import numpy as np
import pytest
from celestcore import quaternion as quat
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from truth import (
    ARW,
    CAMERA,
    PER_FIX,
    PER_ROW,
    RRW,
    SIGMA,
    Truth,
    close,
    directions,
    navigator,
    same_bits,
    same_end,
)

LANES = {"ekf": cc.EKF(), "ukf": cc.UKF(), "ukf rk4": cc.UKF(integrator="rk4")}
ALONE = {"iterated": cc.IteratedEKF(), "literal": cc.LiteralUKF(), "invariant": cc.InvariantEKF()}
SCALARS = ("counts", "sensor_names", "epoch", "title", "filter", "frames", "innovations")
BROKEN = 3


def fleet(n: int, *, gap: bool = True, missing: bool = True) -> list[cc.SensorLog]:
    """Logs of different lengths, steps, cadences and phases, with gaps and rows of NaN."""
    logs = []
    for i in range(n):
        truth = Truth(n=60 + 13 * (i % 5), dt=0.125 * (1 + i % 3), seed=i)
        t, rate = truth.t, truth.measured.copy()
        fix_t = t[:: 1 + i % 4][:-1] + 0.01 * (i % 2)
        fixes = truth.fixes(fix_t)
        keep = np.ones(len(t), dtype=bool)
        if gap and i % 3 == 1:
            keep[20:31] = False
        if missing:
            rate[7 + i % 4] = np.nan
            fixes[len(fixes) // 2] = np.nan
        logs.append(
            cc.SensorLog(gyro=(t[keep], rate[keep]), star=(fix_t, fixes), title=f"number {i}")
        )
    return logs


def alike(n: int) -> list[cc.SensorLog]:
    return [Truth(n=80, seed=i).log() for i in range(n)]


def ran(nav: cc.StarGyroNavigator, logs: list[cc.SensorLog], **options: Any) -> list[cc.Solution]:
    """Return the solutions of logs that all have one."""
    sols = nav.run_many(logs, **options)
    assert all(isinstance(sol, cc.Solution) for sol in sols)
    assert len(sols) == len(logs)
    return [sol for sol in sols if sol is not None]


def identical(a: cc.Solution, b: cc.Solution) -> None:
    same_bits(a, b, (*PER_ROW, *PER_FIX, "gaps"))
    same_end(a, b)
    assert a.log_likelihood == b.log_likelihood
    for name in SCALARS:
        assert getattr(a, name) == getattr(b, name), name
    assert (a.covariance is None) == (b.covariance is None)
    if a.covariance is not None:
        assert np.array_equal(a.covariance, b.covariance)


def agree(many: cc.Solution, one: cc.Solution) -> None:
    """The same to rounding, and all that is counted the same."""
    close(many, one)
    for name in ("measurement_t", "sensor", "dof", "accepted", "gaps"):
        assert np.array_equal(getattr(many, name), getattr(one, name)), name
    for name in SCALARS:
        assert getattr(many, name) == getattr(one, name), name
    assert np.abs(many.rate - one.rate).max() < 1e-12
    used = np.isfinite(one.nis)
    assert np.array_equal(used, np.isfinite(many.nis))
    np.testing.assert_allclose(many.nis[used], one.nis[used], rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(many.innovation, one.innovation, rtol=0, atol=1e-12)
    np.testing.assert_allclose(many.innovation_sigma, one.innovation_sigma, rtol=1e-9)
    assert many.log_likelihood == pytest.approx(one.log_likelihood, rel=1e-9)
    assert many.final["t"] == one.final["t"]
    np.testing.assert_allclose(many.final["sigma"], one.final["sigma"], rtol=1e-9)


# it agrees with run


@pytest.mark.parametrize("n", [1, 8, 9, 17])
@pytest.mark.parametrize("name", LANES)
def test_lanes_agree_with_single_runs(name: str, n: int) -> None:
    nav, logs = navigator(LANES[name]), fleet(n)
    for sol, log in zip(ran(nav, logs), logs, strict=True):
        agree(sol, nav.run(log))
        assert sol.title == log.title
        assert sol.counts["missing"] > 0


@pytest.mark.parametrize("name", LANES)
@pytest.mark.parametrize(
    "options",
    [
        {"every": 7, "covariance": True},
        {"innovations": "nis"},
        {"sigma0": (1e-3, 1e-4), "bias0": [1e-5, 0.0, -1e-5]},
        {"q0": quat.exp([0.3, -0.5, 0.8]), "sigma0": (1e-2, 1e-3), "t0": 1.7},
        {"q0": [1.0, 0.0, 0.0, 0.0], "sigma0": (2.5, 1e-2)},
    ],
    ids=["rows and covariances", "nis", "sigma0", "between samples", "no idea"],
)
def test_options_are_those_of_run(name: str, options: dict[str, Any]) -> None:
    nav, logs = navigator(LANES[name]), fleet(5)
    wild = options.get("sigma0", (0, 0))[0] > 1.0  # rounding grows with the first correction
    for sol, log in zip(ran(nav, logs, **options), logs, strict=True):
        one = nav.run(log, **options)
        close(sol, one, 1e-9 if wild else 1e-12)
        assert np.array_equal(sol.accepted, one.accepted)
        assert sol.counts == one.counts
        if one.covariance is not None:
            scale = one.sigma[:, :, None] * one.sigma[:, None, :]
            assert np.abs((sol.covariance - one.covariance) / scale).max() < 1e-9


@pytest.mark.parametrize("name", LANES)
def test_nothing_kept_of_measurements(name: str) -> None:
    nav, logs = navigator(LANES[name]), fleet(9)
    for sol, log in zip(ran(nav, logs, innovations="none"), logs, strict=True):
        one = nav.run(log, innovations="none")
        close(sol, one)
        assert sol.counts == one.counts
        assert sol.log_likelihood == pytest.approx(one.log_likelihood, rel=1e-9)
        assert len(sol.nis) == len(one.nis) == 0


@pytest.mark.parametrize("name", LANES)
@pytest.mark.parametrize("sampling", ["hold", "integrated", "average"])
def test_gyro_with_mounting_sampling_and_gaps(name: str, sampling: str) -> None:
    gyro = cc.Gyro(
        ARW,
        RRW,
        sampling=sampling,
        mounting=Rotation.from_euler("xyz", [20, -70, 110], degrees=True),
        errors=1e-3 * np.arange(9.0).reshape(3, 3),
        max_gap=0.5,
    )
    nav, logs = navigator(LANES[name], gyro=gyro), fleet(9)
    for sol, log in zip(ran(nav, logs), logs, strict=True):
        agree(sol, nav.run(log))


def cameras(truth: Truth, own_noise: bool) -> dict[str, Any]:
    """Two cameras in their own frames, at times of their own."""
    tables: dict[str, Any] = {}
    for k, (name, mounting) in enumerate(MOUNTINGS.items()):
        t = truth.t[k::3][:-1] + 0.03 * k
        q = quat.multiply(truth.fixes(t), quat.from_rotation(mounting))
        noise = (SIGMA * (1.0 + 0.1 * np.arange(3 * len(t)).reshape(-1, 3) / len(t)),)
        tables[name] = (t, q, *(noise if own_noise else ()))
    return tables


MOUNTINGS = {
    "star_1": Rotation.from_euler("zyx", [10, 80, -30], degrees=True),
    "star_2": Rotation.from_euler("zyx", [-100, 15, 60], degrees=True),
}


@pytest.mark.parametrize("name", LANES)
@pytest.mark.parametrize("gate", [None, 0.9])
def test_several_cameras(name: str, gate: float | None) -> None:
    stars = {
        "star_1": cc.StarCamera((SIGMA, SIGMA, 8 * SIGMA), mounting=MOUNTINGS["star_1"]),
        "star_2": cc.StarCamera(2 * SIGMA, mounting=MOUNTINGS["star_2"]),
    }
    nav = navigator(LANES[name], star=stars, gate=gate)
    logs = []
    for i in range(9):
        truth = Truth(n=60 + 7 * i, seed=i)
        logs.append(
            cc.SensorLog(gyro=(truth.t, truth.measured), **cameras(truth, own_noise=i % 2 == 0))
        )
    sols = ran(nav, logs)
    for sol, log in zip(sols, logs, strict=True):
        agree(sol, nav.run(log))
        assert sol.sensor_names == list(MOUNTINGS)
    assert (gate is None) == (sum(sol.counts["rejected"] for sol in sols) == 0)


# what does not run in lanes is the same to the last bit


@pytest.mark.parametrize("name", LANES)
@pytest.mark.parametrize(
    "options", [{"portable": True}, {"period": 0.5}], ids=["portable", "period"]
)
def test_same_bits_where_logs_run_one_by_one(name: str, options: dict[str, Any]) -> None:
    nav, logs = navigator(LANES[name]), fleet(9)
    for sol, log in zip(ran(nav, logs, **options), logs, strict=True):
        identical(sol, nav.run(log, **options))


@pytest.mark.parametrize("name", ALONE)
def test_other_filters(name: str) -> None:
    nav, logs = navigator(ALONE[name]), fleet(9)
    for sol, log in zip(ran(nav, logs), logs, strict=True):
        identical(sol, nav.run(log))


def test_square_root_filter_agrees() -> None:
    nav, logs = navigator(cc.SRUKF()), fleet(9)
    for sol, log in zip(ran(nav, logs), logs, strict=True):
        agree(sol, nav.run(log))


def with_sun(seed: int) -> cc.SensorLog:
    truth = Truth(n=80, seed=seed)
    t = truth.t[1::3]
    return truth.log(vector_sun=(t, *directions(truth, t, [0.6, 0.0, 0.8])))


@pytest.mark.parametrize("name", LANES)
def test_logs_with_and_without_directions(name: str) -> None:
    nav = navigator(LANES[name], vector=cc.VectorSensor(1e-3))
    logs = [with_sun(i) if i in (0, 3, 10) else log for i, log in enumerate(alike(11))]
    for i, (sol, log) in enumerate(zip(ran(nav, logs), logs, strict=True)):
        one = nav.run(log)
        if i in (0, 3, 10):
            identical(sol, one)
        else:
            agree(sol, one)


# a result does not depend on threads or on the other logs


@pytest.mark.parametrize("name", LANES)
def test_same_bits_for_any_number_of_threads(name: str) -> None:
    nav, logs = navigator(LANES[name]), fleet(17)
    first = ran(nav, logs, threads=1)
    for threads in (2, 3, 50, None):
        for a, b in zip(first, ran(nav, logs, threads=threads), strict=True):
            identical(a, b)


@pytest.mark.parametrize("name", LANES)
def test_same_bits_for_any_subset_and_order(name: str) -> None:
    nav, logs = navigator(LANES[name]), fleet(17)
    every = ran(nav, logs)
    rng = np.random.default_rng(2)
    orders = [np.arange(17)[::-1], *(rng.permutation(17)[:n] for n in (1, 2, 7, 12)), [4] * 9]
    for order in orders:
        for i, sol in zip(order, ran(nav, [logs[i] for i in order]), strict=True):
            identical(sol, every[i])


@pytest.mark.parametrize("name", LANES)
def test_a_large_error_beside_small_ones(name: str) -> None:
    """Where one lane needs sigma points and turns by much, the others keep their bits."""
    nav = navigator(LANES[name])
    logs = alike(8)
    truth = Truth(n=80, dt=4.0, seed=20)  # turns of a good part of a radian a step
    logs[5] = truth.log(each=9)
    options: dict[str, Any] = {"sigma0": (1e-3, 0.5)}
    mixed = ran(nav, logs, **options)
    for i in range(8):
        identical(mixed[i], ran(nav, [logs[i]], **options)[0])


# arguments


def test_no_logs() -> None:
    assert navigator().run_many([]) == []
    assert navigator().run_many(iter(())) == []


def test_any_iterable() -> None:
    logs = alike(3)
    expected = ran(navigator(), logs)
    for given_logs in (tuple(logs), iter(logs), (log for log in logs)):
        for a, b in zip(navigator().run_many(given_logs), expected, strict=True):
            assert a is not None
            identical(a, b)


def test_one_log_is_no_list() -> None:
    with pytest.raises(cc.InputError, match="logs: is one log; use run") as caught:
        navigator().run_many(alike(1)[0])  # type: ignore[arg-type]
    assert caught.value.field == "logs"


def test_a_log_that_cannot_run_names_its_number() -> None:
    truth, logs = Truth(n=80), alike(5)
    no_gyro = cc.SensorLog(star=(truth.t, truth.q))
    no_star = cc.SensorLog(gyro=(truth.t, truth.measured))
    late = truth.log(star=(truth.t + 1e4, truth.q))
    for bad, message in (
        (no_gyro, "^log 3: .*no gyro table"),
        (no_star, "^log 3: .*star"),
        (late, "^log 3: .*star"),
        ("mine.npz", "^log 3: .*must be SensorLog"),
        (None, "^log 3: .*must be SensorLog"),
    ):
        with pytest.raises(cc.InputError, match=message):
            navigator().run_many([*logs[:3], bad, *logs[3:]])  # type: ignore[list-item]


def test_a_log_with_a_start_outside_it_names_its_number() -> None:
    logs = [Truth(n=80).log(), Truth(n=40).log()]
    with pytest.raises(cc.InputError, match=r"log 1: .*t0.*must lie within"):
        navigator().run_many(logs, q0=[1, 0, 0, 0], sigma0=(1e-3, 1e-4), t0=8.0)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"evry": 2}, "evry: is not an option"),
        ({"every": 0}, "every, value 0"),
        ({"period": -1.0}, "period, value -1"),
        ({"innovations": "some"}, "innovations, value 'some'"),
        ({"sigma0": 3.0}, "sigma0"),
        ({"t0": 3.0}, "t0"),
        ({"q0": [0, 0, 0, 0], "sigma0": (1, 1)}, "q0"),
        ({"progress": 3}, "progress"),
        ({"threads": 0}, "threads, value 0"),
        ({"threads": 1.5}, "threads, value 1.5"),
        ({"threads": "all"}, "threads, value 'all'"),
    ],
    ids=lambda x: next(iter(x)) if isinstance(x, dict) else "",
)
def test_a_wrong_option_is_named(options: dict[str, Any], message: str) -> None:
    with pytest.raises(cc.InputError, match=message):
        navigator().run_many(alike(2), **options)


def test_inputs_are_not_changed() -> None:
    def copies(log: cc.SensorLog) -> list[Any]:
        assert log.gyro is not None
        star = log.stars["star"]
        return [x.copy() for x in (log.gyro.t, log.gyro.rate, star.t, star.q)]

    logs, options = fleet(9), {"every": 2, "bias0": np.array([1e-5, 0.0, 0.0])}
    given_logs, before = list(logs), [copies(log) for log in logs]
    ran(navigator(cc.UKF()), logs, **options)
    assert all(a is b for a, b in zip(logs, given_logs, strict=True))
    for log, old in zip(logs, before, strict=True):
        for now, then in zip(copies(log), old, strict=True):
            assert np.array_equal(now, then, equal_nan=True)
    assert options.keys() == {"every", "bias0"}
    assert np.array_equal(options["bias0"], [1e-5, 0.0, 0.0])


def test_a_solution_can_be_smoothed() -> None:
    logs = alike(3)
    nav = navigator()
    for sol, log in zip(ran(nav, logs, every=2), logs, strict=True):
        same_bits(nav.smooth(sol), nav.smooth(log, every=2), PER_ROW)


# progress and Ctrl-C


@pytest.mark.parametrize("n", [1, 8, 9, 17])
def test_progress_counts_logs(n: int) -> None:
    heard: list[tuple[int, int]] = []
    ran(navigator(), alike(n), progress=lambda done, total: heard.append((done, total)))
    assert heard[-1] == (n, n)
    assert all(total == n for _, total in heard)
    assert [done for done, _ in heard] == sorted(done for done, _ in heard)


def test_an_error_of_progress_ends_the_call() -> None:
    def listen(done: int, total: int) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        navigator().run_many(alike(9), progress=listen)


# a filter that breaks down


def broken(seed: int = 0) -> cc.SensorLog:
    """Return a log whose rate overflows at the eighth sample."""
    truth = Truth(n=80, seed=seed)
    rate = truth.measured.copy()
    rate[7] = [1e300, 0.0, 0.0]
    t = truth.t[::2]
    return cc.SensorLog(gyro=(truth.t, rate), star=(t, truth.fixes(t)))


@pytest.mark.parametrize("name", [*LANES, *ALONE, "srukf"])
def test_a_filter_that_breaks_down_leaves_the_others(name: str) -> None:
    nav = navigator({**LANES, **ALONE, "srukf": cc.SRUKF()}[name])
    logs = alike(9)
    expected = ran(nav, logs)
    logs[BROKEN] = broken()
    with pytest.raises(cc.NumericalError, match=r"step 7.* predicted covariance"):
        nav.run(logs[BROKEN])
    with pytest.warns(cc.CelestcoreWarning, match=rf"^log {BROKEN} has no solution") as caught:
        sols = nav.run_many(logs)
    assert len(caught) == 1
    assert "predicted covariance is not positive definite" in str(caught[0].message)
    assert "step 7, t = 1 s" in str(caught[0].message)
    assert sols[BROKEN] is None
    for i, (sol, other) in enumerate(zip(sols, expected, strict=True)):
        if i != BROKEN:
            assert sol is not None
            identical(sol, other)


@pytest.mark.parametrize("name", LANES)
def test_all_break_down(name: str) -> None:
    with pytest.warns(cc.CelestcoreWarning, match="log") as caught:
        assert navigator(LANES[name]).run_many([broken(i) for i in range(9)]) == [None] * 9
    said = [str(w.message) for w in caught]
    assert [s.split(" has")[0] for s in said] == [f"log {i}" for i in range(9)]


@pytest.mark.parametrize("name", LANES)
@pytest.mark.parametrize("bad", [-np.eye(6), np.diag([1e-400, 1, 1, 1, 1, 1])])
def test_a_start_that_no_filter_can_have(name: str, bad: Any) -> None:
    options: dict[str, Any] = {"q0": [1.0, 0.0, 0.0, 0.0], "covariance0": bad}
    with pytest.warns(cc.CelestcoreWarning, match="initial covariance"):
        assert navigator(LANES[name]).run_many(alike(3), **options) == [None] * 3


def test_a_warning_of_one_log_is_like_that_of_run() -> None:
    """A log of which most fixes are turned away says so, as in `run`."""
    truth = Truth(n=80)
    t = truth.t[::2]
    q = truth.fixes(t)
    q[10:] = quat.multiply(q[10:], quat.exp([0.2, 0.1, -0.3]))
    logs, nav = [*alike(2), truth.log(star=(t, q))], navigator(gate=0.9999)
    with pytest.warns(cc.CelestcoreWarning, match="outside the gate"):
        nav.run(logs[2])
    with pytest.warns(cc.CelestcoreWarning, match="outside the gate") as caught:
        sols = nav.run_many(logs)
    assert len(caught) == 1
    assert all(sol is not None for sol in sols)


# any logs

LOGS = st.lists(
    st.fixed_dictionaries(
        {
            "n": st.integers(2, 24),
            "dt": st.sampled_from([0.0625, 0.125, 0.5]),
            "seed": st.integers(0, 99),
            "each": st.integers(1, 5),
            "phase": st.sampled_from([0.0, 0.0, 0.03]),
            "lost": st.sets(st.integers(0, 23), max_size=3),
            "cut": st.integers(0, 3),
        }
    ),
    min_size=1,
    max_size=10,
)


def small(n: int, dt: float, seed: int, each: int, phase: float, lost: Any, cut: int) -> Any:
    truth = Truth(n=n, dt=dt, seed=seed)
    t = truth.t[::each] + phase
    fixes, rate = truth.fixes(t), truth.measured.copy()
    fixes[[row for row in lost if 0 < row < len(t)]] = np.nan
    rate[[row for row in lost if row + 1 < n]] = np.nan
    keep = np.ones(n, dtype=bool)
    keep[2 : 2 + cut] = n <= 2 + cut
    return cc.SensorLog(gyro=(truth.t[keep], rate[keep]), star=(t, fixes))


@settings(max_examples=60, deadline=None)
@given(
    descriptions=LOGS,
    name=st.sampled_from(sorted(LANES)),
    every=st.integers(1, 4),
    gate=st.sampled_from([None, 0.9]),
    threads=st.sampled_from([1, 2]),
)
def test_any_logs_in_lanes_are_like_single_runs(
    descriptions: list[Any], name: str, every: int, gate: float | None, threads: int
) -> None:
    nav = navigator(LANES[name], gate=gate, star=CAMERA)
    logs, expected = [], []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", cc.CelestcoreWarning)
        for description in descriptions:
            log = small(**description)
            try:
                expected.append(nav.run(log, every=every))
            except cc.InputError:
                continue  # no fix to start from
            logs.append(log)
        sols = ran(nav, logs, every=every, threads=threads)
    for sol, one in zip(sols, expected, strict=True):
        agree(sol, one)
