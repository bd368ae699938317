"""What the paper prints: its text; the contents of its Tables 1 and 2 are not legible."""

from __future__ import annotations

from celestcore.units import ARCSEC, DEG

CITATION = (
    "Zhang Li, Chen Zi-ang, Wang Bo, GPS/star-sensor integrated positioning and attitude "
    "determination with ZY-3 data, Nanjing University of Aeronautics and Astronautics, 2019"
)
GPS = (1.0, 10.0)
"""1-sigma of GPS positions in its two examples, per axis [m]."""
STAR = 20.0 * ARCSEC
"""1-sigma of its star sensor, per axis [rad]."""
STEP, DURATION = 10.0, 1200.0
"""Sampling and length [s]: 4:00 to 4:20 of 21 January 2019."""
PITCH = 0.02 * DEG
"""What its text says that the rms pitch error stays below with 10 m GPS [rad]."""
