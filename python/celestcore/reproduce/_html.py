"""What the pages of all experiments are made of: HTML, SVG and CSV pieces."""

from __future__ import annotations

import base64
import csv
import io
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from typing import TYPE_CHECKING, Any

from celestcore.report import STYLE
from celestcore.solution import package_version

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from celestcore.reproduce._target import Target

MORE_STYLE = """
table.paper{font-size:.86rem;line-height:1.28}
table.paper th,table.paper td{text-align:right;padding:.28rem .42rem;white-space:nowrap}
table.paper th.group{text-align:center;border-left:1px solid #ccc}
table.paper .first{border-left:1px solid #ccc}
table.paper small{color:#666}table.paper .off small{color:#b3261e;font-weight:600}
td.yes,td.no,td.open{white-space:nowrap}td.yes{color:#1b7a3d;font-weight:600}td.no{color:#b3261e;font-weight:600}td.open{color:#777}
li{margin:.3rem 0}.two{display:grid;grid-template-columns:repeat(auto-fit,minmax(440px,1fr));
gap:.4rem 1.2rem}
.warn{background:#fff6e0;border-left:4px solid #e69f00;padding:.6rem 1rem;margin:1rem 0}
"""


def document(experiment: str, title: str, heading: str, parts: Iterable[str], citation: str) -> str:
    """Return a whole page; empty parts are left out."""
    every = [
        '<!doctype html><html lang="en"><head><meta charset="utf-8">',
        '<meta name="viewport" content="width=device-width,initial-scale=1">',
        f"<title>{escape(title)}</title>",
        f"<style>{STYLE}{MORE_STYLE}</style></head><body>",
        f'<p class="kind">celestcore reproduce {experiment}</p>',
        f"<h1>{escape(heading)}</h1>",
        *parts,
        f"<footer>{escape(citation)}. Made by celestcore {escape(package_version())}.",
        "</footer></body></html>\n",
    ]
    return "\n".join(part for part in every if part)


def target_table(targets: Iterable[Target]) -> str:
    """Return what was asked and what came out, as HTML."""
    words = {True: ("yes", "met"), False: ("no", "missed"), None: ("open", "–")}
    rows = "".join(
        f"<tr><td>{escape(t.block)}</td><td>{escape(t.asked)}</td><td>{escape(t.found)}</td>"
        f'<td class="{words[t.met][0]}">{words[t.met][1]}</td></tr>'
        for t in targets
    )
    head = "<tr><th>block</th><th>asked</th><th>found</th><th></th></tr>"
    return f'<div class="scroll"><table>{head}{rows}</table></div>'


def run_table(rows: Iterable[tuple[str, str]], notes: Sequence[str]) -> str:
    """Return how an experiment was run, and remarks below it."""
    body = "".join(f"<tr><th>{escape(a)}</th><td>{escape(b)}</td></tr>" for a, b in rows)
    return f"<table>{body}</table>{bullets(notes)}"


def grid(head: Sequence[str], rows: Iterable[Sequence[str]], kind: str = "grid") -> str:
    """Return a plain HTML table; the cells are escaped."""
    top = "".join(f"<th>{escape(name)}</th>" for name in head)
    lines = "".join(
        "<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>" for row in rows
    )
    return f'<div class="scroll"><table class="{kind}"><tr>{top}</tr>{lines}</table></div>'


def bullets(items: Iterable[str]) -> str:
    """Return a list; the items are escaped."""
    return f"<ul>{''.join(f'<li>{escape(item)}</li>' for item in items)}</ul>"


def images(pictures: Mapping[str, bytes]) -> dict[str, str]:
    """Return SVG pictures as parts of the page, by name."""
    return {name: _image(data, name) for name, data in pictures.items()}


def _image(picture: bytes, name: str) -> str:
    data = base64.b64encode(picture).decode("ascii")
    return f'<img alt="{escape(name.replace("_", " "))}" src="data:image/svg+xml;base64,{data}">'


def svg(figure: Figure) -> bytes:
    """Return a figure as SVG; the same bytes for the same figure."""
    from celestcore._optional import require

    matplotlib: Any = require("matplotlib", extra="plot", what="the report")
    buffer = io.BytesIO()
    with matplotlib.rc_context({"svg.hashsalt": "celestcore"}):
        figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None})
    return buffer.getvalue()


def drawn(figures: Mapping[str, Figure]) -> dict[str, bytes]:
    """Return figures as SVG, by the same names."""
    return {name: svg(figure) for name, figure in figures.items()}


def csv_text(rows: Iterable[Sequence[str]]) -> str:
    """Return rows as CSV."""
    buffer = io.StringIO()
    csv.writer(buffer, lineterminator="\n").writerows(rows)
    return buffer.getvalue()


def csv_dicts(rows: Sequence[Mapping[str, Any]]) -> str:
    """Return dicts as CSV, with all keys as columns; lists stand in one cell."""
    keys = list(dict.fromkeys(key for row in rows for key in row))
    return csv_text([keys, *([_cell(row.get(key, "")) for key in keys] for row in rows)])


def _cell(value: Any) -> str:
    if value is None:
        return ""
    if isinstance(value, list):
        return " ".join(f"{v:.6g}" for v in value)
    return f"{value:.9g}" if isinstance(value, float) else str(value)
