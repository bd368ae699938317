"""The GPS and star-sensor experiment: targets, page, JSON and command, on made-up scores."""

from __future__ import annotations

import csv
import dataclasses
import io
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from celestcore import cli
from celestcore.reproduce import _gnss_blocks as blocks
from celestcore.reproduce import _gnss_model as model
from celestcore.reproduce import _gnss_reference as reference
from celestcore.reproduce import gnss_star
from celestcore.reproduce._gnss_model import Cell
from celestcore.reproduce._gnss_page import page
from celestcore.reproduce._gnss_scores import ASKED
from celestcore.reproduce._gnss_series import Series, mean, of_errors
from gnss_result import made_up, series, spread
from pages import Page

pytest.importorskip("matplotlib")
pytest.importorskip("typer")
Result = gnss_star.Result
NAMES = ("errors", "figure_3_4_6", "figure_5", "figure_7", "slew", "observability")
NO_PICTURES = dict.fromkeys(NAMES, b"")


@pytest.fixture(scope="module")
def result() -> Result:
    return made_up()


def changed(result: Result, cell: Cell, name: str, **factors: Any) -> Result:
    """Return a result with a navigator's columns multiplied."""
    old = result.cells[cell][name]
    columns = {key: getattr(old, key) * factor for key, factor in factors.items()}
    found = {**result.cells[cell], name: dataclasses.replace(old, **columns)}
    return dataclasses.replace(result, cells={**result.cells, cell: found})


def missed(result: Result) -> list[str]:
    return [target.asked for target in result.targets() if target.met is False]


def test_all_targets_can_be_met(result: Result) -> None:
    assert len(result.targets()) == 15
    assert all(target.met for target in result.targets())


TEN = Cell("clean", 10.0)
PITCH = np.array([1.0, 1.1, 1.0])


@pytest.mark.parametrize(
    ("cell", "name", "factors", "begin"),
    [
        (Cell("clean"), "20x20", {"rms_position": 1.1}, "filter, 20×20 gravity"),
        (TEN, "20x20", {"rms_position": 1.12}, "filter, 20×20 gravity"),
        (TEN, "20x20_smoothed", {"rms_position": 1.1}, "smoothed, 20×20"),
        (Cell("clean"), "4x4", {"rms_position": 1.1}, "filter, 4×4"),
        (TEN, "20x20", {"rms_velocity": 1.15}, "filter, 20×20, rms"),
        (Cell("lfe"), "states", {"nees_attitude": 1.2}, "NEES"),
        (Cell("lfe", 10.0), "states_smoothed", {"nees_attitude": 0.8}, "NEES"),
        (Cell("lfe"), "states", {"rms_attitude": np.array([1.02, 1.0, 1.0])}, "the same at 1 m"),
        (Cell("gyro"), "states_smoothed", {"rms_attitude": PITCH + 0.02}, "gyro and LFE states"),
        (Cell("gyro"), "ignored_smoothed", {"rms_attitude": 0.9}, "the same without LFE"),
        (Cell("outliers"), "gated", {"rms_position": 1.15}, "5 % of the fixes"),
        (Cell("outliers", 10.0), "gated", {"rms_attitude": PITCH}, "5 % of the fixes"),
        (Cell("slew"), "20x20", {"rms_attitude": 1.12}, "through 90°"),
    ],
)
def test_a_worse_navigator_misses_its_target(
    result: Result, cell: Cell, name: str, factors: dict[str, Any], begin: str
) -> None:
    (asked,) = missed(changed(result, cell, name, **factors))
    assert asked.startswith(begin)


@pytest.mark.parametrize("factor", [1.1, 1.2])
def test_pitch_targets_are_judged_at_both_levels(result: Result, factor: float) -> None:
    for name, cell in (("20x20_smoothed", "clean"), ("states_smoothed", "lfe")):
        made = changed(result, Cell(cell, 10.0), name, rms_attitude=np.array([1, factor, 1]))
        asked = missed(made)
        assert any(a.startswith("pitch with") for a in asked), asked
        assert any(a.startswith("the same at 1 m") for a in asked), asked


def test_other_targets_can_be_missed(result: Result) -> None:
    first = result.observed.first.copy()
    first[2, 4] = 0.97
    for changes in (
        {"observed": result.observed._replace(first=first)},
        {"observed": result.observed._replace(unobservable=[2, 2, 1, 2, 2])},
        {"least_squares": [row._replace(difference=0.031) for row in result.least_squares]},
    ):
        assert len(missed(dataclasses.replace(result, **changes))) == 1


