"""``celestcore campaign``: what it prints and writes, and Ctrl-C on the real program."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest
from celestcore import campaign, cli

pytest.importorskip("typer")
pytest.importorskip("pyarrow.parquet")

CONFIG = """
[campaign]
trials = {trials}
[scenario]
duration_s = {duration}
[gyro]
arw = 1e-6
[star]
sigma_arcsec = 5.0
[grid]
"filter.kind" = ["ekf", "ukf"]
"""


@pytest.fixture
def config(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "trade.toml"
    path.write_text(CONFIG.format(trials=3, duration=20))
    return path


def run(capsys: pytest.CaptureFixture[str], *arguments: object) -> tuple[int, str, str]:
    code = cli.main(["campaign", *(str(a) for a in arguments)])
    out, err = capsys.readouterr()
    return code, out, err


def test_rows_beside_the_configuration(config: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code, out, err = run(capsys, "trade.toml", "--threads", 2)
    assert (code, err) == (0, "")
    assert out.startswith("6 runs, 6 of them now, in ")
    assert "filter.kind" in out
    assert "NEES / 6" in out
    assert "rows: trade.runs" in out
    assert campaign.read("trade.runs").num_rows == 6
    code, out, _ = run(capsys, "trade.toml")
    assert code == 0
    assert out.startswith("6 runs, all of them finished before; 0 failed.")


def test_json(config: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code, out, err = run(capsys, "trade.toml", "--json", "-")
    content = json.loads(out)
    assert code == 0
    assert "6 runs" in err
    assert content["out"] == "trade.runs"
    assert [cell["filter.kind"] for cell in content["cells"]] == ["ekf", "ukf"]
    code, out, _ = run(capsys, "trade.toml", "--out", "trade.runs", "--json", "t.json")
    assert "summary: t.json" in out
    again = json.loads(Path("t.json").read_text())
    assert (again["ran"], again["kept"], again["failed"]) == (0, 6, 0)
    assert again["cells"] == content["cells"]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["nowhere.toml"], "nowhere.toml: cannot be read"),
        (["trade.toml", "--json", "no/t.json"], "cannot write no/t.json"),
        (["trade.toml", "--json", "trade.toml"], "would write into the input"),
        (["trade.toml", "--out", ".", "--json", "t.json"], "into the results"),
        (["trade.toml", "--out", "trade.toml"], "cannot be made"),
        (["trade.toml", "--threads", "0"], "threads"),
        (["trade.toml", "--threads", "2", "--dask", "tcp://h:1"], "--threads: goes without"),
        (["trade.toml", "--resume"], "No such option"),
        (["bad.toml"], "bad.toml: star.sgima: unknown key; known are sigma, sigma_arcsec"),
    ],
)
def test_errors_are_one_line(
    config: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], words: str
) -> None:
    Path("bad.toml").write_text(CONFIG.format(trials=1, duration=9) + '"star.sgima" = [1]\n')
    code, out, err = run(capsys, *arguments)
    assert (code, out) == (2, "")
    assert err.startswith("error: ")
    assert err.count("\n") == 1
    assert words in err


PROGRAM = """
import sys
from celestcore import cli
from celestcore.campaign import _run
_run.SOONEST = 0.1  # parts as it goes
sys.exit(cli.main(sys.argv[1:]))
"""


def begun() -> subprocess.Popen[str]:
    """Start the program, and wait for its first part."""
    command = [sys.executable, "-c", PROGRAM, "campaign", "trade.toml"]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    until = time.monotonic() + 30.0
    while not list(Path("trade.runs").glob("part-*")) and time.monotonic() < until:
        time.sleep(0.005)
    return process


@pytest.mark.skipif(os.name == "nt", reason="there is no SIGINT to send there")
def test_ctrl_c_leaves_complete_rows(config: Path) -> None:
    config.write_text(CONFIG.format(trials=100_000, duration=60))
    with begun() as process:
        process.send_signal(signal.SIGINT)
        sent = time.monotonic()
        given_up = threading.Timer(60.0, process.kill)
        given_up.start()
        assert process.stderr is not None
        err = process.stderr.read()
        code = process.wait()
        took = time.monotonic() - sent
        given_up.cancel()
    assert code == 130
    assert err == (
        "error: interrupted: what is finished is in trade.runs; the same command goes on\n"
    )
    assert took < 3.0
    rows = campaign.read("trade.runs")
    assert 0 < rows.num_rows < 200_000
    assert len(set(rows["key"].to_pylist())) == rows.num_rows
    assert rows["nees"].null_count == 0


@pytest.mark.skipif(os.name == "nt", reason="there is no SIGKILL there")
def test_goes_on_after_kill_9(config: Path) -> None:
    config.write_text(CONFIG.format(trials=2000, duration=60))
    with begun() as process:
        process.kill()
    left = campaign.read("trade.runs").num_rows
    assert 0 < left < 4000
    rest = campaign.run(config, "trade.runs")
    assert (rest.kept, rest.ran) == (left, 4000 - left)
    rows = (r.table().drop_columns(["seconds"]) for r in (rest, campaign.run(config, "whole")))
    assert next(rows).equals(next(rows))
