"""The GNSS and star navigator: against plain filters, with every option, and on wrong fixes."""

from __future__ import annotations

from dataclasses import replace

import celestcore as cc
import numpy as np
import pytest
from celestcore.gnss import (
    Antennas,
    GaussMarkov,
    GnssReceiver,
    GnssStarScenario,
    KinematicAttitude,
    Slew,
)
from celestcore.gnss.profile import AttitudeProfile
from celestcore.orbit import ForceModel, OrbitDynamics
from gnss_plain import angle, orbit_filter, pointing_filter

J2 = ForceModel.j2()
DYNAMICS = OrbitDynamics(J2, 1e-8)
SCENARIO = GnssStarScenario(force=J2, duration=1200.0, lfe=())
NAV = cc.GnssStarNavigator(dynamics=DYNAMICS)


@pytest.fixture(scope="module")
def trial():
    return SCENARIO.trial(seed=3, trial=0)


def shifted(log, **tables):
    """The same log with other tables."""
    own = {name: table for name, table in log.tables.items() if name not in tables}
    new = {name: table for name, table in tables.items() if table is not None}
    return cc.SensorLog(epoch=log.epoch, **own, **new)


def gnss_of(log, r=None, v=None, rows=slice(None)):
    table = log.gnss
    return (
        table.t[rows],
        (table.r if r is None else r)[rows],
        (table.v if v is None else v)[rows],
    )


def error(sol, trial, skip=300.0):
    use = sol.t > skip
    at = np.searchsorted(trial.t, sol.t[use])
    return np.linalg.norm(sol.r[use] - trial.r_i[at], axis=1)


@pytest.mark.parametrize("kind", [cc.EKF(), cc.UKF()])
def test_the_orbit_is_that_of_a_plain_filter(trial, kind):
    nav = cc.GnssStarNavigator(kind, DYNAMICS, gate=1.0)
    r0, v0 = trial.r_i[0] + [30.0, -20.0, 10.0], trial.v_i[0] + [0.1, 0.2, -0.1]
    given = {"r0": r0, "v0": v0, "sigma0": (100.0, 1.0), "covariance": True}
    sol = nav.run(trial.log, **given)
    smoothed = nav.smooth(trial.log, **given)
    table = trial.log.gnss
    z_r, z_v = cc.frames.to_gcrs(trial.log.epoch, table.t, table.r, table.v)
    start = np.append(r0, v0), np.diag(np.repeat([1e4, 1.0], 3))
    for found, back in ((sol, False), (smoothed, True)):
        states, covs = orbit_filter(J2, 1e-8, table.t, z_r, z_v, (1.0, 0.01), start, back=back)
        np.testing.assert_allclose(found.r, states[:, :3], atol=2e-4)
        np.testing.assert_allclose(found.v, states[:, 3:], atol=2e-6)
        spread = np.abs(found.orbit_covariance - covs).max(axis=(1, 2)) / covs.max(axis=(1, 2))
        assert spread.max() < 1e-6
    assert sol.gnss.kind[:2].tolist() == ["position", "velocity"]


@pytest.mark.parametrize("lfe", [None, cc.LowFrequencyError((1e-4,), period=900.0)])
def test_the_attitude_is_that_of_a_plain_filter(trial, lfe):
    nav = cc.GnssStarNavigator(dynamics=DYNAMICS, lfe=lfe, gate=1.0)
    sol = nav.run(trial.log, covariance=True)
    star = trial.log.stars["star"]
    q_io = cc.frames.orbital(sol.r, sol.v)
    fixes = cc.quaternion.multiply(cc.quaternion.conjugate(q_io), star.q)
    weights, prior = np.zeros((len(star), 0)), []
    if lfe is not None:
        weights, prior = lfe.weights(star.t, 900.0), lfe.prior
    start = (0.1, 1e-2, 1e-4)
    q, states, covs = pointing_filter(1e-16, star.t, fixes, 20 * cc.ARCSEC, weights, prior, start)
    # the navigator takes its rate at the start from two fixes, of no weight beside the prior
    off = angle(sol.q_ob, q.as_quat(scalar_first=True))
    assert off[5:].max() < 0.02 * cc.ARCSEC
    n = covs.shape[1]
    assert sol.attitude_covariance.shape == (len(star), n, n)
    ratio = sol.attitude_covariance[5:, :3, :3] / covs[5:, :3, :3].max()
    np.testing.assert_allclose(ratio, covs[5:, :3, :3] / covs[5:, :3, :3].max(), atol=1e-4)
    if lfe is not None:
        at_end = states[-1, 9:].reshape(2, 3)
        np.testing.assert_allclose(sol.lfe.value, at_end, atol=1e-3 * prior[0])
        np.testing.assert_allclose(sol.lfe.sigma.ravel(), np.sqrt(np.diag(covs[-1])[9:]), rtol=1e-3)


