"""`celestcore bench`: what it prints and writes, whom it refuses, what peers compute."""

from __future__ import annotations

import importlib.util
import json
import shlex
import stat
import subprocess
import sys
import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import celestcore as cc
import numpy as np
import pytest
from celestcore import _core, bench, cli
from celestcore.bench import _outcome, _peers, _works
from celestcore.bench._markdown import spell, times
from celestcore.bench._session import Session, checked

WORKS = {work.name: work for work in _works.all_works()}
PAIRS = [(work.name, peer) for work in WORKS.values() for peer in work.peers]
Program = Callable[..., str]


@pytest.fixture
def program(tmp_path: Path) -> Program:
    """Return a function that makes a program which prints lines and ends with a code."""

    def make(*lines: Any, code: int = 0, says: str = "") -> str:
        text = "\n".join(one if isinstance(one, str) else json.dumps(one) for one in lines)
        path = tmp_path / "by hand"
        path.write_text(
            f"#!{sys.executable}\nimport sys\nprint({text!r})\n"
            f"print({says!r}, file=sys.stderr)\nsys.exit({code})\n"
        )
        path.chmod(path.stat().st_mode | stat.S_IXUSR)
        return shlex.join([str(path), "some data"])

    return make


def test_quick_run_of_some_works(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    target, page = tmp_path / "bench.json", tmp_path / "bench.md"
    call = ["bench", "--quick", "--only", "mekf,systematic", "--against", "numpy", "--json"]
    assert cli.main([*call, str(target), "--markdown", str(page)]) == 0
    shown = capsys.readouterr().out
    assert "mekf" in shown
    assert "systematic" in shown
    told = json.loads(target.read_text())
    assert {"machine", "clock", "options", "peers", "works"} <= set(told)
    assert {"date", "cpu", "level", "python", "numpy", "celestcore"} <= set(told["machine"])
    mekf, systematic = told["works"]
    assert (mekf["name"], mekf["unit"]) == ("mekf", "ns per sample")
    assert mekf["celestcore"] > 0.0
    assert mekf["target"] == {"most": 1.3, "of": "limit", "value": None, "met": None}
    peer = systematic["peers"]["numpy"]
    assert peer["ratio"] == pytest.approx(peer["ns"] / systematic["celestcore"])
    heading, table = page.read_text().split("\n", 1)
    assert told["machine"]["date"] in heading
    assert told["machine"]["cpu"] in heading
    assert "MEKF, star fix every 2nd sample" in table


def test_all_works_run_quickly() -> None:
    told = bench.measure(quick=True).to_dict()["works"]
    assert [one["name"] for one in told] == list(WORKS)
    for one in told:
        assert (one["celestcore"] is None) == (one["left_out"] is not None), one
    bases = {one["name"]: one["base"] for one in told if one["base"]}
    assert set(bases) == {"streaming", "whole_run", "campaign"}


def test_json_to_standard_output_is_nothing_else(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["bench", "--quick", "--only", "residual", "--json", "-"]) == 0
    caught = capsys.readouterr()
    assert json.loads(caught.out)["works"][0]["name"] == "residual"
    assert "residual" in caught.err


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--only", "mekf,nothing"], "--only, value 'nothing'"),
        (["--only", ","], "names no work"),
        (["--against", "numba,nobody"], "--against, value 'nobody'"),
        (["--against", "./nothing/there data"], "no program that can be run"),
        (["--against", ""], "names no peer"),
        (["--repeats", "0"], "repeats"),
        (["--json", "no/such/folder/x.json"], "--json"),
        (["--json", "x", "--markdown", "x"], "--markdown"),
        (["--instructions", "not_there.json"], "--instructions"),
    ],
)
def test_wrong_options(options: list[str], words: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["bench", "--quick", *options]) == 2
    told = capsys.readouterr().err
    assert words in told
    assert told.count("\n") == 1


