"""A log with GNSS fixes in windows is the log as a whole, to the bit."""

from __future__ import annotations

import json
from dataclasses import replace
from itertools import pairwise

import celestcore as cc
import numpy as np
import pytest
from celestcore import replay
from celestcore.gnss import Antennas, GaussMarkov, GnssReceiver
from celestcore.gnss._earth import Earth
from celestcore.orbit import ForceModel, OrbitDynamics
from celestcore.replay import _gnss_track, _gnss_waiting
from gnss_parts import (
    ARM,
    DYNAMICS,
    GYRO,
    SCENARIO,
    WINDOWS,
    between,
    changed,
    check,
    moved,
    turned,
    windows_of,
)

pytest.importorskip("pyarrow")
pytestmark = pytest.mark.filterwarnings("ignore::celestcore.CelestcoreWarning")


@pytest.fixture(scope="module")
def made():
    return SCENARIO.trial(seed=1, trial=0)


@pytest.fixture(scope="module")
def turning():
    return replace(SCENARIO, gyro=cc.gnss.GYRO, lever_arm=ARM).trial(seed=2, trial=0)


@pytest.fixture(scope="module")
def nav():
    return cc.GnssStarNavigator(dynamics=DYNAMICS)


def compare(log, nav, folder, windows=WINDOWS):
    whole = nav.run(log)
    for window in windows:
        out = folder / f"{window:g}"
        summary = replay.run(log, nav, out, window=window)
        assert summary.parts > 1 or window > 1e6
        check(replay.read(out), summary, whole)
    return whole


def garbage(log):
    rng = np.random.default_rng(5)
    r, bad = log.gnss.r.copy(), (log.gnss.t > 700.0) & (log.gnss.t < 1800.0)
    r[bad] += 1e4 * rng.standard_normal((int(bad.sum()), 3))
    return changed(log, r=r)


def wrong_at_first(log):
    r, q = log.gnss.r.copy(), log.stars["star"].q.copy()
    r[[0, 2, 5]] += 5e3
    q[[0, 3]] = cc.quaternion.multiply(q[[0, 3]], cc.quaternion.exp([0.1, 0.0, 0.0]))
    return changed(log, r=r, q=q)


LOGS = {
    "plain": lambda log: log,
    "a jump": lambda log: moved(log, 900.0, np.inf, [300.0, 0.0, 0.0]),
    "a jump and back": lambda log: moved(log, 430.0, 1290.0, [300.0, 0.0, 0.0]),
    "garbage": garbage,
    "wrong first fixes": wrong_at_first,
    "a camera that moves": lambda log: turned(log, 861.0),
    "no stars at a seam": lambda log: changed(
        log, stars=between(log.stars["star"].t, 420.0, 700.0)
    ),
    "no fixes over seams": lambda log: changed(log, fixes=between(log.gnss.t, 800.0, 1400.0)),
    "nothing over seams": lambda log: changed(
        log,
        fixes=between(log.gnss.t, 800.0, 1400.0),
        stars=between(log.stars["star"].t, 800.0, 1400.0),
    ),
    "late stars": lambda log: changed(log, stars=log.stars["star"].t > 1000.0),
    "early stars": lambda log: changed(log, fixes=log.gnss.t > 600.0),
    "no stars": lambda log: cc.SensorLog(epoch=log.epoch, gnss=log.gnss),
}


@pytest.mark.parametrize("name", LOGS)
def test_windows_are_the_whole_log(made, nav, tmp_path, name):
    whole = compare(LOGS[name](made.log), nav, tmp_path)
    assert bool(whole.restarts) == name.startswith("a jump")
    assert bool(whole.attitude_restarts) == (name == "a camera that moves")


NAVIGATORS = {
    "ukf and a bias": {
        "filter": cc.UKF(),
        "gnss": GnssReceiver(1.0, 0.01, bias=GaussMarkov(1.0, 1800.0)),
    },
    "offsets": {"gnss": GnssReceiver(1.0, 0.01, time_offset=0.3), "star_time_offset": -4.7},
    "a slow error": {
        "lfe": cc.LowFrequencyError(period=5600.0, gauss_markov=GaussMarkov(1e-5, 1000.0))
    },
    "a fading error alone": {"lfe": cc.LowFrequencyError((), gauss_markov=GaussMarkov(1e-5, 1e3))},
    "all is believed": {"gate": 1.0, "max_rejected": None},
    "positions alone": {"gnss": GnssReceiver(1.0, None)},
    "forces of the date": {
        "dynamics": OrbitDynamics(ForceModel(gravity=4, sun=True, moon=True), 1e-7)
    },
}


@pytest.mark.parametrize("name", NAVIGATORS)
def test_every_state_goes_over_the_seam(made, tmp_path, name):
    compare(made.log, cc.GnssStarNavigator(**{"dynamics": DYNAMICS, **NAVIGATORS[name]}), tmp_path)


