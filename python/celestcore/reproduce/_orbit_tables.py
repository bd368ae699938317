"""Tables 1 to 3 and what goes with them, as CSV files and as HTML."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from typing import TYPE_CHECKING, Any

import numpy as np

from celestcore.reproduce import _orbit_paper as paper
from celestcore.reproduce._html import csv_dicts, grid
from celestcore.reproduce._orbit_model import FILTERS, OUTLIERS, PERIODS, PUBLISHED, Cell
from celestcore.reproduce._orbit_scores import DOF, MEAN_OVER_RMS, Scores, bound_of, row
from celestcore.reproduce._orbit_targets import WORDS

if TYPE_CHECKING:
    from celestcore.reproduce.celestial_orbit import Result

COLUMNS = (
    ("pos. ± run", "mean_position", "mean_pos"),
    ("max", "max_position", "max_pos"),
    ("vel.", "mean_velocity", "mean_vel"),
    ("max", "max_velocity", "max_vel"),
)
SHORT = {
    "ekf_taylor": "EKF, Taylor step",
    "ekf": "EKF",
    "ukf": "UKF",
    "srukf": "square-root UKF",
    "upf": "UPF, one proposal",
    "upf_literal": "UPF, literal",
    "upf_bank": "UPF, bank of UKFs",
    "score": "score filter",
    "score_21x21": "score filter, 21×21",
    "ekf_gated": "EKF, gated",
    "huber": "EKF, Huber",
    "bootstrap": "bootstrap filter",
    "ekf_8x8": "EKF, 8×8",
    "ekf_21x21": "EKF, 21×21",
    "smoothed_21x21": "smoothed, 21×21",
}
LOST = 1e5
"""A position error beyond this [m] is shown in km."""
MUCH = 1000.0
"""NEES / 6 beyond this is only said to be."""


def csv_tables(result: Result) -> dict[str, str]:
    """Return the tables as CSV, by file name."""
    outliers = [row(OUTLIERS, name, s, None) for name, s in result.outliers.items()]
    tables = {
        "table_1": result.table1(),
        "table_2": result.table2(),
        "table_3": result.cost,
        "outliers": outliers,
        "shapes": result.shapes,
        "starts": result.starts,
        "refraction": result.refraction,
    }
    return {f"{name}.csv": csv_dicts(rows) for name, rows in tables.items()}


def overview(result: Result) -> str:
    """Return mean position errors by filter and period, noise A and B, with the bounds."""
    head = ["mean position error [m]; noise, T"]
    for noise in "AB":
        head += [f"{noise}, {p:g}\u00a0s" for p in PERIODS]
    cells = [Cell(p, noise) for noise in "AB" for p in PERIODS]
    rows = [
        [SHORT[name], *(_length(result.cells[cell][name].mean()) for cell in cells)]
        for name in FILTERS
    ]
    for what, name in (("any filter", "ekf_21x21"), ("any smoother", "smoothed_21x21")):
        limits = [bound_of(name, result.bounds.get(cell)) for cell in cells]
        shown = ["–" if v is None else f"{MEAN_OVER_RMS * v:.0f}" for v in limits]
        rows.append([f"bound of {what} (0.92 × Cramér-Rao rms)", *shown])
    return grid(head, rows)


def period_table(result: Result, period: float) -> str:
    """Return Table 1 for one period in the paper's columns: its numbers, ours with A and B."""
    groups = [("noise A", Cell(period)), ("noise B", Cell(period, "B"))]
    return _table(result, groups)


def distribution_table(result: Result, distribution: str) -> str:
    """Return Table 2 for one distribution of the noise."""
    return _table(result, [(WORDS[distribution], Cell(15.0, "A", distribution))])


def _table(result: Result, groups: Sequence[tuple[str, Cell]]) -> str:
    names = [name for name in FILTERS if all(name in result.cells[c] for _, c in groups)]
    titles = [*(title for title, _, _ in COLUMNS), "NEES/6"]
    heads = "".join(
        f'<th colspan="{len(titles)}" class="group">{escape(title)}</th>' for title, _ in groups
    )
    sub = "".join(
        f'<th class="{"first" if k == 0 else ""}">{escape(text)}</th>'
        for _ in groups
        for k, text in enumerate(titles)
    )
    lines = "".join(
        f'<tr><th style="text-align:left">{escape(SHORT[name])}</th>'
        + "".join(_cells(result.cells[cell][name], cell, name) for _, cell in groups)
        + "</tr>"
        for name in names
    )
    return (
        f'<div class="scroll"><table class="paper"><thead><tr><th rowspan="2"></th>{heads}</tr>'
        f"<tr>{sub}</tr></thead><tbody>{lines}</tbody></table></div>"
    )


