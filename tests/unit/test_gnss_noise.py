"""The simulated GPS and star-sensor experiment: the statistics of every error."""

from __future__ import annotations

from dataclasses import replace

import celestcore as cc
import numpy as np
import pytest
from celestcore import quaternion, simulate
from celestcore.gnss.scenario import ANTENNAS, GYRO, GnssStarTrial
from gnss_trials import (
    QUICK,
    SLEWS,
    TRIALS,
    Array,
    assert_normal,
    gnss_error,
    pooled,
    star_error,
)
from scipy import stats

# ------------------------------------------------------------------ star sensor


def test_white_noise_of_star_fixes() -> None:
    scenario = replace(QUICK, lfe=(), star_sigma=np.array([10.0, 20.0, 60.0]) * cc.ARCSEC)
    e = pooled(scenario, star_error)
    for axis, sigma in enumerate((10.0, 20.0, 60.0)):
        assert_normal(e[..., axis], sigma * cc.ARCSEC)
    assert np.abs(np.corrcoef(e.reshape(-1, 3).T) - np.eye(3)).max() < 5.0 / np.sqrt(e.size / 3)
    assert abs(np.corrcoef(e[:, 1:, 0].ravel(), e[:, :-1, 0].ravel())[0, 1]) < 0.08


def test_low_frequency_error() -> None:
    scenario = replace(QUICK, star_sigma=0.0)
    for k in range(3):
        made = scenario.trial(5, k)
        np.testing.assert_allclose(star_error(made), made.star_bias, atol=1e-14)
        n = scenario.mean_motion * made.t[:, None] * [1, 2]
        shape = np.hstack([np.cos(n), np.sin(n)])
        expected = shape @ np.vstack([made.lfe[:, 0], made.lfe[:, 1]])
        np.testing.assert_allclose(made.star_bias, expected, atol=1e-16)


def test_amplitudes_and_phases_of_the_low_frequency_error() -> None:
    c = pooled(QUICK, lambda made: made.lfe, 400) / cc.ARCSEC
    amplitude = np.broadcast_to(np.array([10.0, 3.0])[:, None], (400, 2, 3))
    np.testing.assert_allclose(np.hypot(c[:, :, 0], c[:, :, 1]), amplitude, rtol=1e-12)
    phase = np.arctan2(c[:, :, 1], c[:, :, 0])
    for k in range(2):
        for axis in range(3):
            assert stats.kstest(phase[:, k, axis], stats.uniform(-np.pi, 2 * np.pi).cdf)[1] > 1e-4
    prior = c.std(axis=(0, 2, 3))
    np.testing.assert_allclose(prior, np.array([10.0, 3.0]) / np.sqrt(2.0), rtol=0.06)


def test_markov_part_of_the_low_frequency_error() -> None:
    scenario = replace(QUICK, lfe=(), lfe_markov=(5.0 * cc.ARCSEC, 100.0), star_sigma=0.0)
    e = pooled(scenario, star_error, 200) / (5.0 * cc.ARCSEC)
    assert abs(e.std() - 1.0) < 0.03
    for lag in (1, 5, 10):
        found = np.mean(e[:, lag:] * e[:, :-lag])
        assert abs(found - np.exp(-lag / 10.0)) < 0.05


def test_a_mounting_turns_the_sensor() -> None:
    q_bc = quaternion.exp([0.3, -0.5, 1.0])
    plain = replace(QUICK, star_sigma=0.0).trial(1)
    made = replace(QUICK, star_sigma=0.0, star_mounting=q_bc).trial(1)
    error = quaternion.exp(plain.star_bias)
    expected = quaternion.multiply(quaternion.multiply(made.q_ib, q_bc), error)
    assert quaternion.angle_between(made.log.stars["star"].q, expected).max() < 1e-14


# ------------------------------------------------------------------ GNSS


