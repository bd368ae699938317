"""StarGyroNavigator.run: what is written, and when."""

from __future__ import annotations

import celestcore as cc
import numpy as np
import pytest
from celestcore import quaternion as quat
from hypothesis import given, settings
from hypothesis import strategies as st
from truth import (
    ARW,
    FILTERS,
    PER_FIX,
    PER_ROW,
    RRW,
    Truth,
    close,
    directions,
    errors,
    every_filter,
    navigator,
    same_bits,
    same_end,
)

# what is written, and when


@every_filter
@pytest.mark.parametrize("every", [1, 2, 3, 7, 399, 1000])
def test_every(name: str, every: int) -> None:
    truth = Truth()
    log = truth.log(star=(truth.t[5::3] + 0.01, truth.fixes(truth.t[5::3] + 0.01)))
    start = {"q0": truth.q[0], "sigma0": (1e-3, 1e-4)}
    nav = navigator(FILTERS[name])
    full, part = nav.run(log, **start), nav.run(log, every=every, covariance=True, **start)
    assert np.array_equal(full.t, truth.t)
    for column in PER_ROW:
        assert np.array_equal(getattr(part, column), getattr(full, column)[::every]), column
    same_bits(full, part, PER_FIX)
    same_end(full, part)


@every_filter
@pytest.mark.parametrize("period", [0.125, 0.375, 1.0, 0.03125, 0.05, 7.77, 1e3])
def test_period_does_not_disturb_the_filter(name: str, period: float) -> None:
    truth = Truth()
    t = np.sort(truth.rng.uniform(-1.0, truth.t[-1] + 1.0, 300))
    inside = (t >= 0) & (t <= truth.t[-1])
    log = truth.log(star=(t, truth.fixes(np.clip(t, 0.0, truth.t[-1]))))
    nav = navigator(FILTERS[name])
    start = {"q0": truth.q[0], "sigma0": (1e-3, 1e-4)}
    full, part = nav.run(log, **start), nav.run(log, period=period, covariance=True, **start)
    same_bits(full, part, PER_FIX)
    same_end(full, part)
    assert len(part.measurement_t) == inside.sum()
    rows = int(np.floor(truth.t[-1] / period)) + 1
    assert np.array_equal(part.t, period * np.arange(rows))
    both, i, j = np.intersect1d(full.t, part.t, return_indices=True)
    assert len(both) >= 1
    assert quat.angle_between(full.q[i], part.q[j]).max() < 1e-12
    for column in ("bias", "sigma"):
        assert np.abs(getattr(full, column)[i] - getattr(part, column)[j]).max() < 1e-12, column


def test_rows_between_samples_are_predictions() -> None:
    truth = Truth(noisy=False)
    log = truth.log(each=0)
    nav = navigator(gyro=cc.Gyro(ARW, RRW))
    sol = nav.run(log, q0=truth.q[0], sigma0=(1e-9, 1e-9), bias0=truth.bias[0], period=0.05)
    assert errors(sol, truth).max() < 1e-12
    assert np.all(np.diff(sol.sigma[:, :3], axis=0) > 0.0)


@pytest.mark.parametrize("sampling", ["hold", "integrated", "average"])
def test_rate_of_a_row_is_that_of_its_time(sampling: str) -> None:
    truth = Truth()
    log = truth.log(each=0)
    nav = navigator(gyro=cc.Gyro(ARW, RRW, sampling=sampling))
    start = {"q0": truth.q[0], "sigma0": (1e-9, 1e-9)}
    full, part = nav.run(log, **start), nav.run(log, period=0.0625, **start)
    assert np.array_equal(full.rate, truth.measured)
    before, after = truth.measured[:-1], truth.measured[1:]
    step = {"hold": before, "integrated": after, "average": 0.5 * (before + after)}
    assert np.array_equal(part.rate[1::2], step[sampling])  # between two samples
    assert np.array_equal(part.rate[::2], truth.measured)  # at a sample, as with every=1


