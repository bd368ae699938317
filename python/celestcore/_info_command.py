"""`celestcore info`: what a log holds, for people and for machines."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from celestcore import cli
from celestcore._files import check_output, replacing
from celestcore.errors import InputError
from celestcore.summary import spell_time


def tell(
    log: Path | None, sample: str | None, json_file: str | None, reading: dict[str, Any]
) -> None:
    """Run the command."""
    target = None if json_file in (None, cli.STDOUT) else json_file
    if target is not None and log is not None and check_output(target, "--json") == log.resolve():
        raise InputError(f"would write into the input {log}", field="--json")
    if target is not None:
        check_output(target, "--json")
    content = cli.describe_log(cli.load_log(log, sample, reading))
    text = json.dumps(content, indent=2, default=str) + "\n"
    if json_file == cli.STDOUT:
        sys.stdout.write(text)
        return
    if target is not None:
        with replacing(target) as temporary:
            temporary.write_text(text, encoding="utf-8")
    _show_info(Console(highlight=False, markup=False), content)


def _show_info(console: Console, content: dict[str, Any]) -> None:
    """Print a log's tables and settings."""
    console.print(content["title"] or "untitled log", style="bold")
    console.print(f"start (t = 0): {content['epoch'] or 'not given'}")
    console.print(f"length: {spell_time(content['span_s'])}")
    for name, frame in content["frames"].items():
        console.print(f"{name} frame: {frame}")
    table = Table("table", box=None, pad_edge=False, header_style="bold")
    headings = ("rows", "missing", "from [s]", "to [s]", "step [s]", "longest step [s]", "gaps")
    for heading in headings:
        table.add_column(heading, justify="right")
    for name, row in content["tables"].items():
        table.add_row(
            name,
            f"{row['rows']:,}",
            f"{row['missing']:,}",
            *(
                "n/a" if row[key] is None else f"{row[key]:.10g}"
                for key in ("t_first", "t_last", "step_median_s", "step_max_s")
            ),
            f"{row['gaps']:,}",
        )
    console.print(table)
    for section, values in content["settings"].items():
        if section not in ("log", "frames"):
            words = ", ".join(f"{key} = {value}" for key, value in values.items())
            console.print(f"{section}: {words}", soft_wrap=True)
