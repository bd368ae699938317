"""The smoother: batch least squares on arcsecond data, and errors as large as it says."""

from __future__ import annotations

from functools import lru_cache

import celestcore as cc
import numpy as np
import pytest
from events import Flown, Plan, fly, least_squares
from measure import bounds, inside, quadratic
from scipy.spatial.transform import Rotation
from simulate import FloatArray, changing_rate, local

RUNS = 64
SEED = 20260301
R1 = np.array([[4.0, 1.0, 0.5], [1.0, 2.0, -0.3], [0.5, -0.3, 9.0]])
"""Noise of a camera in units of its best axis; not diagonal."""
MOUNTINGS = {
    name: Rotation.from_rotvec(v).as_quat()[[3, 0, 1, 2]]
    for name, v in (("star_1", [0.4, -1.0, 2.0]), ("star_2", [-2.0, 0.1, 0.5]))
}


def uneven(n: int, seed: int, low: float = 0.3, high: float = 0.7) -> FloatArray:
    """Return times that begin at 0, of uneven steps."""
    return np.concatenate([[0.0], np.cumsum(np.random.default_rng(seed).uniform(low, high, n))])


def between(t: FloatArray, part: float, rows: slice) -> FloatArray:
    """Return times inside the steps that begin at some rows."""
    return t[:-1][rows] + part * np.diff(t)[rows]


def arcsecond_plan() -> Plan:
    """Two cameras of some arcseconds, one off the gyro's times, 0.02 rad a step."""
    t = uneven(60, 1)
    s = 2 * cc.ARCSEC
    return Plan(
        t=t,
        rate=changing_rate(61, 0.04),
        arw=0.5 * cc.ARCSEC,
        rrw=0.02 * cc.ARCSEC,
        sigma0=(20 * cc.ARCSEC, 2 * cc.ARCSEC),
        cameras={
            "star_1": (t[2::5], R1 * s**2, MOUNTINGS["star_1"]),
            "star_2": (between(t, 0.4, slice(3, None, 11)), R1 * s**2, MOUNTINGS["star_2"]),
        },
        directions={},
    )


@lru_cache
def batch() -> tuple[Flown, FloatArray, FloatArray, FloatArray]:
    flown = fly(arcsecond_plan(), 1, SEED)
    sol = flown.plan.navigator(cc.EKF()).run(flown.log(0), **flown.start(0))
    k = np.searchsorted(sol.t, flown.plan.events, side="right") - 1
    turned = cc.quaternion.exp(sol.rate[k] * (flown.plan.events - sol.t[k])[:, None])
    guess = (cc.quaternion.multiply(sol.q[k], turned), sol.bias[k])
    return flown, *least_squares(flown, 0, guess)


SMOOTHERS = {
    "ekf": cc.EKF(),
    "ukf": cc.UKF(),
    "srukf": cc.SRUKF(),
    "iterated": cc.IteratedEKF(),
    "invariant": cc.InvariantEKF(),
    "literal": cc.LiteralUKF(),
}


@pytest.mark.parametrize("kind", SMOOTHERS)
def test_smoother_is_batch_least_squares(kind: str) -> None:
    """Mean and covariance at every gyro sample, to a thousandth of the smoothed sigma."""
    flown, q, bias, p = batch()
    sol = flown.plan.navigator(SMOOTHERS[kind]).smooth(flown.log(0), **flown.start(0))
    k = np.searchsorted(flown.plan.events, sol.t)
    sigma = np.sqrt(np.diagonal(p[k], axis1=1, axis2=2))
    off = np.hstack([local(q[k], sol.q), sol.bias - bias[k]]) / sigma
    assert sol.covariance is not None
    wide = (sol.covariance - p[k]) / (sigma[:, :, None] * sigma[:, None, :])
    print(f"{kind}: mean {np.abs(off).max():.1e} sigma, covariance {np.abs(wide).max():.1e}")
    assert np.abs(off).max() < 1e-3
    assert np.abs(wide).max() < 1e-3
    np.testing.assert_allclose(sol.sigma, sigma, rtol=1e-3)


def test_batch_is_no_copy_of_the_filter() -> None:
    """What it is compared with has teeth: the filter itself is another estimate."""
    flown, q, _, p = batch()
    sol = flown.plan.navigator(cc.EKF()).run(flown.log(0), **flown.start(0))
    k = np.searchsorted(flown.plan.events, sol.t)
    sigma = np.sqrt(np.diagonal(p[k], axis1=1, axis2=2))
    assert np.abs(local(q[k], sol.q) / sigma[:, :3]).max() > 0.5
    assert (sol.sigma[:, :3] / sigma[:, :3]).mean() > 1.2


def everything_plan() -> Plan:
    """Two cameras and a direction, off the grid, a gap of the gyro in the middle."""
    t = uneven(320, 2)
    t[160:] += 6.0
    s = 1e-4
    return Plan(
        t=t,
        rate=changing_rate(321, 0.05),
        arw=2e-5,
        rrw=1e-5,
        sigma0=(1e-2, 1e-3),
        cameras={
            "star_1": (between(t, 0.7, slice(0, None, 2)), R1 * s**2, MOUNTINGS["star_1"]),
            "star_2": (t[1::3], R1 * s**2, MOUNTINGS["star_2"]),
        },
        directions={"sun": (between(t, 0.2, slice(2, None, 2)), s, np.array([0.6, -0.48, 0.64]))},
        max_gap=3.0,
        gap_rate_sigma=1e-3,
    )


