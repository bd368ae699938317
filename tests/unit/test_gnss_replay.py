"""`celestcore replay` of logs with GNSS fixes: the shipped one, and what decides the navigator."""

from __future__ import annotations

import dataclasses
import json
import re
from pathlib import Path
from typing import Any

import celestcore as cc
import numpy as np
import pytest
from celestcore import cli
from celestcore.gnss import GnssStarScenario
from celestcore.gnss.scenario import GYRO
from celestcore.io import write_log
from celestcore.log import SensorLog

pytest.importorskip("typer")
pytest.importorskip("erfa")

SETTINGS: dict[str, dict[str, Any]] = {
    "gnss": {"sigma": 1.0, "sigma_velocity": 0.01},
    "orbit": {"gravity": 20, "accel_psd": 1e-7},
    "star": {"sigma_arcsec": 25.0},
}
BY_GYRO = {"gyro": {"arw": GYRO.arw[0], "rrw": GYRO.rrw[0]}}


def run(capsys: pytest.CaptureFixture[str], *arguments: object) -> tuple[int, str, str]:
    """Return exit code, standard output and standard error of one command."""
    code = cli.main([str(a) for a in arguments])
    out, err = capsys.readouterr()
    return code, out, err


def fails(capsys: pytest.CaptureFixture[str], *arguments: object) -> str:
    code, out, err = run(capsys, *arguments)
    assert (code, out) == (2, "")
    assert err.startswith("error: ")
    assert err.count("\n") == 1
    return err


def replayed(capsys: pytest.CaptureFixture[str], *arguments: object) -> dict[str, Any]:
    code, out, _ = run(capsys, "replay", *arguments, "--json", "-")
    assert code == 0
    result: dict[str, Any] = json.loads(out)
    return result


def write(path: Path, settings: dict[str, Any], *, gyro: bool = False, **more: Any) -> Path:
    """Write a simulated log of 20 minutes."""
    scenario = GnssStarScenario(gyro=GYRO if gyro else None, star_step=2.0, gnss_step=2.0)
    log = scenario.trial(seed=2, trial=0).log
    write_log(SensorLog(epoch=log.epoch, settings=settings, **{**log.tables, **more}), path)
    return path


