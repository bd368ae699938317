"""Reports in a real browser: no errors, plots that are drawn, zoom and hover, a page on paper."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import celestcore as cc
import numpy as np
import pytest
from browser import browse, needed, tried
from celestcore import cli
from celestcore.analysis import WithheldDrift
from celestcore.report import page
from celestcore.solution import Solution
from celestcore.summary import summary
from pages import Page

MakeSolution = Callable[..., Solution]
pytestmark = needed


def test_the_console_is_heard(tmp_path: Path) -> None:
    path = tmp_path / "wrong.html"
    path.write_text("<!doctype html><script>missing()</script>")
    assert "missing is not defined" in browse(path, "--dump-dom")[1]


@pytest.mark.parametrize(("name", "plots"), [("fermi", 12), ("noaa20", 26)])
def test_the_commands_report_opens_and_its_numbers_are_the_jsons(
    name: str, plots: int, tmp_path: Path
) -> None:
    if name == "noaa20":
        pytest.importorskip("erfa")
    path, file = tmp_path / "a.html", tmp_path / "a.json"
    code = cli.main(["replay", "--sample", name, "--report", str(path), "--json", str(file)])
    assert code == 0
    found, console = browse(path, "--dump-dom")
    assert console == ""
    assert found.loaded == []
    assert found.tags.count("canvas") == plots
    result = json.loads(file.read_text())
    assert json.loads(found.inside["summary"]) == result
    assert len(found.numbers) > 30
    found.check_numbers(result)


@pytest.mark.parametrize("width", [360, 1280])
def test_plots_are_drawn_and_answer(
    width: int, make_solution: MakeSolution, drift: WithheldDrift, tmp_path: Path
) -> None:
    sol = make_solution(5000, sensors=3)
    text = page(sol, summary(sol, withheld=drift.summary()), drift=drift)
    found, seen = tried(text, tmp_path, f"--window-size={width},900")
    assert found.tags.count("canvas") == len(seen["ink"]) == 1 + 3 + 3 + 2 + 8 + 3
    assert min(seen["ink"]) > 1000
    assert seen["before"] == "drawn"
    assert seen["zoomed"] == "drawn zoomed"
    assert seen["after"] == "drawn"
    assert seen["pinched"] == "drawn zoomed"
    assert seen["kept"], "two fingers do not move the page"
    assert seen["blocked"] == "drawn zoomed"
    assert seen["wide"] <= 0, "nothing is wider than the screen"
    first, attitude = seen["hover"][:2]
    assert "min (2026-01-01 " in first[0]
    assert all("±" in value and value.endswith(" deg") for value in attitude[1:])


def test_an_orbit_is_drawn_by_the_same_page(tmp_path: Path) -> None:
    trial = cc.gnss.GnssStarScenario(duration=600.0).trial(seed=1, trial=0)
    nav = cc.GnssStarNavigator()
    nav.run(trial.log, covariance=True).report(
        tmp_path / "orbit.html", title="An orbit", log=trial.log, navigator=nav
    )
    text = (tmp_path / "orbit.html").read_text(encoding="utf-8")
    found, seen = tried(text, tmp_path)
    assert len(seen["ink"]) == 1 + 2 + 3 + 2 + 9 + 3
    assert min(seen["ink"]) > 1000
    result = json.loads(found.inside["summary"])
    found.check_numbers(result)
    np.testing.assert_allclose(result["sensors"][0]["noise"]["configured"], 1.0)


def test_hard_solutions_are_drawn(make_solution: MakeSolution, tmp_path: Path) -> None:
    rejected = np.zeros(200, dtype=bool)
    hard = [
        make_solution(400)[:0.5],
        make_solution(400, accepted=rejected),
        make_solution(400, sigma=np.zeros((400, 6)), bias=np.zeros((400, 3))),
        make_solution(400, nis=np.full(200, np.nan)),
    ]
    for sol in hard:
        (tmp_path / "hard.html").write_text(page(sol, summary(sol)), encoding="utf-8")
        found, console = browse(tmp_path / "hard.html", "--dump-dom")
        assert console == ""
        assert found.tags.count("canvas") == text_panels(found)


def text_panels(found: Page) -> int:
    return len(json.loads(found.inside["panels"])["panels"])


def test_it_prints(solution: Solution, tmp_path: Path) -> None:
    solution.report(tmp_path / "a.html")
    pdf = tmp_path / "a.pdf"
    assert browse(tmp_path / "a.html", f"--print-to-pdf={pdf}")[1] == ""
    data = pdf.read_bytes()
    assert data.startswith(b"%PDF")
    bare = tmp_path / "bare.html"
    text = (tmp_path / "a.html").read_text(encoding="utf-8")
    bare.write_text(
        text.replace("</style>", ".uplot{display:none!important}</style>"), encoding="utf-8"
    )
    browse(bare, f"--print-to-pdf={tmp_path / 'bare.pdf'}")
    assert len(data) > 4 * (tmp_path / "bare.pdf").stat().st_size, "the plots are on paper"
