"""The star-gyro experiment: the paper's figures, the page, the JSON, the command."""

from __future__ import annotations

import csv
import dataclasses
import io
import json
from pathlib import Path
from typing import Any

import celestcore as cc
import numpy as np
import pytest
from celestcore import cli
from celestcore.errors import InputError
from celestcore.reproduce import _blocks, _model, _paper, star_gyro
from celestcore.reproduce._page import page
from celestcore.reproduce._pool import in_parallel
from celestcore.reproduce._target import Target
from celestcore.reproduce._targets import at_most, by_chance, tolerance
from celestcore.reproduce._theory import theory
from celestcore.units import ARCSEC
from pages import Page

pytest.importorskip("matplotlib")
pytest.importorskip("typer")
NO_PICTURES = {"ratios": b"", **{f"figure_{k}": b"" for k in range(2, 8)}}


def scores(figures: np.ndarray, runs: int = 16, scatter: float = 0.0) -> _blocks.Scores:
    """Return scores whose pooled figures are as given, (cell, axis)."""
    rng = np.random.default_rng(1)
    each = np.repeat(figures[:, None], runs, axis=1)
    each = each * (1.0 + scatter * rng.standard_normal(each.shape))
    flat = np.ones(each.shape[:2])
    return _blocks.Scores(each, 1.01 * each, 1.04 * each, 3 * flat, 6 * flat, 3 * flat, 0.01 * flat)


def block_n() -> list[dict[str, Any]]:
    lost = {"MEKF": 60.0, "MEKF with reset": 50.0, "invariant EKF": 4.0, "USQUE": 54.0}
    rows: list[dict[str, Any]] = []
    for case in ("90°", "150°"):
        for name, share in {**lost, "iterated MEKF": 0.0}.items():
            form = "library" if name.startswith("iter") else "textbook"
            value = share if case == "90°" or name.startswith("iter") else 95.0
            rows.append(row("N1", case, form, name) | {"not_settled_percent": value})
    for name, nees in (("MEKF", 30.0), ("USQUE", 1.4), ("iterated MEKF", 1.05)):
        more = {"median_bias_deg_per_s": [0.2, 0.005, 0.001], "median_nees_6": nees}
        rows.append(row("N2", "120 s", "library", name) | more)
    return [
        *rows,
        row("N3", "magnetometer", "library", "iterated MEKF") | {"not_settled_percent": 0.0},
    ]


def row(block: str, case: str, form: str, name: str) -> dict[str, Any]:
    return {"block": block, "case": case, "form": form, "filter": name, "runs": 100}


@pytest.fixture(scope="module")
def result() -> star_gyro.Result:
    """Return a result in which every target is met, without running anything."""
    found = theory(_model.cells())
    paper_ekf, paper_ukf = (column.reshape(36, 3) for column in (_paper.EKF, _paper.UKF))
    parts = {
        **dict.fromkeys(("r1", "r1_swapped"), scores(1.05 * paper_ukf)),
        **dict.fromkeys(("r2", "r2_swapped"), scores(0.96 * paper_ekf)),
        **dict.fromkeys(("mekf", "ukf", "ukf7"), scores(1.002 * found.filter)),
        "smoothed": scores(0.998 * found.smoother),
    }
    free = [{"star_arcsec": 0.0, "gyro_arcsec_per_s": 0.2, "pitch": 1e-6, "roll": 0.0, "yaw": 1e-9}]
    return star_gyro.Result(16, 100, 7, parts, found, block_n(), free, 60.0)


def test_tables_are_the_papers() -> None:
    """Sums of the columns of the print, and corners."""
    assert _paper.EKF.shape == _paper.UKF.shape == (3, 12, 3)
    sums = [[15.51, 13.85, 13.70], [9.81, 9.30, 9.18], [7.14, 6.71, 6.59]]
    np.testing.assert_allclose(_paper.EKF.sum(axis=1), sums, atol=1e-9)
    sums = [[13.82, 11.9906, 11.69], [8.38, 7.46, 7.21], [5.90, 5.21, 5.05]]
    np.testing.assert_allclose(_paper.UKF.sum(axis=1), sums, atol=1e-9)
    assert _paper.UKF[0, 9:, 1].tolist() == [1.3708, 1.5707, 1.6991]
    assert _paper.EKF[0, -1].tolist() == [1.95, 2.01, 2.12]


