"""A log of a GNSS receiver alone has an orbit and no attitude."""

from __future__ import annotations

import celestcore as cc
import numpy as np
import pytest


@pytest.mark.parametrize("call", ["run", "smooth"])
def test_orbit_without_stars(call: str) -> None:
    made = cc.gnss.GnssStarScenario(force=cc.orbit.ForceModel.j2(), duration=300.0).trial(1, 0)
    gnss = made.log.gnss
    assert gnss is not None
    alone = cc.SensorLog(epoch=made.log.epoch, gnss=(gnss.t, gnss.r, gnss.v))
    found, both = (getattr(cc.GnssStarNavigator(), call)(log) for log in (alone, made.log))
    assert found.q is None
    np.testing.assert_array_equal(found.r, both.r)
