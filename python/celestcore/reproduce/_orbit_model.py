"""The experiment of section 4 of the paper, filled in where it is silent."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

import celestcore as cc
from celestcore.units import ARCSEC, DEG

Array = NDArray[np.float64]

EPOCH = "2007-07-01T12:00:00"
ELEMENTS = cc.elements.Elements(7136.635e3, 1.809e-3, 65.0 * DEG, 30.0 * DEG, 30.0 * DEG, 0.0)
DURATION = 36_000.0
"""Six orbits [s]; the figures of Table 3 are for one."""
ORBITS = 6
STEP = 3.0
"""The shortest period, at which the truth is computed [s]."""
SKIP = 12_000.0
"""Scored from here on [s]."""
MAGNITUDE, YEAR = 6.0, 2007.5
FIELD = (10.0 * DEG, 10.0 * DEG)
BRIGHTEST, MARGIN = 6, 100e3
SIGMA_STAR, SIGMA_NADIR = 3.0 * ARCSEC, 0.02 * DEG
START = (1e3, 1.0)
"""Sigma of the start per axis [m], [m/s]."""

PERIODS = (3.0, 15.0, 30.0, 60.0)
NOISES = ("A", "B")
DISTRIBUTIONS = ("normal", "student_t", "uniform")

ACCEL_PSD = {"j2": 4e-7, "8x8": 4e-9, "21x21": 3e-11}
"""White acceleration that stands for what a force model leaves out [m^2/s^3]."""
UNIFORM_PSD = {"score": 1e-6}
"""The same with J2 under uniform noise, where that filter is better and so needs a little more."""
OTHER_PSD = {"bootstrap": 3e-4}
"""The same with J2 where particles must be kept apart."""
EDGES = {"score": 0.01}
"""Softness of the edges of uniform noise as a filter is told, over the half-width; others 0.05."""
TAYLOR_PSD = {3.0: 1e-6, 15.0: 3e-6, 30.0: 1e-4, 60.0: 1e-2}
"""The same for the paper's second-order step, by period [s]."""

FILTERS = {
    "ekf_taylor": "EKF, second-order Taylor step (the paper's)",
    "ekf": "EKF, Runge-Kutta",
    "ukf": "UKF",
    "srukf": "square-root UKF",
    "upf": "unscented particle filter, one proposal",
    "upf_literal": "unscented particle filter, literal",
    "upf_bank": "unscented particle filter, bank of UKFs",
    "score": "score filter (Masreliez)",
    "score_21x21": "score filter, 21×21 gravity",
    "ekf_gated": "EKF with a gate",
    "huber": "EKF with Huber's weights",
    "bootstrap": "bootstrap particle filter",
    "ekf_8x8": "EKF, 8×8 gravity, Sun, Moon",
    "ekf_21x21": "EKF, 21×21 gravity, Sun, Moon",
    "smoothed_21x21": "the same, smoothed (not causal)",
}
"""The names of the JSON, and what they are; all but the last three and score_21x21 with J2."""
PUBLISHED = {
    "ekf_taylor": "EKF",
    "ekf": "EKF",
    "ukf": "UKF",
    "srukf": "UKF",
    "upf": "UPF",
    "upf_literal": "UPF",
    "upf_bank": "UPF",
}
"""The paper's column that a filter is put beside."""
PARTICLE_FORMS = {"upf": "proposal", "upf_literal": "literal", "upf_bank": "bank"}
SMOOTHED = {"ekf_21x21": "smoothed_21x21"}


class Cell(NamedTuple):
    """One scenario: what all filters are run on side by side."""

    period: float
    noise: str = "A"
    distribution: str = "normal"
    outliers: tuple[float, float] | None = None
    start: tuple[float, float] = START


TABLE_1 = [Cell(period, noise) for period in PERIODS for noise in NOISES]
TABLE_2 = [Cell(15.0, "A", distribution) for distribution in DISTRIBUTIONS]
CELLS = [*TABLE_1, *TABLE_2[1:]]
"""Of Tables 1 and 2; the normal cell of Table 2 is one of Table 1."""
OUTLIERS = Cell(60.0, outliers=(0.05, 50.0))
LOST = 10e3
"""A run with a mean position error beyond this has lost the satellite [m]."""
STARTS = {
    "100 km, 100 m/s": Cell(15.0, start=(100e3, 100.0)),
    "500 km, 500 m/s": Cell(15.0, start=(500e3, 500.0)),
}


def force(gravity: str) -> Any:
    """Return the force model of a filter: "j2", or a degree with Sun and Moon."""
    if gravity == "j2":
        return cc.orbit.ForceModel.j2()
    return cc.orbit.ForceModel(gravity=int(gravity.split("x")[0]), sun=True, moon=True)


def true_orbit() -> cc.orbit.Trajectory:
    """Return the truth at every 3 s."""
    r0, v0 = cc.elements.to_state(ELEMENTS)
    t = np.arange(round(DURATION / STEP) + 1) * STEP
    return cc.orbit.propagate(cc.orbit.ForceModel.high_fidelity(), EPOCH, r0, v0, t)


def catalogue() -> cc.StarCatalogue:
    """Return Hipparcos to magnitude 6, with proper motion, without aberration."""
    return cc.StarCatalogue.hipparcos(epoch=YEAR, magnitude=MAGNITUDE)