def test_rates_are_those_of_the_body(trial):
    sol = cc.GnssStarNavigator(dynamics=DYNAMICS).smooth(trial.log)
    inner = slice(10, -10)
    off = sol.rate[inner] - trial.omega_b[inner]
    assert np.sqrt(np.mean(off**2)) < 2e-6  # 0.3 arcsec/s, where the filter says 1e-6
    # the turn of the orbital plane and of the satellite along it is in them
    assert np.abs(trial.omega_b).max() > 1e-3


def test_a_gyro_drives_the_attitude():
    scenario = replace(SCENARIO, gyro=cc.gnss.scenario.GYRO)
    made = scenario.trial(seed=4, trial=0)
    gyro = cc.Gyro(0.005 * cc.DEG_PER_SQRT_HOUR, 0.01 * cc.DEG_PER_HOUR / 60.0)
    nav = cc.GnssStarNavigator(dynamics=DYNAMICS, gyro=gyro)
    sol = nav.run(made.log, t_output=made.t)
    assert sol.bias.shape == (len(made.t), 3)
    at = np.searchsorted(made.log.gyro.t, made.t)
    off = sol.bias[-1] - made.gyro_bias[np.minimum(at[-1], len(made.gyro_bias) - 1)]
    assert np.all(np.abs(off) < 5.0 * sol.sigma_bias[-1])
    assert angle(sol.q[30:], made.q_ib[30:]).max() < 60 * cc.ARCSEC
    # the same as the attitude navigator makes of the same log, but for how they start
    plain = cc.StarGyroNavigator(gyro=gyro, star=cc.StarCamera(20 * cc.ARCSEC)).run(made.log)
    mine = nav.run(made.log, t_output=made.log.gyro.t[made.log.gyro.t <= made.t[-1]])
    late = mine.t > 600.0
    assert angle(mine.q[late], plain.at(mine.t[late]).q).max() < 2.0 * cc.ARCSEC


def test_output_at_any_times(trial):
    whole = NAV.run(trial.log)
    grid = np.array([3.3, 100.0, 457.7, 1200.0])
    some = NAV.run(trial.log, t_output=grid)
    assert some.t.tolist() == grid.tolist()
    at = np.searchsorted(whole.t, [100.0, 1200.0])
    np.testing.assert_allclose(some.r[[1, 3]], whole.r[at], atol=1e-6)
    assert angle(some.q[[1, 3]], whole.q[at]).max() < 0.05 * cc.ARCSEC
    back = NAV.smooth(trial.log, t_output=grid)
    assert back.smoothed
    assert np.all(back.sigma_r[:3] < some.sigma_r[:3])


def test_sensors_have_their_own_epochs_offsets_mountings_and_lever_arm():
    arm, tilt = (0.8, -0.4, 1.2), cc.quaternion.exp([0.3, -1.0, 0.5])
    scenario = replace(
        SCENARIO,
        lever_arm=arm,
        star_mounting=tilt,
        gnss_step=7.0,
        star_step=4.0,
        gnss_offset=0.35,
        star_offset=-0.1,
        gnss_sigma=0.05,
        gnss_sigma_velocity=5e-4,
    )
    made = scenario.trial(seed=5, trial=0)
    # a tag t stands for what was measured at t + offset
    nav = cc.GnssStarNavigator(
        dynamics=DYNAMICS,
        gnss=GnssReceiver(0.05, 5e-4, lever_arm=arm, time_offset=-0.35),
        star=cc.StarCamera(20 * cc.ARCSEC, mounting=tilt),
        star_time_offset=0.1,
    )
    inside = made.t[(made.t > 10.0) & (made.t < 1190.0)]
    sol = nav.smooth(made.log, t_output=inside)
    at = np.searchsorted(made.t, inside)
    off = np.linalg.norm(sol.r - made.r_i[at], axis=1)
    assert off.max() < 0.08  # an uncorrected lever arm is 1.5 m, the offset 2.6 km
    assert angle(sol.q, made.q_ib[at]).max() < 60 * cc.ARCSEC
    assert np.mean(sol.gnss.nis) < 3.5


