"""A report as one HTML page: its frame, its tables, and the panels that its script draws."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from importlib.resources import files
from typing import Any

from celestcore._fixes import Fixes
from celestcore._health import STATES, windows
from celestcore._panels import Panel, Section, Times, longest, page_data

POLICY = "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data:"
"""The browser itself sees to it that the page loads nothing."""
MOST_MARKS = 300
BAR = """<div id="bar" role="toolbar" aria-label="zoom of all plots">
<button data-act="left" aria-label="earlier">◀</button>
<button data-act="out" aria-label="zoom out">−</button>
<button data-act="in" aria-label="zoom in">+</button>
<button data-act="right" aria-label="later">▶</button>
<button data-act="all">whole log</button></div>"""
HELP = (
    "All plots share one time axis: drag along one (or pinch it) to zoom all, double-click for the "
    "whole log; a click on a name in a key hides its line. Grey: gaps. Long series are thinned to "
    "the lowest and the highest value of each stretch, so spikes stay."
)
MARKS = "Violet: the filter started again."
NO_SCRIPT = (
    "<noscript><p><b>The plots need JavaScript; words and numbers do not.</b></p></noscript>"
)


def web(name: str) -> str:
    """Return one of the files that every page carries."""
    return files("celestcore").joinpath("web", name).read_text(encoding="utf-8")


def document(
    title: str,
    lead: str,
    parts: Iterable[str],
    panels: Sequence[Panel],
    times: Times,
    result: Mapping[str, Any],
    style: str,
) -> str:
    """Return a whole page.

    Parameters
    ----------
    title, lead : str
        Plain text.
    parts : iterable of str
        HTML, from `sections` and the tables.
    panels : sequence of Panel
        In the order in which the parts name them.
    times : Times
    result : mapping
        The summary; the page carries it as JSON, in the element ``summary``.
    style : str
        CSS before that of the panels.
    """
    head = (
        '<!doctype html><html lang="en"><head><meta charset="utf-8">'
        f'<meta http-equiv="Content-Security-Policy" content="{POLICY}">'
        '<meta name="viewport" content="width=device-width,initial-scale=1">'
        f"<title>{escape(title)}</title>"
        f"<style>{style}{web('uPlot.min.css')}{web('report.css')}</style></head><body>"
    )
    return "\n".join(
        [
            head,
            '<p class="kind">celestcore replay report</p>',
            f'<h1>{escape(title)}</h1><p class="lead">{escape(lead)}</p>',
            NO_SCRIPT,
            *(part for part in parts if part),
            BAR if panels else "",
            f'<script type="application/json" id="summary">{embedded(result)}</script>',
            '<script type="application/json" id="panels">'
            f"{embedded(page_data(panels, times))}</script>",
            f"<script>{web('uPlot.iife.min.js')}</script>",
            f"<script>{web('report.js')}</script></body></html>\n",
        ]
    )


def embedded(value: Any) -> str:
    """Return JSON that may stand inside a script element."""
    text = json.dumps(value, allow_nan=False, separators=(",", ":"))
    return text.replace("<", "\\u003c").replace("\u2028", "\\u2028").replace("\u2029", "\\u2029")


def sections(many: Iterable[Section], panels: list[Panel]) -> list[str]:
    """Return sections as HTML, and add their panels to those of the page.

    On paper a heading keeps together with what follows, up to the first row of panels.
    """
    out = []
    for section in many:
        anchor = f' id="{section.name}"' if section.name else ""
        words = f'<p class="note">{escape(section.words)}</p>' if section.words else ""
        mine = section.panels
        first = 1
        while first < len(mine) and mine[0].row and mine[first].row == mine[0].row:
            first += 1
        out.append(
            f'<div class="keep"><h2{anchor}>{escape(section.heading)}</h2>{words}{section.html}'
            f"{places(mine[:first], panels)}</div>{places(mine[first:], panels)}"
        )
    return out


def places(mine: Sequence[Panel], panels: list[Panel]) -> str:
    """Return the places of some panels, those of a row side by side; add them to the page's."""
    out, row = [], ""
    for panel in mine:
        if panel.row != row:
            out.append(("</div>" if row else "") + ('<div class="trio">' if panel.row else ""))
            row = panel.row
        unit = f" <small>[{escape(panel.unit)}]</small>" if panel.unit else ""
        note = f'<p class="key">{escape(panel.note)}</p>' if panel.note else ""
        out.append(
            f'<div class="panel"><h3>{escape(panel.title)}{unit}</h3>'
            f'<div class="plot" data-panel="{len(panels)}"></div>{note}</div>'
        )
        panels.append(panel)
    return "".join(out) + ("</div>" if row else "")


def number(value: float | None, unit: str = "") -> str:
    """Return a number of three digits for people."""
    if value is None:
        return "n/a"
    return f"{value:,.0f}{unit}" if abs(value) >= 1000.0 else f"{value:.3g}{unit}"


def marked(result: Mapping[str, Any], key: str, unit: str = "", scale: float = 1.0) -> str:
    """Return a number of the summary as HTML that says which one it is.

    Parameters
    ----------
    result : mapping
        The summary.
    key : str
        Where in it: keys and indices with dots between, such as ``innovation.rms_arcsec.0``.
    unit : str
    scale : float
        What to multiply it by.
    """
    value: Any = result
    for part in key.split("."):
        value = value[int(part)] if isinstance(value, list) else value[part]
    if isinstance(value, int):
        text = f"{value:,}{unit}"
    else:
        text = number(None if value is None else scale * value, unit)
    times = "" if scale == 1.0 else f' data-scale="{scale!r}"'
    return f'<span data-key="{escape(key)}"{times}>{escape(text)}</span>'


