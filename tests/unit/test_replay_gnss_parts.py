"""A log with GNSS fixes in windows is the log as a whole, to the bit, whatever stops the replay."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
import warnings
from dataclasses import replace
from itertools import pairwise

import celestcore as cc
import numpy as np
import pytest
from celestcore import cli, replay
from celestcore.gnss import Antennas, GaussMarkov, GnssReceiver, GnssStarScenario
from celestcore.gnss._earth import Earth
from celestcore.orbit import ForceModel, OrbitDynamics
from celestcore.replay import _gnss_piece, _gnss_track, _gnss_waiting
from celestcore.replay._gnss_waiting import Waiting
from celestcore.replay._source import stretches

pytest.importorskip("pyarrow")
pytestmark = pytest.mark.filterwarnings("ignore::celestcore.CelestcoreWarning")

DYNAMICS = OrbitDynamics(ForceModel.j2(), 1e-8)
SCENARIO = GnssStarScenario(force=ForceModel.j2(), duration=2400.0, lfe=())
ARM = (1.0, 0.5, -2.0)
GYRO = cc.Gyro(0.005 * cc.DEG_PER_SQRT_HOUR, 1e-9)
WINDOWS = (35.0, 430.0)


@pytest.fixture(scope="module")
def made():
    return SCENARIO.trial(seed=1, trial=0)


@pytest.fixture(scope="module")
def turning():
    return replace(SCENARIO, gyro=cc.gnss.GYRO, lever_arm=ARM).trial(seed=2, trial=0)


@pytest.fixture(scope="module")
def nav():
    return cc.GnssStarNavigator(dynamics=DYNAMICS)


def changed(log, *, r=None, q=None, fixes=None, stars=None, gyro=None):
    """Return a log with other values, or only some of its rows."""
    gnss, star = log.gnss, log.stars["star"]
    r, q = (gnss.r if r is None else r), (star.q if q is None else q)
    keep = slice(None) if fixes is None else fixes
    seen = slice(None) if stars is None else stars
    return cc.SensorLog(
        epoch=log.epoch,
        gnss=(gnss.t[keep], r[keep], gnss.v[keep]),
        star=(star.t[seen], q[seen]),
        gyro=log.gyro if gyro is None else (log.gyro.t[gyro], log.gyro.rate[gyro]),
    )


def moved(log, begin, end, by):
    r = log.gnss.r.copy()
    r[(log.gnss.t > begin) & (log.gnss.t < end)] += by
    return changed(log, r=r)


def turned(log, begin, end=np.inf, by=0.02):
    star = log.stars["star"]
    q, late = star.q.copy(), (star.t > begin) & (star.t < end)
    q[late] = cc.quaternion.multiply(q[late], cc.quaternion.exp([0.0, by, 0.0]))
    return changed(log, q=q)


def check(found, summary, whole, every=1):
    """Hold parts against a run over the whole log: to the bit."""
    columns = whole.columns()
    assert list(found["rows"]) == list(columns)
    for name, column in columns.items():
        np.testing.assert_array_equal(found["rows"][name], column[::every], err_msg=name)
    seen, both = found["measurements"], (whole.gnss, whole.attitude)
    t = np.concatenate([m.t for m in both])
    order = np.argsort(t, kind="stable")
    for name, parts in (
        ("t", [m.t for m in both]),
        ("nis", [m.nis for m in both]),
        ("accepted", [m.accepted for m in both]),
        ("sensor", [m.kind.astype(object) for m in both]),
        ("iy", [m.innovation[:, 1] for m in both]),
        ("s_iz", [m.sigma[:, 2] for m in both]),
    ):
        np.testing.assert_array_equal(seen[name], np.concatenate(parts)[order], err_msg=name)
    assert summary.restarts == sorted([*whole.restarts, *whole.attitude_restarts])
    assert summary.fixes == len(t) == found["health"]["fixes"].sum()
    refused = sum(int((~m.accepted).sum()) for m in both)
    assert summary.rejected == refused == found["health"]["rejected"].sum()
    assert summary.log_likelihood == pytest.approx(whole.log_likelihood, rel=1e-12)


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


def between(t, begin, end):
    return (t < begin) | (t > end)


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


def windows_of(log, seconds):
    return [window.tables for window in stretches(log, seconds, -np.inf)]


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


class StoppedError(Exception):
    pass


def stopping(after):
    left = [after]

    def progress(_):
        left[0] -= 1
        if not left[0]:
            raise StoppedError

    return progress


def same(one, two):
    for table in ("rows", "measurements"):
        assert one[table].keys() == two[table].keys()
        for name, column in one[table].items():
            np.testing.assert_array_equal(column, two[table][name], err_msg=name)


@pytest.mark.parametrize("driven", [False, True])
def test_a_stopped_replay_goes_on_to_the_same_bits(turning, tmp_path, driven):
    log = turned(moved(turning.log, 900.0, np.inf, [300.0, 0.0, 0.0]), 600.0)
    nav = cc.GnssStarNavigator(
        dynamics=DYNAMICS,
        gnss=GnssReceiver(1.0, 0.01, lever_arm=ARM, time_offset=0.1),
        gyro=GYRO if driven else None,
        lfe=cc.LowFrequencyError(period=5600.0),
        star_time_offset=-0.4,
    )
    cc.write_log(log, tmp_path / "log")
    given = {"window": 60.0, "every": 3}

    def go(out, **more):
        with cc.open_log(tmp_path / "log") as stream:
            return replay.run(stream, nav, tmp_path / out, **given, **more)

    go("whole")
    memory = {"checkpoint": tmp_path / "c.json", "interval": 0.0}
    stops = 0
    for after in (2, 1, 5, 3, 1, 90):
        try:
            done = go("out", **memory, resume=stops > 0, progress=stopping(after))
        except StoppedError:
            stops += 1
    assert stops == 5
    assert done.resumed
    same(replay.read(tmp_path / "whole"), replay.read(tmp_path / "out"))
    one = json.loads((tmp_path / "whole" / "summary.json").read_text())
    two = json.loads((tmp_path / "out" / "summary.json").read_text())
    for name in ("rows", "samples", "fixes", "rejected", "restarts", "log_likelihood", "late"):
        assert one[name] == two[name], name


SCRIPT = """
import sys, time
import celestcore as cc
from celestcore import cli, replay
log, out, memory, resume = sys.argv[1], sys.argv[2], sys.argv[3], sys.argv[4] == "1"
nav = cc.GnssStarNavigator(dynamics=cc.orbit.OrbitDynamics(cc.orbit.ForceModel.j2(), 1e-8))
print("ready", flush=True)
with cc.open_log(log) as stream:
    replay.run(stream, nav, out, window=30.0, checkpoint=memory, interval=0.0, resume=resume,
               progress=lambda t: time.sleep(0.02))
