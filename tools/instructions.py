"""Count the instructions of the core's kernels under callgrind: `make instructions`.

Times on a shared machine drift; counts do not. Each kernel runs n and 2 n steps, and what is set up
drops out of the difference. valgrind emulates the processor, AVX2 included, but not every
extension: the level that the kernels chose there is recorded.
"""

from __future__ import annotations

import argparse
import json
import re
import shutil
import subprocess
import sys
from datetime import date
from pathlib import Path
from typing import NoReturn

ROOT = Path(__file__).resolve().parent.parent
BUILD = ["cargo", "bench", "--package", "celestcore-core", "--bench", "work", "--no-run"]
STEPS = {"upf20": 100, "bootstrap": 20}
"""Steps of the shorter run, where the usual number would take minutes."""
USUAL = 1000
ITEMS = {
    "propagation": "sample",
    "ekf": "sample",
    "ukf": "sample",
    "srukf": "sample",
    "ekf_batch": "filter step",
    "ukf_batch": "filter step",
    "bootstrap": "particle step",
    "systematic": "particle",
    "multinomial": "particle",
    "residual": "particle",
    "gravity21": "acceleration",
}
"""What a kernel counts; a step where nothing else is said."""
COLLECTED = re.compile(r"Collected\s*:\s*(\d+)")


def stop(message: str) -> NoReturn:
    """End with one sentence."""
    sys.exit(f"instructions: {message}")


def built() -> str:
    """Build the kernels' program and return its path."""
    made = subprocess.run(
        [*BUILD, "--message-format", "json"], cwd=ROOT, stdout=subprocess.PIPE, text=True
    )
    if made.returncode:
        stop("the kernels do not build, see above")
    for line in made.stdout.splitlines():
        told = json.loads(line)
        if told.get("executable") and told.get("target", {}).get("name") == "work":
            return str(told["executable"])
    stop("cargo named no program of the bench `work`")


class UnknownError(Exception):
    """An instruction that this valgrind does not know: version 3.19 lacks forms of AVX's vmovq."""


def valgrind(program: str, *arguments: str) -> tuple[str, int]:
    """Return what a run under callgrind prints, and its instructions."""
    command = ["valgrind", "--tool=callgrind", "--callgrind-out-file=/dev/null", program]
    done = subprocess.run([*command, *arguments], capture_output=True, text=True)
    found = COLLECTED.search(done.stderr)
    if "unhandled instruction" in done.stderr:
        raise UnknownError
    if done.returncode or found is None:
        last = (done.stderr.strip().splitlines() or ["nothing was said"])[-1]
        stop(f"valgrind failed at {' '.join(arguments)}: {last}")
    return done.stdout.strip(), int(found[1])


def counted(program: str, kernel: str) -> dict[str, object]:
    """Return the instructions for each item of a kernel."""
    steps = STEPS.get(kernel, USUAL)
    (few, less), (many, more) = (valgrind(program, kernel, str(n)) for n in (steps, 2 * steps))
    per_item = (more - less) / (int(many) - int(few))
    return {"instructions": round(per_item, 1), "item": ITEMS.get(kernel, "step")}


def all_counted(program: str, names: list[str]) -> dict[str, dict[str, object]]:
    """Return the counts of kernels by name, without those that valgrind cannot run."""
    out = {}
    for name in names:
        try:
            out[name] = counted(program, name)
        except UnknownError:
            print(f"{name} is left out: it has an instruction that this valgrind does not know")
    return out


def cpu_model() -> str:
    """Return the processor's name."""
    info = Path("/proc/cpuinfo")
    text = info.read_text(encoding="utf-8") if info.is_file() else ""
    found = re.search(r"model name\s*:\s*(.+)", text)
    return found[1].strip() if found else "unknown processor"


def markdown(result: dict[str, object]) -> str:
    """Return the counts as a table."""
    lines = ["| kernel | per | instructions |", "|---|---|---|"]
    kernels: dict[str, dict[str, object]] = result["kernels"]  # type: ignore[assignment]
    for name, one in kernels.items():
        lines.append(f"| {name} | {one['item']} | {one['instructions']:,.0f} |")
    return "\n".join(lines)


def main(arguments: list[str] | None = None) -> None:
    """Count, print a table, write JSON."""
    parser = argparse.ArgumentParser(
        description=__doc__.splitlines()[0],
        epilog="Example: python tools/instructions.py --only ekf,ukf --json counts.json",
    )
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the counts")
    parser.add_argument("--only", metavar="KERNEL,...", help="some kernels; all")
    options = parser.parse_args(arguments)
    for program, how in (
        ("valgrind", "Debian's package valgrind has it"),
        ("cargo", "https://rustup.rs has it"),
    ):
        if shutil.which(program) is None:
            stop(f"{program} is missing: {how}.")
    if options.json is not None and not options.json.parent.is_dir():
        stop(f"the directory {options.json.parent} does not exist: create it first.")
    program = built()
    known = subprocess.run([program, "list"], capture_output=True, text=True).stdout.split()
    wanted = known if options.only is None else options.only.split(",")
    for name in wanted:
        if name not in known:
            stop(f"{name} is no kernel; known are {', '.join(known)}.")
    result: dict[str, object] = {
        "date": date.today().isoformat(),
        "cpu": cpu_model(),
        "level": valgrind(program, "level")[0],
        "kernels": all_counted(program, wanted),
    }
    print(f"Instructions, {result['level']}, {result['cpu']}, {result['date']}\n")
    print(markdown(result))
    if options.json is not None:
        options.json.write_text(json.dumps(result, indent=2) + "\n", encoding="utf-8")
        print(f"\nwritten: {options.json}")


if __name__ == "__main__":
    main()
