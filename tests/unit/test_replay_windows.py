"""A log in windows is the log as a whole, whatever stops the replay on its way."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time

import celestcore as cc
import numpy as np
import pytest
from celestcore import replay
from celestcore.replay import _windows
from celestcore.replay._source import stretches, window_of
from celestcore.replay._windows import Splicer

pytest.importorskip("pyarrow")


def windows_of(log, seconds):
    return [window.tables for window in stretches(log, seconds, -np.inf)]


@pytest.fixture(scope="module")
def log():
    rng = np.random.default_rng(3)
    t = np.round(np.arange(0.0, 1800.0, 0.25) + 0.01 * rng.random(7200), 6)
    truth = cc.simulate.earth_pointing(1801.0, dt=0.25)
    q = cc.quaternion.slerp(truth.q[:-1], truth.q[1:], 0.0)
    star_t = t[3::4] + 0.004
    at = np.clip((star_t / 0.25).astype(int), 0, len(q) - 1)
    noise = cc.quaternion.exp(5 * cc.ARCSEC * rng.normal(size=(len(at), 3)))
    rate = np.full((len(t), 3), [0.0, -1.1e-3, 0.0]) + 1e-6 * rng.normal(size=(len(t), 3))
    return cc.SensorLog(
        epoch="2026-01-01", gyro=(t, rate), star=(star_t, cc.quaternion.multiply(q[at], noise))
    )


@pytest.fixture(scope="module")
def nav():
    return cc.StarGyroNavigator(
        cc.EKF(), cc.Gyro(1e-5, 1e-8), cc.StarCamera(60 * cc.ARCSEC), gate=0.9999
    )


def same(a, b):
    for table in ("rows", "measurements"):
        assert a[table].keys() == b[table].keys()
        for name, column in a[table].items():
            np.testing.assert_array_equal(column, b[table][name], err_msg=name)


@pytest.mark.parametrize("every", [1, 7])
@pytest.mark.parametrize("window", [13.0, 200.0, 1e9])
def test_windows_are_the_whole_log(log, nav, tmp_path, every, window):
    summary = replay.run(log, nav, tmp_path / "out", window=window, every=every)
    found = replay.read(tmp_path / "out")
    whole = nav.run(log, every=every)
    rows = found["rows"]
    assert summary.samples == whole.counts["samples"]
    assert summary.rows == len(rows["t"])
    # the last piece ends with the last gyro sample, which need not be a row of the whole log
    n = len(whole.t)
    assert n <= len(rows["t"]) <= n + 1
    np.testing.assert_array_equal(rows["t"][:n], whole.t)
    q = np.stack([rows[c][:n] for c in ("qw", "qx", "qy", "qz")], axis=1)
    turn = cc.quaternion.angle_between(q, whole.q)
    assert turn.max() < 1e-12
    np.testing.assert_allclose(rows["s_ax"][:n], whole.sigma[:, 0], rtol=1e-9)
    np.testing.assert_allclose(rows["bz"][:n], whole.bias[:, 2], atol=1e-15)
    np.testing.assert_array_equal(found["measurements"]["t"], whole.measurement_t)
    np.testing.assert_array_equal(found["measurements"]["accepted"], whole.accepted)
    assert summary.log_likelihood == pytest.approx(whole.log_likelihood, rel=1e-12)


def test_a_window_holds_so_many_samples(log, tmp_path):
    assert window_of(log) == pytest.approx(25_000.0, rel=0.05)
    assert window_of(log, 10) == pytest.approx(50_000.0, rel=0.05)
    cc.write_log(log, tmp_path / "log")
    with cc.open_log(tmp_path / "log") as stream:
        assert window_of(stream) == window_of(log)
        assert len(stream.read().gyro) == len(log.gyro)
    star = log.stars["star"]
    cc.write_log(cc.SensorLog(star=star), tmp_path / "star.npz")
    with cc.open_log(tmp_path / "star.npz") as stream:
        assert window_of(stream) == 3600.0
    assert window_of(iter([])) == 3600.0
    assert window_of(cc.SensorLog(gyro=([0.0, 1e-7, 2e-7], np.zeros((3, 3))))) == 1.0


@pytest.mark.parametrize("every", [1, 7, 500])
def test_a_long_window_is_cut_into_pieces(log, nav, tmp_path, monkeypatch, every):
    """What a fast gyro's window becomes must fit into memory, whatever its length in seconds."""
    replay.run(log, nav, tmp_path / "whole", window=900.0, every=every)
    monkeypatch.setattr(_windows, "MOST", 400)
    summary = replay.run(log, nav, tmp_path / "out", window=900.0, every=every)
    assert summary.parts >= len(log.gyro) // max(800, every)
    one, two = replay.read(tmp_path / "whole"), replay.read(tmp_path / "out")
    for table in ("rows", "measurements"):
        assert len(one[table]["t"]) == len(two[table]["t"])
        for name, column in one[table].items():
            if column.dtype == float:
                np.testing.assert_allclose(column, two[table][name], rtol=1e-6, atol=1e-12)