def test_baselines_add_little_to_a_star_sensor():
    antennas = Antennas([[2.0, 0.0, 0.0], [0.0, 1.5, 0.0]], 0.005)
    made = replace(SCENARIO, baselines=antennas.baselines).trial(seed=6, trial=0)
    without = NAV.run(made.log)
    with_them = cc.GnssStarNavigator(dynamics=DYNAMICS, antennas=antennas).run(made.log)
    gain = with_them.sigma_q[60:] / without.sigma_q[60:]
    assert np.all((gain < 1.0) & (gain > 0.98))
    assert with_them.counts["baselines"] == len(made.t)
    nis = with_them.attitude.nis[with_them.attitude.kind == "baselines"]
    assert 2.2 < nis.mean() < 3.8


def test_one_bad_first_fix_does_not_matter(trial):
    r, v = trial.log.gnss.r.copy(), trial.log.gnss.v.copy()
    clean = NAV.run(trial.log)
    for wrong in (500.0, 1e5):
        bad = r.copy()
        bad[0] += [wrong, -wrong, wrong]
        sol = NAV.run(shifted(trial.log, gnss=gnss_of(trial.log, bad, v)))
        assert sol.counts["unused_at_start"] == 1
        np.testing.assert_allclose(sol.r[30:], clean.r[30:], atol=0.2)
        assert error(sol, trial).max() < 1.5


def test_outliers_are_refused(trial):
    rng = np.random.default_rng(1)
    r = trial.log.gnss.r.copy()
    wrong = rng.choice(np.arange(20, len(r)), 6, replace=False)
    r[wrong] += rng.normal(size=(6, 3)) * 100.0
    sol = NAV.run(shifted(trial.log, gnss=gnss_of(trial.log, r)))
    assert sol.counts["position_rejected"] == 6
    refused = sol.gnss.row[(sol.gnss.kind == "position") & ~sol.gnss.accepted]
    assert sorted(refused) == sorted(wrong)
    assert not sol.restarts
    taken = cc.GnssStarNavigator(dynamics=DYNAMICS, gate=1.0)
    worse = taken.run(shifted(trial.log, gnss=gnss_of(trial.log, r)))
    assert error(worse, trial).max() > 5.0 * error(sol, trial).max()


def test_an_outage_is_bridged(trial):
    keep = (trial.log.gnss.t < 400.0) | (trial.log.gnss.t > 800.0)
    log = shifted(trial.log, gnss=gnss_of(trial.log, rows=keep))
    sol = NAV.run(log, covariance=True)
    gap = (sol.t > 400.0) & (sol.t <= 800.0)
    assert gap.sum() > 30  # star fixes are there
    off = np.linalg.norm(sol.r - trial.r_i, axis=1)[gap]
    assert off.max() < 15.0
    sigma = np.linalg.norm(sol.sigma_r, axis=1)[gap]
    assert sigma[-1] > 3.0 * sigma[0]
    assert np.all(off < 5.0 * sigma)


def test_a_manoeuvre_makes_the_filter_start_again(trial):
    # 2.4 m/s at t = 600 s, and on from there
    table = trial.log.gnss
    late = table.t >= 600.0
    at = int(np.searchsorted(trial.t, 600.0))
    kicked = cc.orbit.propagate(
        J2, None, trial.r_i[at], trial.v_i[at] + [2.0, -1.0, 1.0], table.t[late]
    )
    r_e, v_e = cc.frames.to_itrs(trial.log.epoch, table.t[late], kicked.r, kicked.v)
    r, v = table.r.copy(), table.v.copy()
    r[late] += r_e - trial.r_e[np.searchsorted(trial.t, table.t[late])]
    v[late] += v_e - trial.v_e[np.searchsorted(trial.t, table.t[late])]
    log = shifted(trial.log, gnss=gnss_of(trial.log, r, v))
    with pytest.warns(cc.CelestcoreWarning, match="refused 10 fixes running and started again"):
        sol = NAV.run(log)
    assert len(sol.restarts) == 1
    assert 600.0 < sol.restarts[0] < 640.0
    assert sol.t.tolist() == trial.t.tolist()
    off = np.linalg.norm(sol.r[late] - kicked.r, axis=1)
    assert off[-20:].max() < 1.5
    with pytest.warns(cc.CelestcoreWarning):
        back = NAV.smooth(log)
    assert back.restarts == sol.restarts
    assert len(back) == len(sol)


