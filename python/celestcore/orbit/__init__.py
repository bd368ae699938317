"""Orbits: what accelerates a satellite, and where that takes it.

A `ForceModel` is a value: gravity of any degree, Sun, Moon, sunlight and air drag composed by
naming them. `propagate` integrates it in the compiled core. Positions and velocities are
geocentric, GCRS, in m and m/s; times are seconds since the epoch.

Examples
--------
>>> import numpy as np
>>> from celestcore import orbit
>>> t = np.arange(0.0, 6000.0, 60.0)
>>> made = orbit.propagate(orbit.ForceModel.j2(), None, [7e6, 0, 0], [0, 4e3, 6.4e3], t)
>>> made.r.shape
(100, 3)
"""

from __future__ import annotations

from celestcore.orbit.dynamics import OrbitDynamics
from celestcore.orbit.field import GravityField
from celestcore.orbit.force import Drag, ForceModel, SolarPressure
from celestcore.orbit.propagate import Trajectory, propagate

__all__ = [
    "Drag",
    "ForceModel",
    "GravityField",
    "OrbitDynamics",
    "SolarPressure",
    "Trajectory",
    "propagate",
]
