"""Prediction of an orbit over windows without fixes."""

from __future__ import annotations

import celestcore as cc
import numpy as np
import pytest
from celestcore.analysis import withheld_orbit
from celestcore.gnss import GaussMarkov, GnssReceiver, GnssStarScenario, GnssStarTrial

FORCE = cc.orbit.ForceModel(gravity=20)

pytest.importorskip("erfa")


@pytest.fixture(scope="module")
def trial() -> GnssStarTrial:
    """Truth and filter with the same forces: then the sigmas are right."""
    return GnssStarScenario(duration=10800.0, force=FORCE).trial(seed=3, trial=0)


def navigator(bias: GaussMarkov | None = None) -> cc.GnssStarNavigator:
    dynamics = cc.orbit.OrbitDynamics(FORCE, 1e-10)
    return cc.GnssStarNavigator(
        dynamics=dynamics, gnss=GnssReceiver(1.0, 0.01, bias=bias), gate=1.0
    )


@pytest.mark.parametrize("window", [60.0, 600.0])
def test_predicted_sigmas_cover_the_errors(trial: GnssStarTrial, window: float) -> None:
    found = withheld_orbit(navigator(), trial.log, window)
    assert len(found) > 150
    assert np.allclose(found.end - found.start, window)
    assert np.allclose(found.size, np.linalg.norm(found.error, axis=1))
    result = found.summary()
    assert 0.85 < result["inside_95"] <= 1.0
    assert 0.7 < result["ratio_rms"] < 1.3
    assert result["error_median_m"] <= result["error_95_m"] <= result["error_max_m"]
    parts = [result[f"{name}_rms_m"] for name in ("radial", "along", "normal")]
    assert np.linalg.norm(parts) == pytest.approx(result["error_rms_m"])


def test_the_prediction_is_the_filters_own(trial: GnssStarTrial) -> None:
    """The same as a run over a log whose fixes end where the window begins."""
    found = withheld_orbit(navigator(), trial.log, 600.0)
    k = 20
    gnss = trial.log.gnss
    assert gnss is not None
    known = gnss.t <= found.start[k]
    short = cc.SensorLog(
        epoch=trial.log.epoch,
        gnss=(gnss.t[known], gnss.r[known], gnss.v[known]),
    )
    last = navigator().run(short)
    there = cc.orbit.propagate(
        FORCE, trial.log.epoch, last.r[-1], last.v[-1], [found.start[k], found.end[k]]
    )
    at = np.searchsorted(gnss.t, found.end[k])
    fix = cc.frames.itrs_to_gcrs(trial.log.epoch, gnss.t[at]) @ gnss.r[at]
    assert np.linalg.norm(fix - there.r[-1]) == pytest.approx(found.size[k], abs=0.01)


def test_the_receivers_bias_is_part_of_the_prediction() -> None:
    scenario = GnssStarScenario(duration=10800.0, force=FORCE, gnss_markov=(10.0, 1800.0))
    log = scenario.trial(seed=3, trial=0).log
    with_bias = withheld_orbit(navigator(GaussMarkov(10.0, 1800.0)), log, 600.0).summary()
    without = withheld_orbit(navigator(), log, 600.0).summary()
    assert 0.8 < with_bias["inside_95"] <= 1.0
    assert without["inside_95"] < 0.5


def test_what_overlaps_is_counted_once(trial: GnssStarTrial) -> None:
    found = withheld_orbit(navigator(), trial.log, 600.0, every=60.0, settle=600.0)
    assert found.summary()["apart"] == (len(found) - 1) // 10 + 1
    apart = withheld_orbit(navigator(), trial.log, 600.0, every=600.0, settle=600.0)
    assert apart.summary()["apart"] == len(apart)


def test_gaps_take_no_part(trial: GnssStarTrial) -> None:
    gnss = trial.log.gnss
    assert gnss is not None
    kept = (gnss.t < 4000.0) | (gnss.t > 5000.0)
    log = cc.SensorLog(epoch=trial.log.epoch, gnss=(gnss.t[kept], gnss.r[kept], gnss.v[kept]))
    found = withheld_orbit(navigator(), log, 600.0)
    assert np.allclose(found.end - found.start, 600.0, atol=10.0)
    assert not ((found.end > 4000.0) & (found.end < 5000.0)).any()


def test_bad_windows(trial: GnssStarTrial) -> None:
    with pytest.raises(cc.InputError, match="greater than 0"):
        withheld_orbit(navigator(), trial.log, -1.0)
    with pytest.raises(cc.InputError, match="there is no window of 20000 s"):
        withheld_orbit(navigator(), trial.log, 20000.0)
    with pytest.raises(cc.InputError, match="needs GNSS fixes"):
        withheld_orbit(navigator(), cc.sample("fermi"), 60.0)