def test_gains_and_wins_of_the_paper() -> None:
    gains = _paper.gains(_paper.UKF, _paper.EKF)
    known = [[9.9, 12.2, 13.1], [10.7, 15.8, 17.8], [12.0, 16.7, 18.4]]
    np.testing.assert_allclose(gains, known, atol=0.051)
    assert np.sum(_paper.EKF <= _paper.UKF) == 13
    won = _paper.gains(_paper.UKF, _paper.EKF, wins_only=True)
    np.testing.assert_allclose(won, _paper.GAINS, atol=1.25)


def test_readings_of_the_paper() -> None:
    for _, column, star, axis, printed in _paper.READINGS:
        table = _paper.EKF if column == "EKF" else _paper.UKF
        read = _paper.reading(table, star, axis)
        assert read == pytest.approx(printed, abs=0.11)
    assert _paper.reading(0.1 * _paper.UKF, 2.0, None) is None
    assert _paper.reading(10.0 * _paper.UKF, 2.0, None) == 0.2


def test_axes_and_cameras() -> None:
    """The orbit's rate is about minus body y; the boresights are 114.975 degrees apart."""
    np.testing.assert_allclose(_model.PAPER_AXES @ [1.0, 0.0, 0.0], [0.0, -1.0, 0.0])
    np.testing.assert_allclose(_model.PAPER_AXES @ [0.0, 1.0, 0.0], [1.0, 0.0, 0.0])
    assert np.linalg.det(_model.PAPER_AXES) == pytest.approx(1.0)
    angle = np.degrees(np.arccos(_model.BORESIGHTS[0] @ _model.BORESIGHTS[1]))
    assert angle == pytest.approx(114.975, abs=5e-4)
    rate = np.sqrt(3.986004418e14 / _model.SEMI_MAJOR_AXIS**3)
    assert rate == pytest.approx(_model.RATE, rel=1e-10)
    body = _model.star_covariance(5.0)
    assert _model.figures(np.sqrt(np.diag(body)))[0] / 5.0 == pytest.approx(1.3156, abs=1e-4)
    assert body[0, 1] == pytest.approx(0.0, abs=1e-25)
    assert body[0, 2] < 0.0  # roll and yaw hang together: both cameras look to +roll, -yaw
    np.testing.assert_allclose(_model.figures(ARCSEC * np.array([1.0, 2.0, 3.0])), [6.0, 3.0, 9.0])


@pytest.mark.parametrize(
    ("star", "gyro", "causal", "smoothed"),
    [
        (5.0, 0.2, (0.436, 0.345, 0.319), (0.305, 0.243, 0.224)),
        (5.0, 2.4, (1.475, 1.165, 1.074), (1.056, 0.841, 0.777)),
        (2.0, 1.2, (0.658, 0.519, 0.477), (0.472, 0.376, 0.347)),
        (1.0, 0.2, (0.192, 0.152, 0.141), (0.136, 0.109, 0.100)),
        (1.0, 2.4, (0.627, 0.481, 0.437), (0.471, 0.372, 0.343)),
    ],
)
def test_bounds(
    result: star_gyro.Result, star: float, gyro: float, causal: Any, smoothed: Any
) -> None:
    cell = _paper.STAR.index(star), _paper.GYRO.index(gyro)
    np.testing.assert_allclose(result.figures("bound_filter")[cell], causal, atol=6e-4)
    np.testing.assert_allclose(result.figures("bound_smoother")[cell], smoothed, atol=6e-4)


def test_scatter_of_an_orbit_is_that_of_its_autocorrelation() -> None:
    """A scalar filter by simulation: the error is a first-order Markov sequence."""
    found = theory(_model.cells())
    assert found.scatter_filter.max() == pytest.approx(0.0704, abs=5e-4)
    assert np.all(found.scatter_smoother > found.scatter_filter)
    cell, axis = 5, 2
    nav = _model.tuned(_model.cells()[cell], cc.EKF())
    settled = cc.analysis.steady_state(nav.gyro, nav.star, 0.1, 0.2, (0.0, -_model.RATE, 0.0))
    keep = 1.0 - settled.gain[2, 2]
    rng = np.random.default_rng(3)
    steps, runs = round((_model.DURATION - _model.SKIP) / 0.2), 400
    e = rng.standard_normal(runs)
    total = np.zeros(runs)
    for _ in range(steps):
        e = keep * e + np.sqrt(1.0 - keep**2) * rng.standard_normal(runs)
        total += e * e
    scatter = np.std(np.sqrt(total / steps))
    assert found.scatter_filter[cell, axis] == pytest.approx(scatter, rel=0.1)


