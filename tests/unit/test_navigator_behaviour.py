"""StarGyroNavigator.run: Ctrl-C, other threads, progress."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import celestcore as cc
import numpy as np
import pytest
from truth import (
    PER_FIX,
    PER_ROW,
    Truth,
    navigator,
    same_bits,
)

# behaviour: Ctrl-C, the GIL, progress


def long_log(n: int, fixes: int = 0) -> cc.SensorLog:
    t = np.arange(float(n))
    fix_t = np.linspace(0.0, n - 1.0, fixes) if fixes else np.zeros(1)
    q = np.tile([1.0, 0.0, 0.0, 0.0], (len(fix_t), 1))
    return cc.SensorLog(gyro=(t, np.zeros((n, 3))), star=(fix_t, q))


SLOW = navigator(cc.UKF(integrator="rk4"))
BUSY: dict[str, Callable[[], Callable[[], cc.Solution]]] = {}


def busy(function: Callable[[], Callable[[], cc.Solution]]) -> Any:
    BUSY[function.__name__] = function
    return function


@busy
def many_samples() -> Callable[[], cc.Solution]:
    log = long_log(1_000_000)
    return lambda: SLOW.run(log, every=1000)


@busy
def many_rows_between_few_samples() -> Callable[[], cc.Solution]:
    log = long_log(500)
    return lambda: SLOW.run(log, period=5e-4)


@busy
def many_fixes_between_few_samples() -> Callable[[], cc.Solution]:
    log = long_log(100, 500_000)
    return lambda: SLOW.run(log)


@contextmanager
def interrupted_after(delay: float) -> Iterator[list[float]]:
    """Send SIGINT to this process after a delay; yields when it was sent."""
    sent: list[float] = []
    done = threading.Event()

    def kill() -> None:
        if not done.wait(delay):
            sent.append(time.perf_counter())
            os.kill(os.getpid(), signal.SIGINT)

    thread = threading.Thread(target=kill)
    thread.start()
    try:
        yield sent
    finally:
        done.set()
        thread.join()


@pytest.mark.skipif(os.name == "nt", reason="os.kill ends the process there")
@pytest.mark.parametrize("kind", BUSY)
def test_ctrl_c_within_a_fifth_of_a_second(kind: str) -> None:
    run = BUSY[kind]()

    def for_ever() -> None:
        while True:
            run()

    waited = []
    for _ in range(3):  # a busy machine may let one attempt wait
        with interrupted_after(0.06) as sent, pytest.raises(KeyboardInterrupt):
            for_ever()
        waited.append(time.perf_counter() - sent[0])
        if waited[-1] < 0.2:
            break
    assert min(waited) < 0.2


def test_other_threads_run_on() -> None:
    log = long_log(600_000)
    ticks: list[float] = []
    done = threading.Event()

    def tick() -> None:
        while not done.wait(0.002):
            ticks.append(time.perf_counter())

    thread = threading.Thread(target=tick)
    thread.start()
    began = time.perf_counter()
    sol = SLOW.run(log, every=1000)
    ended = time.perf_counter()
    done.set()
    thread.join()
    assert sol.elapsed_s > 0.1
    stops = np.diff([began, *[t for t in ticks if began < t < ended], ended])
    assert stops.max() < 0.5 * sol.elapsed_s


def test_two_runs_at_once_give_the_same_bits() -> None:
    truth = Truth(n=20_000)
    log, nav = truth.log(), navigator(cc.UKF())
    alone = nav.run(log)
    found: list[cc.Solution] = []
    threads = [threading.Thread(target=lambda: found.append(nav.run(log))) for _ in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(found) == 3
    for sol in found:
        same_bits(sol, alone, PER_ROW + PER_FIX)


def test_progress_is_told() -> None:
    n = 600_000
    told: list[tuple[int, int]] = []
    sol = SLOW.run(long_log(n), every=1000, progress=lambda done, total: told.append((done, total)))
    assert len(told) >= 2
    done = [d for d, _ in told]
    assert done == sorted(set(done))
    assert 0 < done[0] < done[-1] < n
    assert {total for _, total in told} == {n}
    same_bits(sol, SLOW.run(long_log(n), every=1000), PER_ROW)


@pytest.mark.parametrize("kind", [RuntimeError, KeyboardInterrupt, SystemExit, cc.CelestcoreError])
def test_an_error_in_progress_comes_out(kind: type[BaseException]) -> None:
    error = kind("stop here")

    def progress(done: int, total: int) -> None:
        raise error

    with pytest.raises(kind) as caught:
        SLOW.run(long_log(600_000), every=1000, progress=progress)
    assert caught.value is error


def test_a_run_inside_progress() -> None:
    small = Truth().log()
    inner: list[cc.Solution] = []
    SLOW.run(
        long_log(300_000),
        every=1000,
        progress=lambda *_: inner.append(navigator().run(small)),
    )
    assert inner
    same_bits(inner[0], navigator().run(small), PER_ROW)


def test_repr_names_everything() -> None:
    text = repr(navigator(cc.SRUKF(), gate=0.99))
    for part in ("SRUKF(", "Gyro(arw=1e-06", "StarCamera(", "gate=0.99"):
        assert part in text
