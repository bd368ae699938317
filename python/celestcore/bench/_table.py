"""The table for people; needs rich."""

from __future__ import annotations

from rich.console import Console
from rich.table import Table

from celestcore.bench import _markdown as words
from celestcore.bench._clock import CLOCK
from celestcore.bench._report import Report


def show(console: Console, report: Report) -> None:
    """Print what was measured, and how to read it."""
    machine = report.machine
    console.print(
        f"celestcore {machine['celestcore']} on {machine['cpu']}, {machine['level']}, "
        f"Python {machine['python']}, {machine['date']}",
        style="bold",
        soft_wrap=True,
    )
    console.print(_works(report))
    compared = [row for row in report.rows if row.peers or row.refused or row.base is not None]
    if compared:
        console.print()
        console.print(_peers(report))
    for line in _notes(report):
        console.print(line, soft_wrap=True)


def _works(report: Report) -> Table:
    table = Table(box=None, pad_edge=False, header_style="bold")
    table.add_column("work", no_wrap=True)
    for heading in ("celestcore", "limit", "ratio", "target", "instr."):
        table.add_column(heading, justify="right", no_wrap=True)
    table.add_column("for each", no_wrap=True)
    for row in report.rows:
        table.add_row(
            row.work.name,
            words.spell(row.ns),
            words.limit(report, row),
            words.ratio(report, row),
            words.target(report, row),
            words.instructions(report, row),
            row.work.item,
        )
    return table


def _peers(report: Report) -> Table:
    table = Table("work", "who", box=None, pad_edge=False, header_style="bold")
    for heading in ("time", "× celestcore"):
        table.add_column(heading, justify="right")
    for row in report.rows:
        others = sorted(row.peers.items(), key=lambda pair: pair[1])
        if row.base is not None:
            others.append((str(row.work.base), row.base))
        for name, ns in others:
            table.add_row(row.work.name, name, words.spell(ns), words.times(ns / row.ns))
    return table


def _notes(report: Report) -> list[str]:
    """Return what must be said with the figures."""
    lines = [f"Time: {CLOCK}."]
    if any(words.ratio(report, row) != words.NOTHING for row in report.rows):
        lines.append("ratio: celestcore over limit, or over what the target names: less is better.")
    if report.peers or any(row.base is not None for row in report.rows):
        lines.append("× celestcore: more is better for celestcore.")
    for row in report.rows:
        if row.left_out:
            lines.append(f"{row.work.name} was not measured: {row.left_out}")
        lines += [f"{p} was refused for {row.work.name}: {why}" for p, why in row.refused.items()]
    return [*lines, *report.skipped.values()]
