"""What ``celestcore formats`` prints."""

from __future__ import annotations

import json
import sys
from typing import TYPE_CHECKING

from celestcore._files import check_output, replacing
from celestcore.formats._registry import table as rows

if TYPE_CHECKING:
    from rich.console import Console

_STDOUT = "-"


def write(json_file: str | None) -> None:
    """Write the list as JSON, to standard output for ``-``."""
    if json_file is None:
        return
    text = json.dumps(rows(), indent=2) + "\n"
    if json_file == _STDOUT:
        sys.stdout.write(text)
        return
    with replacing(check_output(json_file, "--json")) as temporary:
        temporary.write_text(text, encoding="utf-8")


def show(console: Console) -> None:
    """Print the list as a table."""
    from rich.table import Table

    table = Table(box=None, pad_edge=False, header_style="bold")
    for heading in ("format", "endings", "", "what", "to install"):
        table.add_column(heading, overflow="fold")
    for row in rows():
        does = " ".join(w for w in ("reads", "writes") if row[w])
        endings = " ".join(row["suffixes"])
        table.add_row(row["name"], endings, does, row["summary"], row["install"] or "")
    console.print(table)
