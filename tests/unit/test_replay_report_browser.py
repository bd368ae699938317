"""The report of a replay in parts in a real browser: drawn, marked, its numbers the summary's."""

from __future__ import annotations

import json
from pathlib import Path

import celestcore as cc
import pytest
from browser import browse, needed, tried
from celestcore import cli

pytest.importorskip("pyarrow")
pytestmark = needed


@pytest.fixture(scope="module")
def replayed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A log with a gap and a bias step, replayed by the command."""
    folder = tmp_path_factory.mktemp("parts")
    log = cc.sample("fermi")
    broken = cc.simulate.faults.dropout(log, "gyro", 5000.0, 5100.0)
    broken = cc.simulate.faults.bias_step(broken, 20_000.0, 1e9, [0.0, 2e-3, 0.0])
    cc.write_log(broken, folder / "log")
    words = ["replay", folder / "log", "--parts", folder / "out", "--every", 10]
    words += ["--gate", 0.9999, "--report", folder / "a.html", "--json", folder / "a.json"]
    assert cli.main([str(w) for w in words]) == 0
    return folder


def test_it_opens_and_its_numbers_are_the_summarys(replayed: Path) -> None:
    found, console = browse(replayed / "a.html", "--dump-dom")
    assert console == ""
    assert found.loaded == []
    result = json.loads(found.inside["summary"])
    command = json.loads((replayed / "a.json").read_text())
    assert {name: result["replay"][name] for name in command} == command
    assert result["replay"] == json.loads((replayed / "out" / "summary.json").read_text())
    assert len(found.numbers) > 30
    found.check_numbers(result)
    kinds = {event["kind"] for event in result["events"]}
    assert {"gap", "restart"} <= kinds
    assert found.tags.count("canvas") == len(json.loads(found.inside["panels"])["panels"]) == 12


@pytest.mark.parametrize("width", [360, 1280])
def test_it_is_drawn_and_answers(width: int, replayed: Path, tmp_path: Path) -> None:
    text = (replayed / "a.html").read_text(encoding="utf-8")
    _, seen = tried(text, tmp_path, f"--window-size={width},900")
    assert len(seen["ink"]) == 12
    assert min(seen["ink"]) > 1000
    assert seen["zoomed"] == seen["blocked"] == "drawn zoomed"
    assert seen["after"] == "drawn"
    assert seen["wide"] <= 0, "nothing is wider than the screen"


def test_starts_anew_are_drawn(replayed: Path, tmp_path: Path) -> None:
    text = (replayed / "a.html").read_text(encoding="utf-8")
    marks = json.loads(text.split('"marks":')[1].split("]")[0] + "]")
    assert marks
    plain = text.replace(text[text.index('"marks":') :].split("]")[0] + "]", '"marks":[]')
    (tmp_path / "one").mkdir()
    (tmp_path / "two").mkdir()
    _, with_marks = tried(text, tmp_path / "one")
    _, without = tried(plain, tmp_path / "two")
    more = [a > b for a, b in zip(with_marks["ink"], without["ink"], strict=True)]
    assert sum(more) > 6, "in most plots, some of which are full"


def test_it_prints(replayed: Path) -> None:
    pdf = replayed / "a.pdf"
    assert browse(replayed / "a.html", f"--print-to-pdf={pdf}")[1] == ""
    assert pdf.read_bytes().startswith(b"%PDF")
