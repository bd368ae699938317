"""A campaign on a Dask scheduler and two workers, all of them processes, one killed midway."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import celestcore as cc
import pytest
from celestcore import campaign, cli

distributed = pytest.importorskip("distributed")
pytest.importorskip("pyarrow.parquet")
# what Dask warns of within is no fault of ours; celestcore's own warnings stay errors
pytestmark = [
    pytest.mark.skipif(os.name == "nt", reason="there is no SIGKILL there"),
    pytest.mark.filterwarnings("ignore"),
    pytest.mark.filterwarnings("error::celestcore.CelestcoreWarning"),
]

CONFIG = """
[campaign]
trials = 60
seed = 3
skip_s = 60.0
batch = 2
[scenario]
duration_s = 300.0
[gyro]
arw = 1e-6
bias_sigma_deg_per_hour = 1.0
[star]
sigma_arcsec = 5.0
every = 2
[grid]
"filter.kind" = ["ekf", "srukf"]
"""


def started(*arguments: str) -> subprocess.Popen[bytes]:
    command = [sys.executable, "-m", *arguments]
    # how long the scheduler knocks at the dead worker's door for results: 30 s by default
    patience = {"DASK_DISTRIBUTED__COMM__TIMEOUTS__CONNECT": "2s"}
    quiet = subprocess.DEVNULL
    return subprocess.Popen(command, stdout=quiet, stderr=quiet, env={**os.environ, **patience})


@pytest.fixture
def cluster(tmp_path: Path) -> Iterator[tuple[str, list[subprocess.Popen[bytes]]]]:
    file = tmp_path / "scheduler.json"
    scheduler = started(
        *("distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", "0"),
        *("--no-dashboard", "--scheduler-file", str(file)),
    )
    worker = (
        *("distributed.cli.dask_worker", "--scheduler-file", str(file), "--no-nanny"),
        *("--nthreads", "1", "--no-dashboard", "--local-directory", str(tmp_path)),
    )
    running = [scheduler, started(*worker), started(*worker)]
    try:
        with distributed.Client(scheduler_file=str(file), timeout="30s") as client:
            client.wait_for_workers(2, timeout=30)
            yield client.scheduler.address, running[1:]
    finally:
        for process in running:
            process.kill()
            process.wait()


def plain(folder: Path) -> Any:
    return campaign.read(folder).drop_columns(["seconds"])


def test_a_worker_killed_midway(
    cluster: tuple[str, list[subprocess.Popen[bytes]]],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    address, workers = cluster
    config = tmp_path / "trade.toml"
    config.write_text(CONFIG)
    monkeypatch.setattr("celestcore.campaign._run.SOONEST", 0.0)  # parts as it goes
    killed: list[int] = []

    def kill() -> None:
        while not list((tmp_path / "there").glob("part-*")):
            time.sleep(0.005)
        workers[0].send_signal(signal.SIGKILL)
        killed.append(len(list((tmp_path / "there").glob("part-*"))))

    killer = threading.Thread(target=kill)
    killer.start()
    there = tmp_path / "there"
    code = cli.main(["campaign", str(config), "--out", str(there), "--dask", address])
    killer.join()
    out, err = capsys.readouterr()
    assert code == 0, err
    assert "120 runs, 120 of them now" in out
    assert "0 failed" in out
    assert workers[0].wait() == -signal.SIGKILL
    assert workers[1].poll() is None
    assert killed[0] < 60  # of 60 tasks
    here = campaign.run(config, tmp_path / "here")
    assert plain(there).equals(plain(here.folder))
    again = campaign.run(config, there, executor=address)
    assert (again.ran, again.kept) == (0, 120)


def test_no_scheduler(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("celestcore.campaign._dask.TIMEOUT", "0.2s")
    config = tmp_path / "trade.toml"
    config.write_text(CONFIG)
    with pytest.raises(cc.InputError, match=r"dask, value 'tcp://127.0.0.1:9': no scheduler"):
        campaign.run(config, tmp_path / "o", executor="tcp://127.0.0.1:9")
