"""Position and attitude from GNSS and star sensors."""

from __future__ import annotations

from celestcore.gnss.antennas import Antennas, predict_attitude_sigma
from celestcore.gnss.attitude import GpsAttitude, direct_attitude, gps_attitude
from celestcore.gnss.axis import AxisEstimate, axis_filter, euler_filter
from celestcore.gnss.montecarlo import (
    GnssStarMonteCarlo,
    GnssStarPooled,
    GnssStarScores,
    monte_carlo,
)
from celestcore.gnss.navigator import GnssStarNavigator
from celestcore.gnss.profile import AttitudeProfile, Slew
from celestcore.gnss.scenario import ANTENNAS, GYRO, ORBIT, GnssStarScenario, GnssStarTrial
from celestcore.gnss.sensors import (
    GaussMarkov,
    GnssReceiver,
    KinematicAttitude,
    LowFrequencyError,
)
from celestcore.gnss.solution import GnssStarSolution, Innovations, LfeReport
from celestcore.gnss.start import OrbitStart, orbit_start
from celestcore.gnss.stream import FixReport, GnssStarState

__all__ = [
    "ANTENNAS",
    "GYRO",
    "ORBIT",
    "Antennas",
    "AttitudeProfile",
    "AxisEstimate",
    "FixReport",
    "GaussMarkov",
    "GnssReceiver",
    "GnssStarMonteCarlo",
    "GnssStarNavigator",
    "GnssStarPooled",
    "GnssStarScenario",
    "GnssStarScores",
    "GnssStarSolution",
    "GnssStarState",
    "GnssStarTrial",
    "GpsAttitude",
    "Innovations",
    "KinematicAttitude",
    "LfeReport",
    "LowFrequencyError",
    "OrbitStart",
    "Slew",
    "axis_filter",
    "direct_attitude",
    "euler_filter",
    "gps_attitude",
    "monte_carlo",
    "orbit_start",
    "predict_attitude_sigma",
]