@pytest.mark.parametrize("gyro", [None, GYRO])
def test_a_lever_arm_and_a_gyro(turning, tmp_path, gyro):
    nav = cc.GnssStarNavigator(dynamics=DYNAMICS, gyro=gyro, lever_arm=ARM)
    compare(turning.log, nav, tmp_path)
    quiet = changed(turning.log, stars=between(turning.log.stars["star"].t, 420.0, 900.0))
    compare(quiet, nav, tmp_path / "quiet")


def test_a_gyro_with_gaps(turning, tmp_path):
    t = turning.log.gyro.t
    some = between(t, 800.0, 1100.0) & (t > 95.5) & (t < 2300.0)
    log = turned(changed(turning.log, gyro=some), 1300.0)
    nav = cc.GnssStarNavigator(dynamics=DYNAMICS, gyro=GYRO)
    assert compare(log, nav, tmp_path).attitude_restarts
    summary = json.loads((tmp_path / "35" / "summary.json").read_text())
    assert 0 < summary["samples"] <= int(some.sum())


def test_a_gyro_that_begins_late_while_fixes_wait(turning, tmp_path):
    """How far away the first sample is counts from the log's begin, not from a seam before it."""
    late = changed(turning.log, gyro=turning.log.gyro.t > 500.5)
    log = moved(late, 485.0, np.inf, [300.0, 0.0, 0.0])
    nav = cc.GnssStarNavigator(dynamics=DYNAMICS, gyro=GYRO)
    assert compare(log, nav, tmp_path, windows=(35.0, 510.0)).restarts[0] == 490.0
    assert replay.read(tmp_path / "510")["health"]["t_end"][0] < 500.5


@pytest.mark.parametrize("arm", [(0.0, 0.0, 0.0), ARM])
def test_a_sensor_that_falls_silent_holds_nothing_back_for_long(
    turning, tmp_path, monkeypatch, arm
):
    """It refused a few fixes before: if none follows, the results are those of the whole log."""
    for module in (_gnss_track, _gnss_waiting):
        monkeypatch.setattr(module, "MOST_HELD", 300.0)
    nav = cc.GnssStarNavigator(dynamics=DYNAMICS, lever_arm=arm)
    t = turning.log.stars["star"].t
    dead = turned(changed(turning.log, stars=t < 700.0), 660.0)
    reached, out = [], tmp_path / "out"
    with pytest.warns(cc.CelestcoreWarning, match="a sensor fell silent"):
        summary = replay.run(dead, nav, out, window=60.0, progress=reached.append)
    check(replay.read(out), summary, nav.run(dead))
    assert max(np.diff(reached)) <= 360.0


def test_a_receiver_that_comes_back_starts_again_there(made, nav, tmp_path, monkeypatch):
    """Not before the rows that are written."""
    monkeypatch.setattr(_gnss_track, "MOST_HELD", 300.0)
    jump = moved(made.log, 660.0, np.inf, [300.0, 0.0, 0.0])
    log = changed(jump, fixes=between(jump.gnss.t, 700.0, 1500.0))
    sol = nav.run(log)
    assert sol.restarts[0] == 670.0
    for window in (60.0, 350.0):
        with pytest.warns(cc.CelestcoreWarning, match="a sensor fell silent"):
            summary = replay.run(log, nav, tmp_path / f"{window:g}", window=window)
        assert summary.restarts[0] == 1510.0
        rows = replay.read(tmp_path / f"{window:g}")["rows"]
        np.testing.assert_array_equal(rows["t"], sol.t)
        early = sol.t < 670.0
        np.testing.assert_array_equal(rows["x"][early], sol.r[early, 0])
        at = np.flatnonzero(sol.t == 1600.0)
        assert abs(rows["x"][at] - sol.r[at, 0]) < 10.0


def test_antennas_and_two_star_sensors(made, tmp_path):
    log, star = made.log, made.log.stars["star"]
    arms = np.array([[2.0, 0.0, 0.0], [0.0, 1.5, 0.0]])
    n, t = len(log.gnss.t), log.gnss.t
    inertial = cc.quaternion.rotate(np.repeat(made.q_ib[:n], 2, axis=0), np.tile(arms, (n, 1)))
    earth = cc.frames.gcrs_to_itrs(log.epoch, t)
    b = np.einsum("nij,nkj->nki", earth, inertial.reshape(n, 2, 3))
    b = b + 0.003 * np.random.default_rng(1).standard_normal(b.shape)
    several = cc.SensorLog(
        epoch=log.epoch,
        gnss=log.gnss,
        star_b=(star.t, star.q),
        star_a=(star.t[50::2], star.q[50::2]),
        baselines=(t, b),
    )
    antennas = Antennas(arms, sigma=0.005)
    compare(several, cc.GnssStarNavigator(dynamics=DYNAMICS, antennas=antennas), tmp_path)


