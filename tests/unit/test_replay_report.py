"""The report of a replay in parts: its sums are those of the whole, its words say what happened."""

from __future__ import annotations

import dataclasses
import json
import re
import shutil
import warnings
from itertools import pairwise
from pathlib import Path
from typing import Any

import celestcore as cc
import numpy as np
import pytest
from celestcore import _findings, replay, simulate
from celestcore._fixes import Fixes, configured_noise, of_attitude
from celestcore._health import BURST, bursts
from celestcore.analysis import whiteness
from celestcore.replay import _thin
from celestcore.replay._digest import digest, window_edges
from celestcore.replay._report import STATES
from celestcore.replay._runs import Bursts, Lags, Silences
from celestcore.simulate import faults
from celestcore.summary import per_sensor
from pages import Page

pytest.importorskip("pyarrow")
SIGMA = 20 * cc.ARCSEC


@pytest.fixture(scope="module")
def log() -> cc.SensorLog:
    truth = simulate.constant_rate([0.0, -1e-3, 0.0], 1800.0, dt=0.25)
    camera = simulate.StarErrors(SIGMA, every=4)
    scenario = simulate.Scenario(
        truth, simulate.GyroErrors(1e-5, 1e-8), {"star_1": camera, "star_2": camera}
    )
    made = scenario.simulate(seed=3).log
    made = faults.outliers(made, "star_1", 0.05, 0.02, seed=1)
    made = faults.jump(made, "star_2", 800.0, 850.0, [0.02, 0.0, 0.0])
    made = faults.dropout(made, "star_1", 1000.0, 1100.0)
    made = faults.dropout(made, "gyro", 1300.0, 1310.0)
    parts = {n: made.stars[n] for n in made.stars}
    return cc.SensorLog(
        epoch="2026-01-01T00:00:00",
        gyro=(made.gyro.t, made.gyro.rate),
        **{n: (s.t, s.q) for n, s in parts.items()},
    )


@pytest.fixture(scope="module")
def nav() -> cc.StarGyroNavigator:
    camera = cc.StarCamera(SIGMA)
    cameras = {"star_1": camera, "star_2": camera}
    return cc.StarGyroNavigator(cc.EKF(), cc.Gyro(1e-5, 1e-8), cameras, gate=0.9999)


@pytest.fixture(scope="module")
def out(log: cc.SensorLog, nav: cc.StarGyroNavigator, tmp_path_factory: Any) -> Path:
    folder: Path = tmp_path_factory.mktemp("replay") / "out"
    replay.run(log, nav, folder, window=97.0)
    return folder


def test_sums_over_parts_are_those_of_the_whole(
    log: cc.SensorLog, nav: cc.StarGyroNavigator, out: Path
) -> None:
    found = digest(out)
    sol = nav.run(log)
    whole = {f.name: f for f in of_attitude(sol, configured_noise(nav, log))}
    scores = {s["name"]: s for s in per_sensor(sol)}
    assert [t.name for t in found.tallies] == sorted(whole)
    np.testing.assert_allclose(found.gaps, sol.gaps)
    for tally in found.tallies:
        mine = tally.judged(STATES)
        first, last = float(sol.t[0]), float(sol.t[-1])
        wanted = {**scores[tally.name], **_findings.judge(whole[tally.name], first, last)}
        assert wanted["rejected"] > 40
        for name in ("name", "dof", "fixes", "accepted", "rejected", "bursts"):
            assert mine[name] == wanted[name], name
        for name in ("rms_arcsec", "rms_total_arcsec", "nis_mean", "nis_per_dof", "inside_95"):
            np.testing.assert_allclose(mine[name], wanted[name], rtol=1e-6, err_msg=name)
        assert mine["white"]["white"] == wanted["white"]["white"]
        np.testing.assert_allclose(mine["white"]["p"], wanted["white"]["p"], atol=1e-6)
        assert mine["silence"]["begin"] == wanted["silence"]["begin"]
        assert mine["silence"]["usual"] == pytest.approx(wanted["silence"]["usual"])
        for name in ("rms", "predicted", "ratio", "configured", "seen", "mean", "mean_errors"):
            np.testing.assert_allclose(
                mine["noise"][name], wanted["noise"][name], rtol=1e-5, atol=1e-9, err_msg=name
            )