@pytest.mark.parametrize("sigma", [1.0, 10.0])
def test_white_noise_of_gnss_fixes(sigma: float) -> None:
    e = pooled(replace(QUICK, gnss_sigma=sigma), gnss_error)
    assert_normal(e[..., :3], sigma)
    assert_normal(e[..., 3:], 0.01 * sigma)
    assert np.abs(np.corrcoef(e.reshape(-1, 6).T) - np.eye(6)).max() < 5.0 / np.sqrt(e.size / 6)


def test_velocity_noise_and_no_velocity() -> None:
    e = pooled(replace(QUICK, gnss_sigma_velocity=0.3), gnss_error)
    assert_normal(e[..., 3:], 0.3)
    alone = replace(QUICK, gnss_velocity=False).trial(1).log.gnss
    both = QUICK.trial(1).log.gnss
    assert alone is not None
    assert both is not None
    assert alone.v is None
    np.testing.assert_array_equal(alone.r, both.r)


def test_markov_error_of_gnss_positions() -> None:
    scenario = replace(QUICK, gnss_markov=(2.0, 300.0), gnss_sigma=0.0, duration=3000.0)
    made = scenario.trial(1)
    np.testing.assert_allclose(gnss_error(made)[:, :3], made.gnss_bias, atol=1e-8)
    e = pooled(scenario, lambda m: m.gnss_bias, 150) / 2.0
    assert abs(e.std() - 1.0) < 0.05
    assert abs(e[:, 0].std() - 1.0) < 5.0 / np.sqrt(2 * 450)  # stationary from the start
    for lag in (1, 10, 30):
        found = np.mean(e[:, lag:] * e[:, :-lag])
        assert abs(found - np.exp(-lag / 30.0)) < 0.06


def test_outliers() -> None:
    clean, dirty = (
        QUICK,
        replace(QUICK, gnss_outliers=(0.05, 20.0, 200.0), star_outliers=(0.1, 20.0, 200.0)),
    )
    sizes, hits, ways = [], [], []
    for k in range(60):
        one, two = clean.trial(3, k), dirty.trial(3, k)
        off = gnss_error(two) - gnss_error(one)
        away = np.linalg.norm(off[:, :3], axis=1)
        np.testing.assert_array_equal(two.gnss_outlier, away > 1e-6)
        np.testing.assert_allclose(np.linalg.norm(off[:, 3:], axis=1), 0.01 * away, atol=1e-6)
        sizes.append(away[two.gnss_outlier])
        ways.append(off[two.gnss_outlier, :3])
        hits.append((two.gnss_outlier.mean(), two.star_outlier.mean()))
        turned = np.linalg.norm(star_error(two) - star_error(one), axis=1) / (20.0 * cc.ARCSEC)
        np.testing.assert_array_equal(two.star_outlier, turned > 1e-6)
        assert not one.gnss_outlier.any()
    size = np.concatenate(sizes)
    assert stats.kstest(size, stats.uniform(20.0, 180.0).cdf).pvalue > 1e-4
    assert np.abs(np.mean(np.concatenate(ways) / size[:, None], axis=0)).max() < 0.2
    found, n = np.mean(hits, axis=0), 60 * 121
    for share, expected in zip(found, (0.05, 0.1), strict=True):
        assert abs(share - expected) < 5.0 * np.sqrt(expected / n)


def test_lever_arm() -> None:
    arm = np.array([0.2, -1.0, 3.0])
    scenario = replace(
        QUICK, lever_arm=arm, gnss_sigma=0.0, step=0.5, duration=100.0, attitude=SLEWS["large"]
    )
    made = scenario.trial(1)
    table = made.log.gnss
    assert table is not None
    assert table.v is not None
    earth = cc.frames.gcrs_to_itrs(scenario.epoch, made.t)
    expected = np.einsum("nij,nj->ni", earth, quaternion.rotate(made.q_ib, arm))
    np.testing.assert_allclose(table.r - made.r_e, expected, atol=1e-8)
    moved = np.gradient(expected, made.t, axis=0, edge_order=2)
    np.testing.assert_allclose((table.v - made.v_e)[1:-1], moved[1:-1], atol=1e-5)