def _cells(scores: Scores, cell: Cell, name: str) -> str:
    # the paper's figures are for what we call noise A: nothing to put beside noise B
    column = PUBLISHED.get(name) if cell.noise == "A" else None
    printed = paper.row(cell.period, cell.distribution, column)
    out = []
    for k, (_, key, of_paper) in enumerate(COLUMNS):
        position = key.endswith("position")
        ours = _length(scores.mean(key)) if position else f"{scores.mean(key):.3f}"
        text = f"<b>{ours}</b>{_scatter(scores)}" if k == 0 else ours
        if printed is not None:
            theirs = getattr(printed, of_paper)
            text += f"<br><small>{theirs:.{0 if position else 3}f}</small>"
        out.append(f'<td class="{"first" if k == 0 else ""}">{text}</td>')
    nees = scores.mean("nees") / DOF
    out.append(f"<td>{nees:.2f}</td>" if nees < MUCH else f"<td>&gt; {MUCH:.0f}</td>")
    return "".join(out)


def _scatter(scores: Scores) -> str:
    """Return the scatter from run to run, where the mean is not that of a lost filter."""
    scatter = scores.scatter()
    known = np.isfinite(scatter) and scores.mean() < LOST
    return f" ± {_length(scatter)}" if known else ""


def _length(value: float) -> str:
    """Return a length [m] for people."""
    if np.isnan(value):
        return "–"
    return f"{value:.0f}" if value < LOST else f"{value / 1e3:.0f} km"


def cost_table(result: Result) -> str:
    """Return Table 3: the paper's formulas, its time, ours, and what a step costs."""
    rows = []
    for r in result.cost:
        column = r["paper_column"]
        formula = ["–", "–"]
        if column:
            formula = [f"{paper.complexity(column, diagonal=d):,}" for d in (False, True)]
        seconds, printed = r["seconds_per_orbit"], r["paper_seconds"]
        rows.append(
            [
                r["what"],
                *formula,
                f"{r['accelerations_per_step']:,}",
                "–" if printed is None else f"{printed:g}",
                f"{1e3 * seconds:.2f}",
                f"{1e6 * seconds / r['steps_per_orbit']:.2f}",
                "–" if printed is None else f"{printed / seconds:,.0f}",
            ]
        )
    head = [
        "",
        "paper's formula, F full",
        "F diagonal",
        "accelerations a step",
        "paper [s / orbit]",
        "here [ms / orbit]",
        "[µs / step]",
        "paper / here",
    ]
    return grid(head, rows)


def particle_table(result: Result) -> str:
    """Return the particle filters: effective sample size, error, and how often they get lost."""
    head = ["T = 15 s, noise A", "noise", "effective", "median error [m]", "UKF [m]", "runs lost"]
    rows = []
    for name in ("upf", "upf_bank", "upf_literal", "bootstrap"):
        count = 1000 if name == "bootstrap" else paper.PARTICLES
        for key, words in WORDS.items():
            found = result.cells[Cell(15.0, "A", key)]
            scores = found[name]
            rows.append(
                [
                    SHORT[name],
                    words,
                    f"{scores.mean('ess'):.3g} of {count}",
                    _length(scores.median()),
                    _length(found["ukf"].median()),
                    f"{scores.lost} of {len(scores.mean_position)}",
                ]
            )
    return grid(head, rows)


def outlier_table(result: Result) -> str:
    """Return what 5 % outliers do to each filter."""
    head = ["T = 60 s, noise A", "mean [m]", "± run [m]", "max [m]", "measurements used [%]"]
    rows = [
        [
            FILTERS.get(name, name),
            _length(s.mean()),
            _length(s.scatter()),
            _length(s.mean("max_position")),
            f"{100 * s.mean('accepted'):.1f}",
        ]
        for name, s in result.outliers.items()
    ]
    return grid(head, rows)


def shape_table(result: Result) -> str:
    """Return what it costs not to know the edges of uniform noise."""
    head = ["edge told, over the half-width", "half-width told", "J2 [m]", "21×21 [m]"]
    rows = [
        [
            f"{r['edge']:g}",
            "right" if r["half_width"] == 1.0 else f"{100 * (r['half_width'] - 1):+.0f} %",
            _length(r["mean_pos_m"]),
            _length(r["mean_pos_21x21_m"]),
        ]
        for r in result.shapes
    ]
    return grid(head, rows)


def start_table(result: Result) -> str:
    """Return how many runs converge from large errors."""
    starts = list(dict.fromkeys(r["start"] for r in result.starts))
    kinds = list(dict.fromkeys(r["what"] for r in result.starts))
    found = {(r["start"], r["what"]): f"{r['converged']} of {r['of']}" for r in result.starts}
    rows = [[kind, *(found.get((start, kind), "–") for start in starts)] for kind in kinds]
    return grid(["start, 1 sigma per axis", *starts], rows)


def refraction_table(result: Result) -> str:
    """Return the orbit from stars seen through the atmosphere."""
    head = ["stars seen", "density error", "J2 [m]", "21×21 [m]", "expected, J2 / 21×21 [m]"]
    rows: dict[tuple[str, str], list[str]] = {}
    for r in result.refraction:
        line = rows.setdefault(
            (r["field"], r["density"]), [r["field"], r["density"], "–", "–", r["expected"]]
        )
        line[2 if r["gravity"] == "j2" else 3] = _measured(r)
    return grid(head, list(rows.values()))


def _measured(r: dict[str, Any]) -> str:
    mean, scatter = r["mean_pos_m"], r["run_sd_m"]
    if mean is None:
        return "–"
    return f"{mean:.0f}" + ("" if scatter is None else f" ± {scatter:.0f}")
