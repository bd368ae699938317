"""The orbit experiment: the paper's figures, targets, page, JSON and command, on made-up scores."""

from __future__ import annotations

import csv
import dataclasses
import io
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import celestcore as cc
import numpy as np
import pytest
from celestcore import cli
from celestcore.reproduce import _orbit_blocks as blocks
from celestcore.reproduce import _orbit_model as model
from celestcore.reproduce import _orbit_paper as paper
from celestcore.reproduce import celestial_orbit
from celestcore.reproduce._orbit_model import FILTERS
from celestcore.reproduce._orbit_page import page
from celestcore.reproduce._orbit_scores import Scores
from orbit_result import cost, made_up, scores, start
from pages import Page

pytest.importorskip("matplotlib")
pytest.importorskip("typer")
Result = celestial_orbit.Result
NAMES = ("period", "figure_3", "figure_4", "effective_sample_size")
NO_PICTURES = dict.fromkeys(NAMES, b"")


@pytest.fixture(scope="module")
def result() -> Result:
    return made_up()


def test_tables_are_the_papers() -> None:
    """Sums over the columns of the print."""
    one = np.array([[paper.TABLE_1[p][c] for c in paper.COLUMNS] for p in (3.0, 30.0, 60.0)])
    two = np.array([[paper.TABLE_2[d][c] for c in paper.COLUMNS] for d in model.DISTRIBUTIONS])
    np.testing.assert_allclose(one.sum(axis=(0, 1)), [3982.3776, 3.9612, 15331.6436, 13.909])
    np.testing.assert_allclose(two.sum(axis=(0, 1)), [2092.0128, 2.0299, 5551.4224, 4.9791])
    assert paper.row(15.0, "normal", "EKF") == paper.TABLE_2["normal"]["EKF"]
    assert paper.row(60.0, "normal", "UPF").max_pos == 1007.1
    assert paper.row(60.0, "student_t", "UPF") is None


def test_complexity_is_what_the_text_says_of_it() -> None:
    """The UKF about four times the EKF, if F is diagonal; the UPF its number of particles."""
    ekf, ukf, upf = (paper.complexity(name, diagonal=True) for name in paper.COLUMNS)
    assert round(ukf / ekf) == 4
    assert upf == 20 * ukf
    assert paper.complexity("EKF", n=3) == 81 + 27 + 12


def test_truth_is_six_orbits_of_the_papers() -> None:
    r0, v0 = cc.elements.to_state(model.ELEMENTS)
    orbit = cc.elements.from_state(r0, v0)
    assert cc.elements.period(orbit.a) * model.ORBITS == pytest.approx(model.DURATION, abs=0.5)
    assert np.degrees(orbit.i) == pytest.approx(65.0)
    assert orbit.e == pytest.approx(1.809e-3)
    assert len(model.catalogue()) == 4559


def test_all_targets_can_be_met(result: Result) -> None:
    assert [t for t in result.targets() if not t.met] == []


@pytest.mark.parametrize(
    ("asked", "name", "factor"),
    [
        ("the paper's EKF, mean", "ekf_taylor", 1.12),
        ("UKF, mean position", "ukf", 0.88),
        ("UPF (one proposal) equal", "upf", 1.01),
        ("EKF with Runge-Kutta equal", "ekf", 1.01),
        ("8×8 gravity, Sun", "ekf_8x8", 1.2),
        ("UPF, Student's t", "upf", 1.08),
        ("UPF, uniform", "upf", 1.1),
        ("score filter, Student's t", "score", 1.1),
        ("score filter, uniform", "score", 1.1),
    ],
)
def test_a_worse_filter_misses_its_targets(
    result: Result, asked: str, name: str, factor: float
) -> None:
    def worse(found: dict[str, Scores]) -> dict[str, Scores]:
        old = found[name]
        changed = dataclasses.replace(old, mean_position=factor * old.mean_position)
        return {**found, name: changed}

    cells = {cell: worse(found) for cell, found in result.cells.items()}
    made = dataclasses.replace(result, cells=cells)
    (target,) = (t for t in made.targets() if t.asked.startswith(asked))
    assert target.met is False


def changed(result: Result, name: str, **factors: float) -> Result:
    """Return a result with a filter's columns multiplied, in the tables and the long campaign."""

    def worse(found: dict[str, Scores]) -> dict[str, Scores]:
        if name not in found:
            return found
        old = found[name]
        columns = {key: factor * getattr(old, key) for key, factor in factors.items()}
        return {**found, name: dataclasses.replace(old, **columns)}

    return dataclasses.replace(
        result,
        cells={cell: worse(found) for cell, found in result.cells.items()},
        long={cell: worse(found) for cell, found in result.long.items()},
    )