@pytest.mark.parametrize("with_gyro", [False, True])
def test_a_star_sensor_that_moves_makes_the_attitude_start_again(with_gyro):
    scenario = replace(SCENARIO, gyro=cc.gnss.GYRO if with_gyro else None)
    made = scenario.trial(seed=12, trial=0)
    star = made.log.stars["star"]
    late, turn = star.t >= 600.0, cc.quaternion.exp([0.02, -0.01, 0.01])
    q = star.q.copy()
    q[late] = cc.quaternion.multiply(q[late], turn)
    log = shifted(made.log, star=(star.t, q))
    gyro = cc.Gyro(0.005 * cc.DEG_PER_SQRT_HOUR, 1e-9) if with_gyro else None
    nav = cc.GnssStarNavigator(dynamics=DYNAMICS, gyro=gyro)
    for call in (nav.run, nav.smooth):
        with pytest.warns(cc.CelestcoreWarning, match="attitude filter refused 10 fixes running"):
            sol = call(log, t_output=made.t)
        assert sol.attitude_restarts == [600.0]
        assert not sol.restarts
        assert sol.t.tolist() == made.t.tolist()
        truth = made.q_ib.copy()
        truth[made.t >= 600.0] = cc.quaternion.multiply(truth[made.t >= 600.0], turn)
        off = angle(sol.q, truth)
        assert off[20:59].max() < 60 * cc.ARCSEC
        assert off[80:].max() < 60 * cc.ARCSEC
        assert len(sol.attitude) == len(star)


def test_a_filter_that_is_lost_again_and_again_ends(trial):
    """Far too confident dynamics: many starts, every row written, and no end of none."""
    nav = cc.GnssStarNavigator(dynamics=OrbitDynamics(ForceModel.two_body(), 1e-16), max_rejected=3)
    with pytest.warns(cc.CelestcoreWarning) as said:
        sol = nav.run(trial.log)
    assert any("started again" in str(w.message) for w in said)
    assert sol.t.tolist() == trial.t.tolist()
    assert len(sol.restarts) > 2


def test_a_jump_that_no_orbit_fits_is_said(trial):
    rng = np.random.default_rng(5)
    r = trial.log.gnss.r.copy()
    r[60:] += 1e3 * rng.normal(size=r[60:].shape)
    log = shifted(trial.log, gnss=(trial.log.gnss.t, r))
    with pytest.warns(cc.CelestcoreWarning) as said:
        sol = NAV.run(log)
    assert any("no orbit fits them" in str(w.message) for w in said)
    assert len(sol) == len(trial.t)
    assert not sol.restarts


def test_the_receivers_bias_is_estimated():
    scenario = replace(SCENARIO, gnss_markov=(3.0, 1800.0), duration=6000.0)
    made = scenario.trial(seed=7, trial=0)
    plain = NAV.run(made.log, covariance=True)
    bias = GnssReceiver(1.0, 0.01, bias=GaussMarkov(3.0, 1800.0))
    sol = cc.GnssStarNavigator(dynamics=DYNAMICS, gnss=bias).run(made.log, covariance=True)
    assert sol.orbit_covariance.shape == (len(made.t), 9, 9)
    assert sol.sigma_gnss_bias[0].mean() == pytest.approx(3.0, rel=0.1)
    assert sol.gnss_bias.shape == (len(made.t), 3)
    rms = [np.sqrt(np.mean(error(s, made) ** 2)) for s in (sol, plain)]
    assert rms[0] < rms[1]
    sigma = np.linalg.norm(sol.sigma_r, axis=1)[300:]
    assert 0.4 < rms[0] / np.sqrt(np.mean(sigma**2)) < 2.0
    # without the states the filter believes in much less than it errs
    assert rms[1] > 2.0 * np.sqrt(np.mean(np.linalg.norm(plain.sigma_r, axis=1)[300:] ** 2))


def test_position_alone_is_enough(trial):
    log = shifted(trial.log, gnss=(trial.log.gnss.t, trial.log.gnss.r))
    sol = NAV.run(log)
    assert set(sol.gnss.kind) == {"position"}
    assert error(sol, trial, 600.0).max() < 2.5
    ignored = cc.GnssStarNavigator(dynamics=DYNAMICS, gnss=GnssReceiver(1.0, None))
    np.testing.assert_array_equal(ignored.run(trial.log).r, sol.r)


