"""A result of the GPS and star-sensor experiment that is made up: every target is met."""

from __future__ import annotations

from typing import Any

import numpy as np
from celestcore.gnss import GnssStarScores
from celestcore.reproduce import _gnss_model as model
from celestcore.reproduce import gnss_star
from celestcore.reproduce._gnss_model import Cell
from celestcore.reproduce._gnss_reference import (
    AntennaAngles,
    Best,
    Covariance,
    Reference,
    Slew,
)
from celestcore.reproduce._gnss_series import AXES, Array, Series
from celestcore.reproduce._gnss_traces import Flight, Observed, SlowError, Traces, Turn
from celestcore.units import ARCSEC, DEG

Result = gnss_star.Result
RUNS = 100

# position [m] and velocity [mm/s] at 1 m, the rms of pitch ["]
ORBIT = {
    "20x20": (0.43, 1.9, 3.9, 11.5),
    "20x20_smoothed": (0.27, 1.3, 2.2, 4.6),
    "8x8": (0.51, 5.2, 4.1, 15.5),
    "4x4": (0.52, 7.1, 4.5, 24.0),
    "zonal": (0.53, 9.4, 5.1, 39.0),
    "position_only": (0.48, 2.2, 4.4, 15.0),
}
PITCH = {
    ("clean", "20x20_smoothed"): 6.5,
    ("lfe", "states"): 15.3,
    ("lfe", "ignored"): 15.3,
    ("lfe", "states_smoothed"): 10.0,
    ("lfe", "ignored_smoothed"): 10.0,
    ("outliers", "gated"): 13.6,
    ("outliers", "ungated"): 180.0,
    ("slew_back", "20x20"): 19.0,
    ("gyro", "states"): 7.3,
    ("gyro", "ignored"): 9.2,
    ("gyro", "states_smoothed"): 4.7,
    ("gyro", "ignored_smoothed"): 7.7,
}
NEES = {("coloured", "ignored"): 60.0, ("coloured", "ignored_smoothed"): 100.0}


def spread(value: float, runs: int = RUNS) -> Array:
    """Return runs whose rms is the value, to all digits; they scatter by a tenth."""
    rng = np.random.default_rng(round(1e3 * value))
    each = 1.0 + 0.1 * rng.standard_normal(runs)
    return np.asarray(value * each / np.sqrt(np.mean(each**2)))


def series(value: float) -> Series:
    return Series(spread(value), 2.5 * spread(value))


def scores(position: float, velocity: float, pitch: float, nees: float) -> GnssStarScores:
    """Return scores with these rms errors [m], [mm/s], [arcsec]."""
    axes = np.stack([spread(pitch * ARCSEC)] * 3, axis=1)
    one = np.ones(RUNS)
    return GnssStarScores(
        np.arange(RUNS),
        rms_position=spread(position),
        max_position=2.0 * spread(position),
        rms_velocity=1e-3 * spread(velocity),
        max_velocity=2e-3 * spread(velocity),
        rms_attitude=axes,
        max_attitude=2.5 * axes,
        nees=nees * one,
        nees_attitude=2.9 * one,
        nis=3.0 * one,
        nis_attitude=3.0 * one,
        rejected=0.0 * one,
        seconds=1e-3 * one,
        failures={},
    )


def cell(where: Cell) -> dict[str, GnssStarScores]:
    names = list(model.navigators(where))
    names += [f"{name}_smoothed" for name in model.SMOOTHED.get(where.name, ())]
    return {name: _scores(where, name) for name in names}


def _scores(where: Cell, name: str) -> GnssStarScores:
    known = ORBIT.get(name, ORBIT["20x20"])
    position, velocity = known[:2] if where.gps == 1.0 else known[2:]
    if where.name == "coloured":
        position = 1.56 if name.startswith("states") else 1.8
    elif name == "ungated":
        position *= 10.0
    pitch = PITCH.get((where.name, name), 13.4)
    return scores(position, velocity, pitch, NEES.get((where.name, name), 5.0))


def reference(gps: float) -> Reference:
    star = {axis: series(20.0 * ARCSEC) for axis in AXES}
    return Reference(
        gps=series(1.73 * gps),
        gps_velocity=series(0.0173 * gps),
        star=star,
        star_lfe={axis: series(21.3 * ARCSEC) for axis in AXES},
        kinematic=Best(series(0.6 * gps), 3e-5),
        kinematic_smoothed=Best(series(0.4 * gps), 1e-4),
        gps_pitch=series(0.143 * DEG),
        literal=Best(series(0.05 * DEG), 1e-26),
    )


def flight() -> Flight:
    rng, n = np.random.default_rng(1), 121
    track = np.stack([np.linspace(2.0, 1.6, n), np.linspace(1.0, -0.3, n), np.full(n, 5e5)], 1)

    def noise(size: float) -> Array:
        return size * rng.standard_normal((n, 3))

    near = (track + noise(1e-8), track + noise(1e-8))
    errors = (noise(0.3), np.full((n, 3), 0.3), noise(1.0))
    angles = (noise(7e-5), np.full((n, 3), 7e-5), noise(1e-4))
    return Flight(np.arange(n) * 10.0, track, *near, *errors, *angles)


def traces() -> Traces:
    t = np.arange(121) * 10.0
    one = np.full(121, 1e-4)
    turn = Turn(t, model.SLEW.pitch(t)[0], np.where(t > 900.0, 0.1, 1e-4), one, one)
    slow = SlowError(t, one, one, one)
    return Traces({1.0: flight(), 10.0: flight()}, turn, slow)


def made_up(**changes: Any) -> Result:
    """Return the result, with some parts changed."""
    first = np.tile([0.25, 0.25, 0.44, 0.45, 0.9999, 0.9999], (5, 1))
    parts: dict[str, Any] = {
        "runs": RUNS,
        "seed": 7,
        "cells": {where: cell(where) for where in model.CELLS},
        "references": {1.0: reference(1.0), 10.0: reference(10.0)},
        "slew": Slew(series(23.2 * ARCSEC), series(4600.0 * ARCSEC), series(34.7 * ARCSEC)),
        "gyro_star": {axis: series(21.3 * ARCSEC) for axis in AXES},
        "antennas": [AntennaAngles(1.0, 0.87, 0.55, 1.28), AntennaAngles(10.0, 1.7, 0.69, 1.8)],
        "least_squares": [Covariance(n, 20_000, 0.012, (1.0, 0.99, 1.01)) for n in (2, 3, 4)],
        "observed": Observed(first, np.tile(first, 2), [2] * 5, "slow error"),
        "traces": traces(),
        "elapsed_s": 40.0,
    }
    return Result(**{**parts, **changes})
