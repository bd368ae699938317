"""Units as plain floats to multiply with: everything inside celestcore is SI and radians.

Examples
--------
>>> sigma = 5 * ARCSEC                     # 5 arcseconds in rad
>>> arw = 0.003 * DEG_PER_SQRT_HOUR        # gyro angle random walk in rad/sqrt(s)
>>> round(1.0 / DEG, 4)                    # one radian in degrees
57.2958
"""

from __future__ import annotations

from math import pi

__all__ = [
    "ARCMIN",
    "ARCMIN_PER_S",
    "ARCSEC",
    "ARCSEC_PER_S",
    "DAY",
    "DEG",
    "DEG_PER_HOUR",
    "DEG_PER_HOUR_PER_SQRT_HOUR",
    "DEG_PER_S",
    "DEG_PER_SQRT_HOUR",
    "HOUR",
    "KM",
    "MICRORAD",
    "MILLIRAD",
    "MINUTE",
    "RPM",
]

# angles [rad]
DEG = pi / 180.0
ARCMIN = DEG / 60.0
ARCSEC = DEG / 3600.0
MILLIRAD = 1e-3
MICRORAD = 1e-6

# times [s] and lengths [m]
MINUTE = 60.0
HOUR = 3600.0
DAY = 86400.0
KM = 1e3

# angular rates [rad/s]
DEG_PER_S = DEG
DEG_PER_HOUR = DEG / HOUR
ARCMIN_PER_S = ARCMIN
ARCSEC_PER_S = ARCSEC
RPM = 2.0 * pi / MINUTE

# gyro noise densities
DEG_PER_SQRT_HOUR = DEG / 60.0
"""Angle random walk [rad/sqrt(s)]: sqrt(3600 s) = 60."""
DEG_PER_HOUR_PER_SQRT_HOUR = DEG_PER_HOUR / 60.0
"""Rate random walk [rad/s/sqrt(s)]."""
