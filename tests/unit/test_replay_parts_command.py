"""`celestcore replay --parts`: from a file of any format, stopped and gone on with."""

from __future__ import annotations

import json
import shutil

import celestcore as cc
import numpy as np
import pytest
from celestcore import cli, replay

pyarrow = pytest.importorskip("pyarrow")
parquet = pytest.importorskip("pyarrow.parquet")


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    folder = tmp_path_factory.mktemp("log") / "fermi"
    cc.write_log(cc.sample("fermi"), folder)
    return folder


def command(*words):
    return cli.main([str(w) for w in words])


def test_a_file_is_replayed_in_parts(log, tmp_path, capsys):
    out = tmp_path / "out"
    done = command(
        "replay",
        log,
        "--parts",
        out,
        "--every",
        60,
        "--checkpoint",
        tmp_path / "c.json",
        "--json",
        tmp_path / "s.json",
        "--window",
        7200,
    )
    assert done == 0
    summary = json.loads((tmp_path / "s.json").read_text())
    assert summary["samples"] == 43195
    rows = replay.read(out)["rows"]
    whole = cc.Settings.from_log(cc.sample("fermi")).navigator().run(cc.sample("fermi"), every=60)
    np.testing.assert_array_equal(rows["t"][: len(whole.t)], whole.t)
    assert "43,195 gyro samples" in capsys.readouterr().out


def test_rows_that_go_back_are_left_out_on_demand(log, tmp_path, capsys):
    broken = tmp_path / "log"
    shutil.copytree(log, broken)
    table = parquet.read_table(broken / "gyro.parquet")
    t = table["t"].to_numpy().copy()
    t[1000:1060] += 5.0
    parquet.write_table(table.set_column(0, "t", pyarrow.array(t)), broken / "gyro.parquet")
    words = ["replay", broken, "--every", 60]
    assert command(*words, "--parts", tmp_path / "a") != 0
    assert "goes back" in capsys.readouterr().err.replace("\n", " ")
    page = tmp_path / "b.html"
    assert command(*words, "--parts", tmp_path / "b", "--reorder", 0, "--report", page) == 0
    assert "Rows of gyro out of order</th><td>5 late" in page.read_text(encoding="utf-8")
    assert "rows of gyro out of order: 5 late" in capsys.readouterr().out


def test_a_report_is_written(log, tmp_path, capsys):
    page = tmp_path / "a.html"
    done = command("replay", log, "--parts", tmp_path / "out", "--every", 60, "--report", page)
    assert done == 0
    text = page.read_text(encoding="utf-8")
    assert "Fermi gamma-ray telescope" in text
    assert "Noise of star</th><td>2 arcsec (1 sigma)" in text
    assert f"report: {page}" in capsys.readouterr().out


def test_a_stopped_command_goes_on(log, tmp_path, capsys):
    settings = cc.Settings.from_log(cc.sample("fermi"))
    parts = ["--every", 60, "--window", 3600]
    whole = tmp_path / "whole"
    assert command("replay", log, "--parts", whole, *parts) == 0
    memory = tmp_path / "c.json"
    left = [4]

    def stop(_):
        left[0] -= 1
        if not left[0]:
            raise KeyboardInterrupt

    with cc.open_log(log) as stream, pytest.raises(KeyboardInterrupt):
        replay.run(
            stream,
            settings.navigator(),
            tmp_path / "out",
            window=3600.0,
            every=60,
            checkpoint=memory,
            interval=0.0,
            progress=stop,
        )
    assert (
        command(
            "replay", log, "--parts", tmp_path / "out", *parts, "--checkpoint", memory, "--resume"
        )
        == 0
    )
    said = capsys.readouterr().out
    first, last = said.split("went on from the checkpoint")
    assert "samples/s" in first
    assert "samples/s" not in last  # of which run would it be?
    one, two = replay.read(whole), replay.read(tmp_path / "out")
    for table in ("rows", "measurements"):
        for name, column in one[table].items():
            np.testing.assert_array_equal(column, two[table][name], err_msg=name)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--parts", "x", "-o", "a.parquet"], "does not go with --parts"),
        (["--checkpoint", "c.json"], "--parts.*is needed"),
        (["--parts", "x", "--resume"], "--resume.*needs --checkpoint"),
        (["--parts", "no/such/x"], "does not exist: create it first"),
        (["--parts", "x", "--checkpoint", "no/such/c.json"], "does not exist"),
        (["--parts", "x", "--report", "a.png"], r"--report.*let its name end in \.html"),
        (["--parts", "x", "--report", "no/such/a.html"], "does not exist"),
        (["--parts", "x", "--checkpoint", "c.json", "--interval", "-1"], "interval"),
    ],
)
def test_options_are_checked(log, tmp_path, monkeypatch, capsys, words, message):
    import re

    monkeypatch.chdir(tmp_path)
    assert command("replay", log, *words) != 0
    assert re.search(message, capsys.readouterr().err.replace("\n", " "))
    assert not (tmp_path / "x").exists()