def test_a_yardstick_is_mapped(program: Program) -> None:
    command = program(
        {"task": "a_prop", "peer": "no memory", "ns": 0.1},
        {"task": "a_prop", "peer": "whole history stored", "ns": 1e3, "note": "x"},
        {"task": "b_mekf", "peer": "dense", "ns": 900.0},
        "",
        {"task": "b_mekf", "peer": "blocks", "ns": 800.0},
        {"task": "something else", "peer": "", "ns": 1},
        {"task": "gravity21", "peer": "", "ns": 1e-3},
    )
    only = ["propagation", "mekf", "gravity21", "ukf"]
    report = bench.measure(only, [command], quick=True, repeats=2)
    told = {one["name"]: one for one in report.to_dict()["works"]}
    assert told["propagation"]["limit"]["ns"] == 1e3
    limit = told["mekf"]["limit"]
    assert (limit["ns"], limit["by"]) == (800.0, "blocks")
    assert limit["ratio"] == pytest.approx(told["mekf"]["celestcore"] / 800.0)
    target = told["mekf"]["target"]
    assert target["value"] == pytest.approx(limit["ratio"])
    assert target["met"] == (limit["ratio"] <= 1.3)
    assert told["ukf"]["limit"] is None
    assert told["gravity21"]["limit"]["ns"] == 1e-3  # by celestcore's own name, too
    assert "800 ns" in report.to_markdown()


@pytest.mark.parametrize(
    ("lines", "code", "words"),
    [
        (["not JSON"], 0, "line 1 of its output is not JSON: not JSON"),
        (["[1, 2]"], 0, "is no JSON object"),
        ([{"task": "b_mekf", "peer": "x", "ns": 1.0}, {"task": "b_ukf"}], 0, "line 2"),
        ([{"task": "b_mekf", "ns": -1.0}], 0, "no positive ns"),
        ([{"task": "b_mekf", "ns": True}], 0, "no positive ns"),
        (['{"task": "b_mekf", "ns": NaN}'], 0, "no positive ns"),
        ([{"peer": "x", "ns": 1.0}], 0, "names no task"),
        ([""], 0, "printed no line"),
        ([""], 3, "failed with code 3: out of luck"),
    ],
)
def test_a_broken_yardstick_is_told_in_one_sentence(
    program: Program,
    lines: list[Any],
    code: int,
    words: str,
    capsys: pytest.CaptureFixture[str],
) -> None:
    command = program(*lines, code=code, says="out of luck")
    assert cli.main(["bench", "--quick", "--only", "residual", "--against", command]) == 2
    told = capsys.readouterr().err
    assert words in told
    assert "by hand" in told
    assert told.count("\n") == 1


@pytest.mark.parametrize(("name", "peer"), PAIRS)
def test_a_peer_computes_the_same(name: str, peer: str) -> None:
    work = WORKS[name]
    for why in (_peers.PEERS[peer].missing(), work.missing() if work.missing else None):
        if why:
            pytest.skip(why)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        given = work.make(min(work.quick, work.peers[peer].size))
        call = _peers.loaded(work.peers[peer])(given)
        assert checked(work, given, call()) is None
        assert checked(work, given, call()) is None  # a second call starts afresh


