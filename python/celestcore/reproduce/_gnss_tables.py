"""The tables of the page, and the CSV files."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from celestcore.reproduce import _gnss_paper as paper
from celestcore.reproduce._gnss_scores import Figure
from celestcore.reproduce._html import csv_dicts, grid
from celestcore.units import DEG

if TYPE_CHECKING:
    from celestcore.reproduce.gnss_star import Result

POSITION = {
    "position_gps": "raw GPS fixes",
    "position_kinematic": "best kinematic filter, each coordinate",
    "position_kinematic_smoothed": "the same, smoothed",
    "position_zonal": "filter, zonal gravity to degree 20",
    "position_4x4": "filter, 4×4",
    "position_8x8": "filter, 8×8",
    "position_20x20": "filter, 20×20",
    "position_only_20x20": "filter, 20×20, positions without velocities",
    "position_20x20_smoothed": "smoothed, 20×20 (not causal)",
    "position_outliers": "filter, 20×20, 5 % outliers, gated",
    "position_outliers_ungated": "the same without a gate",
}
VELOCITY = {
    "velocity_gps": "raw GPS fixes",
    "velocity_zonal": "filter, zonal gravity to degree 20",
    "velocity_4x4": "filter, 4×4",
    "velocity_8x8": "filter, 8×8",
    "velocity_20x20": "filter, 20×20",
    "velocity_position_only_20x20": "filter, 20×20, positions without velocities",
    "velocity_20x20_smoothed": "smoothed, 20×20 (not causal)",
}
ATTITUDE = {
    "star": "raw star sensor, no LFE",
    "no_lfe": "filter",
    "no_lfe_smoothed": "smoothed (not causal)",
    "baselines": "filter, with baselines of 5 mm",
    "outliers": "filter, 5 % outliers, gated",
    "outliers_ungated": "the same without a gate",
    "star_lfe": "raw star sensor, LFE",
    "lfe": "filter, LFE states",
    "lfe_smoothed": "smoothed, LFE states (not causal)",
    "lfe_ignored": "filter that ignores the LFE",
    "lfe_ignored_smoothed": "the same, smoothed",
}
GYRO = {
    "star_gyro": "raw star sensor, LFE",
    "gyro_lfe": "filter, LFE states",
    "gyro_lfe_smoothed": "smoothed, LFE states (not causal)",
    "gyro_lfe_ignored": "filter that ignores the LFE",
    "gyro_lfe_ignored_smoothed": "the same, smoothed",
}
SLEW = {
    "star": "raw star sensor",
    "no_lfe": "nominal flight, filter",
    "slew": "slew at a constant rate through 90° of pitch",
    "slew_back": "slew by 120° and back, jerk density 1e-12 rad²/s⁵",
}
LENGTHS = {
    "attitude_star": "raw star sensor",
    "attitude_navigator_nominal": "navigator, nominal flight",
    "attitude_euler_nominal": "Euler filters, nominal flight",
    "attitude_navigator_slew": "navigator, slew",
    "attitude_euler_slew": "Euler filters, slew",
}
COLOURED = {"coloured": "with bias states", "coloured_ignored": "without: white noise assumed"}


def csv_tables(result: Result) -> dict[str, str]:
    """Return the tables as CSV, by file name."""
    rows = [{"name": key, **f.to_dict()} for key, f in result.figures.items()]
    return {
        "figures.csv": csv_dicts(rows),
        "antennas.csv": csv_dicts([row._asdict() for row in result.antennas]),
        "least_squares.csv": csv_dicts(
            [row._asdict() | {"sigma": list(row.sigma)} for row in result.least_squares]
        ),
    }


def number(value: float) -> str:
    """Return a figure with three digits or so."""
    if not np.isfinite(value):
        return "–"
    if value >= 100.0:
        return f"{value:.0f}"
    return f"{value:.{3 if value < 1.0 else 2 if value < 10.0 else 1}f}"


def _with_error(figure: Figure) -> str:
    """Return a figure and its standard error, to the same digits, on one line."""
    shown, error = number(figure.series.value), figure.series.error
    if not np.isfinite(error):
        return shown
    digits = len(shown.partition(".")[2])
    return f"{shown}\u00a0±\u00a0{error:.{digits}f}"


def level_table(result: Result, names: dict[str, str], what: str, nees: bool = False) -> str:
    """Return rms and largest errors at 1 m and 10 m, with what is asked."""
    head = [what]
    for gps in paper.GPS:
        head += [f"{gps:g} m GPS: rms", "max", "asked", *(["NEES / 6"] if nees else [])]
    rows = []
    for name, words in names.items():
        row = [words]
        for gps in paper.GPS:
            figure = result.figures[f"{name}_{gps:g}m"]
            row += [_with_error(figure), number(figure.series.maximum), asked(figure)]
            if nees:
                own = result.figures.get(f"{name.replace('position', 'nees_orbit')}_{gps:g}m")
                row.append("–" if own is None else f"{own.series.value / 6.0:.2f}")
        rows.append(row)
    return grid(head, rows)


def asked(figure: Figure) -> str:
    """Return what is asked of a figure, and in brackets its bound or what else there is."""
    wanted = figure.asked
    most, least, bound = (figure.at_level(p) for p in (wanted.most, wanted.least, wanted.bound))
    other = figure.at_level(wanted.reference) if bound is None else bound
    parts = [] if most is None else [f"≤\u00a0{most:g}"]
    parts += [] if least is None else [f">\u00a0{least:g}"]
    parts += [] if other is None else [f"({other:g})"]
    return "\u00a0".join(parts) or "–"


def axes_table(result: Result, names: dict[str, str], what: str, *, targets: bool = True) -> str:
    """Return rms and largest errors in pitch, roll and yaw, at 1 m GPS."""
    head = [what]
    for axis in ("pitch", "roll", "yaw"):
        head += [f"{axis}: rms", "max"]
    rows = []
    for name, words in names.items():
        row = [words]
        for axis in ("pitch", "roll", "yaw"):
            figure = result.figures[f"{axis}_{name}_1m"]
            row += [_with_error(figure), number(figure.series.maximum)]
        rows.append([*row, *([asked(result.figures[f"pitch_{name}_1m"])] if targets else [])])
    return grid([*head, *(["pitch asked"] if targets else [])], rows)


def length_table(result: Result) -> str:
    """Return the lengths of attitude errors in the slew, navigator and Euler filters."""
    rows = []
    for name, words in LENGTHS.items():
        figure = result.figures[f"{name}_1m"]
        rows.append([words, _with_error(figure)])
    return grid(["length of the attitude error [arcsec]", "rms"], rows)


def coloured_table(result: Result) -> str:
    """Return what coloured GPS error does."""
    rows = []
    for name, words in COLOURED.items():
        for end, how in (("", "filter"), ("_smoothed", "smoothed")):
            position, nees = (
                result.figures[f"{kind}_{name}{end}_1m"] for kind in ("position", "nees")
            )
            rows.append(
                [
                    f"{how}, {words}",
                    _with_error(position),
                    number(position.series.maximum),
                    _with_error(nees),
                    "–" if end else f"{asked(position)}; {asked(nees)}",
                ]
            )
    head = ["coloured error", "position rms [m]", "max", "NEES (6 dof)", "prototype: m; NEES"]
    return grid(head, rows)


def antenna_table(result: Result) -> str:
    """Return what GPS says of the attitude: antenna positions, and carrier-phase baselines."""
    rows = [
        [f"antenna positions, {a.gps:g} m", *(f"{v / DEG:.1f}" for v in (a.pitch, a.roll, a.yaw))]
        for a in result.antennas
    ]
    own = result.figures["pitch_gps_baselines_5mm_1m"].series.value
    scheme = result.figures["pitch_paper_scheme_5mm_1m"].series.value
    rows.append(["carrier-phase baselines, 5 mm", f"{own:.3f}", "–", "–"])
    rows.append(["the same, through the paper's scheme", f"{scheme:.3f}", "–", "–"])
    return grid(["rms error [°]", "pitch", "roll", "yaw"], rows)


def covariance_table(result: Result) -> str:
    """Return covariances of least-squares attitudes against the analytic ones."""
    rows = [
        [f"{c.baselines}", f"{100.0 * c.difference:.2f} %", *(f"{v:.4f}" for v in c.sigma)]
        for c in result.least_squares
    ]
    return grid(["baselines", "difference of covariances", "sigma: roll", "pitch", "yaw"], rows)
