"""Campaigns over a folder of logs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import celestcore as cc
import numpy as np
import pytest
from celestcore import campaign, simulate
from celestcore.summary import summary

pytest.importorskip("pyarrow.parquet")

OWN = {"gyro": {"arw": 2e-5, "rrw": 1e-7}, "star": {"sigma_arcsec": 4.0}}
CONFIG: dict[str, Any] = {
    "logs": {"folder": "archive", "pattern": "*"},
    "gate": {"probability": 0.9999},
    "grid": {"filter.kind": ["ekf", "ukf"]},
}


@pytest.fixture
def archive(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Write four logs, one of each kind and one without fixes, and what is no log."""
    monkeypatch.chdir(tmp_path)
    star = simulate.StarErrors(4 * cc.ARCSEC, every=2)
    scenario = simulate.Scenario(simulate.slews(30.0), simulate.GyroErrors(2e-5, 1e-7), star)
    folder = tmp_path / "archive"
    folder.mkdir()
    for trial, name in enumerate(["a.npz", "b.csv", "c"]):
        made = scenario.simulate(1, trial).log
        log = cc.SensorLog(gyro=made.gyro, star=made.stars["star"], settings=OWN)
        cc.write_log(log, folder / name)
    cc.write_log(cc.SensorLog(gyro=made.gyro, settings=OWN), folder / "d.npz")
    (folder / "README.txt").write_text("no log")
    (folder / "pictures").mkdir()
    return folder


def plain(table: Any) -> Any:
    return table.drop_columns(["elapsed_s"])


def test_a_row_a_log(archive: Path) -> None:
    results = campaign.run(CONFIG, "out")
    frame = results.table().to_pandas()
    assert frame["log"].tolist() == ["a.npz", "b.csv", "c", "d.npz"] * 2
    log = cc.read_log(archive / "b.csv")
    nav = cc.Settings.from_log(log).merged({"gate": CONFIG["gate"], "filter": {"kind": "ukf"}})
    sol = nav.navigator().run(log)
    told, row = summary(sol, log), frame.iloc[5]
    for name in ("samples", "fixes", "accepted", "rejected", "start", "missing", "gaps"):
        assert row[name] == told["counts"][name], name
    assert row["nis_per_dof"] == told["innovation"]["nis_per_dof"]
    assert row["nis_inside_95"] == told["innovation"]["inside_95"]
    assert row["log_likelihood"] == sol.log_likelihood
    assert row["span_s"] == told["span_s"]
    assert row["elapsed_s"] > 0.0
    sigma = row[[f"final_sigma_{axis}" for axis in ("ax", "ay", "az", "bx", "by", "bz")]]
    np.testing.assert_array_equal(sigma.to_numpy(dtype=float), sol.final["sigma"])
    assert frame["failure"].notna().tolist() == [False, False, False, True] * 2
    assert "no star" in frame["failure"][3]
    assert str(archive) not in frame["failure"][3]
    cells = results.cells()
    assert [(c["runs"], c["failed"]) for c in cells] == [(4, 1), (4, 1)]


def test_same_bits_and_going_on(archive: Path) -> None:
    whole = campaign.run(CONFIG, "out", threads=2)
    one = {**CONFIG, "logs": {"folder": "archive", "pattern": "*.npz"}}
    assert campaign.run(one, "later", threads=1).ran == 4
    rest = campaign.run(CONFIG, "later")
    assert (rest.ran, rest.kept) == (4, 4)
    assert plain(rest.table()).equals(plain(whole.table()))


def test_a_log_that_changed_is_another(archive: Path) -> None:
    campaign.run(CONFIG, "out")
    (archive / "a.toml").write_text((archive / "a.toml").read_text() + "\n[log]\ntitle = 'x'\n")
    with pytest.raises(cc.InputError, match="holds 2 rows that this campaign does not ask for"):
        campaign.run(CONFIG, "out")


def test_smoothed(archive: Path) -> None:
    both = {**CONFIG, "logs": {"folder": "archive", "pattern": "c"}, "campaign": {"smooth": True}}
    cell = campaign.run(both, "out").cells()[0]
    assert (cell["runs"], cell["failed"]) == (1, 0)


def test_a_damaged_log_is_a_row(archive: Path) -> None:
    (archive / "a.npz").write_bytes(b"PK\x03\x04 not much")
    frame = campaign.run(CONFIG, "out").table().to_pandas()
    assert frame["failure"][0].startswith("cannot be read") or "a.npz" in frame["failure"][0]
    assert frame["samples"].isna().tolist() == [True, False, False, True] * 2


@pytest.mark.parametrize(
    ("tables", "words"),
    [
        ({"logs": {"folder": "nowhere"}}, "logs.folder, value 'nowhere': there is no such"),
        ({"logs": {"pattern": "*"}}, "logs.folder: is needed"),
        ({"logs": {"folder": "archive", "pattern": "*.bin"}}, "no log in archive matches"),
        ({"logs": {"folder": "archive", "pattern": "/x"}}, "logs.pattern, value '/x': cannot"),
        ({"logs": {"folder": "archive", "glob": "*"}}, "logs.glob: unknown key; known are folder"),
        ({"scenario": {"duration_s": 3}}, r"\[logs\]: goes without \[scenario\]"),
        ({"campaign": {"trials": 3}}, "campaign.trials: unknown key"),
        ({"star": {"period_s": 3}}, "star.period_s: unknown key"),
        ({"telescope": {}}, r"\[telescope\]: unknown table"),
    ],
)
def test_bad_configurations(archive: Path, tables: dict[str, Any], words: str) -> None:
    with pytest.raises(cc.InputError, match=words):
        campaign.run({**CONFIG, **tables}, "out")
