"""What a GNSS and star navigator cannot use: named, with row and value, and what to do."""

from __future__ import annotations

import celestcore as cc
import numpy as np
import pytest
from celestcore.gnss import (
    Antennas,
    GaussMarkov,
    GnssReceiver,
    GnssStarScenario,
    KinematicAttitude,
    gps_attitude,
)
from celestcore.orbit import ForceModel, OrbitDynamics

DYNAMICS = OrbitDynamics(ForceModel.j2(), 1e-8)
NAV = cc.GnssStarNavigator(dynamics=DYNAMICS)


@pytest.fixture(scope="module")
def made():
    return GnssStarScenario(force=ForceModel.j2(), duration=300.0, lfe=()).trial(seed=1, trial=0)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: GnssReceiver(-1.0), "gnss.sigma.*positive"),
        (lambda: GnssReceiver(1.0, 0.0), "gnss.sigma_velocity"),
        (lambda: GnssReceiver(lever_arm=(1.0, 2.0)), "gnss.lever_arm"),
        (lambda: GnssReceiver(lever_arm=(5e3, 0, 0)), "below a kilometre"),
        (lambda: GnssReceiver(bias=1.0), "GaussMarkov"),
        (lambda: GnssReceiver(time_offset=float("nan")), "gnss.time_offset"),
        (lambda: GaussMarkov(0.0, 10.0), "sigma"),
        (lambda: GaussMarkov(1.0, -1.0), "tau"),
        (lambda: KinematicAttitude(0.0), "attitude.jerk_psd"),
        (lambda: cc.LowFrequencyError(()), "estimates nothing"),
        (lambda: cc.LowFrequencyError((1e-5, 1e-5, 1e-5)), "2 harmonics at most"),
        (lambda: cc.LowFrequencyError((-1e-5,)), "lfe.amplitudes"),
        (lambda: cc.LowFrequencyError(period=0.0), "lfe.period"),
        (lambda: cc.GnssStarNavigator(cc.SRUKF()), "EKF.. or UKF.. will do"),
        (lambda: cc.GnssStarNavigator("ekf"), "filter"),
        (lambda: cc.GnssStarNavigator(dynamics=4), "OrbitDynamics"),
        (lambda: cc.GnssStarNavigator(gate=1.5), "is a probability"),
        (lambda: cc.GnssStarNavigator(max_rejected=0), "max_rejected"),
        (lambda: Antennas([[1.0, 0.0, 0.0]]), "body axis x unobservable"),
        (lambda: Antennas([[1.0, 0.0, 0.0], [2.0, 0.0, 0.0]]), "axis x"),
    ],
)
def test_descriptions_are_checked(make, words):
    with pytest.raises(cc.InputError, match=words):
        make()


def log_of(made, **tables):
    own = {**made.log.tables, **tables}
    own = {name: table for name, table in own.items() if table is not None}
    return cc.SensorLog(epoch=made.log.epoch, **own)


def test_kilometres_and_positions_inside_the_earth(made):
    g = made.log.gnss
    with pytest.raises(cc.InputError, match=r"gnss.*kilomet"):
        log_of(made, gnss=(g.t, g.r / 1e3))
    r = g.r.copy()
    r[7] *= 0.5
    with pytest.raises(cc.InputError, match=r"row 7.*|inside the Earth"):
        log_of(made, gnss=(g.t, r))


def test_inertial_velocities_are_found(made):
    g = made.log.gnss
    with pytest.raises(cc.InputError, match="inertial"):
        log_of(made, gnss=(g.t, g.r, g.v + np.cross([0, 0, 7.292115e-5], g.r)))


def test_improper_rotations_are_named(made):
    earth = cc.frames.gcrs_to_itrs(made.log.epoch, made.log.gnss.t)
    mirrored = earth.copy()
    mirrored[5] *= -1.0
    with pytest.raises(cc.InputError, match=r"earth_rotation, row 5,.*determinant"):
        NAV.run(made.log, earth_rotation=mirrored)
    with pytest.raises(cc.InputError, match="one matrix for each GNSS fix"):
        NAV.run(made.log, earth_rotation=earth[:3])


