"""StarGyroNavigator.run: fixes at any time, what a gyro sample means, gaps."""

from __future__ import annotations

import celestcore as cc
import numpy as np
import pytest
from celestcore import quaternion as quat
from truth import (
    ARW,
    FILTERS,
    PER_FIX,
    PER_ROW,
    RRW,
    SIGMA,
    Array,
    Truth,
    close,
    errors,
    every_filter,
    navigator,
    same_bits,
    same_end,
)

# time: fixes anywhere, steps of any length, what a sample means


@every_filter
def test_fix_between_samples_equals_a_split_step(name: str) -> None:
    truth = Truth()
    t = np.sort(truth.rng.choice(truth.t[1:-1], 100, replace=False)) + 0.037
    q = truth.fixes(t)
    start = {"q0": truth.q[0], "sigma0": (1e-3, 1e-4)}
    nav = navigator(FILTERS[name])
    sol = nav.run(truth.log(star=(t, q)), **start)
    k = np.searchsorted(truth.t, t, side="right") - 1
    split_t = np.insert(truth.t, k + 1, t)
    split_rate = np.insert(truth.measured, k + 1, truth.measured[k], axis=0)
    split = nav.run(cc.SensorLog(gyro=(split_t, split_rate), star=(t, q)), **start)
    kept = np.isin(split.t, truth.t)
    assert np.array_equal(sol.q, split.q[kept])
    assert np.array_equal(sol.sigma, split.sigma[kept])
    same_bits(sol, split, PER_FIX)


def test_fixes_at_equal_times_come_in_the_order_of_the_tables() -> None:
    truth = Truth()
    a, b = truth.fixes(truth.t), truth.fixes(truth.t)
    start = {"q0": truth.q[0], "sigma0": (1e-3, 1e-4)}
    sol = navigator().run(truth.log(each=0, star_1=(truth.t, a), star_2=(truth.t, b)), **start)
    assert np.array_equal(sol.sensor, np.tile([0, 1], truth.n))
    assert np.array_equal(sol.measurement_t, np.repeat(truth.t, 2))
    other = navigator().run(truth.log(each=0, star_2=(truth.t, b), star_1=(truth.t, a)), **start)
    assert other.sensor_names == ["star_2", "star_1"]
    assert not np.array_equal(sol.nis, other.nis)
    close(sol, other, 1e-10)


def test_output_at_a_sample_has_seen_the_fix_at_that_time() -> None:
    truth = Truth()
    log = truth.log(each=1)
    for output in ({"every": 1}, {"period": 0.125}):
        sol = navigator().run(log, q0=truth.q[0], sigma0=(1.0, 1e-4), **output)
        assert sol.sigma[0, :3].max() < 1.001 * SIGMA
        assert np.all(sol.sigma[:, :3] < 1.001 * SIGMA)


def test_fixes_outside_the_gyro_span_are_counted_and_not_used() -> None:
    truth = Truth()
    inside = truth.log()
    q = np.r_[inside.stars["star"].q[:3], inside.stars["star"].q, inside.stars["star"].q[:2]]
    t = np.r_[-3.0, -2.0, -1e-9, inside.stars["star"].t, truth.t[-1] + 1e-9, 1e3]
    log = truth.log(star=(t, q))
    a, b = navigator().run(inside), navigator().run(log)
    same_bits(a, b, PER_ROW + PER_FIX)
    same_end(a, b)
    assert (a.counts["outside"], b.counts["outside"]) == (0, 5)
    for sol in (a, b):
        c = sol.counts
        assert c["fixes"] == c["accepted"] + c["rejected"] + c["start"] + c["outside"]
    late = navigator().run(log, q0=truth.q[100], sigma0=(1e-3, 1e-4), t0=truth.t[100])
    assert late.counts["outside"] == 5 + 50
    assert late.measurement_t[0] == truth.t[100]
    last = navigator().run(truth.log(star=(truth.t[-1:], truth.q[-1:])))
    assert (len(last), last.counts["outside"]) == (1, 0)


