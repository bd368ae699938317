"""Parts are written by a thread: in order, whole, and its errors are the caller's."""

from __future__ import annotations

import threading
import time

import celestcore as cc
import numpy as np
import pytest
from celestcore import replay
from celestcore.replay import _run
from celestcore.replay._background import Background
from celestcore.replay._checkpoint import Checkpoint
from celestcore.replay._parts import Parts

pytest.importorskip("pyarrow")


@pytest.fixture(scope="module")
def log():
    rng = np.random.default_rng(5)
    t = np.arange(0.0, 600.0, 0.25)
    rate = 1e-6 * rng.normal(size=(len(t), 3))
    q = cc.quaternion.exp(5 * cc.ARCSEC * rng.normal(size=(600, 3)))
    return cc.SensorLog(epoch="2026-01-01", gyro=(t, rate), star=(t[::4], q))


@pytest.fixture(scope="module")
def nav():
    return cc.StarGyroNavigator(cc.EKF(), cc.Gyro(1e-5, 1e-8), cc.StarCamera(5 * cc.ARCSEC))


def threads():
    return [t.name for t in threading.enumerate() if t.name.startswith("celestcore")]


def numbers(folder):
    return sorted(int(p.stem.removeprefix("part-")) for p in (folder / "rows").glob("*.parquet"))


def test_jobs_are_done_in_order_and_few_wait():
    done, given = [], []
    with Background(2) as background:
        for k in range(20):
            background.do(lambda k=k: (time.sleep(0.002), done.append(k)))
            given.append(k + 1 - len(done))
    assert done == list(range(20))
    assert max(given) <= 4  # two wait, one is under way, one was just given


def test_an_error_is_raised_once_and_ends_the_work():
    done = []

    def broken():
        raise OSError(28, "No space left on device")

    def work():
        with Background(1) as background:
            background.do(lambda: done.append(0))
            background.do(broken)
            for k in range(1, 100):
                background.do(lambda k=k: done.append(k))

    with pytest.raises(OSError, match="No space left"):
        work()
    assert done == [0]
    with pytest.raises(OSError, match="No space left"), Background(1) as background:
        background.do(broken)  # at the end, if nothing is given any more


def test_what_was_given_is_done_after_the_callers_error():
    done = []

    def work():
        with Background(2) as background:
            for k in range(3):
                background.do(lambda k=k: (time.sleep(0.01), done.append(k)))
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        work()
    assert done == [0, 1, 2]


def test_the_callers_error_wins():
    def broken():
        raise OSError(28, "No space left on device")

    def work():
        with Background(1) as background:
            background.do(broken)
            raise ZeroDivisionError

    with (
        pytest.warns(cc.CelestcoreWarning, match="could not be: .*No space left"),
        pytest.raises(ZeroDivisionError),
    ):
        work()


def test_a_second_ctrl_c_ends_it(monkeypatch):
    started, go_on, done = threading.Event(), threading.Event(), []

    def slow():
        started.set()
        go_on.wait(10.0)

    background = Background(2)
    background.__enter__()
    background.do(slow)
    started.wait(10.0)
    background.do(lambda: done.append(1))
    join = background._thread.join

    def interrupted():
        raise KeyboardInterrupt

    monkeypatch.setattr(background._thread, "join", interrupted)
    with pytest.raises(KeyboardInterrupt):
        background.__exit__(KeyboardInterrupt, KeyboardInterrupt(), None)
    go_on.set()
    join(10.0)
    assert not background._thread.is_alive()
    assert not done


@pytest.mark.parametrize("broken", [0, 3, 9])
def test_a_full_disk_is_the_callers_error_and_leaves_no_hole(
    log, nav, tmp_path, monkeypatch, broken
):
    write = Parts.write

    def full(self, part, tables):
        if part == broken:
            raise OSError(28, "No space left on device", "part.parquet")
        write(self, part, tables)

    monkeypatch.setattr(Parts, "write", full)
    given = {"window": 60.0, "checkpoint": tmp_path / "c.json", "interval": 0.0}
    with pytest.raises(OSError, match=r"No space left on device: 'part\.parquet'"):
        replay.run(log, nav, tmp_path / "out", **given)
    assert numbers(tmp_path / "out") == list(range(broken))
    assert not threads()
    assert not (tmp_path / "out" / "summary.json").exists()
    # the first checkpoint is written at once
    assert replay.read_checkpoint(tmp_path / "c.json").parts == broken


def test_ctrl_c_leaves_whole_parts(log, nav, tmp_path):
    parts = []

    def stop(t):
        parts.append(t)
        if len(parts) == 4:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        replay.run(log, nav, tmp_path / "out", window=60.0, progress=stop)
    assert numbers(tmp_path / "out") == [0, 1, 2, 3]
    assert not list((tmp_path / "out").rglob(".*tmp*"))
    assert not threads()
    replay.run(log, nav, tmp_path / "whole", window=60.0)
    whole, begun = (replay.read(tmp_path / name)["rows"] for name in ("whole", "out"))
    assert begun["t"][-1] == parts[-1]
    for name, column in begun.items():
        np.testing.assert_array_equal(column, whole[name][: len(column)], err_msg=name)


def test_a_checkpoint_counts_what_the_disk_has(log, nav, tmp_path, monkeypatch):
    """Parts are written, then flushed, then counted, however far ahead the filter is."""
    seen, unflushed = [], set()
    write, sync, remember = Parts.write, Parts.sync, Checkpoint.write

    def slowly(self, part, tables):
        time.sleep(0.01)
        write(self, part, tables)
        unflushed.add(part)

    def flushed(self):
        sync(self)
        unflushed.clear()

    def counted(self, path):
        assert not unflushed
        assert numbers(tmp_path / "out") == list(range(self.parts))
        seen.append(self.parts)
        remember(self, path)

    monkeypatch.setattr(Parts, "write", slowly)
    monkeypatch.setattr(Parts, "sync", flushed)
    monkeypatch.setattr(Checkpoint, "write", counted)
    ahead, progress = [], lambda _: ahead.append(len(ahead) + 1 - len(seen))
    replay.run(
        log,
        nav,
        tmp_path / "out",
        window=30.0,
        checkpoint=tmp_path / "c.json",
        interval=0.0,
        progress=progress,
    )
    assert seen == list(range(21))  # the first at once
    assert 1 <= max(ahead) <= _run.WAITING + 2


def test_a_log_that_breaks_ends_the_threads(log, nav, tmp_path):
    cc.write_log(log, tmp_path / "log")
    with cc.open_log(tmp_path / "log") as stream:

        def broken(_):
            raise ZeroDivisionError

        with pytest.raises(ZeroDivisionError):
            replay.run(stream, nav, tmp_path / "out", window=30.0, progress=broken)
        assert not threads()
        assert len(stream.read().gyro) == len(log.gyro)  # the file can be read again


def test_windows_of_the_caller_are_not_changed(nav, tmp_path):
    t = np.arange(0.0, 60.0, 0.5)
    rate, q = np.zeros((120, 3)), np.tile([0.9995, 0.0, 0.0, 0.0], (120, 1))
    windows = [{"gyro": (t[:60], rate[:60]), "star": (t[:60], q[:60])}]
    windows.append({"gyro": (t[60:], rate[60:]), "star": (t[60:], q[60:])})
    replay.run(windows, nav, tmp_path / "out")
    assert rate.flags.writeable
    assert windows[0]["gyro"][1].flags.writeable
    np.testing.assert_array_equal(q, np.tile([0.9995, 0.0, 0.0, 0.0], (120, 1)))