@pytest.mark.parametrize("name", ["mekf_batch", "ukf_batch"])
@pytest.mark.parametrize("shared", [True, False])
def test_batches_are_measured_where_there_are_any(
    name: str, shared: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With solutions that tell the time of the whole batch, or their share of it."""
    told: list[float] = []

    def run_many(
        nav: Any, logs: list[Any], *, every: int, threads: int, innovations: str
    ) -> list[Any]:
        assert threads == 1
        found = [nav.run(log, every=every) for log in logs]
        told[:] = [sum(one.elapsed_s for one in found)]
        if shared:
            found = [replace(one, elapsed_s=told[0]) for one in found]
        return found

    monkeypatch.setattr(cc.StarGyroNavigator, "run_many", run_many, raising=False)
    work = WORKS[name]
    assert work.missing is not None
    assert work.missing() is None
    given = work.make(100)
    made = work.run(given)
    assert made.ns == pytest.approx(1e9 * told[0] / (len(given) * 100))
    assert made.outcome["q"].shape == (len(given), 4)
    peer = _peers.PEERS["jax"]
    if peer.missing() is None:
        assert checked(work, given, _peers.loaded(work.peers["jax"])(given)()) is None


def test_wrong_work_is_refused() -> None:
    work = replace(WORKS["systematic"], agree=lambda *_: "it is wrong")
    session = Session((work,), [_peers.PEERS["numpy"]], [], quick=True)
    session.run(2)
    assert session.rows[0].peers == {}
    assert session.rows[0].refused == {"numpy": "it is wrong"}


def test_what_is_wrong_is_told() -> None:
    near, there = {"q": [1.0, 0.0, 0.0, 0.0]}, {"q": [1.0, 1e-5, 0.0, 0.0]}
    assert _outcome.attitude(5.0)(None, near, there) is None
    assert "4.13 arcsec" in str(_outcome.attitude(4.0)(None, near, there))
    ours, theirs = {"r": np.zeros(3), "sigma": np.ones(6)}, {"r": [3.0, 0.0, 4.0]}
    assert _outcome.position(5.0)(None, ours, theirs) is None
    assert "5 m" in str(_outcome.position(4.9)(None, ours, theirs))
    assert "10 %" in str(_outcome.position(5.0)(None, ours, {**theirs, "sigma": np.full(6, 1.1)}))
    assert "nan" in str(_outcome.position(5.0)(None, ours, {"r": np.full(3, np.nan)}))
    weights = np.array([0.5, 0.5, 0.0, 0.0])
    assert _outcome.systematic(weights, {}, {"chosen": [0, 0, 1, 1]}) is None
    assert _outcome.systematic(weights, {}, {"chosen": [0, 0, 0, 0]}) is not None
    assert _outcome.residual(weights, {}, {"chosen": [0, 0, 0, 0]}) is not None
    assert _outcome.multinomial(weights, {}, {"chosen": [0, 1]}) is not None


def test_a_missing_peer_is_left_out_with_a_word(monkeypatch: pytest.MonkeyPatch) -> None:
    gone = replace(_peers.PEERS["numba"], module="not_a_module")
    monkeypatch.setitem(_peers.PEERS, "numba", gone)
    report = bench.measure(["systematic"], ["numba,numpy"], quick=True)
    assert list(report.peers) == ["numpy"]
    assert "pip install 'celestcore[bench]'" in report.skipped["numba"]
    assert list(report.rows[0].peers) == ["numpy"]


def test_a_debug_build_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(_core, "release_build", False)
    with pytest.raises(cc.CelestcoreError, match="debug build"):
        bench.measure(["systematic"], quick=True)


def test_instructions_are_recorded(tmp_path: Path) -> None:
    path = tmp_path / "instructions.json"
    path.write_text(json.dumps({"kernels": {"systematic": {"instructions": 1234.5}}}))
    report = bench.measure(["systematic", "residual"], quick=True, instructions=path)
    assert [one["instructions"] for one in report.to_dict()["works"]] == [1234.5, None]
    assert "1,234" in report.to_markdown()
    for text in ("{", "[]", '{"kernels": {"ekf": {}}}', '{"kernels": {"ekf": 1}}'):
        path.write_text(text)
        with pytest.raises(cc.InputError, match="make instructions"):
            bench.measure(["systematic"], quick=True, instructions=path)


def test_kernels_of_works_are_those_that_are_counted(root: Path) -> None:
    source = (root / "rust/core/benches/work.rs").read_text()
    for work in WORKS.values():
        if work.kernel is not None and not work.kernel.endswith("_batch"):
            assert f'("{work.kernel}",' in source


def test_counting_says_what_is_missing(root: Path, tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, root / "tools/instructions.py"],
        env={"PATH": str(tmp_path)},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 1
    assert "valgrind is missing" in done.stderr
    assert done.stderr.count("\n") == 1


def test_a_section_goes_on_top_of_the_page_once(root: Path) -> None:
    spec = importlib.util.spec_from_file_location("record", root / "tools/record_bench.py")
    assert spec is not None
    assert spec.loader is not None
    record = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(record)
    page = record.PAGE.read_text(encoding="utf-8")
    first = record.recorded(page, "## 1999-01-01, a machine\n\n| a |\n")
    second = record.recorded(first, "## 1999-01-02, a machine\n\n| b |\n")
    again = record.recorded(second, "## 1999-01-01, a machine\n\n| c |\n")
    assert again.index("| c |") < again.index("| b |")
    assert "| a |" not in again
    assert [again.count(f"| {letter} |") for letter in "bc"] == [1, 1]
    assert again.endswith(page[-2000:])
    with pytest.raises(SystemExit):
        record.recorded(page, "no section")


def test_help_shows_an_example(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["bench", "--help"]) == 0
    assert "Example: celestcore bench --against filterpy,numba" in capsys.readouterr().out


def test_words_for_times() -> None:
    assert [spell(ns) for ns in (0.5, 9.996, 999.6, 1e3, 1.5e9)] == [
        "0.500 ns", "10.0 ns", "1000 ns", "1.00 µs", "1.50 s",
    ]  # fmt: skip
    assert times(0.0) == "0"
