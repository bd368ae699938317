"""The simulated GPS and star-sensor experiment: its truth and its random numbers."""

from __future__ import annotations

import functools
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any

import celestcore as cc
import erfa
import numpy as np
import pytest
from astropy.time import Time
from astropy.utils import iers
from celestcore import orbit, quaternion, simulate
from celestcore.gnss.profile import AttitudeProfile, Slew
from celestcore.gnss.scenario import ANTENNAS, GYRO, ORBIT, GnssStarScenario
from gnss_trials import (
    J2,
    QUICK,
    SLEWS,
    TRIALS,
    gnss_error,
    pooled,
    star_error,
)
from scipy import stats

FULL = GnssStarScenario()

# ------------------------------------------------------------------ truth


def test_the_defaults_are_the_published_ones() -> None:
    made = FULL.trial(1)
    assert made.log.epoch == "2019-01-21T04:00:00"
    np.testing.assert_array_equal(made.t, 10.0 * np.arange(121))
    found = cc.elements.from_state(made.r_i[0], made.v_i[0], mu=FULL.forces.mu)
    expected = (6884e3, 0.0012, *np.radians([97.42, 100.3, 90.0]))
    np.testing.assert_allclose(found[:5], expected, rtol=1e-9)
    mean = cc.elements.true_to_mean(found.nu, found.e)
    np.testing.assert_allclose(np.degrees(float(mean)), 30.0, rtol=1e-9)
    assert (FULL.forces.gravity, FULL.forces.sun, FULL.forces.moon) == (70, True, True)
    assert FULL.forces.drag == orbit.Drag(cd=2.2, area_to_mass=12.0 / 2650.0)
    assert FULL.forces.srp == orbit.SolarPressure(cr=1.3, area_to_mass=12.0 / 2650.0)
    np.testing.assert_allclose(FULL.mean_motion, np.sqrt(3.986004415e14 / 6884e3**3), rtol=1e-9)
    assert list(made.log.tables) == ["star", "gnss"]
    assert made.log.gnss is not None
    np.testing.assert_array_equal(made.log.gnss.t, made.t)
    np.testing.assert_array_equal(made.log.stars["star"].t, made.t)


def test_the_gravity_can_be_changed() -> None:
    assert FULL.forces.field is not None
    assert FULL.forces.field.name == "EGM2008"
    field = orbit.GravityField.egm2008()
    other = GnssStarScenario(gravity=replace(field, mu=field.mu * (1.0 + 1e-6)))
    off = np.linalg.norm(other.trial(1).r_i - FULL.trial(1).r_i, axis=1)
    assert off[0] < 1.0
    assert off[-1] > 3.0


def test_the_orbit_is_that_of_the_forces() -> None:
    made = FULL.trial(1)
    start = made.r_i[0], made.v_i[0]
    again = orbit.propagate(FULL.forces, FULL.epoch, *start, made.t, rtol=1e-13)
    np.testing.assert_allclose(made.r_i, again.r, atol=1e-4)
    np.testing.assert_allclose(made.v_i, again.v, atol=1e-7)


def test_earth_fixed_positions_by_erfa() -> None:
    made = FULL.trial(1)
    with iers.conf.set_temp("auto_download", False):
        when = Time("2019-01-21T04:00:00", scale="utc", format="isot")
        table = iers.IERS_B.open()
        dut1 = table.ut1_utc(when).to_value("s")
        xp, yp = (p.to_value("rad") for p in table.pm_xy(when))
    for k in (0, 60, 120):
        tt, ut1 = when.tt, 4.0 * 3600.0 + made.t[k] + dut1
        day = when.utc.jd1 if when.utc.jd1 % 1.0 == 0.5 else when.utc.jd1 - 0.5
        matrix = erfa.c2t06a(tt.jd1, tt.jd2 + made.t[k] / 86400.0, day, ut1 / 86400.0, xp, yp)
        np.testing.assert_allclose(made.r_e[k], matrix @ made.r_i[k], atol=0.05)
        speed = matrix @ made.v_i[k] - np.cross([0.0, 0.0, 7.292115e-5], matrix @ made.r_i[k])
        np.testing.assert_allclose(made.v_e[k], speed, atol=2e-3)


@pytest.mark.parametrize("name", SLEWS)
@pytest.mark.parametrize("force", [J2, None])
def test_rates_are_those_of_the_quaternions(name: str, force: orbit.ForceModel | None) -> None:
    h = 0.05
    made = GnssStarScenario(
        force=force, step=h, gnss_step=60.0, star_step=60.0, duration=700.0, attitude=SLEWS[name]
    ).trial(3)
    for q, rate in ((made.q_ib, made.omega_b), (made.q_ob, made.rate_o)):
        turn = quaternion.log(quaternion.multiply(quaternion.conjugate(q[:-2]), q[2:]))
        close = 1e-8 if name == "large" else 1e-9  # the differences' own error
        np.testing.assert_allclose(turn / (2.0 * h), rate[1:-1], atol=close)
        assert (np.abs(np.diff(q, axis=0)) < 0.1).all()  # no jumps of sign
    q_io = cc.frames.orbital(made.r_i, made.v_i)
    same = quaternion.angle_between(made.q_ib, quaternion.multiply(q_io, made.q_ob))
    assert same.max() < 1e-12


