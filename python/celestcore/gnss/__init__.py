"""Position and attitude from GNSS and star sensors."""

from __future__ import annotations

from celestcore.gnss.antennas import Antennas, predict_attitude_sigma
from celestcore.gnss.attitude import GpsAttitude, direct_attitude, gps_attitude
from celestcore.gnss.navigator import GnssStarNavigator
from celestcore.gnss.sensors import (
    GaussMarkov,
    GnssReceiver,
    KinematicAttitude,
    LowFrequencyError,
)
from celestcore.gnss.solution import GnssStarSolution, Innovations, LfeReport
from celestcore.gnss.start import OrbitStart, orbit_start

__all__ = [
    "Antennas",
    "GaussMarkov",
    "GnssReceiver",
    "GnssStarNavigator",
    "GnssStarSolution",
    "GpsAttitude",
    "Innovations",
    "KinematicAttitude",
    "LfeReport",
    "LowFrequencyError",
    "OrbitStart",
    "direct_attitude",
    "gps_attitude",
    "orbit_start",
    "predict_attitude_sigma",
]