def test_a_smoother_looks_ahead(log, nav, tmp_path):
    replay.run(log, nav, tmp_path / "out", window=100.0, smooth=True, overlap=600.0)
    rows = replay.read(tmp_path / "out")["rows"]
    whole = nav.smooth(nav.run(log))
    np.testing.assert_array_equal(rows["t"], whole.t)
    np.testing.assert_allclose(rows["s_ax"], whole.sigma[:, 0], rtol=0.02)
    late = rows["t"] > 600.0
    np.testing.assert_allclose(rows["s_ax"][late], whole.sigma[late, 0], rtol=1e-4)
    filtered = nav.run(log)
    assert rows["s_ax"][100:].mean() < 0.9 * filtered.sigma[100:, 0].mean()


class StoppedError(Exception):
    pass


def stopping(after):
    """Raise after so many parts."""
    left = [after]

    def progress(_):
        left[0] -= 1
        if not left[0]:
            raise StoppedError

    return progress


@pytest.mark.parametrize("smooth", [False, True])
def test_a_stopped_replay_goes_on_to_the_same_bits(log, nav, tmp_path, smooth):
    given = {"window": 60.0, "every": 3, "smooth": smooth, "overlap": 90.0}
    replay.run(log, nav, tmp_path / "whole", **given)
    memory = {"checkpoint": tmp_path / "c.json", "interval": 0.0}
    stops = 0
    for after in (4, 1, 7, 2, 50):
        try:
            done = replay.run(
                log,
                nav,
                tmp_path / "out",
                **given,
                **memory,
                resume=stops > 0,
                progress=stopping(after),
            )
        except StoppedError:
            stops += 1
    assert stops == 4
    assert done.resumed
    same(replay.read(tmp_path / "whole"), replay.read(tmp_path / "out"))
    one = json.loads((tmp_path / "whole" / "summary.json").read_text())
    two = json.loads((tmp_path / "out" / "summary.json").read_text())
    for name in ("rows", "samples", "fixes", "rejected", "log_likelihood", "late"):
        assert one[name] == two[name], name


SCRIPT = """
import sys, time
import celestcore as cc
from celestcore import replay
log, out, memory, resume = cc.read_log(sys.argv[1]), sys.argv[2], sys.argv[3], sys.argv[4] == "1"
camera = cc.StarCamera(60 * cc.ARCSEC)
nav = cc.StarGyroNavigator(cc.EKF(), cc.Gyro(1e-5, 1e-8), camera, gate=0.9999)
print("ready", flush=True)
replay.run(log, nav, out, window=30.0, checkpoint=memory, interval=0.0, resume=resume,
           progress=lambda t: time.sleep(0.02))
"""


