"""The command line, called as a program would be, and once as a real program."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from celestcore import cli
from celestcore.io import write_log
from celestcore.log import SensorLog
from celestcore.units import ARCSEC, DEG_PER_HOUR

pytest.importorskip("typer")
parquet = pytest.importorskip("pyarrow.parquet")

BIAS = DEG_PER_HOUR * np.array([0.5, -1.0, 2.0])


@pytest.fixture
def log(tmp_path: Path) -> Path:
    """Write a log of a slow turn about z: 601 gyro samples at 1 Hz, a noisy fix every 2 s."""
    rng = np.random.default_rng(5)
    t = np.arange(601.0)
    rate = np.array([0.0, 0.0, 1e-3]) + BIAS + 1e-7 * rng.standard_normal((601, 3))
    fix_t = t[::2]
    half = 0.5 * (1e-3 * fix_t + 5 * ARCSEC * rng.standard_normal(len(fix_t)))
    zero = 2.5 * ARCSEC * rng.standard_normal((2, len(fix_t)))
    q = np.column_stack([np.cos(half), *zero, np.sin(half)])
    q /= np.linalg.norm(q, axis=1)[:, None]
    settings = {
        "gyro": {"arw": 1e-7, "rrw": 1e-10},
        "star": {"sigma_arcsec": 5.0},
        "start": {"sigma_attitude_arcsec": 60.0, "sigma_bias": 1e-5},
    }
    path = tmp_path / "turn.npz"
    made = SensorLog(
        epoch="2026-01-01T00:00:00",
        gyro=(t, rate),
        star=(fix_t, q),
        title="A slow turn",
        settings=settings,
    )
    write_log(made, path)
    return path


def run(capsys: pytest.CaptureFixture[str], *arguments: object) -> tuple[int, str, str]:
    """Return exit code, standard output and standard error of one command."""
    code = cli.main([str(a) for a in arguments])
    out, err = capsys.readouterr()
    return code, out, err


def fails(capsys: pytest.CaptureFixture[str], *arguments: object) -> str:
    """Check that a command fails as it should; return its one line."""
    code, out, err = run(capsys, *arguments)
    assert (code, out) == (2, "")
    assert err.startswith("error: ")
    assert err.count("\n") == 1
    assert "Traceback" not in err
    return err


def files(path: Path) -> set[str]:
    return {p.name for p in path.iterdir()}


def test_version(capsys: pytest.CaptureFixture[str]) -> None:
    code, out, _ = run(capsys, "--version")
    assert code == 0
    assert out.startswith("celestcore ")


def test_help_shows_an_example(capsys: pytest.CaptureFixture[str]) -> None:
    assert "celestcore replay --sample fermi" in run(capsys, "replay", "--help")[1]
    assert "celestcore info --sample fermi" in run(capsys, "info", "--help")[1]
    assert run(capsys, "--help")[0] == 0


@pytest.mark.parametrize("kind", ["ekf", "ukf", "srukf"])
def test_replay_writes_what_was_asked(
    kind: str, log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = {name: tmp_path / name for name in ("a.parquet", "a.html", "a.json")}
    out["a.parquet"].write_text("old")
    code, text, err = run(
        capsys,
        "replay",
        log,
        "--filter",
        kind,
        "-o",
        out["a.parquet"],
        "--report",
        out["a.html"],
        "--json",
        out["a.json"],
    )
    assert (code, err) == (0, "")
    assert "601 gyro samples" in text
    assert str(out["a.html"]) in text.replace("\n", "")
    assert files(tmp_path) == {"turn.npz", "turn.toml", *out}
    table = parquet.read_table(out["a.parquet"]).to_pydict()
    bias = np.array([table[name][-1] for name in ("bx", "by", "bz")])
    sigma = np.array([table[name][-1] for name in ("s_bx", "s_by", "s_bz")])
    assert np.all(np.abs(bias - BIAS) < 5 * sigma)
    assert np.all(sigma < 0.1 * np.abs(BIAS).max())
    result: dict[str, Any] = json.loads(out["a.json"].read_text())
    assert result["filter"] == kind
    assert result["counts"]["samples"] == 601
    counts = result["counts"]
    assert (counts["rejected"], counts["start"], counts["outside"]) == (0, 1, 0)
    assert counts["fixes"] == counts["accepted"] + counts["start"]
    assert "A slow turn" in out["a.html"].read_text(encoding="utf-8")


def test_counts_add_up_and_an_untitled_log_goes_by_its_path(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    t, q = np.arange(100.0), np.tile([1.0, 0.0, 0.0, 0.0], (100, 1))
    q[50] = [0.8, 0.6, 0.0, 0.0]
    path = tmp_path / "untitled.npz"
    settings = {"gyro": {"arw": 1e-6}, "star": {"sigma_arcsec": 5.0}, "gate": {"probability": 0.99}}
    write_log(SensorLog(gyro=(t, 0.0 * q[:, 1:]), star=(t + 2.0, q), settings=settings), path)
    _, out, err = run(capsys, "replay", path, "--json", "-")
    result = json.loads(out)
    assert (result["log"], result["gate"]) == (str(path), 0.99)
    counts = result["counts"]
    assert (counts["start"], counts["rejected"], counts["outside"]) == (1, 1, 2)
    parts = ("accepted", "rejected", "start", "outside")
    assert counts["fixes"] == sum(counts[name] for name in parts) == 100
    assert "fixes rejected / that set the start" in err
    assert "1 / 1" in err


def test_json_to_standard_output_is_json_alone(
    log: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code, out, err = run(capsys, "replay", log, "--json", "-")
    assert code == 0
    assert json.loads(out)["log"] == "A slow turn"
    assert "gyro samples" in err


def test_config_and_options_win_over_the_log(
    log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    config = tmp_path / "my.toml"
    config.write_text('[filter]\nkind = "ukf"\nalpha = 1.0\n[star]\nsigma_arcsec = 50.0\n')
    cautious = json.loads(run(capsys, "replay", log, "--config", config, "--json", "-")[1])
    assert cautious["filter"] == "ukf"
    assert cautious["innovation"]["nis_per_dof"] < 0.2
    both = run(capsys, "replay", log, "--config", config, "--filter", "ekf", "--json", "-")
    assert json.loads(both[1])["filter"] == "ekf"


def test_period_thins_the_output(
    log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(capsys, "replay", log, "--period", 10, "-o", tmp_path / "a.parquet")[0] == 0
    assert 60 <= parquet.read_table(tmp_path / "a.parquet").num_rows <= 62


def test_a_missing_directory_is_refused_before_anything_is_read(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    err = fails(capsys, "replay", "no-such-log", "-o", tmp_path / "no" / "a.parquet")
    assert "does not exist" in err
    assert "--output" in err


def test_outputs_may_not_overwrite_each_other_or_the_log(
    log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    same = tmp_path / "a.html"
    assert "same file" in fails(capsys, "replay", log, "--report", same, "--json", same)
    assert "input" in fails(capsys, "replay", log, "--json", log)
    assert "input" in fails(capsys, "info", log, "--json", log)
    folder = tmp_path / "log"
    folder.mkdir()
    assert "input" in fails(capsys, "replay", folder, "-o", folder / "gyro.parquet")
    assert files(tmp_path) == {"turn.npz", "turn.toml", "log"}


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["replay"], "give either a LOG or --sample"),
        (["replay", "a.npz", "--sample", "fermi"], "give either"),
        (["replay", "--sample", "voyager"], "fermi"),
        (["info", "--sample", "voyager"], "noaa20"),
        (["replay", "not-there.npz"], "not-there.npz"),
        (["replay", "--sample", "fermi", "--filter", "kalman"], "ekf, ukf, srukf"),
        (["replay", "--sample", "fermi", "--gate", "7"], "between 0 and 1"),
        (["replay", "--sample", "fermi", "--period", "-1"], "period"),
        (["replay", "--sample", "fermi", "--gate", "much"], "--gate"),
        (["replay", "--sample", "fermi", "-o", "a.csv"], ".parquet"),
        (["replay", "--sample", "fermi", "--report", "a.pdf"], ".html or .png"),
        (["replay", "--sample", "fermi", "--config", "no.toml"], "no.toml"),
        (["replay", "--nonsense"], "--nonsense"),
        (["nonsense"], "nonsense"),
    ],
)
def test_mistakes_get_one_line(
    arguments: list[str],
    words: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    assert words in fails(capsys, *arguments)
    assert files(tmp_path) == set()


def test_a_failure_while_writing_leaves_nothing(
    log: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    def broken(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("celestcore.report.write_report", broken)
    err = fails(
        capsys, "replay", log, "-o", tmp_path / "a.parquet", "--report", tmp_path / "a.html"
    )
    assert "No space left" in err
    assert files(tmp_path) == {"turn.npz", "turn.toml"}


def test_ctrl_c_says_so(
    log: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupted(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(cli.Replay, "run", interrupted)
    assert run(capsys, "replay", log) == (130, "", "error: interrupted: nothing was written\n")


def test_too_little_memory_is_one_line(
    log: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def too_large(*_: object, **__: object) -> None:
        np.empty(2**58)

    monkeypatch.setattr(cli.Replay, "run", too_large)
    assert "not enough memory" in fails(capsys, "replay", log)


@pytest.mark.parametrize(
    ("package", "arguments"),
    [
        ("typer", ["--version"]),
        ("pyarrow", ["replay", "--sample", "fermi", "-o", "a.parquet"]),
        ("matplotlib", ["replay", "--sample", "fermi", "--report", "a.png"]),
    ],
)
def test_a_missing_package_is_one_clear_sentence(
    package: str,
    arguments: list[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    for name in [n for n in sys.modules if n.partition(".")[0] == package]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, package, None)
    assert f"needs {package}" in fails(capsys, *arguments)


def test_info_tells_what_a_log_holds(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code, out, _ = run(capsys, "info", log)
    assert code == 0
    assert "A slow turn" in out
    assert "10 minutes" in out
    content = json.loads(run(capsys, "info", log, "--json", "-")[1])
    assert content["tables"]["gyro"]["rows"] == 601
    assert content["tables"]["star"]["step_median_s"] == 2.0
    assert content["tables"]["star"]["gaps"] == 0


def test_info_counts_gaps(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    t = np.delete(np.arange(50.0), [10, 20, 21, 22])  # a step of 2 s is none, one of 4 s is
    write_log(SensorLog(gyro=(t, np.zeros((46, 3)))), tmp_path / "a.npz")
    code, out, _ = run(capsys, "info", tmp_path / "a.npz")
    heading, row = out.splitlines()[-2:]
    assert code == 0
    assert (heading.split()[-1], row.split()[-1]) == ("gaps", "1")
    assert "[s]" in heading
    content = json.loads(run(capsys, "info", tmp_path / "a.npz", "--json", "-")[1])
    assert content["tables"]["gyro"]["gaps"] == 1


def test_info_of_the_samples(capsys: pytest.CaptureFixture[str]) -> None:
    for name in ("fermi", "noaa20"):
        content = json.loads(run(capsys, "info", "--sample", name, "--json", "-")[1])
        assert content["epoch"]
        assert "star" in content["tables"]


def test_the_program_replays_the_shipped_log(tmp_path: Path) -> None:
    command = [
        sys.executable,
        "-c",
        "import sys; from celestcore.cli import main; sys.exit(main())",
    ]
    done = subprocess.run(
        [*command, "replay", "--sample", "fermi", "-o", "f.parquet", "--report", "f.html"],
        cwd=tmp_path,
        env={**os.environ, "COLUMNS": "100"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert "gyro samples" in done.stdout
    assert files(tmp_path) == {"f.parquet", "f.html"}


def test_importing_the_entry_point_needs_numpy_only() -> None:
    heavy = "typer rich click matplotlib pyarrow pandas scipy astropy"
    code = f"import sys, celestcore.cli; print([m for m in '{heavy}'.split() if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_smoothing_knows_the_fixes_to_come(
    capsys: pytest.CaptureFixture[str], log: Path, tmp_path: Path
) -> None:
    sigma = {}
    for option in ((), ("--smooth",)):
        out = tmp_path / f"out{len(option)}.parquet"
        code, _, _ = run(capsys, "replay", log, *option, "-o", out, "--json", tmp_path / "r.json")
        assert code == 0
        result = json.loads((tmp_path / "r.json").read_text())
        assert result["smoothed"] is bool(option)
        sigma[option] = parquet.read_table(out).column("s_az").to_numpy()
    assert (sigma["--smooth",][:-1] < sigma[()][:-1]).all()
    assert sigma["--smooth",][-1] == sigma[()][-1]


def test_smoothing_writes_at_samples(capsys: pytest.CaptureFixture[str], log: Path) -> None:
    assert "--period: does not go with --smooth" in fails(
        capsys, "replay", log, "--smooth", "--period", 5
    )


@pytest.mark.parametrize("kind", ["iterated", "invariant", "literal"])
def test_every_filter_replays(capsys: pytest.CaptureFixture[str], log: Path, kind: str) -> None:
    code, out, _ = run(capsys, "replay", log, "--filter", kind, "--json", "-")
    assert code == 0
    assert json.loads(out)["filter"] == kind
