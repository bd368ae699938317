"""Replays of logs with GNSS fixes that are stopped, killed, refused or asked for by a command."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
import warnings
from dataclasses import replace

import celestcore as cc
import numpy as np
import pytest
from celestcore import cli, replay
from celestcore.gnss import GnssReceiver
from celestcore.orbit import ForceModel
from celestcore.replay import _gnss_piece
from celestcore.replay._gnss_waiting import Waiting
from gnss_parts import (
    ARM,
    DYNAMICS,
    GYRO,
    SCENARIO,
    StoppedError,
    changed,
    check,
    moved,
    same,
    stopping,
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


def test_no_page_is_made_of_orbits(noaa, tmp_path):
    with cc.open_log(noaa) as stream:
        nav = cc.Settings.from_dict(stream.settings).gnss_navigator()
        replay.run(stream, nav, tmp_path / "out", every=60)
    with pytest.raises(cc.InputError, match="GNSS fixes"):
        replay.report(tmp_path / "out", tmp_path / "out.html")


def test_the_command_refuses(noaa, tmp_path, capsys):
    parts = ["replay", noaa, "--parts", tmp_path / "out"]
    assert command(*parts, "--smooth") == 2
    assert "whole logs alone" in " ".join(capsys.readouterr().err.split())
    assert command(*parts, "--report", tmp_path / "out.html") == 2
    assert "without --parts" in " ".join(capsys.readouterr().err.split())
    slow = tmp_path / "slow.toml"
    slow.write_text("[lfe]\namplitudes = [5e-5]\n")
    assert command(*parts, "--config", slow) == 2
    assert "lfe.period" in capsys.readouterr().err