@pytest.mark.skipif(os.name != "posix", reason="needs kill -9")
def test_a_killed_replay_goes_on_to_the_same_bits(log, nav, tmp_path):
    cc.write_log(log, tmp_path / "log.npz")
    saved = cc.read_log(tmp_path / "log.npz")
    replay.run(saved, nav, tmp_path / "whole", window=30.0)
    call = [sys.executable, "-c", SCRIPT, str(tmp_path / "log.npz"), str(tmp_path / "out")]
    call.append(str(tmp_path / "c.json"))
    known = 0

    def written():
        return len(list((tmp_path / "out" / "rows").glob("part-*.parquet")))

    for resume in ("0", "1"):
        child = subprocess.Popen([*call, resume], stdout=subprocess.PIPE)
        child.stdout.readline()
        wanted = 2 * known + 3
        while written() < wanted and child.poll() is None:
            time.sleep(0.01)
        known = written()
        child.send_signal(signal.SIGKILL)
        assert child.wait() == -signal.SIGKILL
        child.stdout.close()
        assert (tmp_path / "c.json").exists()
    subprocess.run([*call, "1"], check=True, stdout=subprocess.DEVNULL)
    same(replay.read(tmp_path / "whole"), replay.read(tmp_path / "out"))
    assert not list((tmp_path / "out").rglob("*.tmp*"))


def test_a_full_disk_leaves_what_is_complete(log, nav, tmp_path, monkeypatch):
    import pyarrow.parquet as parquet

    write, left = parquet.write_table, [9]

    def full(table, path, **options):
        left[0] -= 1
        if left[0] < 0:
            path.write_bytes(b"PAR1 half of a file")
            raise OSError(28, "No space left on device")
        write(table, path, **options)

    monkeypatch.setattr(parquet, "write_table", full)
    given = {"window": 60.0, "checkpoint": tmp_path / "c.json", "interval": 0.0}
    with pytest.raises(OSError, match="No space left"):
        replay.run(log, nav, tmp_path / "out", **given)
    part = replay.read(tmp_path / "out")["rows"]
    assert 0 < len(part["t"]) < len(log.gyro)
    monkeypatch.undo()
    replay.run(log, nav, tmp_path / "out", **given, resume=True)
    replay.run(log, nav, tmp_path / "whole", window=60.0)
    same(replay.read(tmp_path / "whole"), replay.read(tmp_path / "out"))


def test_a_log_that_vanishes_leaves_what_is_complete(log, nav, tmp_path):
    def windows():
        for k, window in enumerate(windows_of(log, 60.0)):
            if k == 5:
                raise FileNotFoundError("log.parquet")
            yield window

    with pytest.raises(FileNotFoundError, match=r"log\.parquet"):
        replay.run(windows(), nav, tmp_path / "out", epoch=log.epoch)
    rows = replay.read(tmp_path / "out")["rows"]
    assert rows["t"][-1] == pytest.approx(300.0, abs=2.0)


def test_a_checkpoint_is_checked(log, nav, tmp_path):
    memory = tmp_path / "c.json"
    given = {"window": 300.0, "checkpoint": memory, "interval": 0.0}
    replay.run(log, nav, tmp_path / "out", **given)
    text = memory.read_text()
    with pytest.raises(cc.InputError, match="holds the parts of another replay"):
        replay.run(log, nav, tmp_path / "out", **given)
    with pytest.raises(cc.InputError, match="another navigator or other options"):
        replay.run(log, nav, tmp_path / "out", **given, every=2, resume=True)
    with pytest.raises(cc.InputError, match="is needed to resume"):
        replay.run(log, nav, tmp_path / "out", resume=True)
    for broken in (text[:50], "", "[]", '{"kind": 3}', text.replace("parts", "party", 1)):
        memory.write_text(broken)
        with pytest.raises(cc.InputError, match="damaged"):
            replay.read_checkpoint(memory)
    outer = json.loads(text)
    memory.write_text(json.dumps({**outer, "version": 99}))
    with pytest.raises(cc.InputError, match="version 99"):
        replay.read_checkpoint(memory)
    with pytest.warns(cc.CelestcoreWarning, match="begins anew"):
        replay.run(
            log, nav, tmp_path / "new", window=300.0, checkpoint=tmp_path / "none.json", resume=True
        )


