"""Autonomous navigation of an Earth satellite by stars: angles to the nadir, starlight refraction.

A `CelestialNavigator` estimates position and velocity (GCRS, m and m/s) over a `CelestialLog` of
angles to known stars.

Examples
--------
>>> import celestcore as cc
>>> dynamics = cc.orbit.OrbitDynamics(cc.orbit.ForceModel.j2(), accel_psd=4e-7)
>>> cc.CelestialNavigator(cc.UKF(), dynamics, cc.StarHorizon()).filter.kind
'ukf'
"""

from __future__ import annotations

from celestcore.celestial.camera import SkyCamera, StarsInView
from celestcore.celestial.log import AngleTable, CelestialLog
from celestcore.celestial.measurements import StarHorizon
from celestcore.celestial.montecarlo import MonteCarlo, Pooled, Scores, monte_carlo
from celestcore.celestial.navigator import CelestialNavigator
from celestcore.celestial.refracted import RefractedStars, refracted_stars
from celestcore.celestial.refraction import Atmosphere, Rays, StarRefraction
from celestcore.celestial.scenario import Scenario
from celestcore.celestial.solution import OrbitSolution
from celestcore.celestial.stream import CelestialState

__all__ = [
    "AngleTable",
    "Atmosphere",
    "CelestialLog",
    "CelestialNavigator",
    "CelestialState",
    "MonteCarlo",
    "OrbitSolution",
    "Pooled",
    "Rays",
    "RefractedStars",
    "Scenario",
    "Scores",
    "SkyCamera",
    "StarHorizon",
    "StarRefraction",
    "StarsInView",
    "monte_carlo",
    "refracted_stars",
]
