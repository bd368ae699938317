"""The page: one HTML file, for somebody who has the paper in the other hand."""

from __future__ import annotations

from html import escape
from typing import TYPE_CHECKING

import numpy as np

from celestcore.reproduce import _paper, _tables, _words
from celestcore.reproduce._figures import figures
from celestcore.reproduce._html import (
    bullets,
    document,
    drawn,
    grid,
    images,
    run_table,
    target_table,
)
from celestcore.reproduce._targets import WITHIN, difference, within
from celestcore.summary import spell_time

if TYPE_CHECKING:
    from celestcore.reproduce.star_gyro import Result


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
        "" if result.full else f'<p class="warn">{escape(_few(result))}</p>',
        f"<h2>What must not be claimed</h2>{bullets(_words.not_claimed(result))}",
        f"<h2>What was asked and what came out</h2>{target_table(result.targets())}",
        shown["ratios"],
        *_table_parts(result),
        *_figure_parts(shown),
        f"<h2>What the paper reads off its tables</h2>{_readings(result)}",
        f"<h2>Where a sigma-point or an iterated filter does win</h2>{_n_block(result)}",
        f"<h2>What was inferred</h2><p>{escape(_words.INFERRED_LEAD)}</p>",
        bullets(_words.INFERRED),
        f"<h2>What is wrong or unused in the print</h2>{bullets(_words.MISPRINTS)}",
        f"<h2>How it was run</h2>{_run_table(result, command)}",
    ]
    return document(
        "star-gyro",
        "Star camera and gyro, reproduced",
        "Star camera and gyro: Tables 3 to 5 of Wang and Jiang (2020), run again",
        parts,
        _paper.CITATION,
    )


def lead(result: Result) -> str:
    """Return the outcome in a few sentences."""
    below = int(np.sum(result.figures("mekf") < result.figures("paper_ukf")))
    worst = float(np.max(result.figures("smoothed") / result.figures("paper_ukf")))
    return (
        f"With one fixed tuning each, {within(result, 'r1', 'paper_ukf')} of the 108 published UKF "
        f"figures and {within(result, 'r2', 'paper_ekf')} of the 108 EKF figures come out within "
        f"10 %. With the same tuning, EKF and UKF agree to "
        f"{max(difference(result, a, b) for a, b in _SWAPS):.0e}: the published gain is one of "
        f"tuning. A filter that knows its sensors beats the published UKF in {below} of 108 "
        f"figures; forward-backward smoothing, for work on the ground, "
        + (
            f"in all of them, with at most {worst:.2f} of its error."
            if worst < 1.0
            else f"reaches {worst:.2f} of its error at worst."
        )
    )


_SWAPS = (("r1", "r1_swapped"), ("r2", "r2_swapped"), ("mekf", "ukf"))


def _few(result: Result) -> str:
    return (
        f"A run with few trials ({result.runs} a cell, {result.n_runs} in block N): single orbits "
        "scatter by up to 7 %, so most targets are not judged (–). Leave out --quick for "
        "the figures to quote."
    )


def _table_parts(result: Result) -> list[str]:
    note = (
        "In each cell the paper's figure stands above, ours below it (small); red: more than "
        f"{100 * WITHIN:.0f} % apart. † below what a causal filter can reach under this "
        "convention. ‡ the paper's EKF is at least as good as its UKF. All in arcsec, 3 sigma, "
        "just after each fix, pooled over the orbits. MEKF and UKF are the same to all digits "
        "shown; the swaps and both other metrics (at 10 Hz, before the fixes) are in the JSON."
    )
    parts = [f'<h2>Tables 3 to 5</h2><p class="note">{escape(note)}</p>']
    for k, star in enumerate(_paper.STAR):
        parts.append(f"<h3>Table {3 + k}: {star:g}″ star camera</h3>{_tables.table(result, k)}")
    return parts


def _figure_parts(pictures: dict[str, str]) -> list[str]:
    note = (
        "Open marks are the paper's, read from its tables. Lines through them are blocks R1 and "
        "R2; below them what a tuned filter and a smoother reach, with the bounds from the Riccati "
        "equation."
    )
    shown = "".join(pictures[f"figure_{k}"] for k in range(2, 8))
    return [
        f'<h2>Figures 2 to 7</h2><p class="note">{escape(note)}</p><div class="two">{shown}</div>'
    ]