def test_missing_rows_are_counted() -> None:
    truth = Truth()
    rate, q = truth.measured.copy(), truth.fixes(truth.t)
    rate[[5, 6]] = np.nan
    q[7, 2] = np.inf
    sol = navigator().run(cc.SensorLog(gyro=(truth.t, rate), star=(truth.t, q)))
    assert sol.counts["missing"] == 3
    assert sol.counts["samples"] == truth.n - 2
    assert sol.counts["fixes"] == truth.n - 1
    assert np.isfinite(sol.q).all()
    assert errors(sol, truth)[-1] < 5 * SIGMA


def steps_truth(sampling: str, seed: int) -> tuple[Array, Array, Array]:
    """Irregular steps; the rate of each is what the samples mean by it, exactly."""
    rng = np.random.default_rng(seed)
    t = np.cumsum(rng.uniform(0.01, 1.0, 500))
    rate = rng.normal(size=(500, 3)) * 0.1
    step = {"hold": rate[:-1], "integrated": rate[1:], "average": 0.5 * (rate[1:] + rate[:-1])}
    return t, rate, quat.propagate(quat.exp([0.1, 0.2, 0.3]), step[sampling], np.diff(t))


@every_filter
@pytest.mark.parametrize("truth", ["hold", "integrated", "average"])
def test_sampling(name: str, truth: str) -> None:
    t, rate, q = steps_truth(truth, 4)
    log = cc.SensorLog(gyro=(t, rate))
    for sampling in ("hold", "integrated", "average"):
        nav = navigator(FILTERS[name], gyro=cc.Gyro(1e-12, 0.0, sampling=sampling))
        sol = nav.run(log, q0=q[0], sigma0=(1e-9, 1e-12))
        error = quat.angle_between(sol.q, q)[1:]
        if sampling == truth:
            assert error.max() < 1e-12
        else:
            assert error.min() > 1e-4


@pytest.mark.parametrize("sampling", ["integrated", "average"])
def test_sampling_with_fixes_between_samples(sampling: str) -> None:
    """Within a step the rate is that of the step, on both sides of a fix."""
    t, rate, q = steps_truth(sampling, 5)
    part = np.random.default_rng(6).uniform(0.1, 0.9, len(t) - 1)
    fix_q = quat.slerp(q[:-1], q[1:], part)
    log = cc.SensorLog(gyro=(t, rate), star=(t[:-1] + part * np.diff(t), fix_q))
    nav = navigator(gyro=cc.Gyro(ARW, RRW, sampling=sampling))
    sol = nav.run(log, q0=q[0], sigma0=(1e-3, 1e-4))
    assert np.abs(sol.innovation).max() < 1e-11
    assert quat.angle_between(sol.q, q).max() < 1e-11


def test_average_suits_a_smooth_rate() -> None:
    fine = 0.1 * np.arange(10 * 300 + 1) / 10
    rate = 0.2 * np.sin(0.5 * fine[:, None] + [0.0, 1.0, 2.0])
    q = quat.propagate([1.0, 0, 0, 0], 0.5 * (rate[1:] + rate[:-1]), 0.01)[::10]
    log = cc.SensorLog(gyro=(fine[::10], rate[::10]))
    drift = {}
    for sampling in ("hold", "integrated", "average"):
        nav = navigator(gyro=cc.Gyro(ARW, RRW, sampling=sampling))
        sol = nav.run(log, q0=[1.0, 0, 0, 0], sigma0=(1e-9, 1e-9))
        drift[sampling] = quat.angle_between(sol.q, q).max()
    assert drift["average"] < 2e-3
    assert min(drift["hold"], drift["integrated"]) > 10 * drift["average"], drift


# gaps


