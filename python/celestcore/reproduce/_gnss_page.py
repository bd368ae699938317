"""The page of the experiment with GPS and star sensor: one HTML file."""

from __future__ import annotations

from html import escape
from typing import TYPE_CHECKING

from celestcore.reproduce import _gnss_paper as paper
from celestcore.reproduce import _gnss_tables as tables
from celestcore.reproduce import _gnss_words as words
from celestcore.reproduce._gnss_figures import figures
from celestcore.reproduce._gnss_words import lead
from celestcore.reproduce._html import bullets, document, drawn, images, run_table, target_table
from celestcore.summary import spell_time

if TYPE_CHECKING:
    from celestcore.reproduce.gnss_star import Result

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
        shown["errors"],
        *_figures(shown),
        *_tables(result),
        f"<h2>A slew through 90° of pitch</h2><p>{escape(words.SLEW)}</p>{shown['slew']}",
        tables.length_table(result),
        tables.axes_table(result, tables.SLEW, "slew [arcsec]", targets=False),
        f"<h2>What is seen of the low-frequency error</h2><p>{escape(words.OBSERVED)}</p>",
        shown["observability"],
        f"<pre>{escape(result.observed.text)}</pre>",
        f"<h2>Coloured GPS error</h2><p>{escape(words.COLOURED)}</p>",
        tables.coloured_table(result),
        f"<h2>What GPS says of the attitude</h2>{tables.antenna_table(result)}",
        f"<p>{escape(words.COVARIANCE)}</p>{tables.covariance_table(result)}",
        f"<h2>What was inferred</h2><p>{escape(words.INFERRED_LEAD)}</p>{bullets(words.INFERRED)}",
        f"<h2>What is wrong or doubtful in the print</h2>{bullets(words.MISPRINTS)}",
        f"<h2>How it was run</h2>{_run_table(result, command)}",
    ]
    return document(
        "gnss-star",
        "GPS and star sensor, reproduced",
        "GPS and star sensor: the experiment of Zhang, Chen and Wang (2019), run again",
        parts,
        paper.CITATION,
    )


def _figures(shown: dict[str, str]) -> list[str]:
    return [
        f"<h2>Figures 3, 4 and 6: the track</h2>{_note(words.TRACKS)}{shown['figure_3_4_6']}",
        f"<h2>Figures 5 and 7: errors over time</h2>{shown['figure_5']}{shown['figure_7']}",
    ]


def _tables(result: Result) -> list[str]:
    position = tables.level_table(result, tables.POSITION, "position [m]", nees=True)
    velocity = tables.level_table(result, tables.VELOCITY, "velocity [mm/s]")
    return [
        "<h2>Tables 1 and 2: the two levels of GPS noise</h2>",
        f"<h3>Position</h3>{_note(words.POSITION)}{position}",
        f"<h3>Velocity</h3>{velocity}",
        f"<h3>Attitude</h3>{_note(words.ATTITUDE)}",
        tables.axes_table(result, tables.ATTITUDE, "20 minutes, no gyro [arcsec]"),
        _note(words.OUTLIERS),
        f"<h3>With a gyro</h3>{_note(words.GYRO)}",
        tables.axes_table(result, tables.GYRO, "three orbits, gyro [arcsec]"),
    ]


def _note(text: str) -> str:
    return f'<p class="note">{escape(text)}</p>'


def _run_table(result: Result, command: str | None) -> str:
    rows = [
        ("Runs a cell", f"{result.runs}, each with its own noise; all filters see the same"),
        ("Seed", f"{result.seed}; the same figures for any number of threads"),
        ("Time", spell_time(result.elapsed_s)),
        *([("Command", command)] if command else []),
    ]
    return run_table(rows, [])