def _readings(result: Result) -> str:
    gains = result.gains()
    sources = (
        ("as printed in the text", gains["printed"]),
        ("recomputed from its tables, all figures", gains["from_paper_tables"]),
        ("only where its UKF wins", gains["from_paper_tables_where_ukf_wins"]),
        ("R1 over R2", gains["from_r1_r2"]),
        ("UKF over EKF, same tuning", gains["same_tuning"]),
    )
    gain_rows = [
        [name, *(" / ".join(f"{v:.0f}" if k == 0 else f"{v:.1f}" for v in row) for row in rows)]
        for k, (name, rows) in enumerate(sources)
    ]
    head = ["gain of UKF over EKF, pitch / roll / yaw [%]", *(f"{s:g}″" for s in _paper.STAR)]
    reading_rows = [
        [
            row["what"],
            row["column"],
            f"{row['printed']:.1f}",
            *(
                _gyro(row[name])
                for name in (("paper_ekf", "r2") if row["column"] == "EKF" else ("paper_ukf", "r1"))
            ),
            _gyro(row["mekf"]),
            _gyro(row["smoothed"]),
        ]
        for row in result.readings()
    ]
    asks = ["gyro needed [″/s]", "", "text", "its table", "R1 / R2", "tuned filter", "smoothed"]
    better, equal = gains["paper_ekf_better"], gains["paper_equal"]
    return (
        grid(head, [[c.replace("-0.0", "0.0") for c in row] for row in gain_rows])
        + f"<p>{escape(_words.wins(better, equal))}</p>"
        + grid(asks, reading_rows)
        + _cost(result)
        + _error_free(result)
    )


def _gyro(value: float | None) -> str:
    return "above 2.4" if value is None else f"{value:.2f}"


def _cost(result: Result) -> str:
    cost = result.cost()
    rows = [
        [_words.FILTERS[name], f"{1e3 * cost['seconds_per_orbit'][name]:.1f}", f"{factor or 0:.1f}"]
        for name, factor in cost["times_mekf"].items()
    ]
    head = ["one orbit, 56 594 gyro samples and 28 297 fixes", "time [ms]", "times the MEKF"]
    return f"<h3>Cost</h3><p>{escape(_words.COST)}</p>" + grid(head, rows)


def _error_free(result: Result) -> str:
    rows = [
        [
            f"{r['star_arcsec']:g}" if r["star_arcsec"] else "none",
            f"{r['gyro_arcsec_per_s']:g}" if r["gyro_arcsec_per_s"] else "none",
            *(f"{r[axis]:.2g}" for axis in _paper.AXES),
        ]
        for r in result.error_free
    ]
    head = ["camera error [″]", "gyro error [″/s]", *(f"{axis} [″]" for axis in _paper.AXES)]
    words = f"<h3>Sensors without errors</h3><p>{escape(_words.ERROR_FREE)}</p>"
    return words + grid(head, rows)


def _n_block(result: Result) -> str:
    runs = result.n_block[0]["runs"] if result.n_block else 0
    head_1 = ["not settled [% of runs]", "N1, 90°", "N1, 150°", "N3, magnetometer"]
    names = (f"fix {k}" for k in (1, 3, 10))
    head_2 = [
        "fixes every",
        "filter",
        *(f"bias error, {n} [°/s]" for n in names),
        "NEES / 6, fix 3",
    ]
    return (
        f"<p>{escape(_words.block_n(runs))}</p>"
        + bullets(_words.N_CASES)
        + grid(head_1, _tables.lost_rows(result))
        + f'<p class="note">{escape(_words.FORMS)}</p>'
        + grid(head_2, _tables.bias_rows(result))
    )


def _run_table(result: Result, command: str | None) -> str:
    rows = [
        ("Orbits a cell", f"{result.runs}, each with its own noise"),
        ("Runs a case in block N", f"{result.n_runs}"),
        ("Seed", f"{result.seed}; the same figures for any number of threads"),
        ("Scored", "just after each fix, from 1000 s on (smoother: to 1000 s before the end)"),
        ("Time", spell_time(result.elapsed_s)),
        *([("Command", command)] if command else []),
    ]
    return run_table(rows, _words.RUN)