def gap_log(step: float, rate: Array | None = None) -> tuple[Array, cc.SensorLog]:
    t = np.r_[np.arange(0.0, 10.0), 9.0 + step + np.arange(0.0, 10.0)]
    return t, cc.SensorLog(gyro=(t, np.zeros((20, 3)) if rate is None else rate))


@every_filter
def test_gap_grows_the_covariance(name: str) -> None:
    _, log = gap_log(30.0)
    start = {"q0": [1.0, 0, 0, 0], "sigma0": (1e-4, 1e-9)}
    wide, flagged = (
        navigator(FILTERS[name], gyro=cc.Gyro(ARW, RRW, max_gap=gap, gap_rate_sigma=2e-4))
        for gap in (30.0, 29.9)
    )
    plain, sol = wide.run(log, **start), flagged.run(log, **start)
    assert plain.gaps.shape == (0, 2)
    assert plain.counts["gaps"] == 0
    assert np.array_equal(sol.gaps, [[9.0, 39.0]])
    assert sol.counts["gaps"] == 1
    grown = sol.sigma**2 - plain.sigma**2
    assert np.abs(grown[:10]).max() == 0.0
    assert np.allclose(grown[10:, :3], (2e-4 * 30.0) ** 2, rtol=1e-9)
    assert np.abs(grown[10:, 3:]).max() < 1e-25
    none = navigator(FILTERS[name], gyro=cc.Gyro(ARW, RRW, max_gap=1.0, gap_rate_sigma=0.0))
    still = none.run(log, **start)
    assert still.counts["gaps"] == 1
    assert np.array_equal(still.sigma, plain.sigma)


def test_gap_is_three_median_steps_unless_given() -> None:
    for step, gaps in ((3.0, 0), (3.001, 1)):
        _, log = gap_log(step)
        start = {"q0": [1.0, 0, 0, 0], "sigma0": (1e-4, 1e-9)}
        assert navigator().run(log, **start).counts["gaps"] == gaps


@pytest.mark.parametrize("sampling", ["hold", "integrated", "average"])
def test_rate_in_a_gap_is_the_mean_of_its_ends(sampling: str) -> None:
    rate = np.zeros((20, 3))
    rate[9], rate[10] = [0.01, 0.0, 0.0], [0.03, 0.0, 0.0]
    _, log = gap_log(30.0, rate)
    nav = navigator(gyro=cc.Gyro(ARW, RRW, sampling=sampling))
    sol = nav.run(log, q0=[1.0, 0, 0, 0], sigma0=(1e-4, 1e-9), period=1.0)
    inside = (sol.t > 9.0) & (sol.t < 39.0)
    assert inside.sum() == 29
    assert np.abs(sol.rate[inside] - [0.02, 0.0, 0.0]).max() < 1e-15
    before, after = sol.q[9], sol.q[39]
    turned = quat.angle_between(before, after)
    assert turned == pytest.approx(30.0 * 0.02, abs=1e-12)


def test_fixes_inside_a_gap_divide_it() -> None:
    """The unknown rate is a noise density in a gap: its parts add up to the whole."""
    _, log = gap_log(30.0)
    start = {"q0": [1.0, 0, 0, 0], "sigma0": (1e-4, 1e-9)}
    nav = navigator(gyro=cc.Gyro(ARW, RRW), star=cc.StarCamera(covariance=1e6 * np.eye(3)))
    plain = nav.run(log, **start)
    blind = cc.SensorLog(gyro=log.gyro, star=([12.0, 25.0], [[1.0, 0, 0, 0]] * 2))
    with_fixes = nav.run(blind, **start)  # fixes that tell nothing
    assert np.allclose(with_fixes.sigma, plain.sigma, rtol=1e-6)
    sharp = navigator(gyro=cc.Gyro(ARW, RRW)).run(blind, **start)
    expected = SIGMA**2 + 1e-3**2 * 30.0 * (39.0 - 25.0)
    assert np.allclose(sharp.sigma[10, :3] ** 2, expected, rtol=1e-3)