def test_a_log_without_stars_has_an_orbit_alone(trial):
    sol = NAV.run(shifted(trial.log, star=None))
    assert sol.q is None
    assert len(sol) == len(trial.log.gnss)
    assert "qw" not in sol.columns()
    with pytest.raises(cc.InputError, match="no attitude fixes"):
        sol.euler()


def test_pitch_goes_through_90_degrees():
    profile = AttitudeProfile(slew=Slew(120 * cc.DEG, 1200.0, kind="turn"))
    made = replace(SCENARIO, attitude=profile).trial(seed=8, trial=0)
    pitch = cc.frames.euler_321(made.q_ob).pitch
    assert pitch.max() > 89.0 * cc.DEG
    sol = NAV.run(made.log)
    nominal = NAV.run(SCENARIO.trial(seed=8, trial=0).log)
    late = made.t > 300.0
    rms = np.sqrt(np.mean(angle(sol.q[late], made.q_ib[late]) ** 2))
    truth = SCENARIO.trial(seed=8, trial=0).q_ib
    assert rms < 1.1 * np.sqrt(np.mean(angle(nominal.q[late], truth[late]) ** 2))
    # the paper's scheme does not
    e = cc.frames.euler_321(
        cc.quaternion.multiply(
            cc.quaternion.conjugate(cc.frames.orbital(made.r_i, made.v_i)), made.log.stars["star"].q
        )
    )
    angles = np.stack([e.yaw, e.pitch, e.roll], axis=1)
    filtered = cc.gnss.euler_filter(made.t, angles, 20 * cc.ARCSEC, 1e-16)
    q = cc.frames.from_euler_321(*filtered.value.T)
    assert angle(q, made.q_ob).max() > 100.0 * rms


def test_harmonics_are_seen_as_far_as_they_can_be():
    orbits = 3.0 * cc.elements.period(6884e3)
    scenario = GnssStarScenario(
        force=J2,
        duration=float(np.ceil(orbits / 60) * 60),
        step=60.0,
        star_step=10.0,
        gyro=cc.gnss.scenario.GYRO,
    )
    made = scenario.trial(seed=9, trial=0)
    nav = cc.GnssStarNavigator(
        dynamics=DYNAMICS,
        lfe=cc.LowFrequencyError(),
        gyro=cc.Gyro(0.005 * cc.DEG_PER_SQRT_HOUR, 0.01 * cc.DEG_PER_HOUR / 60.0),
    )
    sol = nav.run(made.log)
    first = sol.lfe.part("cos 1", "sin 1")
    assert np.sum(first >= 0.98) == 2
    assert np.sum(first <= 0.5) == 4
    assert sol.lfe.unobservable == 2
    assert "2 were not" in str(sol.lfe)
    # the two look like a constant inertial error
    assert np.all(np.abs(sol.lfe.value) < 5.0 * sol.lfe.prior)


def test_a_short_arc_is_said(trial):
    nav = cc.GnssStarNavigator(dynamics=DYNAMICS, lfe=cc.LowFrequencyError())
    with pytest.warns(cc.CelestcoreWarning, match="less than half an orbit"):
        nav.run(trial.log)


@pytest.mark.parametrize("count", [1, 2])
@pytest.mark.parametrize("markov", [None, GaussMarkov(5 * cc.ARCSEC, 600.0)])
def test_slow_errors_of_every_size(trial, count, markov):
    """Short tails are filled up inside: nothing of it shows."""
    lfe = cc.LowFrequencyError((5e-5, 2e-5)[:count], period=300.0, gauss_markov=markov)
    sol = cc.GnssStarNavigator(dynamics=DYNAMICS, lfe=lfe).smooth(trial.log, covariance=True)
    n = 9 + 3 * lfe.vectors
    assert sol.attitude_covariance.shape == (len(sol), n, n)
    assert sol.lfe.value.shape == (lfe.vectors, 3)
    assert np.all(sol.lfe.ratio <= 1.0 + 1e-9)
    weights = lfe.weights(trial.t, 300.0)
    star = trial.log.stars["star"]
    q_io = cc.frames.orbital(sol.r, sol.v)
    fixes = cc.quaternion.multiply(cc.quaternion.conjugate(q_io), star.q)
    if markov is None:
        _, _, covs = pointing_filter(
            1e-16, star.t, fixes, 20 * cc.ARCSEC, weights, lfe.prior, (0.1, 1e-2, 1e-4)
        )
        np.testing.assert_allclose(
            np.sqrt(np.diag(covs[-1])), np.sqrt(np.diag(sol.attitude_covariance[-1])), rtol=1e-3
        )


