"""Time per gyro sample through the Python API, a star fix every second sample (`make bench`).

Nothing is asserted of a time: machines differ and are shared. Figures: `docs/benchmarks.md`.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import celestcore as cc
import numpy as np
import pytest

pytestmark = pytest.mark.bench

SAMPLES = 1_000_000
STEP = 0.01  # s
REPEATS = 7
ARW, RRW, SIGMA = 2.5e-5, 3e-7, 1.45e-4


@pytest.fixture(scope="module")
def log() -> cc.SensorLog:
    random = np.random.default_rng(1)
    t = STEP * np.arange(SAMPLES)
    phase = np.stack([np.sin(0.1 * t), np.cos(0.13 * t), 0.5 * np.sin(0.07 * t) + 0.5], axis=1)
    rate = 0.02 * phase
    q = cc.quaternion.propagate([1.0, 0.0, 0.0, 0.0], rate[:-1], STEP)
    gyro = rate + ARW / np.sqrt(STEP) * random.standard_normal((SAMPLES, 3))
    noise = cc.quaternion.exp(SIGMA * random.standard_normal((SAMPLES // 2, 3)))
    return cc.SensorLog(gyro=(t, gyro), star=(t[::2], cc.quaternion.multiply(q[::2], noise)))


def best(work: Callable[[], object]) -> float:
    """Return the shortest of some runs [s]."""
    times = []
    for _ in range(REPEATS):
        begin = time.perf_counter()
        work()
        times.append(time.perf_counter() - begin)
    return min(times)


def show(what: str, ns: float, more: str = "") -> None:
    print(f"{what:<44}{ns:8.0f} ns{more}")


def test_propagation(log: cc.SensorLog) -> None:
    assert log.gyro is not None
    rate = log.gyro.rate
    taken = best(lambda: cc.quaternion.propagate([1.0, 0.0, 0.0, 0.0], rate, STEP))
    show("quaternion.propagate", taken / SAMPLES * 1e9)


FILTERS = [cc.EKF(), cc.UKF(integrator="rk4"), cc.UKF(), cc.SRUKF(integrator="rk4")]


@pytest.mark.parametrize("kind", FILTERS, ids=lambda f: f"{f.kind}-{f.integrator}")
@pytest.mark.parametrize("every", [1, 10])
def test_run(log: cc.SensorLog, kind: cc.EKF | cc.UKF, every: int) -> None:
    nav = cc.StarGyroNavigator(kind, cc.Gyro(arw=ARW, rrw=RRW), cc.StarCamera(SIGMA))
    core: list[float] = []
    taken = best(lambda: core.append(nav.run(log, every=every).elapsed_s))
    beyond = taken / min(core) - 1.0
    name = f"run, {kind.kind} {kind.integrator}, a row every {every}"
    show(name, min(core) / SAMPLES * 1e9, f" in the core, {beyond:+.1%} from Python")


@pytest.mark.parametrize(
    "kind", [*FILTERS, cc.LiteralUKF()], ids=lambda f: f"{f.kind}-{f.integrator}"
)
def test_smooth(log: cc.SensorLog, kind: cc.EKF | cc.UKF) -> None:
    nav = cc.StarGyroNavigator(kind, cc.Gyro(arw=ARW, rrw=RRW), cc.StarCamera(SIGMA))
    core: list[float] = []
    best(lambda: core.append(nav.smooth(log, every=10).elapsed_s))
    name = f"smooth, {kind.kind} {kind.integrator}, a row every 10"
    show(name, min(core) / SAMPLES * 1e9, " in the core, there and back")


@pytest.mark.parametrize("kind", [cc.EKF(), cc.UKF()], ids=lambda f: f.kind)
def test_streaming_predict(log: cc.SensorLog, kind: cc.EKF | cc.UKF) -> None:
    assert log.gyro is not None
    n = 100_000
    nav = cc.StarGyroNavigator(kind, cc.Gyro(arw=ARW, rrw=RRW), cc.StarCamera(SIGMA))
    rows, times = list(log.gyro.rate[:n]), log.gyro.t[:n].tolist()

    def stream() -> None:
        predict = nav.start(t=0.0, q=[1.0, 0.0, 0.0, 0.0]).predict
        for t, rate in zip(times, rows, strict=True):
            predict(t, rate)

    alone = cc.SensorLog(gyro=(log.gyro.t[:n], log.gyro.rate[:n]))
    steps: list[float] = []
    begin = {"q0": [1.0, 0.0, 0.0, 0.0], "sigma0": (1e-3, 1e-3)}
    best(lambda: steps.append(nav.run(alone, every=1000, **begin).elapsed_s))
    taken, step = best(stream) / n * 1e9, min(steps) / n * 1e9
    show(f"streaming predict, {kind.kind}", taken, f", {taken - step:.0f} ns beyond the step")


@pytest.mark.parametrize("kind", [cc.EKF(), cc.UKF()], ids=lambda f: f.kind)
@pytest.mark.parametrize("size", [1, 10, 100, 10_000])
def test_streaming_blocks(log: cc.SensorLog, kind: cc.EKF | cc.UKF, size: int) -> None:
    assert log.gyro is not None
    n = 100_000 if size > 1 else 10_000
    nav = cc.StarGyroNavigator(kind, cc.Gyro(arw=ARW, rrw=RRW), cc.StarCamera(SIGMA))
    blocks = np.split(log.gyro.rate[:n], n // size)

    def stream() -> None:
        process = nav.start(t=0.0, q=[1.0, 0.0, 0.0, 0.0]).process
        for rates in blocks:
            process(rates, STEP)

    whole = log.gyro.rate[:n]
    taken = best(stream) / len(blocks) * 1e9
    step = best(lambda: nav.start(t=0.0, q=[1.0, 0.0, 0.0, 0.0]).process(whole, STEP)) / n * 1e9
    beyond = f", {taken - size * step:.0f} ns a block beyond the steps"
    show(f"process, {kind.kind}, blocks of {size}", taken / size, beyond)


def test_log_and_run_from_numpy(log: cc.SensorLog) -> None:
    assert log.gyro is not None
    gyro, star = log.gyro, log.stars["star"]
    given = [np.array(x) for x in (gyro.t, gyro.rate, star.t, star.q)]
    nav = cc.StarGyroNavigator(cc.EKF(), cc.Gyro(arw=ARW, rrw=RRW), cc.StarCamera(SIGMA))
    core: list[float] = []

    def whole() -> None:
        log = cc.SensorLog(gyro=tuple(given[:2]), star=tuple(given[2:]))
        core.append(nav.run(log, every=10).elapsed_s)

    taken = best(whole)
    more = f" in the core, {taken / min(core) - 1.0:+.1%} with the log made of arrays"
    show("log and run, EKF, a row every 10", min(core) / SAMPLES * 1e9, more)