def test_the_slews_pass_through_a_right_angle() -> None:
    for kind, end in (("return", 0.0), ("turn", 120.0)):
        pitch, rate = Slew(np.radians(120.0), 1200.0, kind).pitch([0.0, 600.0, 1200.0])
        np.testing.assert_allclose(
            np.degrees(pitch), [0.0, 120.0 if not end else 60.0, end], atol=1e-9
        )
        assert (abs(rate).max() > 1e-3) == (kind == "turn")


def test_the_profile_has_its_amplitudes_and_periods() -> None:
    t = np.arange(0.0, 3600.0, 1.0)
    angles, rates = AttitudeProfile().angles(t, [0.3, 1.0, 2.0])
    np.testing.assert_allclose(
        np.degrees(np.abs(angles).max(axis=0)), [0.04, 0.02, 0.03], rtol=1e-4
    )
    for k, period in enumerate((900, 600, 400)):
        np.testing.assert_allclose(angles[period:, k], angles[:-period, k], atol=1e-12)
    np.testing.assert_allclose(np.gradient(angles, t, axis=0)[1:-1], rates[1:-1], atol=1e-9)


def test_phases_differ_from_trial_to_trial() -> None:
    first = pooled(QUICK, lambda made: made.q_ob[0, 1:] * 2.0, 300)
    reach = np.radians([0.03, 0.02, 0.04])
    for axis, limit in zip(first.T, reach, strict=True):
        # sin of a uniform phase: arcsine distribution
        assert stats.kstest(axis / limit, stats.arcsine(-1.0, 2.0).cdf).pvalue > 1e-4


# ------------------------------------------------------------------ random numbers


SOURCES: dict[str, dict[str, Any]] = {
    "star": {"star_sigma": 1e-3},
    "lfe": {"lfe": ()},
    "star_markov": {"lfe_markov": (1e-4, 100.0)},
    "star_outliers": {"star_outliers": (0.5, 10.0, 20.0)},
    "gnss": {"gnss_sigma": 7.0},
    "gnss_markov": {"gnss_markov": (3.0, 100.0)},
    "gnss_outliers": {"gnss_outliers": (0.5, 10.0, 20.0)},
    "baselines": {"baseline_sigma": 0.1},
    "gyro": {"gyro": simulate.GyroErrors(arw=1e-3)},
}
TABLE = {"star": "star", "lfe": "star", "gnss": "gnss", "baselines": "baselines", "gyro": "gyro"}


@functools.cache
def everything() -> GnssStarScenario:
    return replace(QUICK, gyro=GYRO, gyro_step=10.0, baselines=ANTENNAS)


@pytest.mark.parametrize("source", SOURCES)
def test_a_source_changes_no_other(source: str) -> None:
    one = everything().trial(4, 2)
    two = replace(everything(), **SOURCES[source]).trial(4, 2)
    np.testing.assert_array_equal(one.q_ib, two.q_ib)
    np.testing.assert_array_equal(one.r_e, two.r_e)
    own = TABLE[source.partition("_")[0]]
    for name, table in one.log.tables.items():
        other = two.log.tables[name]
        same = all(
            np.array_equal(a, b) for a, b in zip(table._parts(), other._parts(), strict=True)
        )
        assert same == (name != own), name
    if source != "lfe":
        np.testing.assert_array_equal(one.lfe, two.lfe)


def test_trials_repeat_on_any_thread() -> None:
    scenario = everything()
    alone = [scenario.trial(9, k) for k in range(8)]
    fresh = GnssStarScenario(force=J2, gyro=GYRO, gyro_step=10.0, baselines=ANTENNAS)
    with ThreadPoolExecutor(4) as pool:
        shared = list(pool.map(lambda k: fresh.trial(9, k), reversed(range(8))))[::-1]
    for one, two in zip(alone, shared, strict=True):
        for name, table in one.log.tables.items():
            for a, b in zip(table._parts(), two.log.tables[name]._parts(), strict=True):
                np.testing.assert_array_equal(a, b)


def test_seeds_and_trials_are_independent() -> None:
    e = [gnss_error(QUICK.trial(s, k))[:, :3].ravel() for s in range(3) for k in range(3)]
    off = np.corrcoef(e) - np.eye(9)
    assert np.abs(off).max() < 5.0 / np.sqrt(363)


def test_sources_are_independent() -> None:
    scenario = replace(everything(), lfe=())
    rows = []
    for k in range(TRIALS):
        made = scenario.trial(6, k)
        rows.append(np.hstack([gnss_error(made), star_error(made)]))
    x = np.vstack(rows)
    assert np.abs(np.corrcoef(x.T) - np.eye(9)).max() < 5.0 / np.sqrt(len(x))


def test_truth_is_read_only_and_shared() -> None:
    one, two = QUICK.trial(1), QUICK.trial(2)
    assert np.shares_memory(one.r_i, two.r_i)
    with pytest.raises(ValueError, match="read-only"):
        one.r_i[0] = 0.0
    assert ORBIT.a == 6884e3