def test_what_happened_is_told_with_its_time(out: Path, tmp_path: Path) -> None:
    told = replay.report(out, tmp_path / "a.html", title="A <log>")
    # single outliers are told of, too, where there were many by chance
    events = {(e["kind"], e["sensor"]): e for e in told["events"] if e["kind"] != "scattered"}
    assert set(events) == {("refused", "star_2"), ("silence", "star_1"), ("gap", None)}
    refused, silence, gap = (events[k] for k in sorted(events, key=lambda k: events[k]["begin"]))
    assert (refused["begin"], refused["end"]) == (800.0, 849.0)
    assert "100 % of 50 measurements" in refused["words"]
    assert (silence["begin"], silence["end"]) == (999.0, 1100.0)
    assert (gap["begin"], gap["end"]) == (1299.75, 1310.0)
    page = Page((tmp_path / "a.html").read_text(encoding="utf-8"))
    text = " ".join(page.words)
    for event in told["events"]:
        assert event["words"] in text
    assert "2026-01-01 00:13:20" in text, "800 s after the epoch"
    assert "A <log>" in text
    assert page.loaded == []


def test_its_numbers_are_those_of_the_summary(out: Path, tmp_path: Path) -> None:
    told = replay.report(out, tmp_path / "a.html")
    page = Page((tmp_path / "a.html").read_text(encoding="utf-8"))
    inside = json.loads(page.inside["summary"])
    assert inside == json.loads(json.dumps(told))
    assert inside["replay"] == json.loads((out / "summary.json").read_text())
    for name in ("rows", "parts", "samples", "fixes", "rejected"):
        assert inside["counts"][name] == inside["replay"][name], name
    assert inside["counts"]["restarts"] == len(inside["replay"]["restarts"])
    assert len(page.numbers) > 30
    page.check_numbers(inside)


@pytest.fixture(scope="module")
def lost(log: cc.SensorLog, nav: cc.StarGyroNavigator, tmp_path_factory: Any) -> Path:
    """A replay that started again: the gyro's bias steps."""
    folder: Path = tmp_path_factory.mktemp("lost") / "out"
    broken = faults.bias_step(log, 500.0, 1e9, [0.0, 2e-3, 0.0])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", cc.CelestcoreWarning)
        summary = replay.run(broken, nav, folder, window=200.0)
    assert len(summary.restarts) >= 1
    return folder


def test_starts_anew_are_told_and_marked(lost: Path, tmp_path: Path) -> None:
    told = replay.report(lost, tmp_path / "a.html")
    (first, *_) = (e for e in told["events"] if e["kind"] == "restart")
    assert 500.0 <= first["begin"] < 505.0
    words = re.search(r"the gyro's bias had gone about y from (.*?) to (.*?) deg/h", first["words"])
    assert words is not None
    old, new = (float(value) for value in words.groups())
    assert (new - old) * cc.DEG_PER_HOUR == pytest.approx(2e-3, rel=0.02)
    assert told["findings"][0]["rule"] == "started again"
    text = (tmp_path / "a.html").read_text(encoding="utf-8")
    page = Page(text)
    marks = json.loads(page.inside["panels"])["marks"]
    assert marks == pytest.approx([t / 60.0 for t in told["replay"]["restarts"]])
    assert "starts anew" in page.words
    assert 'class="r"' in text
    assert any("lost its way and started again" in words for words in page.words)


def test_a_replay_that_has_not_ended_is_told_of(out: Path, lost: Path, tmp_path: Path) -> None:
    half = tmp_path / "half"
    shutil.copytree(out, half)
    (half / "summary.json").unlink()
    # stopped between two tables of a part
    (half / "health" / "part-000012.parquet").unlink()
    for number in range(13, 19):
        for part in half.glob(f"*/part-{number:06d}.parquet"):
            part.unlink()
    told = replay.report(half, tmp_path / "a.html")
    assert told["counts"]["parts"] == 12
    assert told["replay"] is None
    assert "not ended" in {f["rule"] for f in told["findings"]}
    page = Page((tmp_path / "a.html").read_text(encoding="utf-8"))
    page.check_numbers(told)
    assert any(words.startswith("Not ended yet: 12 parts") for words in page.words)