def test_a_gauss_markov_error_alone(trial):
    lfe = cc.LowFrequencyError((), gauss_markov=GaussMarkov(5 * cc.ARCSEC, 600.0))
    sol = cc.GnssStarNavigator(dynamics=DYNAMICS, lfe=lfe).run(trial.log)
    assert sol.lfe.names == ["gauss-markov"]
    assert np.all(sol.lfe.sigma < 5.01 * cc.ARCSEC)


def test_matrices_of_the_user(trial):
    earth = cc.frames.gcrs_to_itrs(trial.log.epoch, trial.log.gnss.t)
    by_array = NAV.run(trial.log, earth_rotation=earth)
    by_call = NAV.run(
        trial.log, earth_rotation=lambda t: cc.frames.gcrs_to_itrs(trial.log.epoch, t)
    )
    np.testing.assert_allclose(by_array.r, NAV.run(trial.log).r, atol=1e-4)
    np.testing.assert_array_equal(by_array.r, by_call.r)


def test_a_run_is_repeatable_and_portable(trial):
    one, two = NAV.run(trial.log), NAV.run(trial.log)
    np.testing.assert_array_equal(one.r, two.r)
    np.testing.assert_array_equal(one.q, two.q)
    portable = NAV.run(trial.log, portable=True)
    np.testing.assert_allclose(portable.r, one.r, atol=1e-6)


def test_progress_is_called(trial):
    seen = []
    NAV.run(trial.log, progress=lambda done, total: seen.append((done, total)))
    assert all(0 <= done <= total for done, total in seen)


def test_columns_and_frames(trial):
    pytest.importorskip("pandas")
    frame = NAV.run(trial.log).to_dataframe()
    assert list(frame.columns[:7]) == ["t", "x", "y", "z", "vx", "vy", "vz"]
    assert {"qw", "wx", "s_ax"} < set(frame.columns)
    assert len(frame) == len(trial.t)


def test_ccsds_messages_come_back(trial, tmp_path):
    pytest.importorskip("ccsds_ndm")
    sol = NAV.run(trial.log, covariance=True)
    names = {"object_name": "TEST", "object_id": "2019-001A"}
    sol.to_oem(tmp_path / "orbit.oem", **names)
    sol.to_aem(tmp_path / "attitude.aem", **names)
    orbit = cc.ccsds.read_oem(tmp_path / "orbit.oem")
    np.testing.assert_allclose(orbit.r, sol.r, atol=1e-5)
    np.testing.assert_allclose(orbit.v, sol.v, atol=1e-8)
    attitude = cc.ccsds.read_aem(tmp_path / "attitude.aem")
    assert angle(attitude.q, sol.q).max() < 1e-8


def test_monte_carlo_is_the_same_for_any_number_of_threads():
    scenario = replace(SCENARIO, duration=600.0)
    one = NAV.monte_carlo(scenario, 4, seed=2, smooth=True, threads=1)
    two = NAV.monte_carlo(scenario, 4, seed=2, smooth=True, threads=2)
    part = NAV.monte_carlo(scenario, 2, seed=2, first=2, smooth=True)
    for name in ("ekf", "ekf_smoothed"):
        np.testing.assert_array_equal(one[name].rms_position, two[name].rms_position)
        np.testing.assert_array_equal(one[name].rms_position[2:], part[name].rms_position)
    assert len(one.to_dataframe()) == 8


def test_errors_and_covariances_agree():
    """Over 60 runs, with what the filter believes: NEES of both filters, forward and back."""
    scenario = replace(SCENARIO, force=ForceModel.j2(), duration=900.0)
    nav = cc.GnssStarNavigator(dynamics=OrbitDynamics(J2, 1e-12), attitude=KinematicAttitude(1e-16))
    made = nav.monte_carlo(scenario, 60, seed=11, smooth=True).pooled()
    for name in ("ekf", "ekf_smoothed"):
        p = made[name]
        assert abs(p.nees - 6.0) < 4.0 * p.error["nees"], (name, p.nees)
        assert 2.2 < p.nees_attitude < 3.2, (name, p.nees_attitude)
    assert abs(made["ekf"].nis - 3.0) < 5.0 * made["ekf"].error["nis"]
