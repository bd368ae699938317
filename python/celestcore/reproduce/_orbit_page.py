"""The page of the orbit experiment: one HTML file, for somebody who has the paper at hand."""

from __future__ import annotations

from html import escape
from typing import TYPE_CHECKING

from celestcore.reproduce import _orbit_paper as paper
from celestcore.reproduce import _orbit_tables as tables
from celestcore.reproduce import _orbit_words as words
from celestcore.reproduce._html import bullets, document, drawn, images, run_table, target_table
from celestcore.reproduce._orbit_figures import figures
from celestcore.reproduce._orbit_model import PERIODS
from celestcore.reproduce._orbit_targets import WORDS
from celestcore.reproduce._orbit_words import lead
from celestcore.summary import spell_time

if TYPE_CHECKING:
    from celestcore.reproduce.celestial_orbit import Result

__all__ = ["lead", "page"]


def page(
    result: Result, command: str | None = None, pictures: dict[str, bytes] | None = None
) -> str:
    """Return the page as HTML text.

    Parameters
    ----------
    result : Result
    command : str, optional
        The command that made it.
    pictures : dict of str to bytes, optional
        The figures as SVG, if they have been drawn already.
    """
    shown = images(drawn(figures(result)) if pictures is None else pictures)
    parts = [
        f'<p class="lead">{escape(lead(result))}</p>',
        "" if result.full else f'<p class="warn">{escape(words.few(result))}</p>',
        f"<h2>What must be said plainly</h2>{bullets(words.said_plainly(result))}",
        f"<h2>What was asked and what came out</h2>{target_table(result.targets())}",
        shown["period"],
        *_table_parts(result),
        f"<h2>Figures 3 and 4</h2>{_note(FIGURES)}{shown['figure_3']}{shown['figure_4']}",
        f"<h2>How well the noise must be known</h2><p>{escape(words.SHAPES)}</p>",
        tables.shape_table(result),
        f"<h2>The three particle filters</h2><p>{escape(words.PARTICLES)}</p>",
        tables.particle_table(result),
        shown["effective_sample_size"],
        f"<h2>Table 3: what it costs</h2><p>{escape(words.COST)}</p>",
        tables.cost_table(result),
        f"<h2>Outliers</h2><p>{escape(words.OUTLIERS)}</p>{tables.outlier_table(result)}",
        f"<h2>Large initial errors</h2><p>{escape(words.STARTS)}</p>{tables.start_table(result)}",
        _refraction(result),
        f"<h2>What was inferred</h2><p>{escape(words.INFERRED_LEAD)}</p>{bullets(words.INFERRED)}",
        f"<h2>What is wrong or doubtful in the print</h2>{bullets(words.MISPRINTS)}",
        f"<h2>How it was run</h2>{_run_table(result, command)}",
    ]
    return document(
        "celestial-orbit",
        "An orbit from stars and the horizon, reproduced",
        "An orbit from stars and the horizon: Tables 1 to 3 of Ning and Ma (2010), run again",
        parts,
        paper.CITATION,
    )


FIGURES = (
    "One run (the first) of each filter. The scale is logarithmic, so that the smoothed error and "
    "the start fit into one picture; the paper draws the same on a linear one."
)
TABLE_NOTE = (
    "In each cell ours stands above and the paper's figure below it (small), where it has one. "
    "Means over the runs; ± is the standard deviation of the mean error from run to run. "
    "Positions in m, velocities in m/s, from 200 min on. NEES / 6 is 1 where a filter's errors "
    "are as large as it says; for J2 it is printed and not asked, as that process noise was "
    "chosen for accuracy. The paper's figures stand beside noise A; beside noise B there is none "
    "to compare with."
)


def _table_parts(result: Result) -> list[str]:
    out = [f"<h2>Mean position error at a glance</h2>{tables.overview(result)}"]
    out.append(f"<h2>Table 1: the filter period</h2>{_note(TABLE_NOTE)}")
    for period in PERIODS:
        out.append(f"<h3>T = {period:g} s</h3>{tables.period_table(result, period)}")
    out.append("<h2>Table 2: the distribution of the noise, T = 15 s, noise A</h2>")
    shown = "".join(f"<div>{tables.distribution_table(result, law)}</div>" for law in WORDS)
    return [*out, f'<div class="two">{shown}</div>']


def _refraction(result: Result) -> str:
    if not result.refraction:
        return ""
    text = f"<h2>The horizon from starlight refraction</h2><p>{escape(words.REFRACTION)}</p>"
    return text + tables.refraction_table(result)


def _note(text: str) -> str:
    return f'<p class="note">{escape(text)}</p>'


def _run_table(result: Result, command: str | None) -> str:
    rows = [
        ("Runs a cell", f"{result.runs}, each with its own noise; all filters see the same"),
        ("Runs against the bound", f"{result.long_runs}"),
        ("Seed", f"{result.seed}; the same figures for any number of threads"),
        ("Stars", words.sky(result)),
        ("Time", spell_time(result.elapsed_s)),
        *([("Command", command)] if command else []),
    ]
    return run_table(rows, [])