def test_all_targets_can_be_met_and_missed(result: star_gyro.Result) -> None:
    met = result.targets()
    assert [t for t in met if not t.met] == []
    assert {t.block for t in met} == {"R1", "R2", "R1 swapped", "R2 swapped", "T", "S", "N"}
    worse = {name: _worse(score) for name, score in result.scores.items()}
    worse["r1"], worse["r2"] = _worse(worse["r1"]), _worse(worse["r2"])
    rows = [_opposite(r) for r in result.n_block]
    missed = dataclasses.replace(result, scores=worse, n_block=rows).targets()
    assert [t for t in missed if t.met and "equal" not in t.asked] == []


def _worse(score: _blocks.Scores) -> _blocks.Scores:
    return dataclasses.replace(
        score, after=1.9 * score.after, nees_attitude=1.05 * score.nees_attitude
    )


def _opposite(row: dict[str, Any]) -> dict[str, Any]:
    row = dict(row)
    if "median_nees_6" in row:
        row["median_nees_6"] = 5.0
    else:
        row["not_settled_percent"] = 20.0
    return row


def test_swap_that_differs_is_seen(result: star_gyro.Result) -> None:
    other = dataclasses.replace(result.scores["r1"], after=result.scores["r1"].after * (1 + 2e-6))
    changed = dataclasses.replace(result, scores={**result.scores, "r1_swapped": other})
    assert [t.met for t in changed.targets() if t.block == "R1 swapped"] == [False]


def test_few_runs_are_not_judged(result: star_gyro.Result) -> None:
    few = dataclasses.replace(result, runs=1, n_runs=10)
    judged = [t for t in few.targets() if t.met is not None]
    assert all("equal" in t.asked for t in judged)
    assert "not judged" in page(few, pictures=NO_PICTURES)
    # block N is judged by its own number of runs
    only_n = dataclasses.replace(result, runs=1).targets()
    assert {t.block for t in only_n if t.met is not None and "equal" not in t.asked} == {"N"}
    np.testing.assert_allclose(tolerance(few, "mekf").max(), 3 * few.theory.scatter_filter.max())


def test_chance_leaves_out_one_figure_now_and_then(result: star_gyro.Result) -> None:
    """Against counts of normal deviates; one figure outside is no miss, two are."""
    rng = np.random.default_rng(4)
    limit = tolerance(result, "mekf") / (result.theory.scatter_filter.reshape(3, 12, 3) / 4.0)
    drawn = np.abs(rng.standard_normal((20000, 3, 12, 3))) > limit
    counts = drawn.sum(axis=(1, 2, 3))
    assert by_chance(result, "mekf") == pytest.approx(counts.mean(), rel=0.1)
    assert np.mean(counts > at_most(by_chance(result, "mekf"))) < 0.02
    assert [at_most(mean) for mean in (0.0, 0.1, 0.2, 1.0)] == [0, 1, 1, 3]
    for outside, met in ((1, True), (2, False)):
        figures = result.scores["mekf"].after.copy()
        figures[-outside:, :, 0] *= 1.2
        changed = dataclasses.replace(result.scores["mekf"], after=figures)
        made = dataclasses.replace(result, scores={**result.scores, "mekf": changed})
        (target,) = (t for t in made.targets() if t.asked.startswith("MEKF: each"))
        assert target.met is met
        assert target.found.startswith(f"{108 - outside} of 108")


def test_standard_error_of_pooled_figures() -> None:
    made = scores(np.ones((36, 3)), runs=400, scatter=0.05)
    np.testing.assert_allclose(made.standard_error().mean(), 0.05 / 20.0, rtol=0.02)
    assert np.isnan(scores(np.ones((36, 3)), runs=1).standard_error()).all()


def test_json_has_every_figure(result: star_gyro.Result) -> None:
    made = json.loads(json.dumps(result.to_dict(), allow_nan=False))
    assert made["experiment"] == "star-gyro"
    assert (made["runs"], made["seed"], len(made["cells"])) == (16, 7, 108)
    keys = ["star_arcsec", "gyro_arcsec_per_s", "axis", "paper_ekf", "paper_ukf", "r1", "r2"]
    keys += ["r1_swapped", "r2_swapped", "mekf", "ukf", "ukf7", "smoothed"]
    keys += ["bound_filter", "bound_smoother"]
    assert all(list(cell)[:15] == keys for cell in made["cells"])
    cell = next(
        c
        for c in made["cells"]
        if (c["star_arcsec"], c["gyro_arcsec_per_s"], c["axis"]) == (2.0, 1.2, "roll")
    )
    assert (cell["paper_ekf"], cell["paper_ukf"]) == (0.72, 0.58)
    assert cell["r1"] == pytest.approx(1.05 * 0.58)
    assert cell["r2_10hz"] == pytest.approx(1.01 * 0.96 * 0.72)
    assert cell["bound_filter"] == pytest.approx(0.519, abs=6e-4)
    assert made["nees"]["ukf7"] == pytest.approx(
        {"attitude_over_3": 1.0, "full_over_6": 1.0, "nis_over_3": 1.0}
    )
    assert made["gains_percent"]["paper_ekf_better"] == 10
    assert made["gains_percent"]["paper_equal"] == 3
    assert made["cost"]["times_mekf"]["ukf"] == 1.0
    assert len(made["n_block"]) == len(result.n_block)
    assert all(target["met"] for target in made["targets"])