def test_bound_and_consistency_are_judged_by_their_standard_errors(result: Result) -> None:
    """Runs scatter by 10 % (NEES 5 %): 200 runs tell 2.1 %, 40 runs of NEES 2.4 %."""

    def judged(made: Result, begin: str) -> set[bool | None]:
        return {t.met for t in made.targets() if t.asked.startswith(begin)}

    for factor, met in ((1.015, True), (1.03, False), (0.97, False)):
        made = changed(result, "ekf_21x21", rms_position=factor)
        assert judged(made, "21×21 filter, noise A: rms") == {met}
        assert judged(made, "21×21 smoother, noise A: rms") == {True}
    for factor, met in ((1.015, True), (1.03, False)):
        made = changed(result, "ekf_8x8", nees=factor)
        assert judged(made, "8×8 filter, noise B: NEES") == {met}


@pytest.mark.parametrize(
    "spoil",
    [
        lambda r: {"outliers": {**r.outliers, "ekf_gated": scores(400.0)}},
        lambda r: {"outliers": {**r.outliers, "ukf": scores(500.0)}},
        lambda r: {"starts": [start("100 km, 100 m/s", "EKF", 29)]},
        lambda r: {"cost": [cost("ukf", "UKF", 2.1e-3)]},
    ],
)
def test_other_targets_can_be_missed(
    result: Result, spoil: Callable[[Result], dict[str, Any]]
) -> None:
    made = dataclasses.replace(result, **spoil(result))
    assert [t.met for t in made.targets()].count(False) == 1


def test_few_runs_are_not_judged(result: Result) -> None:
    few = dataclasses.replace(result, runs=2)
    assert all(target.met is None for target in few.targets())
    assert "not judged" in page(few, pictures=NO_PICTURES)


def test_broken_runs_are_counted_and_left_out() -> None:
    made = scores(100.0)
    made.mean_position[3] = made.rms_position[3] = np.nan
    assert made.failures == 1
    others = np.delete(made.mean_position, 3)
    assert made.mean() == pytest.approx(others.mean())
    assert made.scatter() == pytest.approx(others.std(ddof=1))
    lost = dataclasses.replace(made, mean_position=np.full(40, np.nan))
    assert np.isnan([lost.mean(), lost.rms(), lost.scatter(), lost.rms_error()]).all()


def test_standard_error_of_the_rms() -> None:
    """Against the scatter of many campaigns."""
    rng = np.random.default_rng(5)
    drawn = np.abs(100.0 * (1.0 + 0.2 * rng.standard_normal((3000, 40))))
    base = scores(100.0)
    found = [dataclasses.replace(base, rms_position=d) for d in drawn]
    scatter = np.std([s.rms() for s in found])
    assert np.mean([s.rms_error() for s in found]) == pytest.approx(scatter, rel=0.05)


def test_json_is_the_schema(result: Result) -> None:
    made = json.loads(json.dumps(result.to_dict(), allow_nan=False))
    assert made["experiment"] == "celestial-orbit"
    assert (made["runs"], made["seed"]) == (40, 7)
    needed = {"period_s", "filter", "noise", "mean_pos_m", "max_pos_m", "mean_vel_m_s"}
    needed |= {"max_vel_m_s", "run_sd_m", "paper_mean_pos_m", "paper_max_pos_m", "bound_m"}
    needed |= {"paper_mean_vel_m_s", "paper_max_vel_m_s", "rms_pos_m", "bound_rms_m", "nees"}
    assert all(needed <= set(row) for row in made["table1"])
    assert len(made["table1"]) == 4 * 2 * len(FILTERS)
    assert len(made["table2"]) == 3 * len(FILTERS)
    assert all({"distribution", "filter", "mean_pos_m"} <= set(row) for row in made["table2"])
    assert all(
        {"filter", "seconds_per_orbit", "paper_seconds"} <= set(row) for row in made["table3"]
    )
    assert len(made["refraction"]) == 2
    assert all(target["met"] for target in made["targets"])