"""


@pytest.mark.skipif(os.name != "posix", reason="needs kill -9")
def test_a_killed_replay_goes_on_to_the_same_bits(made, nav, tmp_path):
    log = moved(made.log, 900.0, np.inf, [300.0, 0.0, 0.0])
    cc.write_log(log, tmp_path / "log")
    whole = nav.run(cc.read_log(tmp_path / "log"))
    call = [sys.executable, "-W", "ignore", "-c", SCRIPT, str(tmp_path / "log")]
    call += [str(tmp_path / "out"), str(tmp_path / "c.json")]
    known = 0

    def written():
        return len(list((tmp_path / "out" / "rows").glob("part-*.parquet")))

    for resume in ("0", "1"):
        child = subprocess.Popen([*call, resume], stdout=subprocess.PIPE)
        child.stdout.readline()
        wanted, began = 2 * known + 3, time.monotonic()
        while written() < wanted and child.poll() is None and time.monotonic() - began < 60.0:
            time.sleep(0.01)
        known = written()
        child.send_signal(signal.SIGKILL)
        assert child.wait() == -signal.SIGKILL
        child.stdout.close()
        assert (tmp_path / "c.json").exists()
    subprocess.run([*call, "1"], check=True, stdout=subprocess.DEVNULL, timeout=120.0)
    found = replay.read(tmp_path / "out")
    summary = replay.Summary(
        **{
            name: value
            for name, value in json.loads((tmp_path / "out" / "summary.json").read_text()).items()
            if name in replay.Summary.__dataclass_fields__
        }
    )
    assert summary.resumed
    check(found, summary, whole)
    assert not list((tmp_path / "out").rglob("*.tmp*"))


def test_tables_of_the_forces_reach_as_far_as_is_known(monkeypatch):
    """Near the end of the tables of the Earth's orientation they are asked for no farther."""
    asked = []

    def environment(force, epoch, span, given):
        asked.append(span[1])
        if span[1] > 5e5:
            raise cc.InputError("leaves the table", field="epoch")
        return {"reach": span[1]}

    monkeypatch.setattr(_gnss_piece, "environment_of", environment)
    tables = _gnss_piece.Environment(ForceModel(gravity=4), "2026-01-01")
    assert tables.over(0.0, 1e3)["reach"] == 1e3 + 86400.0
    assert tables.over(0.0, 5e4)["reach"] == 1e3 + 86400.0
    assert len(asked) == 2
    assert tables.over(0.0, 4.5e5)["reach"] == 4.5e5
    with pytest.raises(cc.InputError, match="leaves the table"):
        tables.over(0.0, 6e5)