def test_page_is_whole_and_stands_alone(result: star_gyro.Result) -> None:
    found = Page(page(result, "celestcore reproduce star-gyro --seed 7", NO_PICTURES))
    words = " ".join(found.words)
    assert (found.open, found.loaded) == ([], [])
    assert "1.3708" in words
    assert "--seed 7" in words
    assert "must not be claimed" in words
    assert "21 published UKF figures" in words
    assert "10 where it is better and 3 where they are equal" in words
    assert "None" not in words
    assert "nan" not in words.lower().replace("nanosecond", "")


def test_csv_tables(result: star_gyro.Result) -> None:
    from celestcore.reproduce._tables import csv_tables

    tables = csv_tables(result)
    assert list(tables) == ["table_3.csv", "table_4.csv", "table_5.csv", "block_n.csv"]
    rows = list(csv.DictReader(io.StringIO(tables["table_4.csv"])))
    assert len(rows) == 12
    assert float(rows[5]["paper_ukf_yaw"]) == 0.56
    assert float(rows[5]["mekf_pitch"]) == pytest.approx(0.659, abs=2e-3)


def test_unknown_column(result: star_gyro.Result) -> None:
    with pytest.raises(InputError, match="bound_smoother"):
        result.figures("paper")


def test_jobs_keep_their_order_and_add_up() -> None:
    heard: list[tuple[int, int]] = []
    jobs = [lambda tell, k=k: (tell(2, 2), k)[1] for k in range(9)]
    out = in_parallel(jobs, 4, lambda done, total: heard.append((done, total)), 18)
    assert out == list(range(9))
    assert heard[-1] == (18, 18)


def test_a_failing_job_ends_the_others() -> None:
    def fails(tell: Any) -> int:
        raise ValueError("no")

    def endless(tell: Any) -> int:
        while True:
            tell(1, 2)

    with pytest.raises(ValueError, match="no"):
        in_parallel([endless, fails], 2, None, 4)


@pytest.mark.parametrize(
    "arguments", [("--runs", "0"), ("--seed", "-1"), ("--json", "/nowhere/a.json")]
)
def test_command_refuses(arguments: tuple[str, ...], capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["reproduce", "star-gyro", *arguments]) == 2
    assert capsys.readouterr().err.startswith("error: ")


def test_command_refuses_a_file_for_a_folder(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "a").write_text("")
    assert cli.main(["reproduce", "star-gyro", "--out", str(tmp_path / "a")]) == 2
    assert "is a file" in capsys.readouterr().err


def test_command_on_short_orbits(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The whole road, with orbits of a minute: too short for the figures to mean anything."""
    monkeypatch.setattr(_model, "DURATION", 60.0)
    monkeypatch.setattr(_model, "SKIP", 10.0)
    out, file = tmp_path / "deep" / "out", tmp_path / "a.json"
    arguments = ["reproduce", "star-gyro", "--quick", "--seed", "4", "--json", str(file)]
    made = []
    for more in (["--threads", "1"], ["--threads", "3", "--out", str(out)]):
        code = cli.main([*arguments, *more])
        text, err = capsys.readouterr()
        assert (code, err) == (0, "")
        made.append(json.loads(file.read_text()))
    assert "index.html" in text.replace("\n", "")
    pictures = {f"figure_{k}.svg" for k in range(2, 8)} | {"ratios.svg"}
    tables = {"table_3.csv", "table_4.csv", "table_5.csv", "block_n.csv"}
    assert {p.name for p in out.iterdir()} == {"index.html", "result.json", *pictures, *tables}
    assert made[0]["cells"] == made[1]["cells"]
    assert made[0]["n_block"] == made[1]["n_block"]
    assert all(cell["mekf"] > 0.0 for cell in made[0]["cells"])
    assert made[0]["cells"][0]["mekf"] == pytest.approx(made[0]["cells"][0]["ukf"], rel=1e-5)


def test_target_is_json() -> None:
    assert Target("T", "a", "b", None).to_dict() == {
        "block": "T",
        "asked": "a",
        "found": "b",
        "met": None,
    }
