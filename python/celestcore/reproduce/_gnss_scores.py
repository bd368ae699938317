"""The figures of the experiment under plain names, each with its target and bound."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from celestcore.reproduce import _gnss_paper as paper
from celestcore.reproduce._gnss_model import Cell
from celestcore.reproduce._gnss_series import (
    AXES,
    Series,
    attitude,
    mean,
    position,
    velocity,
    whole_attitude,
)
from celestcore.units import ARCSEC, DEG

if TYPE_CHECKING:
    from celestcore.reproduce.gnss_star import Result

Pair = tuple[float, float]


@dataclass(frozen=True)
class Asked:
    """What is asked of a figure at 1 m and at 10 m: at most, at least; and its bound."""

    most: Pair | None = None
    least: Pair | None = None
    bound: Pair | None = None
    reference: Pair | None = None
    """What a prototype found, or a filter's own sigma says, which is no target."""


ASKED = {
    "position_20x20": Asked(most=(0.47, 4.3), bound=(0.377, 3.77)),
    "position_20x20_smoothed": Asked(most=(0.29, 2.4), bound=(0.218, 2.18)),
    "position_4x4": Asked(most=(0.57, 4.9)),
    "position_kinematic": Asked(reference=(0.59, 5.4)),
    "position_kinematic_smoothed": Asked(reference=(0.40, 4.0)),
    "velocity_20x20": Asked(most=(2.2, 13.0), bound=(1.12, 11.2)),
    "pitch_no_lfe": Asked(most=(14.0, 14.0), reference=(13.7, 13.7)),
    "pitch_no_lfe_smoothed": Asked(most=(7.0, 7.0)),
    "pitch_lfe": Asked(most=(16.0, 16.0), bound=(7.4, 7.4)),
    "pitch_lfe_smoothed": Asked(most=(10.5, 10.5), bound=(7.4, 7.4)),
    "nees_attitude_lfe": Asked(most=(3.4, 3.4), least=(2.4, 2.4), bound=(3.0, 3.0)),
    "nees_attitude_lfe_smoothed": Asked(most=(3.4, 3.4), least=(2.4, 2.4), bound=(3.0, 3.0)),
    "pitch_gyro_lfe_smoothed": Asked(most=(5.2, 5.2)),
    "pitch_gyro_lfe_ignored_smoothed": Asked(least=(7.0, 7.0)),
    "position_coloured": Asked(reference=(1.56, 1.56)),
    "position_coloured_ignored": Asked(reference=(1.8, 1.8)),
    "nees_coloured": Asked(reference=(4.6, 4.6)),
    "nees_coloured_ignored": Asked(reference=(52.0, 52.0)),
}
"""Of the figures by their names; a bound of the LFE rows is the floor that the LFE itself sets."""


@dataclass(frozen=True)
class Figure:
    """One figure at one level of GPS noise."""

    name: str
    gps: float
    unit: str
    series: Series

    @property
    def key(self) -> str:
        """The name with the level."""
        return f"{self.name}_{self.gps:g}m"

    @property
    def asked(self) -> Asked:
        """What is asked of it."""
        return ASKED.get(self.name, Asked())

    def at_level(self, pair: Pair | None) -> float | None:
        """Return the one of a pair that goes with the level."""
        return None if pair is None else pair[paper.GPS.index(self.gps)]

    def met(self) -> bool | None:
        """Say whether the target is met; None without one."""
        most, least = self.at_level(self.asked.most), self.at_level(self.asked.least)
        if most is None and least is None:
            return None
        value = self.series.value
        return (most is None or value <= most) and (least is None or value >= least)

    def to_dict(self) -> dict[str, Any]:
        """Return it ready for JSON."""
        s, asked = self.series, self.asked
        return {
            "value": plain(s.value),
            "standard_error": plain(s.error),
            "mean_of_maxima": plain(s.maximum),
            "mean_of_maxima_standard_error": plain(s.maximum_error),
            "unit": self.unit,
            "gps_sigma_m": self.gps,
            "at_most": self.at_level(asked.most),
            "at_least": self.at_level(asked.least),
            "bound": self.at_level(asked.bound),
            "reference": self.at_level(asked.reference),
            "met": self.met(),
        }


def figures(result: Result) -> dict[str, Figure]:
    """Return all figures by their keys."""
    made = [Figure(*row) for gps in paper.GPS for row in _level(result, gps)]
    made += [Figure(name, 1.0, unit, series) for name, unit, series in _once(result)]
    return {figure.key: figure for figure in made}


def _level(result: Result, gps: float) -> Iterator[tuple[str, float, str, Series]]:
    """Yield the figures of one level of GPS noise."""
    for name, unit, series in (*_orbit(result, gps), *_attitude(result, gps)):
        yield name, gps, unit, series


