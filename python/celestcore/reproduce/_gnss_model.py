"""The experiment with GPS and star sensor, filled in where the paper is silent."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

import celestcore as cc
from celestcore.gnss.scenario import ANTENNAS as PAIR
from celestcore.gnss.scenario import GYRO
from celestcore.reproduce import _gnss_paper as paper
from celestcore.units import ARCSEC, DEG

Array = NDArray[np.float64]

ANTENNAS: Array = np.array(PAIR)
"""Baselines, where they are used, body frame (2, 3) [m]."""
SKIP = 300.0
"""Filters are scored after this time [s], smoothers at all epochs."""
DEGREE = 70
"""Of the field EGM2008 of the truth; the filters take the same one to a lower degree."""
GRAVITY: dict[str, tuple[Any, float]] = {
    "20x20": (20, 1e-8),
    "8x8": (8, 1e-7),
    "4x4": (4, 1e-6),
    "zonal": ((20, 0), 3e-6),
}
"""Degree, or degree and order, and white acceleration that stands for the rest [m^2/s^3]."""
LFE = (10.0 * ARCSEC, 3.0 * ARCSEC)
"""Amplitudes of the star sensor's low-frequency error at once and twice the orbit's frequency."""
JERK = 1e-16
"""White angular jerk of the body about the orbital frame [rad^2/s^5]."""
SLEW_JERK = 1e-12
"""The same for a turn there and back, whose jerk is large."""
COLOURED = (1.0, 1800.0)
"""Gauss-Markov error of positions: 1-sigma [m] and time [s]."""
OUTLIERS = (0.05, 20.0, 200.0)
"""Share of wrong fixes, and by how many 1-sigmas at least and at most."""
SLEW = cc.gnss.Slew(120.0 * DEG, paper.DURATION, "turn")
THERE_AND_BACK = cc.gnss.Slew(120.0 * DEG, paper.DURATION, "return")
ORBITS = 3
"""Length of the runs with a gyro."""
GYRO_STEP = 1.0
BASELINE = 0.005
"""1-sigma of a carrier-phase baseline per axis [m]."""


class Cell(NamedTuple):
    """One scenario: what several navigators are run on side by side."""

    name: str
    gps: float = 1.0


CELLS = [
    *(Cell(name, gps) for name in ("clean", "lfe", "outliers") for gps in paper.GPS),
    Cell("slew"),
    Cell("slew_back"),
    Cell("coloured"),
    Cell("gyro"),
]
SMOOTHED = {
    "clean": ("20x20",),
    "lfe": ("states", "ignored"),
    "coloured": ("states", "ignored"),
    "gyro": ("states", "ignored"),
}
"""Of each cell the navigators that are smoothed as well."""


@cache
def field() -> cc.orbit.GravityField:
    """Return the field of truth and filters."""
    return cc.orbit.GravityField.egm2008(DEGREE)


def gyro_duration() -> float:
    """Return the length of three orbits, in whole steps [s]."""
    period = 2.0 * np.pi / scenario(Cell("clean")).mean_motion
    return float(np.floor(ORBITS * period / paper.STEP) * paper.STEP)


@cache
def scenario(cell: Cell) -> cc.gnss.GnssStarScenario:
    """Return what is simulated in a cell; its flight is computed once."""
    options: dict[str, Any] = {
        "clean": {"baselines": ANTENNAS, "baseline_sigma": BASELINE},
        "lfe": {"lfe": LFE},
        "outliers": {"gnss_outliers": OUTLIERS, "star_outliers": OUTLIERS},
        "slew": {"attitude": cc.gnss.AttitudeProfile(slew=SLEW)},
        "slew_back": {"attitude": cc.gnss.AttitudeProfile(slew=THERE_AND_BACK)},
        "coloured": {"gnss_markov": COLOURED},
    }
    if cell.name == "gyro":
        options["gyro"] = {
            "gyro": GYRO,
            "gyro_step": GYRO_STEP,
            "duration": gyro_duration(),
            "lfe": LFE,
        }
    return cc.gnss.GnssStarScenario(
        **{
            "gravity": field(),
            "duration": paper.DURATION,
            "step": paper.STEP,
            "gnss_sigma": cell.gps,
            "star_sigma": paper.STAR,
            "lfe": (),
            **options[cell.name],
        }
    )


@cache
def without_gyro() -> cc.gnss.GnssStarScenario:
    """Return the long scenario without its gyro: the same star fixes."""
    return replace(scenario(Cell("gyro")), gyro=None)


def navigator(gps: float, gravity: str = "20x20", **options: Any) -> cc.GnssStarNavigator:
    """Return a navigator that is told the noise.

    Parameters
    ----------
    gps : float
        1-sigma of positions [m]; a hundredth of it per second is that of velocities.
    gravity : str
        As in `GRAVITY`.
    **options
        Of the navigator; ``receiver`` of the receiver.
    """
    degree, psd = GRAVITY[gravity]
    force = cc.orbit.ForceModel(gravity=degree, field=field())
    receiver = {"sigma_velocity": 0.01 * gps, **options.pop("receiver", {})}
    return cc.GnssStarNavigator(
        dynamics=cc.orbit.OrbitDynamics(force, psd),
        gnss=cc.GnssReceiver(gps, **receiver),
        star=cc.StarCamera(paper.STAR),
        **{"attitude": cc.gnss.KinematicAttitude(JERK), **options},
    )


def navigators(cell: Cell) -> dict[str, cc.GnssStarNavigator]:
    """Return the navigators of a cell, by the names of the JSON."""
    gps, slow = cell.gps, cc.LowFrequencyError(LFE)
    if cell.name == "clean":
        antennas = cc.gnss.Antennas(ANTENNAS, BASELINE)
        return {
            **{name: navigator(gps, name) for name in GRAVITY},
            "position_only": navigator(gps, receiver={"sigma_velocity": None}),
            "baselines": navigator(gps, antennas=antennas),
        }
    if cell.name == "lfe":
        return {"states": navigator(gps, lfe=slow), "ignored": navigator(gps)}
    if cell.name == "outliers":
        return {"gated": navigator(gps), "ungated": navigator(gps, gate=1.0)}
    if cell.name == "coloured":
        bias = cc.gnss.GaussMarkov(*COLOURED)
        return {"states": navigator(gps, receiver={"bias": bias}), "ignored": navigator(gps)}
    if cell.name == "gyro":
        gyro = cc.Gyro(arw=float(np.ravel(GYRO.arw)[0]), rrw=float(np.ravel(GYRO.rrw)[0]))
        return {
            "states": navigator(gps, lfe=slow, gyro=gyro),
            "ignored": navigator(gps, gyro=gyro),
        }
    if cell.name == "slew_back":
        return {"20x20": navigator(gps, attitude=cc.gnss.KinematicAttitude(SLEW_JERK))}
    return {"20x20": navigator(gps)}
