"""Time scales, the Earth's orientation, Sun and Moon, and frames that go with an orbit.

Frames: ``i`` GCRS (inertial, geocentric), ``e`` ITRS (Earth-fixed), ``o`` orbital frame (z to the
Earth's centre, y against the orbit's normal, x along-track). Times are an epoch and elapsed SI
seconds. With the extra ``orbit`` precession, nutation, Sun and Moon are pyerfa's and the Earth's
pole and UT1 the IERS' as `astropy-iers-data` brings them; nothing is downloaded. Without it short
series take their place, with a warning that says what it costs.

Examples
--------
>>> r_ei = gcrs_to_itrs("2026-01-01T00:00:00", [0.0, 60.0])
>>> tables = environment("2026-01-01T00:00:00", 36000.0)
>>> sorted(tables)
['body_t', 'cip', 'dut1', 'earth_t', 'moon', 'pole', 'sp', 'sun', 'ut1']
"""

from __future__ import annotations

from celestcore.frames._bodies import (
    earth_position,
    earth_velocity,
    environment,
    moon,
    sun,
)
from celestcore.frames._euler import Euler321, euler_321, from_euler_321
from celestcore.frames._nadir import nadir, orbital_geodetic
from celestcore.frames._orbit import (
    Eclipse,
    GroundTrack,
    aberrate,
    eclipse,
    from_geodetic,
    geodetic,
    ground_track,
    orbital,
)
from celestcore.frames._rotation import gcrs_to_itrs, itrs_to_gcrs, to_gcrs, to_itrs
from celestcore.frames._time import julian_date

__all__ = [
    "Eclipse",
    "Euler321",
    "GroundTrack",
    "aberrate",
    "earth_position",
    "earth_velocity",
    "eclipse",
    "environment",
    "euler_321",
    "from_euler_321",
    "from_geodetic",
    "gcrs_to_itrs",
    "geodetic",
    "ground_track",
    "itrs_to_gcrs",
    "julian_date",
    "moon",
    "nadir",
    "orbital",
    "orbital_geodetic",
    "sun",
    "to_gcrs",
    "to_itrs",
]
