"""The GNSS and star navigator on odd logs: shared epochs, short gyros, many restarts."""

from __future__ import annotations

from dataclasses import replace

import celestcore as cc
import numpy as np
import pytest
from celestcore.gnss import GnssReceiver, GnssStarScenario
from celestcore.gnss._segments import in_segments, many_refused
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


@pytest.mark.parametrize("off", [2e3, 5e4])
def test_a_wrong_start_is_given_up(off):
    made = SCENARIO.trial(seed=1)
    for call in (NAV.run, NAV.smooth):
        with pytest.warns(cc.CelestcoreWarning, match="started again at t = 0 s.*a wrong r0"):
            sol = call(made.log, r0=made.r_i[0] + [off, 0, 0], v0=made.v_i[0], sigma0=(10.0, 0.1))
        assert sol.restarts == [0.0]
        assert np.linalg.norm(sol.r - made.r_i, axis=1).max() < 5.0


class Jumps:
    """A filter that is lost after every hundredth stop, and counts the stops it has gone over."""

    def __init__(self, n):
        self.t, self.gone = np.arange(float(n)), 0

    def rows(self, t):
        return np.flatnonzero(self.t >= t)

    def times(self, rows):
        return self.t[rows]

    def go(self, stops, start, rows, *, back):
        assert (self.t[rows] <= self.t[stops][-1]).all() or rows[-1] == len(self.t) - 1
        self.gone += len(self.t[stops])
        return {"t": self.t[stops], "start": start[0]}

    def lost(self, out, rows):
        next_jump = 100.0 * (1 + out["start"] // 100)
        return np.array([next_jump] if out["t"][-1] >= next_jump + 10.0 else [])

    def again(self, lost, t):
        return (t, np.zeros(1), np.eye(1))


def test_many_restarts_cost_no_square():
    runs = Jumps(100_000)
    start = (0.0, np.zeros(1), np.eye(1))
    segments, restarts = in_segments(runs, runs.t, start, back=False)
    assert restarts == (100.0 * np.arange(1, 1000)).tolist()
    np.testing.assert_array_equal(np.concatenate([out["t"] for out, _ in segments]), runs.t)
    assert runs.gone < 15 * len(runs.t)


def test_restarts_far_apart_are_all_found():
    long = replace(SCENARIO, duration=40_000.0, star_step=1000.0)
    made, ahead = (replace(long, gnss_offset=s).trial(seed=1) for s in (0.0, 0.1))
    gnss, later = made.log.gnss, ahead.log.gnss
    use = ((gnss.t > 5000.0) & (gnss.t < 30_000.0))[:, None]
    log = log_of(
        made, gnss=(gnss.t, np.where(use, later.r, gnss.r), np.where(use, later.v, gnss.v))
    )
    with pytest.warns(cc.CelestcoreWarning, match="started again at t = 5010, 30000 s"):
        sol = NAV.run(log)
    assert sol.restarts == [5010.0, 30_000.0]
    assert sol.t.tolist() == made.t.tolist()


def test_runs_of_refused_fixes():
    refused = np.array([0, 1, 1, 1, 1, 1, 1, 1, 0, 1, 1, 0, 1, 1, 1], bool)
    t = np.arange(15.0)
    assert many_refused(refused, t, 3).tolist() == [1.0, 4.0, 12.0]
    assert many_refused(refused, t, None).tolist() == []
    assert many_refused(refused[:2], t[:2], 3).tolist() == []


@pytest.mark.parametrize("kick", [0.0, 3.0])
def test_after_fixes_that_no_orbit_fits_the_filter_finds_the_orbit_again(kick):
    """Eight minutes of garbage; after a manoeuvre in it the old orbit does not come back."""
    made = replace(SCENARIO, duration=4000.0).trial(seed=1)
    gnss, rng = made.log.gnss, np.random.default_rng(2)
    late = made.t >= 1500.0
    new = cc.orbit.propagate(
        J2, None, made.r_i[150], made.v_i[150] + [0.0, 0.0, kick], made.t[late]
    )
    r_e, v_e = cc.frames.to_itrs(made.log.epoch, made.t[late], new.r, new.v)
    r, v = gnss.r.copy(), gnss.v.copy()
    r[late], v[late] = r_e + rng.normal(size=r_e.shape), v_e + 0.01 * rng.normal(size=v_e.shape)
    r[150:200] += 1e3 * rng.normal(size=(50, 3))
    log = log_of(made, gnss=(gnss.t, r, v))
    for call in (NAV.run, NAV.smooth):
        with pytest.warns(cc.CelestcoreWarning) as said:
            sol = call(log)
        assert sum("no orbit fits them" in str(w.message) for w in said) == 1
        assert len(sol.restarts) == 1
        assert sol.t.tolist() == made.t.tolist()
        # found at the latest when it has gone on for as long again
        assert np.linalg.norm(sol.r[250:] - new.r[100:], axis=1).max() < 5.0


def test_monte_carlo_with_time_offsets():
    """Epochs of the truth before the first and after the last fix are not scored."""
    scenario = replace(SCENARIO, duration=600.0, gnss_offset=-0.3, star_offset=0.4)
    receiver = GnssReceiver(time_offset=0.3)
    nav = cc.GnssStarNavigator(dynamics=DYNAMICS, gnss=receiver, star_time_offset=-0.4)
    one = nav.monte_carlo(scenario, 2, seed=1, smooth=True)
    assert not one["ekf"].failures
    assert (one["ekf"].rms_position < 1.0).all()
    early = replace(scenario, star_offset=-0.4)
    nav = cc.GnssStarNavigator(dynamics=DYNAMICS, gnss=receiver, star_time_offset=0.4)
    assert not nav.monte_carlo(early, 2, seed=1)["ekf"].failures


def test_errors_name_the_log_and_the_argument():
    made = SCENARIO.trial(seed=1)
    gnss = made.log.gnss
    with pytest.raises(cc.InputError, match=r"^gnss, .*needs two fixes at least"):
        NAV.run(log_of(made, gnss=(gnss.t[:1], gnss.r[:1])))
    with pytest.raises(cc.InputError, match=r"outside the log's span, 0\.0 to 1200\.0 s"):
        NAV.run(made.log, t_output=[1300.0])
    state = NAV.start(0.0, made.r_i[0], made.v_i[0], epoch=made.log.epoch)
    with pytest.raises(cc.InputError, match=r"^r_e.*kilometres"):
        state.update_gnss(0.0, gnss.r[0] / 1e3)
    with pytest.raises(cc.InputError, match=r"^v_e.*km/s"):
        state.update_gnss(0.0, gnss.r[0], gnss.v[0] / 1e3)


def test_a_geostationary_satellite_hardly_moves_over_the_ground():
    r_e = np.array([[42164e3, 0.0, 0.0]])
    epoch = "2026-01-01T00:00:00"
    r_i, v_i = cc.frames.to_gcrs(epoch, [0.0], r_e, np.array([[0.0, 0.0, 1.5]]))
    state = NAV.start(0.0, r_i[0], v_i[0], epoch=epoch)
    assert state.update_gnss(0.0, r_e[0], [0.0, 0.0, 1.5]).accepted