def test_missed_targets_are_shown_as_missed(result: Result) -> None:
    made = changed(result, Cell("clean"), "20x20", rms_position=1.2)
    text = page(made, pictures=NO_PICTURES)
    assert text.count('class="no">missed') == 1
    assert 'class="no">missed' not in page(result, pictures=NO_PICTURES)
    assert made.to_dict()["figures"]["position_20x20_1m"]["met"] is False


def test_few_runs_are_not_judged(result: Result) -> None:
    few = dataclasses.replace(result, runs=2)
    assert all(target.met is None for target in few.targets())
    assert "no target is judged" in page(few, pictures=NO_PICTURES)


def test_standard_errors_come_from_the_scatter() -> None:
    """Against the scatter of many campaigns."""
    rng = np.random.default_rng(5)
    drawn = np.abs(1.0 + 0.2 * rng.standard_normal((3000, 50)))
    scatter = np.std([Series(d).value for d in drawn])
    assert np.mean([Series(d).error for d in drawn]) == pytest.approx(scatter, rel=0.05)
    plain = np.std([mean(d).value for d in drawn])
    assert np.mean([mean(d).error for d in drawn]) == pytest.approx(plain, rel=0.05)
    assert np.isnan(Series(np.ones(1)).error)
    gone = Series(np.array([1.0, np.nan, 1.0]), np.array([2.0, np.nan, 4.0]))
    assert (gone.value, gone.maximum) == (1.0, 3.0)


def test_series_of_errors() -> None:
    made = of_errors([np.array([[3.0, 4.0, 0.0]]), np.zeros((2, 3))])
    assert made.each.tolist() == [5.0, 0.0]
    assert made.value == pytest.approx(5.0 / np.sqrt(2.0))
    assert of_errors([np.array([-2.0, 1.0])]).largest == [2.0]
    assert series(3.0).value == pytest.approx(3.0)
    assert series(3.0).times(2.0).maximum == pytest.approx(5.0 * spread(3.0).mean())


def test_json_is_the_schema(result: Result) -> None:
    made = json.loads(json.dumps(result.to_dict(), allow_nan=False))
    assert made["experiment"] == "gnss-star"
    assert (made["runs"], made["seed"]) == (100, 7)
    needed = {"value", "standard_error", "mean_of_maxima", "unit", "gps_sigma_m", "met"}
    needed |= {"at_most", "at_least", "bound", "reference"}
    assert all(needed <= set(row) for row in made["figures"].values())
    for name in ASKED:
        assert f"{name}_1m" in made["figures"], name
    row = made["figures"]["position_20x20_10m"]
    assert (row["at_most"], row["bound"], row["unit"], row["met"]) == (4.3, 3.77, "m", True)
    assert row["value"] == pytest.approx(3.9)
    assert made["figures"]["pitch_star_1m"]["value"] == pytest.approx(20.0)
    assert len(made["observability"]["first_harmonic"]) == 5
    assert all(target["met"] for target in made["targets"])
    assert made["failures"] == {}


def test_broken_runs_are_counted(result: Result) -> None:
    old = result.cells[Cell("clean")]["8x8"]
    broken = dataclasses.replace(old, failures={3: "lost"})
    cells = {**result.cells, Cell("clean"): {**result.cells[Cell("clean")], "8x8": broken}}
    made = dataclasses.replace(result, cells=cells)
    assert made.to_dict()["failures"] == {"clean_1m_8x8": 1}


def test_page_is_whole_and_stands_alone(result: Result) -> None:
    found = Page(page(result, "celestcore reproduce gnss-star --seed 7", NO_PICTURES))
    words = " ".join(found.words)
    assert (found.open, found.loaded) == ([], [])
    for phrase in (
        "--seed 7",
        "What must be said plainly",
        "0.02° of pitch error is 72″: worse than its own star sensor",
        "carry no attitude: the direct method has 32° of pitch error",
        "does not depend on GPS noise",
        "Real GPS errors are coloured",
        "not legible",
        "inferred",
    ):
        assert phrase in words
    assert "None" not in words
    assert " nan" not in words