@settings(max_examples=150, deadline=None)
@given(
    first=st.floats(-1e6, 1e6),
    dt=st.floats(1e-3, 10.0),
    n=st.integers(1, 40),
    period=st.floats(1e-2, 1e2),
    late=st.floats(0.0, 1.0),
)
def test_period_rows_are_all_written(
    first: float, dt: float, n: int, period: float, late: float
) -> None:
    t = first + dt * np.arange(n)
    log = cc.SensorLog(gyro=(t, np.zeros((n, 3))))
    t0 = first + late * (t[-1] - first)
    sol = navigator().run(
        log, q0=[1.0, 0.0, 0.0, 0.0], sigma0=(1.0, 1.0), t0=t0, period=dt * period
    )
    assert np.array_equal(sol.t, t0 + dt * period * np.arange(len(sol)))
    assert sol.t[-1] <= t[-1] < t0 + dt * period * len(sol)
    assert np.all(sol.sigma > 0.0)
    assert np.array_equal(sol.q, np.tile([1.0, 0.0, 0.0, 0.0], (len(sol), 1)))


@settings(max_examples=150, deadline=None)
@given(n=st.integers(1, 40), every=st.integers(1, 50), late=st.floats(0.0, 1.0))
def test_every_rows_are_all_written(n: int, every: int, late: float) -> None:
    t = np.arange(float(n))
    log = cc.SensorLog(gyro=(t, np.zeros((n, 3))), star=(t, np.tile([1.0, 0, 0, 0], (n, 1))))
    t0 = late * t[-1]
    sol = navigator().run(log, q0=[1.0, 0, 0, 0], sigma0=(1.0, 1.0), t0=t0, every=every)
    assert np.array_equal(sol.t, [t0, *t[int(t0) :: every][1:]])
    assert np.all(sol.sigma > 0.0)
    assert np.array_equal(sol.measurement_t, t[t >= t0])
    assert np.all(sol.innovation_sigma > 0.0)


def test_columns_of_a_run() -> None:
    truth = Truth()
    star_t = truth.t[::2]
    log = truth.log(epoch="2026-01-01T00:00:00", title="made up", frames={"body": "bus"})
    sol = navigator(cc.UKF(), gate=0.9).run(log)
    n, m = truth.n, len(star_t) - 1
    shapes = {"t": (n,), "q": (n, 4), "rate": (n, 3), "bias": (n, 3), "sigma": (n, 6)}
    shapes |= {"measurement_t": (m,), "sensor": (m,), "nis": (m,), "dof": (m,), "accepted": (m,)}
    shapes |= {"innovation": (m, 3), "innovation_sigma": (m, 3), "gaps": (0, 2)}
    for name, shape in shapes.items():
        assert getattr(sol, name).shape == shape, name
    assert sol.covariance is None
    assert (sol.epoch, sol.title, sol.filter) == ("2026-01-01T00:00:00", "made up", "ukf")
    assert sol.frames["body"] == "bus"
    assert sol.sensor_names == ["star"]
    assert np.array_equal(sol.measurement_t, star_t[1:])
    assert np.all(sol.dof == 3)
    assert np.abs(np.linalg.norm(sol.q, axis=1) - 1.0).max() < 1e-14
    assert np.array_equal(sol.rate, truth.measured - sol.bias)
    assert sol.elapsed_s > 0.0
    counts = sol.counts
    assert counts["samples"] == n
    assert counts["fixes"] == m + 1
    assert counts["start"] == 1
    assert counts["accepted"] + counts["rejected"] == m
    assert counts["rejected"] == np.count_nonzero(~sol.accepted) > 0


@every_filter
def test_covariance(name: str) -> None:
    truth = Truth()
    log, nav = truth.log(), navigator(FILTERS[name])
    sol, plain = nav.run(log, covariance=True), nav.run(log)
    same_bits(sol, plain, PER_ROW + PER_FIX)
    p = sol.covariance
    assert p is not None
    assert p.shape == (truth.n, 6, 6)
    assert np.abs(np.sqrt(np.diagonal(p, axis1=1, axis2=2)) / sol.sigma - 1.0).max() < 1e-12
    assert np.array_equal(p, p.transpose(0, 2, 1))
    scaled = p / (sol.sigma[:, :, None] * sol.sigma[:, None, :])
    assert np.linalg.eigvalsh(scaled).min() > 1e-6
    assert np.abs(scaled[-1] - np.eye(6)).max() > 0.01  # attitude and bias are correlated
    assert np.array_equal(p[-1], sol.final["covariance"])
    assert np.array_equal(sol.q[-1], sol.final["q"])
    assert sol.t[-1] == sol.final["t"]


