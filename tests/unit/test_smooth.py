"""StarGyroNavigator.smooth: its rows, its options, and how it behaves."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import textwrap
import threading
import time
from functools import lru_cache
from typing import Any

import celestcore as cc
import numpy as np
import pytest
from celestcore import quaternion as quat
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

Array = NDArray[np.float64]
SIGMA = 5 * cc.ARCSEC
GYRO = cc.Gyro(0.3 * cc.ARCSEC, 0.01 * cc.ARCSEC)
FILTERS = {
    "ekf": cc.EKF(),
    "ukf": cc.UKF(),
    "srukf": cc.SRUKF(),
    "iterated": cc.IteratedEKF(),
    "invariant": cc.InvariantEKF(),
    "literal": cc.LiteralUKF(),
}
every_filter = pytest.mark.parametrize("name", FILTERS)
PER_ROW = ("t", "q", "rate", "bias", "sigma")
PER_FIX = ("measurement_t", "sensor", "nis", "dof", "accepted", "innovation", "innovation_sigma")


def navigator(filter: Any = None, **options: Any) -> cc.StarGyroNavigator:  # noqa: A002
    return cc.StarGyroNavigator(filter, **{"gyro": GYRO, "star": cc.StarCamera(SIGMA), **options})


@lru_cache
def truth(n: int = 800) -> tuple[Array, Array, Array]:
    """Return times, rates and attitudes of a body that turns slowly."""
    t = 0.25 * np.arange(n)
    rate = 0.02 * np.sin(0.1 * t[:, None] + [0.0, 1.0, 2.0]) + [0.0, 0.001, 0.0]
    return t, rate, quat.propagate(quat.exp([0.3, -0.5, 0.8]), rate[:-1], 0.25)


def make_log(n: int = 800, seed: int = 0) -> cc.SensorLog:
    """Return a log with fixes at samples, and between them from a second camera."""
    rng = np.random.default_rng(seed)
    t, rate, q = truth(n)
    measured = rate + 1e-5 + 0.3 * cc.ARCSEC / 0.5 * rng.standard_normal((n, 3))
    one = quat.multiply(q[::2], quat.exp(SIGMA * rng.standard_normal((len(q[::2]), 3))))
    k = np.arange(1, n - 1, 5)
    two = quat.multiply(
        quat.slerp(q[k], q[k + 1], 0.4), quat.exp(SIGMA * rng.normal(size=(len(k), 3)))
    )
    return cc.SensorLog(gyro=(t, measured), star_1=(t[::2], one), star_2=(t[k] + 0.1, two))


def same_bits(a: cc.Solution, b: cc.Solution, names: tuple[str, ...]) -> None:
    for name in names:
        assert np.array_equal(getattr(a, name), getattr(b, name), equal_nan=True), name


@every_filter
def test_last_row_is_the_filters_last(name: str) -> None:
    log, nav = make_log(), navigator(FILTERS[name])
    run, best = nav.run(log, covariance=True), nav.smooth(log, covariance=True)
    assert (run.smoothed, best.smoothed) == (False, True)
    assert "smoothed" in repr(best)
    assert np.array_equal(best.t, run.t)
    for column in ("q", "bias", "sigma", "rate", "covariance"):
        a, b = getattr(best, column)[-1], getattr(run, column)[-1]
        if name == "srukf":  # which carries a square root
            np.testing.assert_allclose(np.abs(a), np.abs(b), rtol=1e-12, atol=1e-20)
        else:
            assert np.array_equal(
                a if column != "q" else np.abs(a), b if column != "q" else np.abs(b)
            )
    for key in ("t", "bias", "sigma", "covariance"):
        assert np.array_equal(best.final[key], run.final[key]), key
    same_bits(best, run, PER_FIX)
    assert best.log_likelihood == run.log_likelihood
    assert best.counts == run.counts


@every_filter
def test_sigma_is_never_above_the_filters(name: str) -> None:
    log, nav = make_log(), navigator(FILTERS[name])
    run, best = nav.run(log), nav.smooth(log)
    assert np.all(best.sigma <= run.sigma * (1.0 + 1e-9))
    assert np.all(best.sigma[:-40] < 0.99 * run.sigma[:-40])
    assert np.abs(best.sigma[1:, :3] / best.sigma[:-1, :3] - 1.0).max() < 0.1  # no saw of fixes


@every_filter
def test_rows_do_not_depend_on_how_many_are_written(name: str) -> None:
    log, nav = make_log(200), navigator(FILTERS[name])
    full = nav.smooth(log, covariance=True)
    for every in (2, 7, 199, 1000):
        some = nav.smooth(log, every=every, covariance=True)
        for column in (*PER_ROW, "covariance"):
            a, b = getattr(some, column), getattr(full, column)[::every]
            if column == "q":  # the sign goes on from row to row, from the end
                a, b = a * np.sign(a[:, :1]), b * np.sign(b[:, :1])
            assert np.array_equal(a, b), (every, column)
        same_bits(some, full, PER_FIX)


def test_smoothers_agree_on_fine_data() -> None:
    log = make_log()
    start: dict[str, Any] = {"sigma0": (1.0, 1e-5)}
    first = navigator(cc.EKF()).smooth(log, **start)
    allowed = {"ukf": 1e-5, "srukf": 1e-5, "iterated": 1e-4, "invariant": 1e-4, "literal": 1e-4}
    for name, tolerance in allowed.items():
        other = navigator(FILTERS[name]).smooth(log, **start)
        apart = quat.log(quat.multiply(quat.conjugate(first.q), other.q)) / first.sigma[:, :3]
        worst = max(
            np.abs(apart).max(),
            np.abs((other.bias - first.bias) / first.sigma[:, 3:]).max(),
            np.abs(other.sigma / first.sigma - 1.0).max(),
        )
        print(f"{name}: {worst:.1e}")
        assert worst < tolerance, name


@every_filter
def test_same_bits_every_time_and_on_any_machine(name: str) -> None:
    log, nav = make_log(300), navigator(FILTERS[name], gate=0.9999)
    for portable in (False, True):
        a, b = (nav.smooth(log, covariance=True, portable=portable) for _ in range(2))
        same_bits(a, b, (*PER_ROW, *PER_FIX, "covariance"))
    a, b = nav.smooth(log), nav.smooth(log, portable=True)
    assert quat.angle_between(a.q, b.q).max() < 1e-11
    assert np.abs(a.sigma / b.sigma - 1.0).max() < 1e-8


def test_a_solution_knows_its_log_and_options() -> None:
    log, nav = make_log(300), navigator()
    start: dict[str, Any] = {"q0": truth(300)[2][0], "sigma0": (1e-3, 1e-4), "bias0": [1e-6, 0, 0]}
    sol = nav.run(log, every=3, covariance=True, **start)
    best = nav.smooth(sol)
    same_bits(best, nav.smooth(log, every=3, covariance=True, **start), (*PER_ROW, *PER_FIX))
    assert best.covariance is not None
    assert len(best) == len(sol) == 100
    assert len(nav.smooth(sol, every=1)) == 300  # an option given anew goes first
    assert nav.smooth(sol, covariance=False).covariance is None
    again = nav.smooth(best)
    same_bits(again, best, (*PER_ROW, *PER_FIX))
    other = navigator(cc.UKF()).smooth(sol)  # another navigator on the same log
    assert other.filter == "ukf"
    assert np.abs(other.bias - best.bias).max() < 1e-9


def test_start_inside_the_log_and_fixes_outside() -> None:
    log = make_log(300)
    t, _, q = truth(300)
    nav = navigator()
    sol = nav.smooth(log, t0=t[100] + 0.03, q0=q[100], sigma0=(1e-2, 1e-4))
    assert sol.t[0] == t[100] + 0.03
    assert len(sol) == 200
    error = quat.log(quat.multiply(quat.conjugate(sol.q[1:]), q[101:])) / sol.sigma[1:, :3]
    assert np.abs(error).max() < 5.0
    assert sol.sigma[0, 0] < 1e-4  # a start that knew little knows what came after


def test_a_log_of_one_sample() -> None:
    log = cc.SensorLog(gyro=([5.0], [[0.1, 0.2, 0.3]]), star=([5.0], [[0.0, 1.0, 0.0, 0.0]]))
    sol = navigator().smooth(log)
    assert np.array_equal(np.abs(sol.q), [[0.0, 1.0, 0.0, 0.0]])
    assert sol.smoothed


def test_sign_of_q_is_continuous() -> None:
    n = 2000
    t = 0.1 * np.arange(n)
    rate = np.tile([0.0, 0.3, 0.0], (n, 1))
    q = quat.propagate([1.0, 0.0, 0.0, 0.0], rate[:-1], 0.1)
    best = navigator().smooth(cc.SensorLog(gyro=(t, rate), star=(t, q)))
    assert np.all(np.einsum("ni,ni->n", best.q[1:], best.q[:-1]) > 0.99)


def test_mountings_and_gyro_errors_are_those_of_run() -> None:
    """The same log as other sensors see it gives the same answer."""
    log = make_log(300)
    assert log.gyro is not None
    errors = np.array([[1e-3, 2e-3, 0.0], [0.0, -1e-3, 5e-4], [-3e-4, 0.0, 2e-3]])
    turn = Rotation.from_rotvec([0.5, 1.0, -0.3])
    star, other = log.stars["star_1"], log.stars["star_2"]
    seen = cc.SensorLog(
        gyro=(log.gyro.t, turn.inv().apply(log.gyro.rate @ (np.eye(3) + errors).T)),
        star_1=(star.t, Rotation.from_quat(star.q, scalar_first=True) * turn),
        star_2=other,
    )
    cameras = {"star_1": cc.StarCamera(SIGMA, mounting=turn), "star_2": cc.StarCamera(SIGMA)}
    gyro = cc.Gyro(GYRO.arw, GYRO.rrw, mounting=turn, errors=errors)
    a = navigator().smooth(log)
    b = navigator(gyro=gyro, star=cameras).smooth(seen)
    assert quat.angle_between(a.q, b.q).max() < 1e-11
    assert np.abs(a.bias - b.bias).max() < 1e-12


# behaviour: memory, progress, Ctrl-C


def still(n: int) -> cc.SensorLog:
    t = np.arange(float(n))
    return cc.SensorLog(gyro=(t, np.zeros((n, 3))), star=([0.0], [[1.0, 0.0, 0.0, 0.0]]))


def test_progress_goes_there_and_back() -> None:
    n = 600_000
    told: list[tuple[int, int]] = []
    slow = navigator(cc.UKF(integrator="rk4"))
    slow.smooth(still(n), every=1000, progress=lambda done, total: told.append((done, total)))
    done = [d for d, _ in told]
    assert {total for _, total in told} == {2 * n}
    assert done == sorted(set(done))
    assert done[0] < n < done[-1] <= 2 * n


def test_an_error_in_progress_comes_out() -> None:
    """On the way back as well as on the way there."""
    n = 400_000

    def progress(done: int, total: int) -> None:
        if done > n:
            raise RuntimeError("stop here")

    with pytest.raises(RuntimeError, match="stop here"):
        navigator(cc.UKF(integrator="rk4")).smooth(still(n), every=1000, progress=progress)


@pytest.mark.skipif(os.name == "nt", reason="os.kill ends the process there")
def test_ctrl_c_on_the_way_back() -> None:
    nav, log = navigator(cc.UKF(integrator="rk4")), still(1_000_000)
    sent: list[float] = []

    def progress(done: int, total: int) -> None:
        if done > total // 2 and not sent:
            sent.append(time.perf_counter())
            threading.Timer(0.01, os.kill, (os.getpid(), signal.SIGINT)).start()

    waited = []
    for _ in range(3):  # a busy machine may let one attempt wait
        sent.clear()
        with pytest.raises(KeyboardInterrupt):
            nav.smooth(log, every=1000, progress=progress)
        waited.append(time.perf_counter() - sent[0])
        if waited[-1] < 0.25:
            break
    assert min(waited) < 0.25


MEMORY = """
    from pathlib import Path
    import numpy as np
    import celestcore as cc
    def peak():  # a child's ru_maxrss begins at its parent's
        lines = Path("/proc/self/status").read_text().splitlines()
        return next(float(line.split()[1]) for line in lines if line.startswith("VmHWM")) / 1e6
    n = {n}
    t = 0.1 * np.arange(n)
    log = cc.SensorLog(
        gyro=(t, np.zeros((n, 3))), star=(t[::2], np.tile([1.0, 0, 0, 0], (len(t[::2]), 1)))
    )
    nav = cc.StarGyroNavigator(cc.{name}(), cc.Gyro(1e-6, 1e-9), cc.StarCamera(1e-5))
    before = peak()
    sol = nav.smooth(log)
    assert len(sol) == n
    print(before, peak())
"""


def peak(n: int, name: str) -> tuple[float, float]:
    """Return GB before a smoothing and at its peak, in a process of its own."""
    code = textwrap.dedent(MEMORY.format(n=n, name=name))
    out = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    before, after = (float(x) for x in out.stdout.split())
    return before, after


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
def test_memory_of_an_hour() -> None:
    before, after = peak(36_000, "EKF")
    print(f"{before:.3f} GB, {after:.3f} GB")
    assert after - before < 2.0 / 24.0 + 0.02


@pytest.mark.long
@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
@pytest.mark.parametrize("name", ["EKF", "UKF", "SRUKF", "LiteralUKF"])
def test_a_day_at_10_hz_in_less_than_2_gb(name: str) -> None:
    before, after = peak(864_000, name)
    print(f"{name}: {before:.2f} GB, {after:.2f} GB")
    assert after < 2.0
