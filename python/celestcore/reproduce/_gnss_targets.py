"""What section G asks of the experiment, and whether it came out."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from celestcore.reproduce import _gnss_paper as paper
from celestcore.reproduce._gnss_series import AXES
from celestcore.reproduce._target import Target

if TYPE_CHECKING:
    from celestcore.reproduce.gnss_star import Result

SAME = 0.01
"""How far attitude errors may differ between 1 m and 10 m of GPS noise."""
NO_WORSE = 1.1
"""By how much errors may grow with outliers, and in a slew."""
COVARIANCE = 0.03
UNSEEN, SEEN = 0.98, 0.5
"""Sigma over prior from which a combination counts as not seen, and up to which as seen."""
ROWS = (
    ("Position", "filter, 20×20 gravity", ("position_20x20",), "m", 3),
    ("Position", "smoothed, 20×20", ("position_20x20_smoothed",), "m", 3),
    ("Position", "filter, 4×4", ("position_4x4",), "m", 3),
    ("Velocity", "filter, 20×20", ("velocity_20x20",), "mm/s", 2),
    (
        "Attitude",
        "pitch without LFE, filter / smoothed (the filter's own sigma: 13.7″)",
        ("pitch_no_lfe", "pitch_no_lfe_smoothed"),
        "″",
        2,
    ),
    ("Attitude", "pitch with LFE, filter / smoothed", ("pitch_lfe", "pitch_lfe_smoothed"), "″", 2),
)
"""Block, words, figures, unit, digits: all are at most so much."""


def targets(result: Result) -> list[Target]:
    """Return all targets of the experiment."""
    return [
        *(_most(result, *row) for row in ROWS),
        _nees(result),
        _same(result),
        _gyro(result),
        _ignored(result),
        _observability(result),
        _covariance(result),
        *_outliers(result),
        _slew(result),
    ]


def value(result: Result, name: str, gps: float = 1.0) -> float:
    """Return a figure."""
    return result.figures[f"{name}_{gps:g}m"].series.value


def _judged(result: Result, met: object) -> bool | None:
    return bool(met) if result.full else None


def _listed(values: list[str]) -> str:
    return " / ".join(values)


def _most(
    result: Result, block: str, what: str, names: tuple[str, ...], unit: str, digits: int
) -> Target:
    asked, found, met = [], [], True
    bounds: dict[str, None] = {}
    for gps in paper.GPS:
        figures = [result.figures[f"{name}_{gps:g}m"] for name in names]
        asked.append(_listed([f"{f.at_level(f.asked.most):g}" for f in figures]))
        found.append(_listed([f"{f.series.value:.{digits}f}" for f in figures]))
        bounds |= {f"{f.at_level(f.asked.bound):g}": None for f in figures if f.asked.bound}
        met = met and all(f.met() for f in figures)
    wanted = asked[0] if asked[0] == asked[1] else "; ".join(asked)
    floor = f" (bound {_listed(list(bounds))})" if bounds else ""
    return Target(
        block,
        f"{what}, rms at 1 m; 10 m GPS: at most {wanted} {unit}{floor}",
        f"{'; '.join(found)} {unit}",
        _judged(result, met),
    )


def _nees(result: Result) -> Target:
    names = ("nees_attitude_lfe", "nees_attitude_lfe_smoothed")
    figures = [result.figures[f"{n}_{gps:g}m"] for gps in paper.GPS for n in names]
    found = [f"{f.series.value:.2f}" for f in figures]
    return Target(
        "Attitude",
        "NEES of 3 degrees of freedom with LFE states, filter / smoothed: 2.4 to 3.4 (3)",
        f"{_listed(found[:2])}; {_listed(found[2:])}",
        _judged(result, all(f.met() for f in figures)),
    )


SAME_NAMES = ("no_lfe", "no_lfe_smoothed", "lfe", "lfe_smoothed")


def difference(result: Result) -> float:
    """Return by how much attitude errors differ at most between the levels, relative."""
    pairs = [
        [value(result, f"{axis}_{name}", gps) for gps in paper.GPS]
        for axis in AXES
        for name in SAME_NAMES
    ]
    return float(max(abs(b / a - 1.0) for a, b in pairs))


def _same(result: Result) -> Target:
    found = difference(result)
    return Target(
        "Attitude",
        "the same at 1 m and 10 m GPS within 1 %, all axes, filter and smoothed",
        f"largest difference {100.0 * found:.2g} %",
        _judged(result, found <= SAME),
    )


def _gyro(result: Result) -> Target:
    figure = result.figures["pitch_gyro_lfe_smoothed_1m"]
    return Target(
        "Gyro",
        "gyro and LFE states over 3 orbits, smoothed pitch: at most 5.2″",
        f"{figure.series.value:.2f}″",
        _judged(result, figure.met()),
    )


def _ignored(result: Result) -> Target:
    figure = result.figures["pitch_gyro_lfe_ignored_smoothed_1m"]
    return Target(
        "Gyro",
        "the same without LFE states: more than 7″",
        f"{figure.series.value:.2f}″",
        _judged(result, figure.met()),
    )


def _observability(result: Result) -> Target:
    first, told = result.observed.first, result.observed.unobservable
    met = (
        np.all((first >= UNSEEN).sum(axis=1) == 2)
        and np.all((first <= SEEN).sum(axis=1) == 4)
        and all(n == 2 for n in told)
    )
    shown = ", ".join(f"{v:.3g}" if v < UNSEEN else f"{v:.4f}" for v in first.mean(axis=0))
    return Target(
        "Gyro",
        "first harmonic's coefficients: two combinations keep 0.98 of their prior sigma or more "
        "and are reported as unobservable, four at most 0.5",
        f"{shown}; reported: {sorted(set(told))[0] if len(set(told)) == 1 else told}",
        _judged(result, met),
    )


def _covariance(result: Result) -> Target:
    found = [row.difference for row in result.least_squares]
    draws = result.least_squares[0].draws
    shown = _listed([f"{100.0 * d:.2g}" for d in found])
    return Target(
        "Baselines",
        f"covariance of least-squares attitudes from 2 / 3 / 4 baselines, {draws} draws: within "
        "3 % of the analytic one",
        f"{shown} %",
        _judged(result, max(found) <= COVARIANCE),
    )


def outlier_ratios(result: Result) -> dict[str, list[float]]:
    """Return errors with gated outliers over those without, by what and by level."""
    pairs = {"position": ("position_outliers", "position_20x20")}
    pairs |= {axis: (f"{axis}_outliers", f"{axis}_no_lfe") for axis in AXES}
    return {
        what: [value(result, a, gps) / value(result, b, gps) for gps in paper.GPS]
        for what, (a, b) in pairs.items()
    }


def _outliers(result: Result) -> list[Target]:
    ratios, out = outlier_ratios(result), []
    for what, names in (("position", ("position",)), ("attitude", tuple(AXES))):
        found = [max(ratios[name][k] for name in names) for k in range(len(paper.GPS))]
        worst = ", worst axis" if len(names) > 1 else ""
        out.append(
            Target(
                "Outliers",
                f"5 % of the fixes wrong by 20 to 200 sigma, gated: {what} error at most 1.1 × "
                f"clean{worst}, 1 m / 10 m",
                _listed([f"{v:.3f}" for v in found]),
                _judged(result, max(found) <= NO_WORSE),
            )
        )
    return out


def slew_ratio(result: Result) -> float:
    """Return the navigator's attitude error in the slew over that in nominal flight, worst axis."""
    return max(value(result, f"{axis}_slew") / value(result, f"{axis}_no_lfe") for axis in AXES)


def _slew(result: Result) -> Target:
    found = slew_ratio(result)
    euler = value(result, "attitude_euler_slew") / value(result, "attitude_euler_nominal")
    return Target(
        "Slew",
        "through 90° of pitch: attitude error at most 1.1 × nominal, worst axis (the Euler filters "
        "fail there)",
        f"{found:.3f} (Euler filters {euler:.0f})",
        _judged(result, found <= NO_WORSE),
    )
