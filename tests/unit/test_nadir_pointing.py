"""The attitude about the geodetic nadir, and the time tags that it tells."""

from __future__ import annotations

import celestcore as cc
import numpy as np
import pytest
from celestcore.analysis import NadirPointing, nadir_pointing

pytest.importorskip("erfa")


@pytest.fixture(scope="module")
def found() -> NadirPointing:
    log = cc.sample("noaa20")
    nav = cc.Settings.from_log(log).gnss_navigator()
    return nadir_pointing(nav, log, nav.run(log))


def test_noaa20_keeps_to_the_geodetic_nadir(found: NadirPointing) -> None:
    result = found.summary()
    np.testing.assert_allclose(result["std_deg"], [0.00060, 0.00081, 0.00021], atol=1e-5)
    assert result["largest_deg"] == pytest.approx(0.0041, abs=5e-5)
    assert np.abs(result["mean_deg"]).max() < 5e-5
    assert result["geocentric_largest_deg"] == pytest.approx(0.167, abs=1e-3)
    assert result["fixes"] == 7200


def test_noaa20s_time_tags_are_right(found: NadirPointing) -> None:
    """The attitude's tags are 0.1 s before the position's, and so is the attitude."""
    result = found.summary()
    assert result["tag_difference_s"] == pytest.approx(-0.1, abs=1e-6)
    assert result["found_difference_s"] == pytest.approx(-0.1, abs=1e-3)
    assert 0.001 < result["offset_sigma_s"] < 0.01


@pytest.mark.parametrize("late", [-0.1, 0.05])
def test_a_wrong_tag_is_found(late: float) -> None:
    log = cc.sample("noaa20")
    star, gnss = log.stars["star"], log.gnss
    assert gnss is not None
    moved = cc.SensorLog(
        epoch=log.epoch, star=(star.t + late, star.q), gnss=(gnss.t, gnss.r, gnss.v)
    )
    nav = cc.Settings.from_log(log).gnss_navigator()
    wrong = nadir_pointing(nav, moved, nav.run(moved))
    assert wrong.offset == pytest.approx(late, abs=1e-3)
    assert wrong.summary()["found_difference_s"] == pytest.approx(-0.1, abs=1e-3)


def test_a_body_that_looks_elsewhere_tells_no_time() -> None:
    trial = cc.gnss.GnssStarScenario(duration=1200.0).trial(seed=1, trial=0)
    nav = cc.GnssStarNavigator()
    log = trial.log
    turned = cc.quaternion.multiply(log.stars["star"].q, cc.quaternion.exp([0.3, 0.0, 0.0]))
    gnss = log.gnss
    assert gnss is not None
    other = cc.SensorLog(
        epoch=log.epoch, star=(log.stars["star"].t, turned), gnss=(gnss.t, gnss.r, gnss.v)
    )
    found = nadir_pointing(nav, other, nav.run(other))
    assert np.isnan([found.offset, found.offset_sigma]).all()
    with pytest.raises(cc.InputError, match="no rows at the times of star fixes"):
        nadir_pointing(nav, other, nav.run(other, t_output=[5.0, 15.0]))
