"""Faults put into a log: what was injected, what was detected, what was survived.

The rule for every fault that the sensors can tell from the truth: error and sigma may not fit for
`ALLOWED` seconds at most. What one camera alone cannot tell (it has turned, or the gyro has; its
clock has jumped; it drifts) is listed as such, and must at least be noticed where it is sudden.
``docs/howto/faults.md`` holds the table that this file prints (``pytest -s``).
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass

import celestcore as cc
import numpy as np
import pytest
from celestcore import replay, simulate
from celestcore.simulate import faults

pytest.importorskip("pyarrow")

BEGIN, END = 300.0, 420.0
ALLOWED = 60.0
RATE = 0.0011  # rad/s: the body turns once an orbit
SIGMA = 20 * cc.ARCSEC
TILT = cc.quaternion.exp([0.0, 0.5, 0.0])

SURVIVED, AMBIGUOUS, HIDDEN = "survived", "noticed", "hidden"


@dataclass(frozen=True)
class Fault:
    """What is done to the log, by how many cameras it is seen, and what is expected."""

    name: str
    inject: Callable[[cc.SensorLog], cc.SensorLog]
    expected: str = SURVIVED
    cameras: int = 1
    noticed: bool = True


def drifting(log):
    """A slow turn of the only camera's mount looks like the bias of the gyro."""
    star = log.stars["star_1"]
    angle = 1e-6 * np.maximum(star.t - BEGIN, 0.0)
    extra = cc.quaternion.exp(angle[:, None] * np.array([0.0, 0.0, 1.0]))
    q = cc.quaternion.multiply(star.q, extra)
    return cc.SensorLog(gyro=log.gyro, star_1=(star.t, q))


def blinded(log):
    return faults.dropout(log, "star_1", BEGIN, END)


def turned(log):
    return faults.jump(log, "star_1", BEGIN, END, [0.0, 0.05, 0.0])


def stuck(log):
    return faults.stuck(log, "star_1", BEGIN, END)


def late(log):
    return faults.clock_jump(log, "star_1", BEGIN, 2.0)


FAULTS = [
    Fault("none", lambda log: log, noticed=False),
    Fault("camera blinded", blinded, noticed=False),
    Fault("gyro silent for 20 s", lambda g: faults.dropout(g, "gyro", BEGIN, BEGIN + 20.0)),
    Fault("gyro stuck", lambda g: faults.stuck(g, "gyro", BEGIN, END), noticed=False),
    Fault("gyro bias step", lambda g: faults.bias_step(g, BEGIN, 1e9, [0.0, 2e-4, 0.0])),
    Fault("gyro axis lost", lambda g: faults.lost_axis(g, BEGIN, 1e9, 1)),
    Fault("gyro clock jumps", lambda g: faults.clock_jump(g, "gyro", BEGIN, 3.0)),
    Fault("signs flipped", lambda g: faults.sign_flips(g, "star_1", 0.5), noticed=False),
    Fault("20 % outliers", lambda g: faults.outliers(g, "star_1", 0.2, 0.02)),
    Fault("one of two cameras turned", turned, cameras=2),
    Fault("one of two cameras stuck", stuck, cameras=2),
    Fault("one of two cameras late", late, cameras=2),
    Fault("only camera turned", turned, AMBIGUOUS),
    Fault("only camera stuck", stuck),
    Fault("only camera late", late, AMBIGUOUS),
    Fault("cameras swapped", lambda g: faults.swapped(g, "star_1", "star_2"), AMBIGUOUS, 2),
    Fault("only camera drifts", drifting, HIDDEN, noticed=False),
]


@pytest.fixture(scope="module")
def flight():
    truth = simulate.constant_rate([0.0, -RATE, 0.0], 900.0, dt=0.1)
    scenario = simulate.Scenario(
        truth,
        simulate.GyroErrors(1e-5, 1e-8, bias_sigma=1e-6),
        {
            "star_1": simulate.StarErrors(SIGMA, every=10),
            "star_2": simulate.StarErrors(SIGMA, every=10, mounting=TILT),
        },
    )
    return scenario.simulate(seed=5)


def navigator(cameras):
    star = {"star_1": cc.StarCamera(SIGMA), "star_2": cc.StarCamera(SIGMA, mounting=TILT)}
    named = {name: star[name] for name in list(star)[:cameras]}
    return cc.StarGyroNavigator(cc.EKF(), cc.Gyro(1e-5, 1e-8), named, gate=0.9999)


def survived(fault, flight, folder):
    """Replay; return for how long error and sigma do not fit, and whether the fault was noticed."""
    log = flight.log
    if fault.cameras == 1:
        log = cc.SensorLog(gyro=log.gyro, star_1=log.stars["star_1"])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", cc.CelestcoreWarning)
        summary = replay.run(
            fault.inject(log), navigator(fault.cameras), folder, window=100.0, max_rejected=20
        )
    found = replay.read(folder)
    rows, truth = found["rows"], flight.truth
    inside = rows["t"] <= truth.t[-1]
    q = np.stack([rows[c][inside] for c in ("qw", "qx", "qy", "qz")], axis=1)
    error = cc.quaternion.angle_between(q, truth.at(rows["t"][inside]))
    assert np.isfinite(error).all()
    sigma = np.linalg.norm([rows[c][inside] for c in ("s_ax", "s_ay", "s_az")], axis=0)
    bad = 0.1 * np.count_nonzero(error > 5.0 * sigma + 5 * cc.ARCSEC)
    gaps = np.diff(rows["t"]).max() > 1.0
    return bad, bool(summary.restarts) or summary.rejected > 20 or gaps, error.max()


@pytest.mark.parametrize("fault", FAULTS, ids=[f.name for f in FAULTS])
def test_a_fault_is_survived_or_said(fault, flight, tmp_path):
    bad, noticed, worst = survived(fault, flight, tmp_path / "out")
    said = "yes" if noticed else "no"
    print(f"| {fault.name} | {said} | {bad:.0f} s | {worst / cc.ARCSEC:.0f}″ |")
    assert noticed == fault.noticed
    if fault.expected == SURVIVED:
        assert bad <= ALLOWED
    else:  # if it were survived, it would not be listed among those that cannot be told
        assert bad > ALLOWED