@every_filter
def test_runs_give_the_same_bits(name: str) -> None:
    truth = Truth()
    t = truth.t[:-1:3] + 0.01
    log = truth.log(star_2=(t, truth.fixes(t)))
    for portable in (False, True):
        nav = navigator(FILTERS[name], gate=0.999)
        a = nav.run(log, covariance=True, portable=portable)
        b = nav.run(log, covariance=True, portable=portable)
        same_bits(a, b, (*PER_ROW, *PER_FIX, "covariance"))
        same_end(a, b)
    close(nav.run(log), nav.run(log, portable=True), 1e-11)


def test_filters_agree() -> None:
    truth = Truth(n=2000)
    log = truth.log(vector_sun=(truth.t[::5], *directions(truth, truth.t[::5], [0.0, 0.6, 0.8])))
    runs = [navigator(f, vector=cc.VectorSensor(1e-3)).run(log) for f in FILTERS.values()]
    for other in runs[1:]:
        late = runs[0].t > 20.0
        apart = quat.angle_between(runs[0].q, other.q)[late]
        assert np.all(apart < 1e-4 * runs[0].sigma[late, :3].min())
        relative = np.abs(other.bias - runs[0].bias)[late] / runs[0].sigma[late, 3:]
        assert relative.max() < 1e-3
        assert np.abs(other.sigma / runs[0].sigma - 1.0)[late].max() < 1e-5


def test_errors_are_as_predicted() -> None:
    ratios = []
    for seed in range(20):
        truth = Truth(n=1000, seed=seed)
        sol = navigator().run(truth.log())
        late = sol.t > 30.0
        dtheta = quat.log(quat.multiply(quat.conjugate(sol.q), truth.at(sol.t)))
        ratios.append((np.c_[dtheta, truth.bias - sol.bias] / sol.sigma)[late])
    rms = np.sqrt(np.mean(np.square(ratios), axis=(0, 1)))
    assert np.all((rms > 0.7) & (rms < 1.3))


def test_sign_of_q_is_continuous_over_several_turns() -> None:
    n = 2000
    t = 0.1 * np.arange(n)
    rate = np.tile([0.0, 0.3, 0.0], (n, 1))
    q = quat.propagate([1.0, 0.0, 0.0, 0.0], rate[:-1], 0.1)
    signs = np.where(np.random.default_rng(1).random(n) < 0.5, -1.0, 1.0)
    signs[0] = 1.0
    log = cc.SensorLog(gyro=(t, rate), star=(t, q * signs[:, None]))
    for kind in FILTERS.values():
        sol = navigator(kind).run(log)
        assert np.all(np.einsum("ni,ni->n", sol.q[1:], sol.q[:-1]) > 0.99)
        assert np.abs(sol.q - q).max() < 1e-6  # past a whole turn, q is on the other side
        assert sol.q[:, 0].min() < -0.99


def test_inputs_are_left_alone_and_outputs_are_fresh() -> None:
    truth = Truth()
    q0, bias0, sigma0 = truth.q[0].copy(), truth.bias[0].copy(), np.array([[1e-3] * 3, [1e-4] * 3])
    log = truth.log()
    before = [q0.copy(), bias0.copy(), sigma0.copy(), log.gyro.rate.copy()]
    sol = navigator().run(log, q0=q0, bias0=bias0, sigma0=sigma0)
    for was, now in zip(before, [q0, bias0, sigma0, log.gyro.rate], strict=True):
        assert np.array_equal(was, now)
    for name in PER_ROW + PER_FIX:
        column = getattr(sol, name)
        assert column.flags.c_contiguous
        assert column.flags.writeable
        assert not np.shares_memory(column, log.gyro.t)