def test_what_a_log_must_have(made):
    star = made.log.stars["star"]
    with pytest.raises(cc.InputError, match="no GNSS fixes"):
        NAV.run(log_of(made, gnss=None))
    with pytest.raises(cc.InputError, match="epoch"):
        NAV.run(cc.SensorLog(**made.log.tables))
    gyro = cc.GnssStarNavigator(dynamics=DYNAMICS, gyro=cc.Gyro(1e-6))
    with pytest.raises(cc.InputError, match="the log has none"):
        gyro.run(made.log)
    two = log_of(made, star=None, star_1=star, star_2=star)
    with pytest.raises(cc.InputError, match=r"lfe.*one star sensor"):
        cc.GnssStarNavigator(dynamics=DYNAMICS, lfe=cc.LowFrequencyError()).run(two)
    with pytest.raises(cc.InputError, match="no star sensor is described"):
        cc.GnssStarNavigator(dynamics=DYNAMICS, star={"star_1": cc.StarCamera(1e-4)}).run(two)
    both = cc.GnssStarNavigator(dynamics=DYNAMICS).run(two)
    assert both.counts["star_2"] == len(star)
    with pytest.raises(cc.InputError, match="SensorLog"):
        NAV.run("log.npz")


def test_options_are_checked(made):
    cases = [
        ({"t_output": [-5.0]}, "outside the log's span"),
        ({"t_output": [10.0, 5.0]}, "t_output"),
        ({"r0": made.r_i[0]}, "give both or neither"),
        ({"sigma0": (1.0, 1.0)}, "goes with r0 and v0"),
        ({"r0": made.r_i[0], "v0": made.v_i[0], "sigma0": 3.0}, "sigma0"),
        ({"r0": made.r_i[0] / 1e3, "v0": made.v_i[0]}, "r0"),
        ({"progress": 3}, "callable"),
    ]
    for options, words in cases:
        with pytest.raises(cc.InputError, match=words):
            NAV.run(made.log, **options)
    with pytest.raises(cc.InputError, match="is not an option"):
        NAV.smooth(made.log, every=3)


def test_fixes_that_do_not_agree(made):
    g = made.log.gnss
    rng = np.random.default_rng(0)
    r = g.r + rng.normal(size=g.r.shape) * 1e4
    with pytest.raises(cc.CelestcoreError, match="agree"):
        NAV.run(log_of(made, gnss=(g.t, r)))


def test_a_lever_arm_without_attitude(made):
    nav = cc.GnssStarNavigator(dynamics=DYNAMICS, lever_arm=(1.0, 0.0, 0.0))
    with pytest.raises(cc.InputError, match="needs star fixes"):
        nav.run(log_of(made, star=None))


def test_baselines_that_tell_nothing(made):
    g = made.log.gnss
    antennas = Antennas([[2.0, 0.0, 0.0], [0.0, 1.5, 0.0]])
    wrong = np.tile([[5.0, 0.0, 0.0], [0.0, 5.0, 0.0]], (len(g), 1, 1))
    assert not gps_attitude(antennas, wrong).valid.any()
    nav = cc.GnssStarNavigator(dynamics=DYNAMICS, antennas=antennas)
    with pytest.warns(cc.CelestcoreWarning, match="no epoch of the baselines"):
        sol = nav.run(log_of(made, baselines=(g.t, wrong)))
    assert "baselines" not in sol.counts


def test_a_wrong_dynamics_is_said(made):
    """Every fix refused: the run says what is probably wrong."""
    nav = cc.GnssStarNavigator(
        dynamics=OrbitDynamics(ForceModel.two_body(), 1e-16),
        max_rejected=None,
    )
    long = GnssStarScenario(force=ForceModel.j2(), duration=900.0, lfe=()).trial(seed=2, trial=0)
    with pytest.warns(cc.CelestcoreWarning, match="outside the gate"):
        sol = nav.run(long.log)
    assert sol.counts["position_rejected"] > 40