def test_a_replay_stopped_before_its_first_interval_goes_on(log, nav, tmp_path):
    """Parts are there long before a checkpoint is due: they must not stand in the way."""
    given = {"window": 60.0, "checkpoint": tmp_path / "c.json", "interval": 1e9}
    with pytest.raises(StoppedError):
        replay.run(log, nav, tmp_path / "out", **given, progress=stopping(3))
    assert (tmp_path / "c.json").exists()
    assert len(replay.read(tmp_path / "out")["rows"]["t"])
    done = replay.run(log, nav, tmp_path / "out", **given, resume=True)
    replay.run(log, nav, tmp_path / "whole", window=60.0)
    assert done.resumed
    same(replay.read(tmp_path / "whole"), replay.read(tmp_path / "out"))


def test_gaps_starts_anew_and_the_noise_told_are_beside_the_rows(log, nav, tmp_path):
    broken = cc.simulate.faults.dropout(log, "gyro", 300.0, 320.0)
    broken = cc.simulate.faults.bias_step(broken, 900.0, 1e9, [0.0, 5e-3, 0.0])
    with pytest.warns(cc.CelestcoreWarning, match="started again"):
        summary = replay.run(broken, nav, tmp_path / "out", window=100.0)
    found = replay.read(tmp_path / "out")
    events = found["events"]
    assert events["kind"].tolist() == ["gap", *["restart"] * len(summary.restarts)]
    assert events["t"][0] < 300.0 < 320.0 <= events["t_end"][0] < 320.5
    np.testing.assert_array_equal(events["t"][1:], summary.restarts)
    for name in ("sx", "sy", "sz"):
        np.testing.assert_allclose(found["health"][name], 60 * cc.ARCSEC)


def test_refusals_are_said_once_and_not_window_by_window(log, nav, tmp_path):
    star = log.stars["star"]
    turned = cc.simulate.faults.jump(log, "star", 400.0, 1200.0, [0.0, 0.02, 0.0])
    assert len(turned.stars["star"]) == len(star)
    with pytest.warns(cc.CelestcoreWarning) as said:
        replay.run(turned, nav, tmp_path / "out", window=100.0, max_rejected=None)
    assert len([w for w in said if "outside the gate" in str(w.message)]) == 1


def test_rows_that_come_late_are_counted(log, nav, tmp_path):
    windows = list(windows_of(log, 200.0))
    t, q = windows[3]["star"]
    late = tuple(part[:5] for part in (t, q))
    windows[3] = {**windows[3], "star": (t[5:], q[5:])}
    windows[5] = {
        **windows[5],
        "star": tuple(np.concatenate(p) for p in zip(late, windows[5]["star"], strict=True)),
    }
    with pytest.warns(cc.CelestcoreWarning, match="5 of star"):
        summary = replay.run(windows, nav, tmp_path / "out", epoch=log.epoch)
    assert summary.late == {"star": 5}


