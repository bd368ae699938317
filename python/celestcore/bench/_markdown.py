"""A measurement as a section of the documentation, and the words that both tables share."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from celestcore.bench._report import Report
    from celestcore.bench._session import Row

NOTHING = "–"


def spell(ns: float) -> str:
    """Return a time with a unit that suits it.

    Examples
    --------
    >>> spell(12.34), spell(1234.0), spell(12.34e6)
    ('12.3 ns', '1.23 µs', '12.3 ms')
    """
    if math.isnan(ns):
        return NOTHING
    for size, unit in ((1e9, "s"), (1e6, "ms"), (1e3, "µs")):
        if ns >= size:
            return f"{_digits(ns / size)} {unit}"
    return f"{_digits(ns)} ns"


def _digits(value: float) -> str:
    """Return three digits, and no exponent."""
    value = float(f"{value:.3g}")
    return f"{value:.{max(0, 2 - math.floor(math.log10(value)))}f}" if value > 0.0 else "0"


def times(ratio: float) -> str:
    """Return a ratio.

    Examples
    --------
    >>> times(1.234), times(123.4)
    ('1.23', '123')
    """
    return _digits(ratio)


def target(report: Report, row: Row) -> str:
    """Return a work's target in words, and whether it is met."""
    aim = row.work.target
    if aim is None:
        return NOTHING
    of = "" if aim.of == "limit" else f" × {aim.of}"
    words = spell(aim.most) if aim.of == "ns" else f"{aim.most:g}{of}"
    reached = report.reached(row)
    return words if reached is None else f"{words}, {'met' if reached[1] else 'missed'}"


def peers(row: Row) -> str:
    """Return the peers' times and how many times celestcore's they are, fastest first."""
    order = sorted(row.peers.items(), key=lambda pair: pair[1])
    told = [f"{name} {spell(ns)} (×{times(ns / row.ns)})" for name, ns in order]
    told += [f"{name}: refused" for name in row.refused]
    if row.base is not None:
        told.append(f"{row.work.base} {spell(row.base)} (×{times(row.base / row.ns)})")
    return ", ".join(told) or NOTHING


def limit(report: Report, row: Row) -> str:
    """Return the yardstick's time."""
    found = report.limit(row)
    return NOTHING if found is None else spell(found[0])


def ratio(report: Report, row: Row) -> str:
    """Return celestcore's time over the yardstick's, or over that of the work the target names."""
    found, reached, aim = report.limit(row), report.reached(row), row.work.target
    if found is not None and not math.isnan(row.ns):
        return times(row.ns / found[0])
    if reached is None or aim is None or aim.of == "ns":
        return NOTHING
    return times(reached[0])


def instructions(report: Report, row: Row) -> str:
    """Return the instructions for each item."""
    count = report.instructions.get(row.work.kernel or "")
    return NOTHING if count is None else f"{count:,.0f}"


def section(report: Report) -> str:
    """Return the section."""
    m = report.machine
    title = (
        f"## {m['date']}, {m['cpu']}, celestcore {m['celestcore']}, "
        f"instruction set {m['level']}, Python {m['python']}, numpy {m['numpy']}"
    )
    heading = "| work | per | celestcore | limit | ratio | target | peers (× celestcore) | instr. |"
    lines = [title, "", heading, "|" + "---|" * 8]
    for row in report.rows:
        cells = (
            row.work.title,
            row.work.item,
            spell(row.ns),
            limit(report, row),
            ratio(report, row),
            target(report, row),
            peers(row),
            instructions(report, row),
        )
        lines.append("| " + " | ".join(cells) + " |")
    lines += ["", *_notes(report)]
    return "\n".join(lines) + "\n"


def _notes(report: Report) -> list[str]:
    notes = []
    if report.peers:
        versions = ", ".join(f"{name} {version}" for name, version in report.peers.items())
        notes.append(f"Peers: {versions}.")
    left = [f"{row.work.name} ({row.left_out})" for row in report.rows if row.left_out]
    if left:
        notes.append("Not measured: " + "; ".join(left) + ".")
    for row in report.rows:
        notes += [f"Refused, {row.work.name} by {p}: {why}." for p, why in row.refused.items()]
    if report.options.get("quick"):
        notes.append("Made with `--quick`: too short to judge by.")
    return notes