@pytest.mark.parametrize("kept", ["nis", "none"])
def test_less_may_be_kept(
    kept: str, log: cc.SensorLog, nav: cc.StarGyroNavigator, tmp_path: Path
) -> None:
    replay.run(log, nav, tmp_path / "out", window=300.0, every=20, innovations=kept)
    told = replay.report(tmp_path / "out", tmp_path / "a.html")
    assert len(told["sensors"]) == (2 if kept == "nis" else 0)
    assert told["innovation"]["rms_total_arcsec"] is None
    Page((tmp_path / "a.html").read_text(encoding="utf-8")).check_numbers(told)


def test_output_of_before_there_were_events_is_reported(out: Path, tmp_path: Path) -> None:
    shutil.copytree(out, tmp_path / "old")
    shutil.rmtree(tmp_path / "old" / "events")
    told = replay.report(tmp_path / "old", tmp_path / "a.html")
    assert {e["kind"] for e in told["events"]} - {"scattered"} == {"refused", "silence"}


def test_wrong_places_are_named(out: Path, tmp_path: Path) -> None:
    with pytest.raises(cc.InputError, match=r"folder, value .*holds no replay in parts: give"):
        replay.report(tmp_path, tmp_path / "a.html")
    with pytest.raises(cc.InputError, match=r"path, value .*let its name end in \.html"):
        replay.report(out, tmp_path / "a.png")
    with pytest.raises(cc.InputError, match="does not exist: create it first"):
        replay.report(out, tmp_path / "no" / "a.html")


def pieces(n: int, seed: int) -> list[slice]:
    cuts = np.sort(np.random.default_rng(seed).integers(0, n, 12))
    edges = [0, *cuts.tolist(), n]
    return [slice(a, b) for a, b in pairwise(edges)]