def test_what_is_read_again(nav):
    """A stream goes on where the earliest tag is whose time has not been reached."""
    receiver = GnssReceiver(1.0, 0.01, time_offset=0.1)
    own = cc.GnssStarNavigator(dynamics=DYNAMICS, gnss=receiver, star_time_offset=-0.4)
    for navigator, expected in ((nav, 100.0), (own, 99.6)):
        waiting = Waiting(navigator, ("gnss", "star", "gyro", "vector_sun"))
        assert waiting.names == ["gnss", "star"]
        waiting.reached = 100.0
        assert waiting.reading_from == pytest.approx(expected)


def test_a_checkpoint_is_of_this_navigator(made, nav, tmp_path):
    memory = tmp_path / "c.json"
    given = {"window": 300.0, "checkpoint": memory, "interval": 0.0}
    replay.run(made.log, nav, tmp_path / "out", **given)
    kept = replay.read_checkpoint(memory).state
    assert kept["orbit"]["state"].shape == (6,)
    assert '"__float__": "0x' in json.loads(memory.read_text())["payload"]
    others = (
        {"max_rejected": 7},
        {"star_time_offset": 0.5},
        {"attitude": cc.gnss.KinematicAttitude(jerk_psd=1e-15)},
        {"gate": 0.99},
    )
    for other in others:
        changed_nav = cc.GnssStarNavigator(dynamics=DYNAMICS, **other)
        with pytest.raises(cc.InputError, match="another navigator or other options"):
            replay.run(made.log, changed_nav, tmp_path / "out", **given, resume=True)
    memory.write_text(memory.read_text().replace("orbit", "orbir", 1))
    with pytest.raises(cc.InputError, match="damaged"):
        replay.run(made.log, nav, tmp_path / "out", **given, resume=True)


def test_what_cannot_be_split_is_refused(made, turning, nav, tmp_path):
    log, out = made.log, tmp_path / "out"
    harmonics = cc.GnssStarNavigator(dynamics=DYNAMICS, lfe=cc.LowFrequencyError())
    driven = cc.GnssStarNavigator(dynamics=DYNAMICS, gyro=GYRO)
    angles = cc.CelestialNavigator(cc.EKF(), DYNAMICS, cc.celestial.StarHorizon())
    two = cc.SensorLog(
        epoch=log.epoch, gnss=log.gnss, star=log.stars["star"], star_2=log.stars["star"]
    )
    slow = cc.GnssStarNavigator(dynamics=DYNAMICS, lfe=cc.LowFrequencyError(period=5600.0))
    stars = cc.SensorLog(epoch=log.epoch, star=log.stars["star"])
    orbit = cc.SensorLog(epoch=log.epoch, gnss=log.gnss)
    arm = cc.GnssStarNavigator(dynamics=DYNAMICS, lever_arm=ARM)
    bare = cc.SensorLog(gnss=log.gnss, star=log.stars["star"])
    for source, navigator, options, words in (
        (log, nav, {"smooth": True}, r"smooth.*nav\.smooth\(log\)"),
        (log, nav, {"max_rejected": 5}, r"max_rejected.*GnssStarNavigator\(max_rejected"),
        (log, nav, {"max_rejected": None}, "max_rejected"),
        (log, harmonics, {}, r"lfe\.period.*LowFrequencyError\(period"),
        (log, driven, {}, "gyro.*the log has none"),
        (windows_of(log, 300.0), driven, {"epoch": log.epoch}, "gyro.*the log has none"),
        (two, slow, {}, "lfe.*star_2"),
        (orbit, arm, {}, "lever_arm.*needs star fixes"),
        ([], nav, {"epoch": log.epoch}, "gnss.*no GNSS fixes"),
        (stars, nav, {}, "gnss.*no GNSS fixes"),
        (windows_of(stars, 300.0), nav, {"epoch": log.epoch}, "gnss.*no GNSS fixes"),
        (bare, nav, {}, "epoch.*is needed"),
        (log, angles, {}, r"CelestialNavigator.*covariance0"),
        (log, "nav", {}, "navigator"),
    ):
        with pytest.raises(cc.InputError, match=words):
            replay.run(source, navigator, out, **options)
    assert not out.exists() or not list(out.rglob("*.parquet"))