def _orbit(result: Result, gps: float) -> Iterator[tuple[str, str, Series]]:
    reference, cell = result.references[gps], result.cells[Cell("clean", gps)]
    yield "position_gps", "m", reference.gps
    yield "position_kinematic", "m", reference.kinematic.series
    yield "position_kinematic_smoothed", "m", reference.kinematic_smoothed.series
    for name in ("zonal", "4x4", "8x8", "20x20", "20x20_smoothed"):
        yield f"position_{name}", "m", position(cell[name])
    yield "position_only_20x20", "m", position(cell["position_only"])
    wrong = result.cells[Cell("outliers", gps)]
    yield "position_outliers", "m", position(wrong["gated"])
    yield "position_outliers_ungated", "m", position(wrong["ungated"])
    yield "velocity_gps", "mm/s", reference.gps_velocity.times(1e3)
    for name in ("zonal", "4x4", "8x8", "20x20", "20x20_smoothed"):
        yield f"velocity_{name}", "mm/s", velocity(cell[name]).times(1e3)
    yield "velocity_position_only_20x20", "mm/s", velocity(cell["position_only"]).times(1e3)
    for name in ("zonal", "4x4", "8x8", "20x20", "20x20_smoothed"):
        yield f"nees_orbit_{name}", "", mean(cell[name].nees)


def _attitude(result: Result, gps: float) -> Iterator[tuple[str, str, Series]]:
    reference = result.references[gps]
    clean, slow = (result.cells[Cell(name, gps)] for name in ("clean", "lfe"))
    wrong = result.cells[Cell("outliers", gps)]
    for axis in AXES:
        yield f"{axis}_star", "arcsec", arcsec(reference.star[axis])
        yield f"{axis}_star_lfe", "arcsec", arcsec(reference.star_lfe[axis])
        each = {
            "no_lfe": clean["20x20"],
            "no_lfe_smoothed": clean["20x20_smoothed"],
            "baselines": clean["baselines"],
            "lfe": slow["states"],
            "lfe_smoothed": slow["states_smoothed"],
            "lfe_ignored": slow["ignored"],
            "lfe_ignored_smoothed": slow["ignored_smoothed"],
            "outliers": wrong["gated"],
            "outliers_ungated": wrong["ungated"],
        }
        for name, scores in each.items():
            yield f"{axis}_{name}", "arcsec", arcsec(attitude(scores, axis))
    for name, scores in (("no_lfe", clean["20x20"]), ("lfe", slow["states"])):
        yield f"nees_attitude_{name}", "", mean(scores.nees_attitude)
    yield "nees_attitude_lfe_smoothed", "", mean(slow["states_smoothed"].nees_attitude)
    yield "nees_attitude_lfe_ignored", "", mean(slow["ignored"].nees_attitude)
    yield "pitch_gps_baselines_5mm", "deg", degrees(reference.gps_pitch)
    yield "pitch_paper_scheme_5mm", "deg", degrees(reference.literal.series)


def _once(result: Result) -> Iterator[tuple[str, str, Series]]:
    """Yield what is run at 1 m only."""
    gyro = result.cells[Cell("gyro")]
    names = {"lfe": "states", "lfe_ignored": "ignored"}
    for axis in AXES:
        yield f"{axis}_star_gyro", "arcsec", arcsec(result.gyro_star[axis])
        for name, own in names.items():
            for end in ("", "_smoothed"):
                series = arcsec(attitude(gyro[own + end], axis))
                yield f"{axis}_gyro_{name}{end}", "arcsec", series
        for name in ("slew", "slew_back"):
            scores = result.cells[Cell(name)]["20x20"]
            yield f"{axis}_{name}", "arcsec", arcsec(attitude(scores, axis))
    yield "nees_attitude_gyro_lfe", "", mean(gyro["states"].nees_attitude)
    coloured = result.cells[Cell("coloured")]
    for own, name in (("states", "coloured"), ("ignored", "coloured_ignored")):
        for end in ("", "_smoothed"):
            yield f"position_{name}{end}", "m", position(coloured[own + end])
            yield f"nees_{name}{end}", "", mean(coloured[own + end].nees)
    nominal = result.cells[Cell("clean")]["20x20"]
    slewing = result.cells[Cell("slew")]["20x20"]
    yield "attitude_star", "arcsec", arcsec(result.slew.star)
    yield "attitude_navigator_nominal", "arcsec", arcsec(whole_attitude(nominal))
    yield "attitude_navigator_slew", "arcsec", arcsec(whole_attitude(slewing))
    yield "attitude_euler_nominal", "arcsec", arcsec(result.slew.nominal)
    yield "attitude_euler_slew", "arcsec", arcsec(result.slew.slew)


def arcsec(series: Series) -> Series:
    """Return radians as arcseconds."""
    return series.times(1.0 / ARCSEC)


def degrees(series: Series) -> Series:
    """Return radians as degrees."""
    return series.times(1.0 / DEG)


def plain(value: Any) -> float | None:
    """Return a number for JSON: None if it is not finite."""
    return float(value) if np.isfinite(value) else None