def test_a_lost_filter_starts_again(log, nav, tmp_path):
    """The camera's frame jumps: all is refused for ever, unless the filter starts again."""
    star = log.stars["star"]
    turn = cc.quaternion.exp([0.0, 0.02, 0.0])
    q = star.q.copy()
    late = star.t > 905.0
    q[late] = cc.quaternion.multiply(q[late], turn)
    jumped = cc.SensorLog(epoch=log.epoch, gyro=log.gyro, star=(star.t, q))
    with pytest.warns(cc.CelestcoreWarning) as said:
        summary = replay.run(jumped, nav, tmp_path / "out", window=100.0)
    words = [str(w.message) for w in said]
    assert any("refused 20 fixes running and started again" in w for w in words)
    assert len(summary.restarts) == 1
    assert 905.0 < summary.restarts[0] < 910.0
    rows = replay.read(tmp_path / "out")["rows"]
    assert np.all(np.diff(rows["t"]) > 0.0)
    assert len(rows["t"]) == len(nav.run(log).t)
    good = nav.run(log)
    after = rows["t"] > 1000.0
    want = cc.quaternion.multiply(good.q[good.t > 1000.0], turn)
    got = np.stack([rows[c][after] for c in ("qw", "qx", "qy", "qz")], axis=1)
    assert cc.quaternion.angle_between(got, want).max() < 60 * cc.ARCSEC
    # and it is said where it was refused
    health = replay.read(tmp_path / "out")["health"]
    assert health["rejected"].sum() == summary.rejected
    with pytest.warns(cc.CelestcoreWarning, match="outside the gate"):
        never = replay.run(jumped, nav, tmp_path / "never", window=100.0, max_rejected=None)
    assert never.rejected > 500


def test_no_fix_for_a_while(log, nav, tmp_path):
    star = log.stars["star"]
    keep = star.t > 500.0
    quiet = cc.SensorLog(epoch=log.epoch, gyro=log.gyro, star=(star.t[keep], star.q[keep]))
    replay.run(quiet, nav, tmp_path / "out", window=100.0)
    rows = replay.read(tmp_path / "out")["rows"]
    assert rows["t"][0] > 499.0
    assert len(rows["t"]) == len(nav.run(quiet).t)


@pytest.mark.parametrize("seed", range(8))
def test_pieces_hold_every_row_once(seed):
    rng = np.random.default_rng(seed)
    t = np.sort(rng.random(500)) * 100.0
    star = np.sort(rng.random(60)) * 100.0
    log = cc.SensorLog(
        gyro=(np.unique(t), np.zeros((len(np.unique(t)), 3))),
        star=(star, np.tile([1.0, 0, 0, 0], (60, 1))),
    )
    splicer = Splicer(int(rng.integers(1, 9)), float(rng.choice([0.0, 7.0])), None)
    gyro, fixes = [], []
    for window in [*windows_of(log, float(rng.random() * 20 + 0.5)), None]:
        if window is not None:
            splicer.push(window)
        piece = splicer.take(last=window is None)
        if piece is None:
            continue
        gyro += piece.log.gyro.t.tolist()[1 if gyro else 0 :]
        fixes += piece.log.stars["star"].t.tolist() if piece.log.stars else []
    assert gyro == log.gyro.t.tolist()
    assert fixes == star.tolist()
    assert not splicer.late


def turned_gyro() -> tuple[cc.SensorLog, cc.StarGyroNavigator]:
    """Return a log whose gyro changes at once, and whose fixes then have the other sign."""
    t = np.arange(0.0, 2000.0, 0.5)
    rate = np.tile([0.002, -0.001, 0.0015], (len(t), 1))
    q = cc.quaternion.propagate([1.0, 0.0, 0.0, 0.0], rate[:-1], 0.5)
    measured = rate + np.where(t >= 1000.0, 2e-3, 0.0)[:, None] * [1.0, 0.0, 0.0]
    sign = np.where(t[::4] >= 1000.0, -1.0, 1.0)[:, None]
    log = cc.SensorLog(gyro=(t, measured), star=(t[::4], sign * q[::4]))
    nav = cc.StarGyroNavigator(cc.EKF(), cc.Gyro(1e-6, 1e-9), cc.StarCamera(1e-5), gate=0.9999)
    return log, nav


