"""A log on which everything breaks once, replayed by the program, killed twice and gone on with.

What is asked of every fault: `BACK` seconds after its end the error is within five of its stated
sigmas again, and for good; and if the sensors show it, the report names the time at which it began.
Of the week ``docs/howto/faults.md`` holds the table that this file prints
(``pytest -s -m long tests/faults/test_week_of_faults.py``).
"""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("pyarrow")

from fault_flight import FAULTS, Fared, Flight, fared, told_of

pytestmark = pytest.mark.skipif(os.name != "posix", reason="needs kill -9")
BACK = 10.0
NEAR = 30.0
"""So near to a fault's begin the report must name a time [s]."""
LARGEST_REPORT = 10e6
PROGRAM = "import sys; from celestcore import cli; sys.exit(cli.main(sys.argv[1:]))"


class Program:
    """`celestcore replay` of a log in a process of its own."""

    def __init__(self, folder: Path, name: str, window: float) -> None:
        self.out, self.page, self.json = (folder / f"{name}{e}" for e in ("", ".html", ".json"))
        words = ["replay", folder / "log", "--parts", self.out, "--window", window]
        words += ["--checkpoint", folder / f"{name}.checkpoint", "--interval", 0, "--reorder", 0]
        words += ["--report", self.page, "--json", self.json]
        self._call = [sys.executable, "-c", PROGRAM, *(str(w) for w in words)]

    def start(self, *more: str) -> subprocess.Popen[bytes]:
        """Start it."""
        quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
        return subprocess.Popen([*self._call, *more], **quiet)

    def run(self, *more: str) -> tuple[float, float, float]:
        """Run it to its end; return its time and the processor's [s], largest memory [bytes]."""
        began = time.perf_counter()
        child = self.start(*more)
        _, status, used = os.wait4(child.pid, 0)
        child.returncode = os.waitstatus_to_exitcode(status)
        assert child.returncode == 0
        unit = 1 if sys.platform == "darwin" else 1024
        busy = used.ru_utime + used.ru_stime
        return time.perf_counter() - began, busy, float(used.ru_maxrss * unit)

    def kill_at(self, parts: int, *more: str) -> None:
        """Start it, and kill it as soon as it has written so many parts."""
        child = self.start(*more)
        while len(list(self.out.glob("rows/part-*.parquet"))) < parts and child.poll() is None:
            time.sleep(0.002)
        child.send_signal(signal.SIGKILL)
        assert child.wait() == -signal.SIGKILL, "it had ended before it was killed"
        assert not self.page.exists()

    def files(self) -> dict[str, Path]:
        """Return the parts of all tables by name."""
        return {str(p.relative_to(self.out)): p for p in sorted(self.out.rglob("*.parquet"))}


def check_same_bits(one: Program, other: Program) -> None:
    first, second = one.files(), other.files()
    assert list(first) == list(second)
    for name, path in first.items():
        assert path.read_bytes() == second[name].read_bytes(), name


def check_numbers(program: Program) -> dict[str, Any]:
    """The page's numbers are those of `summary.json` and of the command; return the page's."""
    text = program.page.read_text(encoding="utf-8")
    found = re.search(r'id="summary">(.*?)</script>', text)
    assert found is not None
    page: dict[str, Any] = json.loads(found.group(1))
    written = json.loads((program.out / "summary.json").read_text())
    assert page["replay"] == written
    said = json.loads(program.json.read_text())
    assert {name: written[name] for name in said} == said
    for name in ("rows", "parts", "samples", "fixes", "rejected"):
        assert page["counts"][name] == written[name], name
    assert sum(s["rejected"] for s in page["sensors"]) == written["rejected"]
    assert page["counts"]["restarts"] == len(written["restarts"])
    for event in page["events"]:
        assert event["words"] in text, "what happened is told in words"
    return page


def check_faults(flight: Flight, page: dict[str, Any], out: Path) -> list[Fared]:
    """Every fault is survived, and told of if the sensors show it; print how each fared."""
    found = fared(flight, out, 0.1)
    events = page["events"]
    print("\n| fault | for | told of as | after | bad | back after | largest error |")
    print("|---|---|---|---|---|---|---|")
    for k, (fault, one) in enumerate(zip(FAULTS, found, strict=True)):
        told = told_of(flight, k, events)
        begin, last = flight.begin_of(k), flight.end_of(k) - flight.begin_of(k)
        after = "" if told is None else f"{round(told['begin'] - begin) + 0} s"
        print(
            f"| {fault.name} | {f'{last:.0f} s' if last else ''} "
            f"| {'' if told is None else told['kind']} | {after} | {one.bad:.0f} s "
            f"| {one.back:.1f} s | {one.worst:.0f}″ |"
        )
    for k, (fault, one) in enumerate(zip(FAULTS, found, strict=True)):
        assert one.back <= BACK, fault.name
        begin, told = flight.begin_of(k), told_of(flight, k, events)
        if fault.told:
            assert told is not None, fault.name
            near = page["sensors"][0]["windows"]["length_s"]  # scattered: as near as these
            assert abs(told["begin"] - begin) <= (near if told["kind"] == "scattered" else NEAR)
        else:
            until = begin + flight.slot - NEAR
            mine = [e for e in events if begin <= e["begin"] < until]
            assert not mine, f"{fault.name}: nothing happened that could be seen"
    return found


def fly(flight: Flight, folder: Path, window: float, kills: tuple[int, int]) -> None:
    """Replay a flight in one go, and killed twice; check all that is asked."""
    flight.write(folder / "log")
    whole = Program(folder, "whole", window)
    took, busy, memory = whole.run()
    killed = Program(folder, "killed", window)
    killed.kill_at(kills[0])
    killed.kill_at(kills[1], "--resume")
    killed.run("--resume")
    check_same_bits(whole, killed)
    page = check_numbers(whole)
    resumed = check_numbers(killed)
    assert resumed["replay"]["resumed"]
    assert page["events"] == resumed["events"]
    size = whole.page.stat().st_size
    assert size < LARGEST_REPORT
    check_faults(flight, page, whole.out)
    print(
        f"\n{page['counts']['samples']:,} samples, {page['counts']['fixes']:,} fixes, "
        f"{page['counts']['restarts']} starts anew: {took:.0f} s ({busy:.0f} s of "
        f"processor) with the report, largest memory {memory / 1e6:.0f} MB, "
        f"report {size / 1e6:.2f} MB"
    )


def test_an_hour_and_a_half_on_which_everything_breaks(tmp_path: Path) -> None:
    fly(Flight(400.0, week=False), tmp_path, 200.0, (5, 12))


@pytest.mark.long
@pytest.mark.timeout(3600)
def test_a_week_at_10_hz_on_which_everything_breaks(tmp_path: Path) -> None:
    flight = Flight(43_200.0, week=True)
    assert round(flight.end * 10.0) == 6_048_000
    fly(flight, tmp_path, 3600.0, (50, 110))