def test_the_start_of_a_configuration_is_taken(log, tmp_path):
    config = tmp_path / "start.toml"
    config.write_text("[start]\nsigma_bias = 1e-8\nsigma_attitude_arcsec = 60.0\n")
    done = command("replay", log, "--config", config, "--parts", tmp_path / "out", "--every", 600)
    assert done == 0
    sample = cc.sample("fermi")
    settings = cc.Settings.from_log(sample).merged(cc.Settings.from_toml(config))
    whole = settings.navigator().run(sample, sigma0=settings.sigma0(), every=600)
    rows = replay.read(tmp_path / "out")["rows"]
    np.testing.assert_array_equal(rows["s_bx"][: len(whole.t)], whole.sigma[:, 3])


def test_options_of_reading_reach_the_report(tmp_path, capsys):
    sample = cc.sample("fermi")
    own = cc.SensorLog(
        gyro=(sample.gyro.t[:600], sample.gyro.rate[:600]),
        star=(sample.stars["star"].t[:600], sample.stars["star"].q[:600]),
        epoch=sample.epoch,
    )
    cc.write_log(own, tmp_path / "a.csv")
    (tmp_path / "a.csv").rename(tmp_path / "a.measured")
    config = tmp_path / "c.toml"
    config.write_text("[gyro]\narw = 1e-6\nrrw = 1e-9\n[star]\nsigma_arcsec = 5.0\n")
    words = ["replay", tmp_path / "a.measured", "--format", "csv", "--config", config]
    page = tmp_path / "a.html"
    done = command(*words, "--parts", tmp_path / "out", "--report", page)
    assert done == 0, capsys.readouterr().err
    assert page.exists()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--json", "LOG/gyro.parquet"], "--json: would write into the input"),
        (["--checkpoint", "LOG/log.toml"], "--checkpoint: would write into the input"),
        (["--checkpoint", "x", "--json", "x"], "--json: is the same file as --checkpoint"),
        (["--json", "nodir/x.json"], "--json: "),
        (["--parts", "LOG"], "--parts: would write into the input"),
        (["--interval", "5"], "--interval: goes with --checkpoint"),
    ],
)
def test_nothing_is_overwritten(log, tmp_path, monkeypatch, capsys, words, message):
    monkeypatch.chdir(tmp_path)
    before = {path: path.stat().st_mtime_ns for path in log.iterdir()}
    given = [word.replace("LOG", str(log)) for word in words]
    assert command("replay", log, "--parts", tmp_path / "out", *given) == 2
    assert message in " ".join(capsys.readouterr().err.split())
    assert {path: path.stat().st_mtime_ns for path in log.iterdir()} == before
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("option", ["--every", "--window", "--interval"])
def test_options_of_parts_go_with_them(log, tmp_path, capsys, option):
    assert command("replay", log, option, 5, "-o", tmp_path / "a.parquet") == 2
    assert f"{option}, value 5" in capsys.readouterr().err
    assert not (tmp_path / "a.parquet").exists()


@pytest.mark.parametrize("kept", [True, False])
@pytest.mark.parametrize(
    ("error", "code", "words"),
    [
        (KeyboardInterrupt(), 130, "interrupted"),
        (OSError(28, "No space left on device"), 2, "the disk is full"),
    ],
)
def test_a_stop_says_what_is_left(log, tmp_path, monkeypatch, capsys, error, code, words, kept):
    from celestcore import _parts_command

    def stopped(*_, checkpoint, **__):
        if checkpoint is not None:
            checkpoint.write_text("{}")
        raise error

    monkeypatch.setattr(_parts_command, "run", stopped)
    more = ["--checkpoint", tmp_path / "c.json"] if kept else []
    assert command("replay", log, "--parts", tmp_path / "out", *more) == code
    said = " ".join(capsys.readouterr().err.split())
    assert f"{words}: the parts so far are in" in said
    assert ("--resume" in said) == kept