@pytest.mark.parametrize("smooth", [False, True])
@pytest.mark.parametrize("window", [150.0, 400.0])
@pytest.mark.parametrize("every", [1, 10])
def test_rows_keep_their_rhythm_and_sign_past_a_start_anew(tmp_path, every, window, smooth):
    log, nav = turned_gyro()
    with pytest.warns(cc.CelestcoreWarning, match="started again"):
        done = replay.run(log, nav, tmp_path / "out", window=window, every=every, smooth=smooth)
    assert done.restarts
    rows = replay.read(tmp_path / "out")["rows"]
    # all of the log's rhythm, but for what lies between a lost filter and the fix it starts from
    rhythm = log.gyro.t[::every]
    missing = np.setdiff1d(rhythm, rows["t"])
    np.testing.assert_array_equal(np.union1d(rows["t"], missing), rhythm)
    lost = done.restarts[0]
    assert ((missing >= lost) & (missing < lost + 4.0)).all()
    q = np.stack([rows[name] for name in ("qw", "qx", "qy", "qz")], axis=1)
    assert (np.sum(q[1:] * q[:-1], axis=1) > 0.0).all()
    assert done.samples == len(log.gyro)


@pytest.mark.parametrize("window", [1.5, 2.5, 5.0, 60.0])
def test_small_windows_start_where_the_whole_log_does(tmp_path, window):
    fermi = cc.sample("fermi")
    nav = cc.Settings.from_log(fermi).navigator()
    star = fermi.stars["star"]
    q = star.q[:300].copy()
    q[:2] = cc.quaternion.multiply(q[:2], cc.quaternion.exp([0.1, 0.0, 0.0]))
    log = cc.SensorLog(
        gyro=(fermi.gyro.t[:300], fermi.gyro.rate[:300]), star=(star.t[:300], q), epoch=fermi.epoch
    )
    whole = nav.run(log)
    replay.run(log, nav, tmp_path / "out", window=window)
    rows = replay.read(tmp_path / "out")["rows"]
    assert rows["t"][0] == whole.t[0]
    np.testing.assert_array_equal(rows["bx"], whole.bias[:, 0])


def test_the_uncertainty_of_the_start_is_taken(log, nav, tmp_path):
    sigma0 = (3e-4, [1e-8, 2e-8, 3e-8])
    whole = nav.run(log, sigma0=sigma0)
    replay.run(log, nav, tmp_path / "out", window=30.0, sigma0=sigma0)
    rows = replay.read(tmp_path / "out")["rows"]
    np.testing.assert_allclose(rows["s_bx"], whole.sigma[:, 3], rtol=1e-12)
    plain = nav.run(log)
    assert not np.allclose(plain.sigma[:, 3], whole.sigma[:, 3])


@pytest.mark.parametrize("table", ["rows", "health", "measurements"])
def test_missing_parts_are_noticed(log, nav, tmp_path, table):
    given = {"window": 30.0, "checkpoint": tmp_path / "c.json", "interval": 0.0}
    replay.run(log, nav, tmp_path / "out", **given)
    (tmp_path / "out" / table / "part-000003.parquet").unlink()
    with pytest.raises(cc.InputError, match="first part-000003"):
        replay.run(log, nav, tmp_path / "out", resume=True, **given)
    with pytest.raises(cc.InputError, match="give that replay's folder"):
        replay.run(log, nav, tmp_path / "other", resume=True, **given)


def test_another_log_is_not_gone_on_with(log, nav, tmp_path):
    given = {"window": 30.0, "checkpoint": tmp_path / "c.json", "interval": 0.0}
    replay.run(log, nav, tmp_path / "out", **given)
    star = log.stars["star"]
    turned = cc.quaternion.multiply(star.q, cc.quaternion.exp([1e-6, 0.0, 0.0]))
    other = cc.SensorLog(gyro=log.gyro, star=(star.t, turned), epoch=log.epoch)
    with pytest.raises(cc.InputError, match="another log"):
        replay.run(other, nav, tmp_path / "out", resume=True, **given)