def fast_plan() -> Plan:
    """Half a radian in a step, each fix as good as a step of the gyro."""
    t = np.arange(241.0)
    return Plan(
        t=t,
        rate=changing_rate(241, 0.5),
        arw=1e-6,
        rrw=1e-5,
        sigma0=(1e-3, 1e-4),
        cameras={"star_1": (t, R1 * 1e-12, MOUNTINGS["star_1"])},
        directions={},
    )


def directions_plan() -> Plan:
    """Two directions and no camera: no measurement tells the whole attitude."""
    t = uneven(320, 3)
    known = {"sun": np.array([0.6, -0.48, 0.64]), "field": np.array([-0.28, 0.96, 0.0])}
    return Plan(
        t=t,
        rate=changing_rate(321, 0.05),
        arw=1e-4,
        rrw=4e-5,
        sigma0=(3e-3, 1e-3),
        cameras={},
        directions={
            name: (between(t, part, slice(k, None, 2)), 1e-4, known[name])
            for k, (name, part) in enumerate((("sun", 0.3), ("field", 0.6)))
        },
    )


PLANS = {
    # the plan, rows between epochs, share of outliers, gate
    "everything": (everything_plan(), 40, 0.0, None),
    "gated": (everything_plan(), 40, 0.03, 0.999999),
    "fast": (fast_plan(), 24, 0.0, None),
    "directions": (directions_plan(), 40, 0.0, None),
}
CASES = [
    *[("everything", kind) for kind in ("ekf", "ukf", "srukf", "iterated", "invariant")],
    ("gated", "ekf"),
    ("gated", "srukf"),
    ("fast", "ekf"),
    ("fast", "ukf"),
    ("fast", "invariant"),
    ("directions", "ekf"),
    ("directions", "ukf"),
]


@lru_cache
def flights(plan: str) -> Flown:
    return fly(PLANS[plan][0], RUNS, SEED, PLANS[plan][2])


@lru_cache
def smoothed(plan: str, kind: str, told: float = 1.0) -> tuple[FloatArray, FloatArray]:
    """Return errors (runs, epochs, 6) and covariances at epochs; `told` scales the gyro's noise."""
    flown = flights(plan)
    _, spacing, outliers, gate = PLANS[plan]
    nav = flown.plan.navigator(SMOOTHERS[kind], gate)
    if told != 1.0:
        gyro = cc.Gyro(
            told * nav.gyro.arw,
            told * nav.gyro.rrw,
            max_gap=nav.gyro.max_gap,
            gap_rate_sigma=nav.gyro.gap_rate_sigma,
        )
        nav = cc.StarGyroNavigator(nav.filter, gyro, nav.star, nav.vector, gate=gate)
    errors, covariances = [], []
    for trial in range(RUNS):
        sol = nav.smooth(flown.log(trial), every=spacing, **flown.start(trial))
        assert sol.covariance is not None
        wrong = 1.0 - sol.counts["accepted"] / sol.counts["fixes"]
        assert wrong < 0.05 if outliers else wrong == 0.0
        errors.append(flown.error(sol, trial))
        covariances.append(sol.covariance)
    return np.array(errors), np.array(covariances)


def faults(errors: FloatArray, covariances: FloatArray) -> list[str]:
    out = []
    for dof in (3, 6):
        nees = quadratic(errors[..., :dof], covariances[..., :dof, :dof])
        mean, within = nees.mean(), bounds(0.999, dof, nees.size)
        print(f"NEES of {dof}: {mean / dof:.3f} in {within[0] / dof:.3f} .. {within[1] / dof:.3f}")
        if not within[0] < mean < within[1]:
            out.append(f"NEES of {dof}: mean {mean:.3f} outside {within}")
        allowed = bounds(1.0 - 1e-3 / nees.shape[1], dof, RUNS)
        if not np.all(inside(nees.mean(axis=0), allowed)):
            out.append(f"NEES of {dof}: an epoch outside {allowed}")
    return out


@pytest.mark.parametrize(("plan", "kind"), CASES)
def test_smoother_is_consistent(plan: str, kind: str) -> None:
    assert faults(*smoothed(plan, kind)) == []


@pytest.mark.parametrize("plan", ["everything", "fast", "directions"])
def test_epochs_are_independent(plan: str) -> None:
    errors, covariances = smoothed(plan, "ekf")
    white = np.linalg.solve(np.linalg.cholesky(covariances), errors[..., None])[..., 0]
    together = np.einsum("nki,nkj->ij", white[:, :-1], white[:, 1:]) / white[:, 1:, 0].size
    assert np.linalg.norm(together, 2) < 5.0 * np.sqrt(6.0 / white[:, 1:, 0].size)


@pytest.mark.parametrize("plan", ["everything", "fast", "directions"])
def test_wrong_noise_is_noticed(plan: str) -> None:
    assert faults(*smoothed(plan, "ekf", 0.85)) != []


def test_smoothing_pays() -> None:
    """The errors themselves are smaller, not only what is said of them."""
    flown = flights("everything")
    nav = flown.plan.navigator(cc.EKF())
    before, after = [], []
    for trial in range(0, RUNS, 4):
        log, start = flown.log(trial), flown.start(trial)
        before.append(flown.error(nav.run(log, **start), trial)[40:])
        after.append(flown.error(nav.smooth(log, **start), trial)[40:])
    ratio = np.sqrt(
        np.mean(np.square(after), axis=(0, 1)) / np.mean(np.square(before), axis=(0, 1))
    )
    print("smoothed over filtered rms", ratio.round(3))
    assert np.all(ratio < 0.9)