def test_csv_tables(result: Result) -> None:
    from celestcore.reproduce._gnss_tables import csv_tables

    tables = csv_tables(result)
    assert list(tables) == ["figures.csv", "antennas.csv", "least_squares.csv"]
    rows = {row["name"]: row for row in csv.DictReader(io.StringIO(tables["figures.csv"]))}
    assert float(rows["velocity_20x20_1m"]["value"]) == pytest.approx(1.9)


def test_figures_have_their_curves(result: Result) -> None:
    from celestcore.reproduce._gnss_figures import figures

    drawn = figures(result)
    assert tuple(drawn) == NAMES
    assert len(drawn["figure_5"].axes) == len(drawn["figure_3_4_6"].axes) == 6
    _, ax = drawn["slew"].axes
    tall = [np.max(line.get_ydata()) for line in ax.lines if len(line.get_xdata()) == 121]
    assert max(tall) > 100.0 * min(tall)


def test_truth_and_filters_share_the_field() -> None:
    scenario, nav = model.scenario(Cell("clean", 10.0)), model.navigator(10.0, "zonal")
    assert scenario.forces.gravity == 70
    assert scenario.forces.field is nav.dynamics.force.field
    assert nav.dynamics.force.gravity == (20, 0)
    assert nav.gnss.sigma_velocity == (0.1, 0.1, 0.1)
    assert model.gyro_duration() == pytest.approx(3 * 5684.4, abs=15.0)


def test_euler_filters_fail_at_a_right_angle_only() -> None:
    made = reference.slew(2, seed=5)
    assert made.nominal.value < made.star.value
    assert made.slew.value > 50.0 * made.star.value


def test_antenna_positions_carry_no_attitude() -> None:
    one, ten = reference.antenna_angles(3)
    assert 30.0 < np.degrees(one.pitch) < 38.0
    # evenly spread directions: the square root of pi^2 / 4 - 2
    assert ten.pitch == pytest.approx(np.sqrt(np.pi**2 / 4.0 - 2.0), rel=0.02)


@pytest.mark.parametrize(
    "arguments", [("--runs", "0"), ("--seed", "-1"), ("--json", "/nowhere/a.json")]
)
def test_command_refuses(arguments: tuple[str, ...], capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["reproduce", "gnss-star", *arguments]) == 2
    assert capsys.readouterr().err.startswith("error: ")


@pytest.fixture
def short_gyro(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Half an orbit with a gyro instead of three: too short for its figures to mean anything."""
    caches = (model.scenario, model.without_gyro)
    monkeypatch.setattr(model, "ORBITS", 0.55)
    monkeypatch.setattr(blocks, "OBSERVED", 1)
    for cache in caches:
        cache.cache_clear()
    yield
    for cache in caches:
        cache.cache_clear()


@pytest.mark.usefixtures("short_gyro")
def test_command_on_two_runs(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out, file = tmp_path / "out", tmp_path / "a.json"
    arguments = ["reproduce", "gnss-star", "--quick", "--seed", "4", "--json", str(file)]
    made = []
    for more in (["--threads", "1"], ["--threads", "3", "--out", str(out)]):
        code = cli.main([*arguments, *more])
        text, err = capsys.readouterr()
        assert (code, err) == (0, "")
        made.append(json.loads(file.read_text()))
    assert "index.html" in text.replace("\n", "")
    tables = {f"{name}.csv" for name in ("figures", "antennas", "least_squares")}
    files = tables | {f"{name}.svg" for name in NAMES}
    assert {p.name for p in out.iterdir()} == {"index.html", "result.json", *files}
    assert {k: v for k, v in made[0].items() if k != "elapsed_s"} == {
        k: v for k, v in made[1].items() if k != "elapsed_s"
    }
    figures = {name: row["value"] for name, row in made[0]["figures"].items()}
    assert 0.2 < figures["position_20x20_1m"] < 0.8
    assert figures["position_20x20_smoothed_10m"] < figures["position_gps_10m"] / 4.0
    assert 8.0 < figures["pitch_no_lfe_1m"] < figures["pitch_star_1m"]
    assert made[0]["attitude_difference_1m_10m"] < 0.01
    assert figures["position_outliers_ungated_1m"] > 3.0 * figures["position_outliers_1m"]
    assert figures["attitude_euler_slew_1m"] > 50.0 * figures["attitude_navigator_slew_1m"]
    assert figures["nees_coloured_ignored_1m"] > 3.0 * figures["nees_coloured_1m"]
