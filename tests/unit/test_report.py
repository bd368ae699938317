"""The report and the summary."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from celestcore.analysis import WithheldDrift
from celestcore.errors import InputError
from celestcore.report import page, write_report
from celestcore.solution import Solution
from celestcore.summary import headline, inside_95, per_sensor, spell_time, summary, verdict
from celestcore.units import ARCSEC
from pages import Page

MakeSolution = Callable[..., Solution]


def test_summary_has_the_promised_keys(solution: Solution) -> None:
    result = summary(solution)
    assert list(result) == [
        "log",
        "filter",
        "smoothed",
        "gate",
        "version",
        "counts",
        "span_s",
        "innovation",
        "final",
        "samples_per_second",
        "sensors",
        "findings",
    ]
    counts = "samples fixes accepted rejected start missing gaps outside"
    assert sorted(result["counts"]) == sorted(counts.split())
    assert result["span_s"] == 2000.0
    assert result["samples_per_second"] == pytest.approx(2.001e6)
    assert result["final"]["t"] == 2000.0
    assert len(result["final"]["q"]) == 4
    json.dumps(result, allow_nan=False)


def test_summary_numbers(solution: Solution) -> None:
    found = summary(solution)["innovation"]
    used = solution.innovation[solution.accepted] / ARCSEC
    np.testing.assert_allclose(found["rms_arcsec"], np.sqrt(np.mean(used**2, axis=0)))
    assert found["rms_total_arcsec"] == pytest.approx(np.sqrt(np.mean(np.sum(used**2, axis=1))))
    nis = solution.nis[solution.accepted]
    assert found["nis_mean"] == pytest.approx(nis.mean())
    assert found["nis_per_dof"] == pytest.approx(nis.mean() / 3)
    assert found["inside_95"] == pytest.approx(np.mean((nis > 0.2158) & (nis < 9.3484)), abs=2e-3)


def test_summary_of_a_solution_without_fixes_is_valid_json(solution: Solution) -> None:
    result = summary(solution[:0.5])
    assert result["innovation"]["rms_total_arcsec"] is None
    json.dumps(result, allow_nan=False)
    assert "No fix was used" in headline(result)


def test_withheld_is_passed_through(solution: Solution) -> None:
    result = summary(solution, withheld={"windows": np.int64(3), "drift": np.array([1.0, np.nan])})
    assert result["withheld"] == {"windows": 3, "drift": [1.0, None]}


def test_inside_95_uses_each_dof() -> None:
    nis = np.array([0.1, 3.0, 8.0, 9.0])
    dof = np.array([2, 3, 2, 3])
    assert inside_95(nis, dof).tolist() == [True, True, False, True]


def test_per_sensor_splits(make_solution: MakeSolution) -> None:
    sensors = per_sensor(make_solution(3000, sensors=3))
    assert [s["name"] for s in sensors] == ["star", "star_1", "vector_sun"]
    assert [s["dof"] for s in sensors] == [3, 3, 2]
    assert sum(s["fixes"] for s in sensors) == 1500
    assert len(sensors[2]["rms_arcsec"]) == 2
    assert all(0.8 < s["nis_per_dof"] < 1.2 for s in sensors)


def test_the_headline_tells_the_drift(solution: Solution, drift: WithheldDrift) -> None:
    words = headline(summary(solution, withheld=drift.summary()))
    assert "33.3 minutes with 2,001 gyro samples and 1,000 attitude fixes, 6 of them" in words
    assert "drifted by 29.5 arcsec and plain integration of the rates by 88.5" in words
    assert "within 3 sigma in 92.5 % of them, the predicted sigma being" in words


@pytest.mark.parametrize(
    ("ratio", "inside", "words"),
    [
        (1.0, 0.95, "can be believed"),
        (2.0, 0.7, "too small"),
        (0.2, 0.6, "larger than needed"),
        (1.0, 0.8, "not Gaussian"),
    ],
)
def test_verdict_in_plain_words(ratio: float, inside: float, words: str) -> None:
    assert words in verdict({"nis_per_dof": ratio, "inside_95": inside})


def rejecting(make_solution: MakeSolution, rejected: int, judged: int) -> Solution:
    """Return a solution of so many fixes, the last of them rejected."""
    counts = {"samples": 2 * judged, "fixes": judged + 1, "start": 1, "gaps": 1}
    counts.update(accepted=judged - rejected, rejected=rejected)
    used = np.arange(judged) < judged - rejected
    return make_solution(2 * judged, accepted=used, counts=counts)


@pytest.mark.parametrize(("rejected", "judged"), [(298, 299), (299, 299), (31, 300), (2, 10)])
def test_many_rejected_fixes_come_first_and_end_the_verdict(
    make_solution: MakeSolution, rejected: int, judged: int
) -> None:
    words = headline(summary(rejecting(make_solution, rejected, judged), gate=0.9999))
    expected = "fixes were rejected: the start, the noise or the frames are probably wrong."
    assert words.startswith(f"{rejected} of {judged} {expected}")
    assert "error bars" not in words


@pytest.mark.parametrize(
    ("rejected", "judged", "gate"), [(30, 300, 0.9999), (9, 9, None), (60, 300, 0.9), (0, 300, 1.0)]
)
def test_as_many_rejected_as_expected_is_no_alarm(
    make_solution: MakeSolution, rejected: int, judged: int, gate: float | None
) -> None:
    words = headline(summary(rejecting(make_solution, rejected, judged), gate=gate))
    assert "probably wrong" not in words
    assert f"{rejected or 'none'} " in words


@pytest.mark.parametrize(("judged", "said"), [(29, False), (30, True)])
def test_few_fixes_give_no_verdict(make_solution: MakeSolution, judged: int, said: bool) -> None:
    words = headline(summary(rejecting(make_solution, 0, judged)))
    assert ("Too few fixes" in words) is not said
    assert ("NIS per dof" in words) is said


def test_spelled_times() -> None:
    spelled = [spell_time(s) for s in (0.5, 59.0, 60.0, 5400.0, 86400.0, 200000.0)]
    assert spelled == [
        "0.5 seconds",
        "59 seconds",
        "1 minute",
        "1.5 hours",
        "24 hours",
        "2.31 days",
    ]


def test_the_page_stands_alone_and_is_well_formed(solution: Solution, drift: WithheldDrift) -> None:
    result = summary(solution, withheld=drift.summary())
    text = page(solution, result, drift=drift, command="celestcore replay")
    parsed = Page(text)
    assert parsed.open == []
    assert parsed.loaded == []
    assert "default-src 'none'" in text
    assert text.count('class="plot"') == 1 + 3 + 3 + 2 + 3 + 1
    assert "Made-up satellite" in text
    assert "What was run" in text
    assert (
        '<th>Fixes that set the start</th><td><span data-key="counts.start">0</span></td>' in text
    )
    assert "hidden for 10 minutes" in text
    assert "within 3 sigma in 92.5 %" in text
    assert len(text) < 1_000_000


def test_the_page_names_only_frames_that_were_given(make_solution: MakeSolution) -> None:
    sol = make_solution(100)
    text = page(sol, summary(sol))
    assert "GCRS" not in text
    assert "turn the axes of the inertial frame into the body axes" in text
    assert "from the body frame to the inertial frame;" in text
    named = make_solution(100, frames={"inertial": "GCRS", "body": "bus"})
    text = page(named, summary(named))
    assert "turn the axes of GCRS into the body axes" in text
    assert "from the body frame (bus) to GCRS;" in text


def test_the_page_is_escaped(make_solution: MakeSolution) -> None:
    evil = "<script>alert('x')</script>"
    sol = make_solution(100, title=evil, sensor_names=[evil], frames={"inertial": evil})
    text = page(sol, summary(sol), settings={evil: evil}, command=evil)
    assert "<script>alert" not in text
    assert "&lt;script&gt;alert" in text
    assert Page(text).open == []


def test_every_number_is_the_summarys(solution: Solution, drift: WithheldDrift) -> None:
    result = summary(solution, withheld=drift.summary())
    text = page(solution, result, drift=drift)
    parsed = Page(text)
    assert json.loads(parsed.inside["summary"]) == json.loads(json.dumps(result))
    assert len(parsed.numbers) > 30
    parsed.check_numbers(result)


def test_a_day_at_10_hz_is_small_and_fast(make_solution: MakeSolution, tmp_path: Path) -> None:
    sol = make_solution(864_000, sensors=2)
    make_solution(100).report(tmp_path / "warm.html")
    start = time.perf_counter()
    sol.report(tmp_path / "day.html")
    took = time.perf_counter() - start
    size = (tmp_path / "day.html").stat().st_size
    print(f"a day at 10 Hz: {size / 1e6:.2f} MB in {took:.2f} s")
    assert size < 3_000_000, "10 MB is the limit, 2 MB is usual"
    assert took < 10.0, "1 s on an idle machine"


def test_what_was_not_kept_is_said(make_solution: MakeSolution) -> None:
    nan = np.full((50, 3), np.nan)
    sol = make_solution(100, innovations="nis", innovation=nan, innovation_sigma=nan)
    text = page(sol, summary(sol))
    assert text.count("Not kept: innovations=&#x27;nis&#x27;.") == 1
    none = {name: getattr(sol, name)[:0] for name in ("measurement_t", "sensor", "nis", "dof")}
    sol = make_solution(100, innovations="none", accepted=sol.accepted[:0], **none)
    result = summary(sol)
    assert [found["rule"] for found in result["findings"]][-1] == "not judged"
    assert page(sol, result).count("Not kept: innovations=&#x27;none&#x27;.") == 3


def test_an_empty_solution_is_refused(solution: Solution) -> None:
    empty = solution[1e9:]
    with pytest.raises(InputError, match="nothing to report"):
        page(empty, summary(empty))


def test_the_page_needs_numpy_only(tmp_path: Path) -> None:
    code = (
        "import sys\n"
        "for name in ('matplotlib', 'plotly', 'scipy', 'pandas'): sys.modules[name] = None\n"
        "import celestcore as cc\n"
        "log = cc.sample('fermi')\n"
        "cc.Settings.from_log(log).navigator().run(log).report('a.html')\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True, cwd=tmp_path)
    assert (tmp_path / "a.html").stat().st_size > 100_000


def test_a_report_is_html_or_png(solution: Solution, tmp_path: Path) -> None:
    result = summary(solution)
    write_report(tmp_path / "a.html", solution, result)
    write_report(tmp_path / "a.PNG", solution, result)
    assert (tmp_path / "a.html").read_text(encoding="utf-8").startswith("<!doctype html>")
    assert (tmp_path / "a.PNG").read_bytes().startswith(b"\x89PNG")
    assert len(list(tmp_path.iterdir())) == 2
    with pytest.raises(InputError, match=r"ends in \.html or \.png"):
        write_report(tmp_path / "a.pdf", solution, result)
