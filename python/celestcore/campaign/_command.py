"""``celestcore campaign``: check, run, write, show."""

from __future__ import annotations

import json
import math
import os
import sys
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Optional

import typer
from rich.console import Console
from rich.table import Table

from celestcore._arguments import processors
from celestcore._files import check_output, replacing
from celestcore._interrupted import Interrupted
from celestcore.campaign._config import Campaign
from celestcore.campaign._results import Results
from celestcore.campaign._run import Progress, run
from celestcore.errors import InputError
from celestcore.summary import spell_time
from celestcore.units import ARCSEC, DEG_PER_HOUR

STDOUT = "-"
SHOWN = 40
"""Cells in the table for people at most."""
Bar = Callable[[str], AbstractContextManager["Progress | None"]]


@dataclass(frozen=True)
class Request:
    """What was asked for; `check` before `run`."""

    config: Path
    out: Path | None = None
    threads: int | None = None
    dask: str | None = None
    json: str | None = None

    @property
    def folder(self) -> Path:
        """The folder of the results: beside the configuration, if none is named."""
        return self.config.with_suffix(".runs") if self.out is None else self.out

    def check(self) -> None:
        """Refuse what cannot be written, before anything is read.

        Raises
        ------
        InputError
            Names the option.
        """
        if self.threads is not None:
            processors(self.threads, alone=True)
            if self.dask is not None:
                raise InputError(
                    "goes without --dask: its workers have their own", field="--threads"
                )
        if self.json not in (None, STDOUT):
            target = check_output(str(self.json), "--json")
            if target == Path(os.path.realpath(self.config)):
                raise InputError(f"would write into the input {self.config}", field="--json")
            if target.parent == Path(os.path.realpath(self.folder)):
                raise InputError(
                    "would write into the results: name another folder", field="--json"
                )

    def run(self, campaign: Campaign, progress: Progress | None) -> Results:
        """Run what is missing.

        Raises
        ------
        Interrupted
            On Ctrl-C.
        """
        try:
            return run(
                campaign, self.folder, executor=self.dask, threads=self.threads, progress=progress
            )
        except KeyboardInterrupt:
            raise Interrupted(
                f"interrupted: what is finished is in {self.folder}; the same command goes on"
            ) from None

    def write(self, campaign: Campaign, results: Results) -> list[tuple[str, Path]]:
        """Write the summary, and return what each output is and its name."""
        content = {"config": str(self.config), **results.to_dict()}
        text = json.dumps(content, indent=2, allow_nan=False, default=str) + "\n"
        if self.json == STDOUT:
            sys.stdout.write(text)
        elif self.json is not None:
            with replacing(self.json) as temporary:
                temporary.write_text(text, encoding="utf-8")
            return [("rows", self.folder), ("summary", Path(self.json))]
        return [("rows", self.folder)]


def register(app: typer.Typer, bar: Bar) -> None:
    """Add the command to the application."""

    @app.command(epilog="Example: celestcore campaign trade.toml --out trade --json trade.json")
    def campaign(
        config: Annotated[
            Path, typer.Argument(metavar="CONFIG.toml", help="Grid of scenarios, or logs.")
        ],
        out: Annotated[
            Optional[Path],  # noqa: UP045
            typer.Option("--out", metavar="DIR", help="Folder of the rows; CONFIG.runs."),
        ] = None,
        threads: Annotated[
            Optional[int],  # noqa: UP045
            typer.Option("--threads", metavar="N", help="Same rows for any number; all."),
        ] = None,
        dask: Annotated[
            Optional[str],  # noqa: UP045
            typer.Option("--dask", metavar="ADDRESS", help="A Dask scheduler, tcp://HOST:PORT."),
        ] = None,
        json_file: Annotated[
            Optional[str],  # noqa: UP045
            typer.Option("--json", metavar="FILE", help="Write a summary; - for standard output."),
        ] = None,
    ) -> None:
        """Run a grid of scenarios times trials, or a folder of logs.

        Runs that DIR holds already are not run again.
        """
        request = Request(config, out, threads, dask, json_file)
        request.check()
        asked = Campaign.from_toml(config)
        with bar("running") as advance:
            results = request.run(asked, advance)
        written = request.write(asked, results)
        console = Console(stderr=json_file == STDOUT, highlight=False, markup=False)
        show(console, asked, results)
        for name, path in written:
            console.print(f"{name}: {path}", soft_wrap=True)


def show(console: Console, campaign: Campaign, results: Results) -> None:
    """Print what was run, and a row for each cell."""
    cells = results.cells()
    failed = sum(cell["failed"] for cell in cells)
    now = f"{results.ran:,} of them now, in {spell_time(results.seconds)}"
    now = now if results.ran else "all of them finished before"
    console.print(f"{results.runs:,} runs, {now}; {failed:,} failed.")
    for reason in [cell["first_failure"] for cell in cells if cell["first_failure"]][:1]:
        console.print(f"first failure: {reason}", soft_wrap=True)
    columns = _of_logs if campaign.logs else _of_trials
    table = Table(box=None, pad_edge=False, header_style="bold")
    for name in campaign.grid:
        table.add_column(name, no_wrap=True)
    for name in columns(cells[0]):
        table.add_column(name, justify="right")
    for cell in cells[:SHOWN]:
        values = [str(cell[name]) for name in campaign.grid]
        table.add_row(*values, *columns(cell).values())
    console.print(table)
    if len(cells) > SHOWN:
        console.print(f"and {len(cells) - SHOWN:,} more cells: --json writes all")


def _of_trials(cell: dict[str, Any]) -> dict[str, str]:
    return {
        "runs": f"{cell['runs']:,}",
        "failed": f"{cell['failed']:,}",
        "error [arcsec]": _number(_total(cell["rms"]), ARCSEC),
        "bias error [deg/h]": _number(_total(cell["rms_bias"]), DEG_PER_HOUR),
        "NEES / 6": _number(cell["nees"], 6.0),
        "NIS / 3": _number(cell["nis"], 3.0),
    }


def _of_logs(cell: dict[str, Any]) -> dict[str, str]:
    counts = {name: f"{cell[name]:,}" for name in ("runs", "failed", "fixes", "rejected")}
    return counts | {"NIS per dof": _number(cell["nis_per_dof"])}


def _total(axes: list[float | None]) -> float | None:
    """Return the root mean square of the whole error, from those about the axes."""
    given = [a for a in axes if a is not None]
    return math.hypot(*given) if given else None


def _number(value: float | None, unit: float = 1.0) -> str:
    return "n/a" if value is None else f"{value / unit:.4g}"
