"""Bad input to smooth, calibrate and fixed-lag streams: clear errors that leave all as it was."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import celestcore as cc
import numpy as np
import pytest
from celestcore import quaternion as quat

T = np.arange(50.0)
RATE = np.tile([0.0, 0.0, 0.01], (50, 1))
Q = quat.propagate([1.0, 0.0, 0.0, 0.0], RATE[:-1], 1.0)
IDENTITY = [1.0, 0.0, 0.0, 0.0]
START: dict[str, Any] = {"q0": IDENTITY, "sigma0": (1e-3, 1e-4)}
LOG = cc.SensorLog(gyro=(T, RATE), star=(T[::2], Q[::2]))
TWO = cc.SensorLog(gyro=(T, RATE), star_1=(T[::2], Q[::2]), star_2=(T[::2], Q[::2]))
THREE = cc.SensorLog(
    gyro=(T, RATE), star_1=(T[::2], Q[::2]), star_2=(T[::2], Q[::2]), star_3=(T[::2], Q[::2])
)


def navigator(filter: Any = None) -> cc.StarGyroNavigator:  # noqa: A002
    return cc.StarGyroNavigator(filter, cc.Gyro(1e-6, 1e-9), cc.StarCamera(1e-5))


def smooth(log: Any = LOG, **options: Any) -> cc.Solution:
    return navigator().smooth(log, **options)


def calibrate(log: Any = LOG, **options: Any) -> Any:
    return navigator().calibrate(log, **options)


def without_source() -> cc.Solution:
    sol: cc.Solution = navigator().run(LOG)[10.0:20.0]
    return sol


SMOOTHS: dict[str, tuple[Callable[[], Any], str]] = {
    "period": (lambda: smooth(period=1.0), r"period, value 1.*smooth.*every"),
    "period of the run": (
        lambda: smooth(navigator().run(LOG, period=2.0)),
        r"period, value 2.*smooth.*every",
    ),
    "unknown option": (lambda: smooth(sigma=1.0), r"sigma: is not an option; known are t0, q0"),
    "unknown option with a solution": (
        lambda: smooth(navigator().run(LOG), evry=2),
        r"evry: is not an option; known are .*every",
    ),
    "part of a solution": (lambda: smooth(without_source()), r"log: .*SensorLog instead"),
    "no log": (lambda: smooth(None), r"log.*must be SensorLog"),
    "a tuple": (lambda: smooth((T, RATE)), r"log.*must be SensorLog"),
    "no gyro": (lambda: smooth(cc.SensorLog(star=(T, Q))), r"no gyro table; it has star"),
    "no fixes": (lambda: smooth(cc.SensorLog(gyro=(T, RATE))), r"no star camera.*give .*q0"),
    "every 0": (lambda: smooth(every=0), r"every, value 0"),
    "every 1.5": (lambda: smooth(every=1.5), r"every, value 1\.5"),
    "progress": (lambda: smooth(progress=1), r"progress.*callable"),
    "t0": (lambda: smooth(t0=1.0), r"t0, value 1\.0: goes with q0"),
    "sigma0": (lambda: smooth(q0=IDENTITY), r"sigma0: is needed with q0"),
    "not definite": (
        lambda: smooth(q0=IDENTITY, covariance0=-np.eye(6)),
        r"initial covariance",
    ),
}

CALIBRATES: dict[str, tuple[Callable[[], Any], str]] = {
    "scale 0": (lambda: calibrate(scale_sigma=0.0), r"scale_sigma, value 0\.0: .*greater than 0"),
    "misalignment nan": (
        lambda: calibrate(misalignment_sigma=np.nan),
        r"misalignment_sigma, value nan: must be finite",
    ),
    "alignment below 0": (lambda: calibrate(alignment_sigma=-0.1), r"alignment_sigma, value -0\.1"),
    "three cameras": (
        lambda: calibrate(THREE),
        r"aligned: .*more than two cameras: one of star_1, star_2, star_3",
    ),
    "unknown camera": (
        lambda: calibrate(TWO, aligned="star_9"),
        r"aligned, value 'star_9': is no star table.*star_1, star_2",
    ),
    "one camera": (lambda: calibrate(aligned="star"), r"aligned: needs a second camera"),
    "no camera": (
        lambda: calibrate(cc.SensorLog(gyro=(T, RATE)), aligned="star", **START),
        r"aligned, value 'star': .*it has none",
    ),
    "unknown option": (lambda: calibrate(scale=1.0), r"scale: is not an option"),
    "no gyro": (lambda: calibrate(cc.SensorLog(star=(T, Q))), r"no gyro table"),
    "errors of a gyro": (lambda: cc.Gyro(1e-6, errors=np.eye(3)), r"gyro\.errors.*small beside 1"),
    "two errors": (lambda: cc.Gyro(1e-6, errors=np.zeros(3)), r"gyro\.errors: has shape \(3,\)"),
    "nan errors": (
        lambda: cc.Gyro(1e-6, errors=np.full((3, 3), np.nan)),
        r"gyro\.errors, value nan: must be",
    ),
}

LAGS: dict[str, tuple[Callable[[], Any], str]] = {
    "lag 0": (lambda: navigator().start(0.0, IDENTITY, lag=0.0), r"lag, value 0\.0: .*greater"),
    "lag below 0": (lambda: navigator().start(0.0, IDENTITY, lag=-1.0), r"lag, value -1\.0"),
    "lag nan": (lambda: navigator().start(0.0, IDENTITY, lag=np.nan), r"lag, value nan: .*finite"),
    "lag inf": (lambda: navigator().start(0.0, IDENTITY, lag=np.inf), r"lag, value inf: .*finite"),
    "no lag": (lambda: navigator().start(0.0, IDENTITY).smoothed(), r"lag.*start with a lag"),
}


@pytest.mark.parametrize("case", [*SMOOTHS, *CALIBRATES, *LAGS])
def test_message(case: str) -> None:
    call, message = {**SMOOTHS, **CALIBRATES, **LAGS}[case]
    with pytest.raises(cc.CelestcoreError, match=message):
        call()


def test_a_smoother_that_overflows_is_an_error() -> None:
    """Rates that are finite, turns that are not."""
    log = cc.SensorLog(gyro=(T, np.full((50, 3), 1e300)))
    for filter in (cc.EKF(), cc.UKF(), cc.SRUKF(), cc.InvariantEKF(), cc.LiteralUKF()):  # noqa: A001
        with pytest.raises(cc.NumericalError, match="step"):
            navigator(filter).smooth(log, **START)


def test_inputs_are_left_alone() -> None:
    assert LOG.gyro is not None
    before = [LOG.gyro.rate.copy(), LOG.stars["star"].q.copy()]
    options: dict[str, Any] = {"q0": np.array(IDENTITY), "sigma0": (np.ones(3), np.ones(3))}
    sol = navigator().run(LOG, **options)
    kept = {name: getattr(sol, name).copy() for name in ("q", "bias", "sigma", "nis")}
    best = navigator().smooth(sol, every=2)
    for name, was in kept.items():
        assert np.array_equal(getattr(sol, name), was), name
        assert not np.shares_memory(getattr(best, name), getattr(sol, name))
    assert np.array_equal(before[0], LOG.gyro.rate)
    assert np.array_equal(before[1], LOG.stars["star"].q)
    assert sol.source is not None
    assert sol.source[1]["every"] == 1  # options given to smooth are not the solution's
