"""Tables 3 to 5 and block N as CSV files and as HTML."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from celestcore.reproduce._html import csv_dicts, csv_text
from celestcore.reproduce._paper import AXES, GYRO, STAR
from celestcore.reproduce._targets import WITHIN, out_of_reach

if TYPE_CHECKING:
    from celestcore.reproduce.star_gyro import Result

COLUMNS = (
    "paper_ekf",
    "r2",
    "r2_swapped",
    "paper_ukf",
    "r1",
    "r1_swapped",
    "mekf",
    "ukf",
    "ukf7",
    "bound_filter",
    "smoothed",
    "bound_smoother",
)
GROUPS = (
    ("EKF", ("paper_ekf", "r2"), "paper<br>R2"),
    ("UKF", ("paper_ukf", "r1"), "paper<br>R1"),
    ("tuned filters", ("mekf", "ukf7", "bound_filter"), "MEKF = UKF<br>7-state UKF<br>bound"),
    ("smoothed, not causal", ("smoothed", "bound_smoother"), "smoothed<br>bound"),
)


def csv_tables(result: Result) -> dict[str, str]:
    """Return the tables as CSV, by file name; figures in arcsec, 3 sigma."""
    out = {}
    for k in range(len(STAR)):
        head = ["gyro_arcsec_per_s", *(f"{name}_{axis}" for name in COLUMNS for axis in AXES)]
        rows = (
            [f"{g:g}", *(f"{v:.4f}" for name in COLUMNS for v in result.figures(name)[k, j])]
            for j, g in enumerate(GYRO)
        )
        out[f"table_{3 + k}.csv"] = csv_text([head, *rows])
    return out | {"block_n.csv": csv_dicts(result.n_block)}


def table(result: Result, camera: int) -> str:
    """Return Table 3, 4 or 5 as HTML, in the paper's layout with all numbers of a cell in it."""
    figures = {name: result.figures(name)[camera] for name in COLUMNS}
    beyond = out_of_reach(result, "paper_ukf")[camera]
    heads = "".join(
        f'<th colspan="3" class="group">{name}<br><small>{what}</small></th>'
        for name, _, what in GROUPS
    )
    axes = "".join(
        f'<th class="{"first" if axis == "pitch" else ""}">{axis}</th>'
        for _ in GROUPS
        for axis in AXES
    )
    lines = []
    for j, gyro in enumerate(GYRO):
        cells = []
        for group, names, _ in GROUPS:
            for axis in range(3):
                values = [float(figures[name][j, axis]) for name in names]
                mark = "†" if group == "UKF" and beyond[j, axis] else ""
                best = group == "EKF" and values[0] <= figures["paper_ukf"][j, axis]
                cells.append(_stack(group, values, axis == 0, mark or ("‡" if best else "")))
        lines.append(f"<tr><th>{gyro:.1f}</th>{''.join(cells)}</tr>")
    return (
        f'<div class="scroll"><table class="paper"><thead><tr><th rowspan="2">gyro<br>'
        f"<small>[″/s]</small></th>{heads}</tr><tr>{axes}</tr></thead>"
        f"<tbody>{''.join(lines)}</tbody></table></div>"
    )


def _stack(group: str, values: list[float], first: bool, mark: str) -> str:
    """Return one cell: the paper's number above, ours below, in red where they are far apart."""
    published = group in ("EKF", "UKF")
    off = published and abs(values[1] / values[0] - 1.0) > WITHIN
    classes = " ".join(c for c in ("first" if first else "", "off" if off else "") if c)
    # as many digits as the paper prints
    digits = 3 if not published else 2 if round(values[0], 2) == values[0] else 4
    top = f"{values[0]:.{digits}f}{mark}"
    rest = "".join(f"<br><small>{v:.3f}</small>" for v in values[1:])
    return f'<td class="{classes}">{top}{rest}</td>'


def lost_rows(result: Result) -> list[list[str]]:
    """Return blocks N1 and N3: filter, and the share not settled in each case [%]."""
    cases = (("N1", "90°"), ("N1", "150°"), ("N3", "magnetometer"))
    keys = list(dict.fromkeys((r["form"], r["filter"]) for r in result.n_block))
    found = {
        (r["block"], r["case"], r["form"], r["filter"]): r.get("not_settled_percent")
        for r in result.n_block
    }
    return [
        [
            f"{name} ({form})",
            *(_percent(found.get((block, case, form, name))) for block, case in cases),
        ]
        for form, name in keys
    ]


def bias_rows(result: Result) -> list[list[str]]:
    """Return block N2: interval, filter, bias errors after fixes 1, 3, 10 [deg/s], NEES / 6."""
    return [
        [
            r["case"],
            r["filter"],
            *(f"{v:.2g}" if np.isfinite(v) else "lost" for v in r["median_bias_deg_per_s"]),
            f"{r['median_nees_6']:.3g}",
        ]
        for r in result.n_block
        if r["block"] == "N2"
    ]


def _percent(value: float | None) -> str:
    return "–" if value is None else f"{value:.0f} %"
