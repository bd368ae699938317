"""Campaigns over logs of any format, read as `[logs]` says."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import celestcore as cc
import numpy as np
import pytest
from celestcore import campaign, simulate
from celestcore.campaign import _logs

parquet = pytest.importorskip("pyarrow.parquet")

OWN = {"gyro": {"arw": 2e-5, "rrw": 1e-7}, "star": {"sigma_arcsec": 4.0}}
FOLDER: dict[str, Any] = {"logs": {"folder": "archive"}}


@pytest.fixture
def made(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> cc.SensorLog:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "archive").mkdir()
    star = simulate.StarErrors(4 * cc.ARCSEC, every=2)
    scenario = simulate.Scenario(simulate.slews(30.0), simulate.GyroErrors(2e-5, 1e-7), star)
    log = scenario.simulate(1, 0).log
    return cc.SensorLog(gyro=log.gyro, star=log.stars["star"], settings=OWN)


def rows(document: dict[str, Any], out: str = "out") -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = campaign.run(document, out).table().to_pylist()
    return sorted(found, key=lambda row: row["log"])


def test_any_known_format_is_found_and_read(made: cc.SensorLog) -> None:
    pytest.importorskip("h5py")
    folder = Path("archive")
    for name in ("a.npz", "b.h5", "c", "d.csv"):
        cc.write_log(made, folder / name)
    (folder / "set").mkdir()
    for table in ("gyro", "star"):  # datasets in parts
        (folder / "set" / table).mkdir()
        whole = parquet.read_table(folder / "c" / f"{table}.parquet")
        half = len(whole) // 2
        for k, part in enumerate((whole.slice(0, half), whole.slice(half))):
            parquet.write_table(part, folder / "set" / table / f"part-{k}.parquet")
    (folder / "set" / "log.toml").write_bytes((folder / "c" / "log.toml").read_bytes())
    (folder / "notes.txt").write_text("no log")
    (folder / ".hidden.npz").write_text("no log")
    found = rows(FOLDER)
    assert [row["log"] for row in found] == ["a.npz", "b.h5", "c", "d.csv", "set"]
    for row in found:
        assert row["failure"] is None, row
        assert row["nis"] == found[0]["nis"]


def test_deeper_patterns_do_not_take_tables_for_logs(made: cc.SensorLog) -> None:
    Path("archive/deep").mkdir()
    cc.write_log(made, "archive/deep/log")
    found = rows({"logs": {"folder": "archive", "pattern": "**/*"}})
    assert [row["log"] for row in found] == ["deep/log"]


def test_a_dataset_that_changed_is_another_log(made: cc.SensorLog) -> None:
    cc.write_log(made, "archive/c")
    folder = Path("archive/c")
    before = _logs.digest(folder)
    (folder / "gyro").mkdir()
    (folder / "gyro.parquet").rename(folder / "gyro" / "part.parquet")
    moved = _logs.digest(folder)
    (folder / "gyro" / "more.parquet").write_bytes(b"x")
    assert len({before, moved, _logs.digest(folder)}) == 3


def test_logs_are_read_as_the_table_says(made: cc.SensorLog) -> None:
    gyro = made.gyro
    assert gyro is not None
    order = np.arange(len(gyro))
    order[[4, 5]] = [5, 4]
    columns = {"gyro_t": 1e3 * gyro.t[order]}
    columns |= {f"gyro_w{a}": gyro.rate[order, k] for k, a in enumerate("xyz")}
    star = made.stars["star"]
    columns |= {"star_t": star.t, **{f"star_q{a}": star.q[:, k] for k, a in enumerate("wxyz")}}
    np.savez("archive/a.npz", **columns)
    cc.write_log(made, "plain.npz")
    Path("archive/a.toml").write_bytes(Path("plain.toml").read_bytes())
    plain = rows(FOLDER)[0]
    assert "gyro.t" in plain["failure"]
    reading = {"format": "npz", "reorder": 1.0, "stamps": {"gyro": {"unit": 1e-3}}}
    told = rows({"logs": {**FOLDER["logs"], **reading}}, "told")[0]
    assert told["failure"] is None
    assert told["samples"] == len(gyro)
    assert told["key"] != plain["key"]  # read in another way it is another run


def test_a_date_of_toml_will_do(made: cc.SensorLog) -> None:
    cc.write_log(made, "archive/a.npz")
    Path("campaign.toml").write_text(
        "[logs]\nfolder = 'archive'\nepoch = 2026-01-01T00:00:00\n"
        "[logs.stamps]\nscale = 'GPS'\nsince = 2026-01-01\n"
    )
    made_of = campaign.Campaign.from_toml("campaign.toml")
    assert '"since":"2026-01-01"' in made_of.cells[0].text.replace(" ", "")
    assert campaign.run(made_of, "out").table()["failure"].to_pylist() == [None]


@pytest.mark.parametrize(
    ("more", "words"),
    [
        ({"reorder": "late"}, "logs.reorder, value 'late': must be a number of seconds"),
        ({"format": 3}, "logs.format, value 3: must be a text"),
        ({"stamps": 3}, r"logs.stamps, value 3: must be a table, write \[logs.stamps\]"),
        ({"stamps": {"scale": "EST"}}, "logs.stamps.scale, value 'EST': must be one of UTC"),
        ({"stamps": {"gyro": {"size": 1}}}, "logs.stamps.size: unknown key; known are scale"),
        ({"late": 3}, "logs.late: unknown key; known are folder, pattern, format, reorder"),
    ],
)
def test_bad_ways_of_reading(made: cc.SensorLog, more: dict[str, Any], words: str) -> None:
    cc.write_log(made, "archive/a.npz")
    with pytest.raises(cc.InputError, match=words):
        campaign.run({"logs": {**FOLDER["logs"], **more}}, "out")


def test_what_the_reader_refuses_is_the_row_s_failure(made: cc.SensorLog) -> None:
    cc.write_log(made, "archive/a.npz")
    for k, more in enumerate(({"jump": 3.0}, {"options": {"segment": 1}}, {"format": "hdf5"})):
        row = rows({"logs": {**FOLDER["logs"], **more}}, f"out{k}")[0]
        assert row["failure"]