def test_rows_stand_beside_the_papers_figures(result: Result) -> None:
    rows = {(r["period_s"], r["noise"], r["filter"]): r for r in result.table1()}
    ukf = rows[60.0, "A", "ukf"]
    assert ukf["mean_pos_m"] == pytest.approx(333.0)
    printed = [ukf[f"paper_{key}"] for key in ("mean_pos_m", "max_pos_m", "mean_vel_m_s")]
    assert printed == [338.503, 1127.6, 0.3355]
    assert ukf["bound_m"] == pytest.approx(0.92 * ukf["bound_rms_m"])
    assert ukf["run_sd_m"] == pytest.approx(33.3 * np.sqrt(40 / 39))
    smoothed = rows[60.0, "A", "smoothed_21x21"]
    assert smoothed["bound_rms_m"] < 0.8 * ukf["bound_rms_m"]
    assert smoothed["paper_mean_pos_m"] is None
    other = {(r["distribution"], r["filter"]): r for r in result.table2()}
    assert other["uniform", "upf"]["paper_mean_pos_m"] == 197.3377
    assert other["uniform", "upf"]["bound_m"] is None
    assert other["student_t", "upf"]["bound_rms_m"] == 75.0


def test_page_is_whole_and_stands_alone(result: Result) -> None:
    found = Page(page(result, "celestcore reproduce celestial-orbit --seed 7", NO_PICTURES))
    words = " ".join(found.words)
    assert (found.open, found.loaded) == ([], [])
    for phrase in (
        "--seed 7",
        "What must be said plainly",
        "because of its discretisation, not of linearisation",
        "540.5632",
        "4559 stars",
        "19,060",
        "13 of 30",
        "383 ± 77",
    ):
        assert phrase in words
    assert "None" not in words
    assert "nan" not in words.lower().replace("ning and", "").replace("nanosecond", "")


def test_csv_tables(result: Result) -> None:
    from celestcore.reproduce._orbit_tables import csv_tables

    tables = csv_tables(result)
    names = ("table_1", "table_2", "table_3", "outliers", "shapes", "starts", "refraction")
    assert list(tables) == [f"{name}.csv" for name in names]
    rows = list(csv.DictReader(io.StringIO(tables["table_1.csv"])))
    ours = next(r for r in rows if (r["filter"], r["period_s"]) == ("upf", "30"))
    assert float(ours["mean_pos_m"]) == pytest.approx(276.0)
    assert float(ours["paper_mean_pos_m"]) == 193.9783


def test_figures_have_their_curves(result: Result) -> None:
    from celestcore.reproduce._orbit_figures import figures

    drawn = figures(result)
    assert tuple(drawn) == NAMES
    assert len(drawn["figure_3"].axes) == len(drawn["figure_4"].axes) == 3
    (ess,) = drawn["effective_sample_size"].axes
    means = [line.get_ydata().mean() for line in ess.lines if len(line.get_xdata()) == 600]
    assert min(means) < 2.0
    assert max(means) > 16.0


@pytest.mark.parametrize(
    "arguments", [("--runs", "0"), ("--seed", "-1"), ("--json", "/nowhere/a.json")]
)
def test_command_refuses(arguments: tuple[str, ...], capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["reproduce", "celestial-orbit", *arguments]) == 2
    assert capsys.readouterr().err.startswith("error: ")


def test_command_on_short_flights(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The whole road, with flights of 20 min: too short for the figures to mean anything."""
    monkeypatch.setattr(model, "DURATION", 1200.0)
    monkeypatch.setattr(model, "SKIP", 300.0)
    monkeypatch.setattr(blocks, "LAST_ORBIT", 600.0)
    out, file = tmp_path / "out", tmp_path / "a.json"
    arguments = ["reproduce", "celestial-orbit", "--quick", "--seed", "4", "--json", str(file)]
    made = []
    for more in (["--threads", "1"], ["--threads", "3", "--out", str(out)]):
        code = cli.main([*arguments, *more])
        text, err = capsys.readouterr()
        assert (code, err) == (0, "")
        made.append(json.loads(file.read_text()))
    assert "index.html" in text.replace("\n", "")
    names = ("table_1", "table_2", "table_3", "outliers", "shapes", "starts", "refraction")
    files = {f"{name}.csv" for name in names} | {f"{name}.svg" for name in NAMES}
    assert {p.name for p in out.iterdir()} == {"index.html", "result.json", *files}
    for part in ("table1", "table2", "long", "outliers", "shapes", "starts", "refraction", "sky"):
        assert made[0][part] == made[1][part]
    rows = {(r["period_s"], r["noise"], r["filter"]): r for r in made[0]["table1"]}
    assert len(rows) == 4 * 2 * len(FILTERS)
    ukf, ekf = rows[15.0, "A", "ukf"], rows[15.0, "A", "ekf"]
    assert ukf["mean_pos_m"] == pytest.approx(ekf["mean_pos_m"], rel=0.01)
    assert ukf["paper_mean_pos_m"] == 217.3204
    assert all(r["mean_pos_m"] > 0.0 for r in made[0]["table1"] if r["filter"] != "bootstrap")
    assert {r["gravity"] for r in made[0]["refraction"]} == {"j2", "21x21"}