def cards(items: Iterable[tuple[str, str]]) -> str:
    """Return large numbers (HTML) with words (text) below."""
    cells = "".join(
        f'<div class="card"><b>{value}</b><span>{escape(words)}</span></div>'
        for value, words in items
    )
    return f'<div class="cards">{cells}</div>'


def grid(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a table; the head is text, the cells are HTML."""
    top = "".join(f"<th>{escape(name)}</th>" for name in head)
    lines = "".join("<tr>" + "".join(f"<td>{cell}</td>" for cell in row) + "</tr>" for row in rows)
    return f'<div class="scroll"><table class="grid"><tr>{top}</tr>{lines}</table></div>'


def findings(result: Mapping[str, Any], times: Times) -> str:
    """Return "what to look at next", with buttons that show when."""
    items = []
    known: set[str] = set()
    for found in result["findings"]:
        button = ""
        advice = "" if found["rule"] in known else f" {found['advice']}"  # once is enough
        known.add(found["rule"])
        if found["at"] is not None:
            begin, end = (times.place(float(t)) for t in found["at"])
            button = (
                f'<br><button data-from="{begin:.9g}" data-to="{end:.9g}" '
                'data-goto="health">show when</button>'
            )
        items.append(
            f'<li class="{found["level"]}"><b>{escape(found["title"])}</b>'
            f"{escape(found['words'] + advice)}{button}</li>"
        )
    return f'<h2>What to look at next</h2><ul class="next">{"".join(items)}</ul>'


def lanes(fixes: Sequence[Fixes], times: Times, carrier: str | None = "gyro") -> str:
    """Return the timeline of the carrier's gaps, if there is one, and of each sensor's health."""
    first, last = times.first, times.last
    length = max(last - first, 1e-9)

    def block(begin: float, end: float, kind: str, words: str) -> str:
        left, wide = 100.0 * (begin - first) / length, 100.0 * (end - begin) / length
        a, b = (f"{times.place(t):.9g}" for t in (begin, end))
        return (
            f'<i class="{kind}" style="left:{left:.3f}%;width:max({wide:.3f}%,2px)" '
            f'title="{escape(words)}" data-from="{a}" data-to="{b}"></i>'
        )

    def when(begin: float, end: float) -> str:
        return f"t = {begin:.10g} to {end:.10g} s"

    gaps = "".join(
        block(max(a, first), min(b, last), "g", f"gap, {when(a, b)}")
        for a, b in longest(times.gaps).tolist()
    )
    out = []
    if carrier is not None:
        out.append(f'<div>{escape(carrier)}</div><div class="lane s0">{gaps}</div>')
    again = "".join(
        block(t, t, "r", f"started again, t = {t:.10g} s") for t in times.marks[:MOST_MARKS]
    )
    if again:
        out.append(f'<div>starts anew</div><div class="lane">{again}</div>')
    for each in fixes:
        blocks = "".join(
            block(
                a, b, f"s{state}", f"{STATES[state]}, {when(a, b)}: {n:,} fixes, {bad:,} rejected"
            )
            for a, b, state, n, bad in windows(each, first, last).segments()
        )
        out.append(f'<div>{escape(each.name)}</div><div class="lane">{blocks}</div>')
    key = "".join(f'<span class="swatch s{k}"></span>{escape(v)}' for k, v in STATES.items())
    begin, end = (f"{round(times.place(t), 2) + 0.0:g} {times.unit}" for t in (first, last))
    ticks = f'<div></div><div class="ticks"><span>{begin}</span><span>{end}</span></div>'
    return (
        f'<div class="lanes">{"".join(out)}{ticks}</div>'
        f'<p class="key">{key}<span class="swatch g"></span>gap'
        + ('<span class="swatch r"></span>started again</p>' if again else "</p>")
    )


def noise_table(result: Mapping[str, Any]) -> str:
    """Return the noise that each sensor was told, beside what its innovations say."""
    rows = []
    adapted = [s for s in result["sensors"] if s.get("noise_scale") is not None]
    for k, sensor in enumerate(result["sensors"]):
        found = sensor["noise"]
        if found is None:
            continue
        for j, axis in enumerate(found["axes"]):
            at = f"sensors.{k}.noise."
            told, seen = (
                "n/a" if found[key] is None else marked(result, f"{at}{key}.{j}")
                for key in ("configured", "seen")
            )
            cells = [marked(result, f"{at}{key}.{j}") for key in ("rms", "predicted", "ratio")]
            name = f"{escape(sensor['name'])}, {escape(axis)} [{escape(found['unit'])}]"
            rows.append((name, told, seen, *cells))
    lines = "".join(
        f"<p>{escape(s['name'])}: noise found while running: "
        f"{number(s['noise_scale'] ** 0.5)} times as told</p>"
        for s in adapted
    )
    heading = "<h2>Noise, as seen and as configured</h2>"
    if not rows:
        return heading + lines if lines else ""
    head = (
        "noise (1 sigma)",
        "as configured",
        "as the innovations say",
        "innovations rms",
        "predicted rms",
        "their ratio (ideal 1)",
    )
    words = (
        "As the innovations say: the noise of the fixes that makes the innovations as large as "
        "they are, if all of the misfit is theirs (configured² + rms² - predicted²"
        f"{', configured times what was found while running' if adapted else ''}); n/a if it "
        "was not known, or nothing is left for it. celestcore.analysis.estimate_noise weighs it "
        "against the gyro's noise."
    )
    return f'{heading}{lines}{grid(head, rows)}<p class="note">{escape(words)}</p>'