@pytest.mark.parametrize("seed", range(6))
def test_random_faults_and_windows(made, tmp_path, seed):
    """Stretches of wrong fixes of any length: restarts, refusals and seams meet in all ways."""
    rng = np.random.default_rng(seed)
    log = made.log
    for _ in range(8):
        begin, length = rng.uniform(0.0, 2400.0), rng.choice([15.0, 45.0, 120.0, 400.0])
        size = rng.choice([60.0, 3e3]) * rng.standard_normal(3)
        log = moved(log, begin, begin + length, size)
        begin = rng.uniform(0.0, 2400.0)
        log = turned(log, begin, begin + length, by=rng.choice([1e-3, 0.3]))
    nav = cc.GnssStarNavigator(dynamics=DYNAMICS, max_rejected=int(rng.integers(2, 6)))
    compare(log, nav, tmp_path, windows=rng.uniform(15.0, 300.0, 3))


def test_a_log_long_after_its_epoch(made, nav, tmp_path):
    """Frames count from the log's begin; tables of the forces reach farther and farther."""
    late = 40.0 * 86400.0 - 1200.0
    epoch, star = "2018-12-12T04:20:00", made.log.stars["star"]
    log = cc.SensorLog(
        epoch=epoch,
        gnss=(made.log.gnss.t + late, made.log.gnss.r, made.log.gnss.v),
        star=(star.t + late, star.q),
    )
    dynamics = OrbitDynamics(ForceModel(gravity=4), 1e-6)
    compare(log, cc.GnssStarNavigator(dynamics=dynamics), tmp_path)


def test_part_of_the_times_has_the_bits_of_the_whole():
    epoch = "2026-01-01T00:00:00"
    for begin in (0.0, 5000.3, 3e7):
        t = begin + np.arange(0.0, 20000.0, 50.0)
        whole = Earth(epoch).at(t)
        for some in (slice(0, 1), slice(3, 5), slice(70, 200), slice(399, 400)):
            part = Earth(epoch, t[0]).at(t[some].copy())
            for a, b in zip(whole, part, strict=True):
                np.testing.assert_array_equal(a[some], b)


def test_fewer_rows(made, nav, tmp_path):
    whole = nav.run(made.log)
    summary = replay.run(made.log, nav, tmp_path / "out", window=77.0, every=7)
    check(replay.read(tmp_path / "out"), summary, whole, every=7)
    assert summary.rows == len(whole.t[::7])
    replay.run(made.log, nav, tmp_path / "nis", window=300.0, innovations="nis")
    assert list(replay.read(tmp_path / "nis")["measurements"])[-1] == "accepted"
    replay.run(made.log, nav, tmp_path / "none", window=300.0, innovations="none")
    assert not replay.read(tmp_path / "none")["measurements"]


def test_windows_of_ones_own(made, nav, tmp_path):
    log, whole = made.log, nav.run(made.log)
    own = [{n: c for n, c in w.items() if len(c[0])} for w in windows_of(log, 130.0)]
    summary = replay.run(own, nav, tmp_path / "out", epoch=log.epoch)
    check(replay.read(tmp_path / "out"), summary, whole)
    with pytest.raises(cc.InputError, match=r"epoch.*is needed"):
        replay.run(own, nav, tmp_path / "none")
    late = tuple(part[3:5] for part in own[4]["gnss"])
    own[4]["gnss"] = tuple(np.delete(part, [3, 4], axis=0) for part in own[4]["gnss"])
    own[7]["gnss"] = tuple(np.concatenate(p) for p in zip(late, own[7]["gnss"], strict=True))
    with pytest.warns(cc.CelestcoreWarning, match="2 of gnss"):
        assert replay.run(own, nav, tmp_path / "late", epoch=log.epoch).late == {"gnss": 2}


def test_missing_rows_of_a_whole_window(made, nav, tmp_path):
    r = made.log.gnss.r.copy()
    r[(made.log.gnss.t > 600.0) & (made.log.gnss.t < 900.0)] = np.nan
    star = made.log.stars["star"]
    given = {"gnss": (made.log.gnss.t, r, made.log.gnss.v), "star": (star.t, star.q)}
    whole = nav.run(cc.SensorLog(epoch=made.log.epoch, **given))
    cuts = np.arange(0, len(r) + 20, 20)
    own = [
        {name: tuple(c[a:b] for c in columns) for name, columns in given.items()}
        for a, b in pairwise(cuts)
    ]
    summary = replay.run(own, nav, tmp_path / "out", epoch=made.log.epoch)
    check(replay.read(tmp_path / "out"), summary, whole)


def test_restarts_without_an_output_row_between(made, nav):
    log = turned(made.log, 1000.0)
    for grid in ([100.0], [2300.0], [100.0, 2300.0]):
        sol = nav.run(log, t_output=grid)
        assert sol.attitude_restarts
        assert len(sol) == len(sol.q) == len(grid)
