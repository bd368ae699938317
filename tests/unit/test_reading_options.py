"""How a log is read, told on the command line: the options of `open_log` by name."""

from __future__ import annotations

import json
import re
from pathlib import Path

import celestcore as cc
import numpy as np
import pytest
from celestcore import cli, replay

pytest.importorskip("typer")
pytest.importorskip("pyarrow")

OWN = {"gyro": {"arw": 1e-7, "rrw": 1e-10}, "star": {"sigma_arcsec": 5.0}}


@pytest.fixture(scope="module")
def good() -> cc.SensorLog:
    rng = np.random.default_rng(2)
    t = np.arange(600.0)
    q = cc.quaternion.exp(5 * cc.ARCSEC * rng.standard_normal((600, 3)))
    rate = 1e-7 * rng.standard_normal((600, 3))
    return cc.SensorLog(epoch="2026-01-01", gyro=(t, rate), star=(t, q), settings=OWN)


@pytest.fixture
def wrong(good: cc.SensorLog, tmp_path: Path) -> Path:
    """Write the log with a repeated, a late and a stray row, and the star's times in ticks."""
    gyro, star = good.gyro, good.stars["star"]
    assert gyro is not None
    rows = np.r_[0:100, 101, 100, 102:600, 599]
    t = gyro.t[rows]
    t[300] = 1e7
    # a counter of 12 bits, 8 a second, that wraps
    ticks = (8 * star.t.astype(int)) % 4096
    columns = {"gyro_t": t, "star_t": ticks}
    columns |= {f"gyro_w{a}": gyro.rate[rows, k] for k, a in enumerate("xyz")}
    columns |= {f"star_q{a}": star.q[:, k] for k, a in enumerate("wxyz")}
    np.savez(tmp_path / "log.npz", **columns)
    cc.write_log(good, tmp_path / "good.npz")
    (tmp_path / "good.toml").rename(tmp_path / "log.toml")
    return tmp_path / "log.npz"


WORDS = ["--reorder", "5", "--jump", "3600", "--stamps", "star:unit=1/8,bits=12"]


def command(*words: object) -> int:
    return cli.main([str(w) for w in words])


