"""Wrong star fixes at the start of a log must not start the attitude filter."""

from __future__ import annotations

import celestcore as cc
import numpy as np
import pytest
from celestcore import quaternion
from celestcore.gnss._attitude_start import agreeing
from celestcore.gnss.scenario import GYRO

J2 = cc.orbit.ForceModel.j2()
SIGMA = 20.0 * cc.ARCSEC


@pytest.mark.parametrize("gyro", [False, True])
@pytest.mark.parametrize("bad", [(0,), (1,), (2,), (0, 1), (0, 4, 6)])
def test_wrong_first_fixes_do_not_matter(bad: tuple[int, ...], gyro: bool) -> None:
    scenario = cc.gnss.GnssStarScenario(force=J2, lfe=(), gyro=GYRO if gyro else None)
    made = scenario.trial(3, 0)
    star = made.log.stars["star"]
    q = star.q.copy()
    for k in bad:
        q[k] = quaternion.multiply(q[k], quaternion.exp((k + 1) * np.array([1e-3, 4e-3, -2e-3])))
    gnss, table = made.log.gnss, made.log.gyro
    assert gnss is not None
    more = {} if table is None else {"gyro": (table.t, table.rate)}
    log = cc.SensorLog(
        epoch=made.log.epoch, gnss=(gnss.t, gnss.r, gnss.v), star=(star.t, q), **more
    )
    sensor = cc.Gyro(arw=float(GYRO.arw[0]), rrw=float(GYRO.rrw[0])) if gyro else None
    nav = cc.GnssStarNavigator(dynamics=J2, star=cc.StarCamera(SIGMA), gyro=sensor)
    found = nav.run(log)
    assert found.q is not None
    error = quaternion.log(quaternion.multiply(quaternion.conjugate(found.q), made.q_ib))
    assert np.abs(error[30:]).max() < 4.0 * SIGMA


def test_good_fixes_agree() -> None:
    rng, t = np.random.default_rng(2), np.arange(8) * 10.0
    motion = 1e-3 * t[:, None] * np.array([1.0, -2.0, 0.5]) + 1e-5 * t[:, None] ** 2
    left = 0
    for _ in range(300):
        q = quaternion.exp(motion + SIGMA * rng.standard_normal((8, 3)))
        left += int(np.sum(~agreeing(t, q, np.full(8, SIGMA), 1e-16, 2)))
    assert left <= 3


def test_without_a_majority_all_are_kept() -> None:
    rng, t = np.random.default_rng(2), np.arange(8) * 10.0
    q = quaternion.exp(0.1 * rng.standard_normal((8, 3)))
    assert agreeing(t, q, np.full(8, SIGMA), 1e-16, 2).all()
    assert agreeing(t[:3], q[:3], np.full(3, SIGMA), 1e-16, 2).all()


def test_an_orbit_that_is_still_being_found_does_not_turn_the_body() -> None:
    """Coarse positions alone: at first the orbital frame turns to and fro by minutes of arc."""
    scenario = cc.gnss.GnssStarScenario(
        force=J2, lfe=(), gnss_sigma=10.0, gnss_velocity=False, duration=600.0
    )
    nav = cc.GnssStarNavigator(
        dynamics=J2, gnss=cc.GnssReceiver(10.0, None), star=cc.StarCamera(SIGMA)
    )
    for k in range(25):
        made = scenario.trial(9, k)
        found = nav.run(made.log)
        assert found.counts["star_rejected"] <= 2, k
        assert found.q is not None
        error = quaternion.log(quaternion.multiply(quaternion.conjugate(found.q), made.q_ib))
        assert np.abs(error[30:]).max() < 5.0 * SIGMA
