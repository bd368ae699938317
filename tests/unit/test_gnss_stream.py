"""A navigator fed one measurement at a time does what it does on the whole log."""

from __future__ import annotations

from dataclasses import replace

import celestcore as cc
import numpy as np
import pytest
from celestcore.gnss import GaussMarkov, GnssReceiver, GnssStarScenario
from celestcore.orbit import ForceModel, OrbitDynamics
from gnss_plain import angle

SCENARIO = GnssStarScenario(force=ForceModel.j2(), duration=400.0, lfe=())
DYNAMICS = OrbitDynamics(ForceModel.j2(), 1e-8)


def fed(nav, made, rate=False, q=None):
    """Feed a log; return the state after every epoch."""
    log = made.log
    state = nav.start(0.0, made.r_i[0], made.v_i[0], q, (10.0, 0.1), epoch=log.epoch, until=900.0)
    out = []
    star = log.stars["star"]
    for k, t in enumerate(log.gnss.t):
        if rate and k:
            inside = np.flatnonzero((log.gyro.t >= state.t) & (log.gyro.t < t))
            for i in inside:
                state.predict(min(log.gyro.t[i + 1], t), log.gyro.rate[i])
        state.update_gnss(t, log.gnss.r[k], log.gnss.v[k])
        state.update_star(t, star.q[k])
        out.append((state.r, state.v, state.q, state.sigma))
    return state, [np.array(column) for column in zip(*out, strict=True)]


@pytest.mark.parametrize("kind", [cc.EKF(), cc.UKF()])
def test_a_stream_is_a_run(kind):
    made = SCENARIO.trial(seed=1, trial=0)
    nav = cc.GnssStarNavigator(kind, DYNAMICS)
    _, (r, v, q, sigma) = fed(nav, made)
    run = nav.run(made.log, r0=made.r_i[0], v0=made.v_i[0], sigma0=(10.0, 0.1))
    np.testing.assert_allclose(r, run.r, atol=1e-5)
    np.testing.assert_allclose(v, run.v, atol=1e-7)
    np.testing.assert_allclose(sigma, np.hstack([run.sigma_r, run.sigma_v]), rtol=1e-6)
    # both settle to the same, whatever they started from
    assert angle(q[15:], run.q[15:]).max() < 2.0 * cc.ARCSEC


def test_a_stream_with_gyro_bias_and_slow_error():
    made = replace(SCENARIO, gyro=cc.gnss.scenario.GYRO).trial(seed=2, trial=0)
    nav = cc.GnssStarNavigator(
        dynamics=DYNAMICS,
        gyro=cc.Gyro(0.005 * cc.DEG_PER_SQRT_HOUR, 1e-9),
        gnss=GnssReceiver(1.0, 0.01, bias=GaussMarkov(1.0, 1800.0)),
        lfe=cc.LowFrequencyError(period=5600.0),
    )
    state = nav.start(0.0, made.r_i[0], made.v_i[0], epoch=made.log.epoch)
    state.predict(0.0, made.log.gyro.rate[0])
    assert state.orbit_covariance.shape == (9, 9)
    assert state.q is None
    assert state.sigma_q is None
    state.predict(0.0, made.log.gyro.rate[0])
    _, (_, _, q, _) = fed(nav, made, rate=True, q=made.q_ib[0])
    assert angle(q[10:], made.q_ib[10:]).max() < 90 * cc.ARCSEC


def test_a_lever_arm_needs_an_attitude():
    made = replace(SCENARIO, lever_arm=(1.0, 0.5, -2.0), gnss_sigma=0.01).trial(seed=3, trial=0)
    nav = cc.GnssStarNavigator(
        dynamics=DYNAMICS, gnss=GnssReceiver(0.01, 1e-4), lever_arm=(1.0, 0.5, -2.0)
    )
    state = nav.start(0.0, made.r_i[0], made.v_i[0], epoch=made.log.epoch)
    with pytest.raises(cc.InputError, match="needs an attitude"):
        state.update_gnss(0.0, made.log.gnss.r[0])
    state, (r, *_) = fed(nav, made, q=made.q_ib[0])
    assert np.linalg.norm(r - made.r_i, axis=1)[5:].max() < 0.05


def test_a_failed_step_leaves_the_state_as_it_was():
    made = SCENARIO.trial(seed=4, trial=0)
    nav = cc.GnssStarNavigator(dynamics=DYNAMICS)
    state = nav.start(0.0, made.r_i[0], made.v_i[0], epoch=made.log.epoch)
    state.predict(10.0)
    before = state.r, state.orbit_covariance
    for call in (
        lambda: state.predict(5.0),
        lambda: state.predict(20.0, [0.0, 0.0, 0.0]),
        lambda: state.update_gnss(20.0, made.log.gnss.r[2] / 1e3),
        lambda: state.update_gnss(20.0, [np.nan] * 3),
        lambda: state.update_star(20.0, [2.0, 0.0, 0.0, 0.0]),
    ):
        with pytest.raises(cc.InputError):
            call()
        assert state.t == 10.0
        np.testing.assert_array_equal(state.r, before[0])
        np.testing.assert_array_equal(state.orbit_covariance, before[1])


def test_copies_are_independent():
    made = SCENARIO.trial(seed=5, trial=0)
    state = cc.GnssStarNavigator(dynamics=DYNAMICS).start(
        0.0, made.r_i[0], made.v_i[0], made.q_ib[0], epoch=made.log.epoch
    )
    other = state.copy()
    other.update_gnss(10.0, made.log.gnss.r[1])
    assert (state.t, other.t) == (0.0, 10.0)