def test_a_start_that_fails_says_so(made, nav, tmp_path):
    rng = np.random.default_rng(1)
    r = made.log.gnss.r + 1e5 * rng.standard_normal(made.log.gnss.r.shape)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        wrong = changed(made.log, r=r)
        for go in (lambda: nav.run(wrong), lambda: replay.run(wrong, nav, tmp_path / "out")):
            with pytest.raises(cc.InputError, match="no orbit to start from"):
                go()


@pytest.fixture(scope="module")
def noaa(tmp_path_factory):
    folder = tmp_path_factory.mktemp("log") / "noaa20"
    cc.write_log(cc.sample("noaa20"), folder)
    return folder


def command(*words):
    return cli.main([str(word) for word in words])


def test_the_command(noaa, tmp_path, capsys):
    """More than an orbit: the sign of the attitude goes over the seams, too."""
    out, memory = tmp_path / "out", tmp_path / "c.json"
    parts = ["replay", noaa, "--parts", out, "--checkpoint", memory, "--window", 900]
    assert command(*parts, "--json", tmp_path / "s.json") == 0
    said = capsys.readouterr().out
    assert "21,600 fixes, 2 refused; 14,400 rows" in said
    assert "gyro" not in said
    log = cc.read_log(noaa)
    nav = cc.Settings.from_log(log).gnss_navigator()
    whole, found = nav.run(log), replay.read(out)
    summary = replay.Summary(**json.loads((tmp_path / "s.json").read_text()))
    # the first window holds a single star fix
    assert (summary.windows, summary.parts) == (9, 8)
    check(found, summary, whole)
    assert set(found["health"]["sensor"]) == {"position", "velocity", "star"}
    given = {"window": 900.0, "checkpoint": memory, "interval": 0.0}
    with cc.open_log(noaa) as stream, pytest.raises(StoppedError):
        replay.run(stream, nav, tmp_path / "stopped", **given, progress=stopping(4))
    parts[3] = tmp_path / "stopped"
    assert command(*parts, "--resume") == 0
    assert "went on from the checkpoint" in capsys.readouterr().out
    same(found, replay.read(tmp_path / "stopped"))


def test_the_command_refuses(noaa, tmp_path, capsys):
    parts = ["replay", noaa, "--parts", tmp_path / "out"]
    assert command(*parts, "--smooth") == 2
    assert "whole logs alone" in " ".join(capsys.readouterr().err.split())
    slow = tmp_path / "slow.toml"
    slow.write_text("[lfe]\namplitudes = [5e-5]\n")
    assert command(*parts, "--config", slow) == 2
    assert "lfe.period" in capsys.readouterr().err


def test_restarts_without_an_output_row_between(made, nav):
    log = turned(made.log, 1000.0)
    for grid in ([100.0], [2300.0], [100.0, 2300.0]):
        sol = nav.run(log, t_output=grid)
        assert sol.attitude_restarts
        assert len(sol) == len(sol.q) == len(grid)
