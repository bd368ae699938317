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
