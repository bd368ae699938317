"""celestcore: where a spacecraft is and which way it points, from its sensors.

Conventions, the same everywhere:

- Units are SI and radians; a name says so when it differs (``sigma_arcsec``).
- Quaternions are Hamilton's, scalar first ``(w, x, y, z)``, unit; ``q_ib`` takes body vectors to
  inertial ones, ``v_i = q_ib * v_b * conj(q_ib)``.
- Attitude errors stand on the right, in the body frame: ``q = q_hat * exp(dtheta / 2)``.
- Frames: ``i`` GCRS, ``e`` ITRS, ``o`` orbital (z to the Earth's centre, y against the orbit's
  normal), ``b`` body, ``c`` camera; ``q_ab`` takes ``b`` components to ``a`` components.
- Times are float64 seconds since one stated epoch.
- Noise is given as densities: gyro angle random walk ``arw`` [rad/sqrt(s)], rate random walk
  ``rrw`` [rad/s/sqrt(s)].
- Arrays: leading axes are time or trial, the last axis is the vector; outputs are fresh float64.

Examples
--------
>>> import celestcore as cc
>>> log = cc.sample("fermi")
>>> nav = cc.Settings.from_log(log).navigator()
>>> sol = nav.run(log)
>>> sol.q.shape == (len(sol), 4)
True
"""

from celestcore import (
    analysis,
    campaign,
    ccsds,
    celestial,
    elements,
    formats,
    frames,
    gnss,
    orbit,
    quaternion,
    replay,
    simulate,
    wahba,
)
from celestcore._core import __version__
from celestcore.calibration import Calibration
from celestcore.camera import CameraModel, StarCatalogue
from celestcore.celestial import (
    CelestialLog,
    CelestialNavigator,
    OrbitSolution,
    StarHorizon,
    StarRefraction,
)
from celestcore.config import Settings
from celestcore.errors import (
    CelestcoreError,
    CelestcoreWarning,
    InputError,
    LogFormatError,
    MissingDependencyError,
    NumericalError,
)
from celestcore.filters import (
    EKF,
    SRUKF,
    UKF,
    UPF,
    BootstrapPF,
    InvariantEKF,
    IteratedEKF,
    LiteralUKF,
    ScoreEKF,
)
from celestcore.formats import LogStream, Stamps, open_log
from celestcore.gnss import GnssReceiver, GnssStarNavigator, GnssStarSolution, LowFrequencyError
from celestcore.io import read_log, write_log
from celestcore.log import SensorLog
from celestcore.montecarlo import MonteCarlo, monte_carlo
from celestcore.navigator import StarGyroNavigator, StarGyroState
from celestcore.samples import sample, sample_names, sample_path
from celestcore.sensors import Gyro, StarCamera, VectorSensor
from celestcore.solution import Solution, StateAt
from celestcore.units import *  # noqa: F403 - plain floats, listed in units.__all__

__all__ = [
    "EKF",
    "SRUKF",
    "UKF",
    "UPF",
    "BootstrapPF",
    "Calibration",
    "CameraModel",
    "CelestcoreError",
    "CelestcoreWarning",
    "CelestialLog",
    "CelestialNavigator",
    "GnssReceiver",
    "GnssStarNavigator",
    "GnssStarSolution",
    "Gyro",
    "InputError",
    "InvariantEKF",
    "IteratedEKF",
    "LiteralUKF",
    "LogFormatError",
    "LogStream",
    "LowFrequencyError",
    "MissingDependencyError",
    "MonteCarlo",
    "NumericalError",
    "OrbitSolution",
    "ScoreEKF",
    "SensorLog",
    "Settings",
    "Solution",
    "Stamps",
    "StarCamera",
    "StarCatalogue",
    "StarGyroNavigator",
    "StarGyroState",
    "StarHorizon",
    "StarRefraction",
    "StateAt",
    "VectorSensor",
    "__version__",
    "analysis",
    "campaign",
    "ccsds",
    "celestial",
    "elements",
    "formats",
    "frames",
    "gnss",
    "monte_carlo",
    "open_log",
    "orbit",
    "quaternion",
    "read_log",
    "replay",
    "sample",
    "sample_names",
    "sample_path",
    "simulate",
    "wahba",
    "write_log",
]
