"""Seeded simulation: a true attitude, and what a gyro and star cameras report of it.

A `Scenario` is a `Truth` with the errors of its sensors. Its trials are numbered: trial ``k`` of a
seed is the same to the last bit, in whichever order and on whichever thread it is made. Every
source of noise of every trial has a stream of random numbers of its own (ChaCha with 8 rounds), so
that adding one source leaves the others as they were.

Examples
--------
>>> import celestcore as cc
>>> from celestcore import simulate
>>> gyro = simulate.GyroErrors(arw=1e-6, rrw=1e-9, bias_sigma=1 * cc.DEG_PER_HOUR)
>>> star = simulate.StarErrors(5 * cc.ARCSEC, every=2)
>>> scenario = simulate.Scenario(simulate.earth_pointing(600.0, dt=0.1), gyro, star)
>>> made = scenario.simulate(seed=1)
>>> sol = scenario.navigator(cc.UKF()).run(made.log)
>>> bool(abs(made.error(sol)[-1, :3]).max() < 5 * cc.ARCSEC)
True
"""

from __future__ import annotations

from celestcore.simulate import faults
from celestcore.simulate._field import StarField
from celestcore.simulate._scenario import Scenario, Simulation, log
from celestcore.simulate._sensors import GyroErrors, StarErrors
from celestcore.simulate._truth import (
    MU_EARTH,
    Truth,
    attitude,
    constant_rate,
    earth_pointing,
    slews,
)

__all__ = [
    "MU_EARTH",
    "GyroErrors",
    "Scenario",
    "Simulation",
    "StarErrors",
    "StarField",
    "Truth",
    "attitude",
    "constant_rate",
    "earth_pointing",
    "faults",
    "log",
    "slews",
]
