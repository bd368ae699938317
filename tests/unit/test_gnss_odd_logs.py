"""The GNSS and star navigator on odd logs: shared epochs, short gyros, many restarts."""

from __future__ import annotations

from dataclasses import replace

import celestcore as cc
import numpy as np
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
