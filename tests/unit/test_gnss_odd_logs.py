"""The GNSS and star navigator on odd logs: shared epochs, short gyros, many restarts."""

from __future__ import annotations

from dataclasses import replace

import celestcore as cc
import numpy as np
import pytest
from celestcore.gnss import GnssStarScenario
from celestcore.orbit import ForceModel, OrbitDynamics

J2 = ForceModel.j2()
DYNAMICS = OrbitDynamics(J2, 1e-8)
SCENARIO = GnssStarScenario(force=J2, duration=1200.0, lfe=())
NAV = cc.GnssStarNavigator(dynamics=DYNAMICS)
GYRO = cc.Gyro(0.005 * cc.DEG_PER_SQRT_HOUR, 0.01 * cc.DEG_PER_HOUR / 60)


def log_of(made, **tables):
    own = {name: table for name, table in made.log.tables.items() if name not in tables}
    new = {name: table for name, table in tables.items() if table is not None}
    return cc.SensorLog(epoch=made.log.epoch, **own, **new)


def test_a_lever_arm_with_two_star_sensors_at_the_same_epochs():
    arm = (0.5, 0.2, -1.0)
    made = replace(SCENARIO, lever_arm=arm).trial(seed=1)
    star = made.log.stars["star"]
    nav = cc.GnssStarNavigator(dynamics=DYNAMICS, lever_arm=arm)
    one = nav.run(made.log)
    two = nav.run(log_of(made, star=None, star_1=(star.t, star.q), star_2=(star.t, star.q)))
    np.testing.assert_allclose(two.r, one.r, atol=1e-6)


@pytest.mark.parametrize("rows", [slice(0, 600), slice(300, None), slice(0, 1), slice(0, 2)])
def test_beyond_a_short_gyro_the_sigma_grows(rows):
    """Its rate is held there, and the body turns: what is not known must be said."""
    made = replace(SCENARIO, gyro=cc.gnss.GYRO).trial(seed=1)
    gyro, star = made.log.gyro, made.log.stars["star"]
    seen = (star.t < 250.0) | (star.t > 950.0)
    log = log_of(made, gyro=(gyro.t[rows], gyro.rate[rows]), star=(star.t[seen], star.q[seen]))
    nav = cc.GnssStarNavigator(dynamics=DYNAMICS, gyro=GYRO)
    with pytest.warns(cc.CelestcoreWarning, match="gap_rate_sigma") as said:
        sol = nav.run(log, t_output=made.t)
    assert not [w for w in said if w.category is RuntimeWarning]
    assert not sol.attitude_restarts
    assert sol.counts["star_rejected"] == 0
    turned = cc.quaternion.multiply(cc.quaternion.conjugate(sol.q), made.q_ib)
    assert (np.abs(cc.quaternion.log(turned)) < 5.0 * sol.sigma_q).all()
