"""Works of the whole package: sample by sample from Python, a long log, a campaign."""

from __future__ import annotations

import time

import numpy as np

from celestcore import simulate
from celestcore.bench import _inputs
from celestcore.bench._attitude import navigator
from celestcore.bench._clock import clocked
from celestcore.bench._inputs import AttitudeInput
from celestcore.bench._work import Timed, Work
from celestcore.filters import EKF
from celestcore.log import SensorLog
from celestcore.montecarlo import monte_carlo

EVERY = 10
"""Gyro samples for each output row of the long log."""
ORBIT = 5659.4
"""Length of a trial of the campaign [s]."""


def _stream(given: AttitudeInput) -> Timed:
    nav = navigator(EKF(), given)
    rows, times = list(given.gyro), given.t.tolist()
    predict = nav.start(t=0.0, q=given.q0).predict

    def stream() -> None:
        for t, rate in zip(times, rows, strict=True):
            predict(t, rate)

    taken, _ = clocked(stream)
    alone = SensorLog(gyro=(given.t, given.gyro))
    core = nav.run(alone, q0=given.q0, sigma0=(1e-3, 1e-3), every=given.steps).elapsed_s
    return Timed(1e9 * taken / given.steps, base=1e9 * core / given.steps)


def _long(steps: int) -> SensorLog:
    """Return a log that repeats a short one's readings: its length is what counts."""
    short = _inputs.attitude(min(steps, 100_000))
    times = -(-steps // short.steps)
    gyro = np.tile(short.gyro[:-1], (times, 1))[:steps]
    t = short.dt * np.arange(steps)
    q = np.tile([1.0, 0.0, 0.0, 0.0], (steps // 2, 1))
    return SensorLog(gyro=(t, gyro * 1e-3), star=(t[::2][: len(q)], q))


def _whole(log: SensorLog) -> Timed:
    assert log.gyro is not None
    nav, samples = navigator(EKF(), _inputs.attitude(100)), len(log.gyro)
    began = time.perf_counter()
    solution = nav.run(log, every=EVERY)
    taken = time.perf_counter() - began
    return Timed(1e9 * taken / samples, base=1e9 * solution.elapsed_s / samples)


def _scenario(trials: int) -> tuple[simulate.Scenario, int]:
    flown = simulate.earth_pointing(ORBIT if trials >= 100 else 100.0)
    gyro = simulate.GyroErrors(1e-7, 1e-10, bias_sigma=1e-5)
    return simulate.Scenario(flown, gyro, simulate.StarErrors(1e-5, every=2)), trials


def _campaign(given: tuple[simulate.Scenario, int]) -> Timed:
    scenario, trials = given
    nav, taken = scenario.navigator(EKF()), []
    for threads in (1, 2):
        began = time.perf_counter()
        monte_carlo(scenario, nav, trials, seed=1, threads=threads)
        taken.append(time.perf_counter() - began)
    return Timed(1e9 * taken[1] / trials, base=1e9 * taken[0] / trials)


def works() -> list[Work]:
    """Return the works of the whole package."""
    return [
        Work(
            name="streaming",
            title="streaming predict from Python, MEKF",
            item="sample",
            size=100_000,
            quick=1000,
            make=_inputs.attitude,
            run=_stream,
            base="the same step in a whole log",
        ),
        Work(
            name="whole_run",
            title="a log of 1e7 samples from numpy, MEKF, a row every 10 samples",
            item="sample",
            size=10_000_000,
            quick=20_000,
            make=_long,
            run=_whole,
            base="the core writing the same columns",
            once=True,
        ),
        Work(
            name="campaign",
            title="1000 Monte Carlo runs of an orbit at 10 Hz, two threads",
            item="run",
            size=1000,
            quick=8,
            make=_scenario,
            run=_campaign,
            base="one thread",
            once=True,
        ),
    ]