@pytest.mark.parametrize("offset", [0.1, -0.25])
def test_time_offsets(offset: float) -> None:
    scenario = replace(
        QUICK, gnss_offset=offset, star_offset=-offset, gnss_sigma=0.0, star_sigma=0.0, lfe=()
    )
    made = scenario.trial(1)
    table, star = made.log.gnss, made.log.stars["star"]
    assert table is not None
    np.testing.assert_allclose(table.t, made.t, atol=1e-12)
    np.testing.assert_allclose(star.t, made.t, atol=1e-12)
    np.testing.assert_allclose(table.r - made.r_e, made.v_e * offset, atol=9.0 * offset**2)
    np.testing.assert_allclose(star_error(made), -made.omega_b * offset, atol=1e-8)


def test_sensors_have_steps_of_their_own() -> None:
    made = replace(QUICK, gnss_step=1.0, star_step=0.25, duration=20.0).trial(1)
    assert made.log.gnss is not None
    assert (len(made.t), len(made.log.gnss)) == (3, 21)
    assert len(made.log.stars["star"]) == 81
    assert made.star_bias.shape == (81, 3)


# ------------------------------------------------------------------ baselines and gyro


def test_baselines_share_the_master_antenna() -> None:
    scenario = replace(QUICK, baselines=ANTENNAS, attitude=SLEWS["large"])
    earth = cc.frames.gcrs_to_itrs(scenario.epoch, scenario.trial(0).t)

    def error(made: GnssStarTrial) -> Array:
        table = made.log.baselines
        assert table is not None
        body = np.array([quaternion.rotate(made.q_ib, b) for b in ANTENNAS])
        return table.b - np.einsum("nij,knj->nki", earth, body)

    e = pooled(scenario, error)
    assert_normal(e, 0.005)
    flat = e.reshape(-1, 2, 3)
    for axis in range(3):
        found = np.corrcoef(flat[:, :, axis].T)[0, 1]
        assert abs(found - 0.5) < 5.0 * 0.75 / np.sqrt(len(flat))
        other = np.corrcoef(flat[:, 0, axis], flat[:, 1, (axis + 1) % 3])[0, 1]
        assert abs(other) < 5.0 / np.sqrt(len(flat))


def test_gyro() -> None:
    scenario = replace(QUICK, gyro=GYRO, gyro_step=1.0)
    without = replace(scenario, step=1.0, gyro=None)
    white, start, walk = [], [], []
    for k in range(TRIALS):
        made = scenario.trial(2, k)
        fine = without.trial(2, k)
        gyro = made.log.gyro
        assert gyro is not None
        assert made.gyro_bias is not None
        q = fine.q_ib
        mean = quaternion.log(quaternion.multiply(quaternion.conjugate(q[:-1]), q[1:]))
        white.append(gyro.rate[:-1] - mean - made.gyro_bias[:-1])
        start.append(made.gyro_bias[0])
        walk.append(np.diff(made.gyro_bias, axis=0))
    arw, rrw = 0.005 * cc.DEG_PER_SQRT_HOUR, 0.01 * cc.DEG_PER_HOUR_PER_SQRT_HOUR
    assert_normal(np.array(white), arw)
    assert_normal(np.array(walk), rrw)
    assert abs(np.std(start) / cc.DEG_PER_HOUR - 1.0) < 5.0 / np.sqrt(2.0 * 3 * TRIALS)


def test_gyro_at_another_step_and_offset() -> None:
    quiet = simulate.GyroErrors()
    made = replace(QUICK, gyro=quiet, gyro_step=0.1, gyro_offset=0.05, duration=60.0).trial(1)
    gyro = made.log.gyro
    assert gyro is not None
    assert gyro.t[1] == pytest.approx(0.1, abs=1e-12)
    # the mean from t + 0.05 to t + 0.15 is the rate in the middle
    np.testing.assert_allclose(gyro.rate[99], made.omega_b[1], atol=1e-8)