@pytest.fixture(scope="module")
def noaa20(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    folder = tmp_path_factory.mktemp("noaa20")
    names = {"--json": "a.json", "-o": "a.npz", "--report": "a.html"}
    options = [x for option, name in names.items() for x in (option, str(folder / name))]
    assert cli.main(["replay", "--sample", "noaa20", *options]) == 0
    result: dict[str, Any] = json.loads((folder / "a.json").read_text())
    return {"folder": folder, **result}


def test_noaa20s_innovations(noaa20: dict[str, Any]) -> None:
    found = noaa20["innovations"]
    assert found["position"]["rms_total_m"] == pytest.approx(0.191, abs=0.005)
    assert found["position"]["nis_mean"] == pytest.approx(3.0, abs=0.1)
    assert found["velocity"]["rms_total_m_s"] == pytest.approx(0.0184, abs=0.001)
    assert found["velocity"]["nis_mean"] < 0.1
    assert found["star"]["nis_mean"] == pytest.approx(1.34, abs=0.1)
    refused = [found[name]["refused"] for name in ("position", "velocity", "star")]
    assert refused == [0, 0, 2]
    assert noaa20["restarts"] == []
    # two hours of fixes do not tell their common error
    assert np.all(np.array(noaa20["final"]["sigma_r"]) > 3.0)


def test_noaa20s_predictions(noaa20: dict[str, Any]) -> None:
    short, long = noaa20["withheld"]
    assert (short["window_s"], long["window_s"]) == (60.0, 600.0)
    assert short["error_rms_m"] == pytest.approx(0.325, rel=0.05)
    assert short["error_max_m"] == pytest.approx(0.89, rel=0.1)
    assert long["error_rms_m"] == pytest.approx(10.2, rel=0.05)
    assert long["error_median_m"] == pytest.approx(9.41, rel=0.05)
    assert long["error_max_m"] == pytest.approx(17.1, rel=0.05)
    for found in (short, long):
        assert found["windows"] >= 100
        assert found["inside_95"] >= 0.95
        assert found["ratio_rms"] > 0.5


def test_noaa20s_frames_and_tags(noaa20: dict[str, Any]) -> None:
    found = noaa20["pointing"]
    np.testing.assert_allclose(found["std_deg"], [0.00060, 0.00081, 0.00021], atol=1e-5)
    assert found["largest_deg"] == pytest.approx(0.0041, abs=5e-5)
    assert found["geocentric_largest_deg"] == pytest.approx(0.167, abs=1e-3)
    assert found["tag_difference_s"] == pytest.approx(-0.1, abs=1e-6)
    assert found["found_difference_s"] == pytest.approx(-0.0998, abs=5e-4)
    assert found["offset_sigma_s"] < 0.005


def test_noaa20s_files(noaa20: dict[str, Any]) -> None:
    columns = np.load(noaa20["folder"] / "a.npz")
    assert len(columns["t"]) == 14400
    assert {"x", "vz", "qw", "s_x", "s_az"} <= set(columns)
    assert json.loads(str(columns["note"]))["epoch"] == "2021-04-09T00:00:00"
    page = (noaa20["folder"] / "a.html").read_text(encoding="utf-8")
    for words in ("geodetic nadir", "Predicted over 10 minutes", "gravity 20×20", "found -0.0998"):
        assert words in page
    assert page.count('class="plot"') == 26
    for tag in ("table", "div", "p", "h2", "tr", "td"):
        assert len(re.findall(f"<{tag}[ >]", page)) == page.count(f"</{tag}>"), tag


def test_noaa20_with_the_plain_noise_starts_again(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Velocities believed to 5 mm/s contradict the positions; nothing jumps."""
    config = tmp_path / "plain.toml"
    config.write_text(
        "[gnss]\nsigma = 0.5\nsigma_velocity = 0.005\nbias_sigma = 0\n[orbit]\naccel_psd = 1e-8\n"
    )
    options = ("replay", "--sample", "noaa20", "--config", config, "--withhold", 60, "--json", "-")
    code, out, err = run(capsys, *options)
    result = json.loads(out)
    assert code == 0
    assert 6 <= len(result["restarts"]) <= 10
    assert [w["window_s"] for w in result["withheld"]] == [60.0]
    assert result["withheld"][0]["inside_95"] < 0.3
    assert err.count("warning: the orbit filter refused 10 fixes running") == 1
    assert "The orbit filter lost the fixes and started again" in " ".join(err.split())


def test_smooth_period_and_csv(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = write(tmp_path / "a.npz", SETTINGS)
    out = tmp_path / "out.csv"
    result = replayed(
        capsys, path, "--smooth", "--period", 30, "--filter", "ukf", "--gate", 0.999, "-o", out
    )
    assert (result["smoothed"], result["filter"], result["gate"]) == (True, "ukf", 0.999)
    assert result["log"] == str(path)
    assert [w["window_s"] for w in result["withheld"]] == [60.0]
    head, *rows = out.read_text().splitlines()
    assert head.startswith("t,x,y,z,vx")
    assert [float(row.partition(",")[0]) for row in rows] == list(np.arange(0.0, 1201.0, 30.0))


def test_parquet_and_png(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    parquet = pytest.importorskip("pyarrow.parquet")
    path = write(tmp_path / "a.npz", SETTINGS)
    out, picture = tmp_path / "out.parquet", tmp_path / "out.png"
    replayed(capsys, path, "-o", out, "--report", picture)
    table = parquet.read_table(out)
    assert table.num_rows == 601
    assert json.loads(table.schema.metadata[b"celestcore"])["inertial"] == "GCRS"
    assert picture.read_bytes().startswith(b"\x89PNG")


def test_a_turning_body_tells_no_time(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code, out, _ = run(capsys, "replay", write(tmp_path / "a.npz", SETTINGS))
    assert code == 0
    assert "off the geodetic nadir of its GNSS fixes: it does not steer there" in " ".join(
        out.split()
    )
    assert "time tags" not in out


def test_positions_alone(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = cc.sample("noaa20")
    assert log.gnss is not None
    path = tmp_path / "a.npz"
    gnss = (log.gnss.t[:900], log.gnss.r[:900])
    write_log(SensorLog(epoch=log.epoch, gnss=gnss, settings={"gnss": {"sigma": 0.5}}), path)
    result = replayed(capsys, path, "--report", tmp_path / "a.html")
    assert list(result["innovations"]) == ["position"]
    assert (result["attitude"], result["pointing"]) == (None, None)
    assert [w["window_s"] for w in result["withheld"]] == [60.0]


def test_what_decides_the_navigator(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """GNSS fixes and a gyro: by the gyro alone unless the settings describe the receiver."""
    stars = {"star": {"sigma_arcsec": 25.0}, **BY_GYRO}
    plain = replayed(capsys, write(tmp_path / "a.npz", stars, gyro=True))
    assert "navigator" not in plain
    assert "samples" in plain["counts"]
    both = replayed(capsys, write(tmp_path / "b.npz", {**SETTINGS, **BY_GYRO}, gyro=True))
    assert (both["navigator"], both["attitude"]) == ("gnss-star", "gyro")
    assert "bias" in both["final"]
    code, out, err = run(capsys, "replay", write(tmp_path / "c.npz", SETTINGS, gyro=True))
    assert code == 0
    assert "attitude without gyro" in out
    assert "warning: the gyro is not used" in err


def test_what_is_left_out_is_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    start = {"start": {"sigma_attitude_arcsec": 60.0, "sigma_bias": 1e-5}}
    sun = ([0.0, 1.0], [[1.0, 0.0, 0.0]] * 2, [[0.0, 1.0, 0.0]] * 2)
    path = write(tmp_path / "a.npz", {**SETTINGS, **start}, vector_sun=sun)
    code, _, err = run(capsys, "replay", path)
    assert code == 0
    assert "vector_sun" in err
    assert "[start] is not used" in err


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--filter", "invariant"), "must be ekf or ukf"),
        (("--gate", "3"), "between 0 and 1"),
        (("--period", "-1"), "period"),
        (("--withhold", "0"), "window"),
        (("--withhold", "9000"), "there is no window of 9000 s"),
        (("-o", "a.xlsx"), ".parquet (.npz or .csv, too"),
        (("--report", "a.pdf"), ".html or .png"),
    ],
)
def test_mistakes_get_one_line(
    options: tuple[str, ...], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert words in fails(capsys, "replay", "--sample", "noaa20", *options)


def test_a_log_without_settings_says_what_to_add(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    err = fails(capsys, "replay", write(tmp_path / "a.npz", {}))
    assert "add a line sigma = ... to the table [gnss]" in err
    star = SensorLog(star=([0.0, 1.0], [[1.0, 0.0, 0.0, 0.0]] * 2))
    write_log(star, tmp_path / "b.npz")
    assert "neither a gyro nor GNSS fixes" in fails(capsys, "replay", tmp_path / "b.npz")


def test_the_slow_error_is_reported(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    slow = {"lfe": {"amplitudes_arcsec": [10.0], "period": 1000.0}}
    code, out, _ = run(capsys, "replay", write(tmp_path / "a.npz", {**SETTINGS, **slow}))
    assert code == 0
    assert "slow error cos 1, body x y z [arcsec]" in out


def test_unknown_panels_are_refused() -> None:
    from celestcore import _gnss_plots, _gnss_replay
    from celestcore.config import Settings

    log = cc.sample("noaa20")
    assert log.gnss is not None
    rows = slice(0, 200)
    gnss = dataclasses.replace(log.gnss, t=log.gnss.t[rows], r=log.gnss.r[rows], v=None)
    short = SensorLog(epoch=log.epoch, gnss=gnss)
    replay = _gnss_replay.run(short, Settings.from_log(log))
    assert _gnss_plots.panels(replay) == ("innovation position", "nis position", "sigma")
    with pytest.raises(cc.InputError, match="unknown panel bias"):
        _gnss_plots.figure(replay, ("bias",))
