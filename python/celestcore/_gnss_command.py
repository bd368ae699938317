"""What `celestcore replay` writes and prints of a log with GNSS fixes."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.table import Table

from celestcore import _gnss_replay, _gnss_words, cli

if TYPE_CHECKING:
    from celestcore.log import SensorLog


def replay_gnss(
    request: cli.Replay, log: SensorLog, replayed: _gnss_replay.GnssReplay, command: str
) -> None:
    """Write the files that were asked for, then print the summary."""
    result = _gnss_replay.summary(replayed, log, str(request.log))
    request.write_gnss(replayed, log, result, command)
    console = Console(stderr=request.json == cli.STDOUT, highlight=False, markup=False)
    _show(console, result)
    for name, path in request.written():
        console.print(f"{name}: {path}", soft_wrap=True)


def _show(console: Console, result: dict[str, Any]) -> None:
    """Print a headline and a table of the summary."""
    console.print(result["log"], style="bold")
    console.print(_gnss_words.headline(result))
    table = Table(show_header=False, box=None, pad_edge=False)
    table.add_column(style="bold")
    table.add_column(justify="right")
    for row in _gnss_words.rows(result):
        table.add_row(*row)
    console.print(table)