def test_info_and_replay_read_as_told(
    wrong: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert command("info", wrong) == 2
    capsys.readouterr()
    assert command("info", wrong, *WORDS, "--json", "-") == 0
    out, err = capsys.readouterr()
    tables = json.loads(out)["tables"]
    assert (tables["gyro"]["rows"], tables["star"]["rows"]) == (599, 600)
    assert tables["star"]["t_last"] == 599.0
    assert "gyro: of 601 rows these were not in order: 1 repeated, 1 stray" in err
    assert command("replay", wrong, *WORDS, "--json", tmp_path / "r.json") == 0
    assert json.loads((tmp_path / "r.json").read_text())["counts"]["samples"] == 599


def test_parts_are_read_as_told(
    wrong: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    assert command("replay", wrong, *WORDS, "--parts", out, "--window", 50) == 0
    assert "gyro: of 601 rows these were not in order: 1 repeated" in capsys.readouterr().err
    stamps = {"star": cc.Stamps(unit=1 / 8, bits=12)}
    with cc.open_log(wrong, reorder=5.0, jump=3600.0, stamps=stamps) as stream:
        log = stream.read()
    whole = cc.Settings.from_log(log).navigator().run(log)
    rows = replay.read(out)["rows"]
    np.testing.assert_array_equal(rows["t"], whole.t)
    np.testing.assert_allclose(rows["s_ax"], whole.sigma[:, 0], rtol=1e-9)


def test_a_replay_read_in_another_way_is_another(wrong: Path, tmp_path: Path) -> None:
    call = ["replay", wrong, "--parts", tmp_path / "out", "--checkpoint", tmp_path / "c.json"]
    nav = cc.Settings.from_toml(wrong.with_suffix(".toml")).navigator()
    stamps = {"star": cc.Stamps(unit=1 / 8, bits=12)}
    given = {"checkpoint": tmp_path / "c.json", "interval": 0.0, "window": 100.0}
    with cc.open_log(wrong, reorder=5.0, jump=3600.0, stamps=stamps) as stream:
        replay.run(stream, nav, tmp_path / "out", **given)
    with (
        cc.open_log(wrong, reorder=5.0, stamps=stamps) as stream,
        pytest.raises(cc.InputError, match="other options"),
    ):
        replay.run(stream, nav, tmp_path / "out", **given, resume=True)
    assert command(*call, *WORDS, "--window", 100, "--resume") == 0


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--jump", "3"], "jump: goes with reorder= only"),
        (["--reorder", "-1"], "reorder, value -1.0: must be at least 0"),
        (["--damaged", "maybe"], "damaged, value 'maybe': must be 'raise' or 'keep'"),
        (["--format", "wav"], "format, value 'wav': is not one of parquet, csv"),
        (["--epoch", "never"], "epoch, value 'never': must be an ISO time"),
        (["--stamps", "scale=EST"], "stamps.scale, value 'EST': must be one of UTC, TAI"),
        (["--stamps", "size=3"], "stamps.size: unknown key; known are scale, since, unit, bits"),
        (["--stamps", "unit=1/0"], "stamps.unit, value '1/0': must be a number of seconds"),
        (["--stamps", "bits=2.5"], "stamps.bits, value '2.5': must be a whole number"),
        (["--stamps", "scale"], "--stamps, value 'scale': must be .SENSOR:.KEY=VALUE"),
        (["--stamps", "gyor:unit=2"], "stamps, value 'gyor': is no sensor of the log, which has"),
        (["--stamps", "unit=2", "--stamps", "gyro:unit=2"], "value 'gyro:unit=2': is given twice"),
        (["--option", "segment"], "--option, value 'segment': must be NAME=VALUE"),
        (["--option", "segment=1"], "segment: is no option of this format, which takes none"),
    ],
)
@pytest.mark.parametrize("how", ["info", "replay", "parts"])
def test_errors_are_those_of_python(
    wrong: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    how: str,
    words: list[str],
    message: str,
) -> None:
    call = {"info": ["info"], "replay": ["replay"], "parts": ["replay", "--parts", tmp_path / "x"]}
    assert command(*call[how], wrong, *words) == 2
    assert re.search(message, capsys.readouterr().err)
    assert not (tmp_path / "x").exists()


def test_a_sample_needs_no_reading(capsys: pytest.CaptureFixture[str]) -> None:
    for name in ("info", "replay"):
        assert command(name, "--sample", "fermi", "--reorder", 5) == 2
        err = capsys.readouterr().err
        assert "--sample, value 'fermi': goes with a LOG: how the sample is read (reorder)" in err


def test_a_damaged_file_is_kept_up_to_the_damage(
    good: cc.SensorLog, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cc.write_log(good, tmp_path / "log.csv")
    text = (tmp_path / "log.csv").read_text().splitlines(keepends=True)
    text[300] = "300.0,not,a,row\n"
    (tmp_path / "log.csv").write_text("".join(text))
    assert command("info", tmp_path / "log.csv") == 2
    capsys.readouterr()
    assert command("info", tmp_path / "log.csv", "--damaged", "keep", "--format", "csv") == 0
    assert "kept what stands before the damage" in capsys.readouterr().err


def test_options_of_a_format(tmp_path: Path, good: cc.SensorLog) -> None:
    cc.write_log(good, tmp_path / "log")
    (tmp_path / "log" / "gyro.parquet").rename(tmp_path / "rates.parquet")
    assert command("info", tmp_path / "rates.parquet") == 2
    assert command("info", tmp_path / "rates.parquet", "--option", "table=gyro") == 0


def test_help_tells_of_them(capsys: pytest.CaptureFixture[str]) -> None:
    for name in ("info", "replay"):
        assert command(name, "--help") == 0
        said = capsys.readouterr().out
        for option in ("format", "reorder", "jump", "damaged", "epoch", "stamps", "option"):
            assert f"--{option}" in said