@pytest.mark.parametrize("seed", range(6))
def test_runs_and_lags_do_not_see_where_parts_end(seed: int) -> None:
    rng = np.random.default_rng(seed)
    n = 400
    t = np.cumsum(rng.random(n))
    accepted = np.repeat(rng.random(n // 4) > 0.5, 4)
    z = rng.standard_normal((n, 3)) + 0.5
    found, lags, silences = Bursts(), Lags(20, 3), Silences()
    for piece in pieces(n, seed):
        found.add(t[piece], accepted[piece])
        lags.add(z[piece])
        silences.add(t[piece])
    fixes = Fixes("a", "", ("x",), t, np.ones(n), 1, accepted, None, None)
    mine = [{"begin": b.begin, "end": b.end, "fixes": b.fixes} for b in found.found()]
    assert mine == bursts(fixes)
    assert found.count + found.ends_open == len(mine)
    whole = whiteness(z - z.mean(axis=0), lags=20)
    tested = lags.tested()
    assert tested is not None
    np.testing.assert_allclose(tested.autocorrelation, whole.autocorrelation, atol=1e-12)
    np.testing.assert_allclose(tested.p_value, whole.p_value, rtol=1e-8)
    longest = silences.longest(1.0)
    assert longest is not None
    assert longest["end"] - longest["begin"] == np.diff(t).max()


def test_bursts_with_little_between_are_one_stretch() -> None:
    accepted = np.ones(100, dtype=bool)
    accepted[10:30] = accepted[33:50] = accepted[80:90] = False
    found = Bursts()
    found.add(np.arange(100.0), accepted)
    first, second = found.stretches(1.0)
    assert (first.begin, first.end, first.fixes, first.rejected) == (10.0, 49.0, 40, 37)
    assert (second.begin, second.fixes, second.rejected) == (80.0, 10, 10)
    assert BURST <= 10


def test_spikes_survive_and_memory_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(_thin, "ROOM", 2000)
    kept = _thin.Thinned(lambda c: [c["y"]], 10, even=5)
    rng = np.random.default_rng(1)
    most = 0
    for part in range(300):
        y = rng.standard_normal(1000)
        y[rng.integers(1000)] = 50.0 + part
        kept.add({"t": 1000.0 * part + np.arange(1000.0), "y": y})
        most = max(most, len(kept.columns()["t"]))
    columns = kept.columns()
    assert most <= 2100
    assert columns["y"].max() == 349.0
    assert np.all(np.diff(columns["t"]) > 0.0)
    # of every stretch of ten parts there still is a spike
    spiky = np.unique((columns["t"][columns["y"] > 40.0] // 10_000).astype(int))
    assert len(spiky) == 30


def test_windows_are_parts_or_shares_of_parts() -> None:
    edge = np.arange(169.0)
    np.testing.assert_array_equal(window_edges(edge, 1e6), edge)
    many = window_edges(np.arange(8761.0), 1e6)
    assert len(many) <= 481
    assert many[-1] == 8760.0
    few = window_edges(np.array([0.0, 10.0, 20.0]), 1e6)
    assert len(few) == 61
    assert 10.0 in few
    assert len(window_edges(np.array([0.0, 10.0]), 30.0)) == 2


def test_a_shortened_summary_is_the_replays(out: Path) -> None:
    found = digest(out)
    assert found.summary is not None
    names = {f.name for f in dataclasses.fields(replay.Summary)}
    assert names <= set(found.summary)


def test_noise_found_by_an_adaptive_filter_is_kept_and_told(tmp_path: Path) -> None:
    """Noise as seen is the true one, though the filter was told a fifth of it."""
    cameras = {name: cc.StarCamera(SIGMA / 5) for name in ("star_1", "star_2")}
    nav = cc.StarGyroNavigator(cc.EKF(), cc.Gyro(1e-5, 1e-8), cameras, adaptive=50.0)
    clean = simulate.Scenario(
        simulate.constant_rate([0.0, -1e-3, 0.0], 1800.0, dt=0.25),
        simulate.GyroErrors(1e-5, 1e-8),
        dict.fromkeys(cameras, simulate.StarErrors(SIGMA, every=4)),
    ).simulate(seed=4)
    replay.run(clean.log, nav, tmp_path / "out", window=300.0)
    health = replay.read(tmp_path / "out")["health"]
    assert np.isfinite(health["noise_scale"]).all()
    result = replay.report(tmp_path / "out", tmp_path / "page.html")
    text = (tmp_path / "page.html").read_text(encoding="utf-8")
    for sensor in result["sensors"]:
        np.testing.assert_allclose(sensor["noise"]["configured"], SIGMA / cc.ARCSEC / 5)
        np.testing.assert_allclose(sensor["noise"]["seen"], SIGMA / cc.ARCSEC, rtol=0.15)
        mine = health["noise_scale"][health["sensor"] == sensor["name"]]
        assert sensor["noise_scale"] == mine[-1]
        times = np.sqrt(mine[-1])
        assert times == pytest.approx(5.0, rel=0.15)
        assert f"{sensor['name']}: noise found while running: {times:.3g} times as told" in text


def test_parts_of_a_filter_that_does_not_adapt_have_no_noise_found(out: Path) -> None:
    assert np.isnan(replay.read(out)["health"]["noise_scale"]).all()
    assert all(tally.judged(STATES)["noise_scale"] is None for tally in digest(out).tallies)


def test_parts_of_before_the_noise_found_was_kept_are_read(out: Path, tmp_path: Path) -> None:
    import pyarrow.parquet as parquet

    shutil.copytree(out, tmp_path / "old")
    for path in (tmp_path / "old" / "health").glob("part-*.parquet"):
        parquet.write_table(parquet.read_table(path).drop_columns(["noise_scale"]), path)
    now, old = digest(out), digest(tmp_path / "old")
    for a, b in zip(now.tallies, old.tallies, strict=True):
        assert a.judged(STATES) == b.judged(STATES)
