"""Short series for the celestial pole, the Sun and the Moon: what celestcore has without pyerfa.

Measured against pyerfa from 1990 to 2040 (`tests/unit/test_frames.py`): the pole is good to
0.04 arcsec, the Sun to 40 arcsec and 0.01 percent, the Moon to 300 arcsec and 0.2 percent.
"""

from __future__ import annotations

import numpy as np

from celestcore._check import FloatArray
from celestcore.units import ARCSEC, DEG

_OBLIQUITY = 23.43929111 * DEG
COST = (
    "the built-in series stand in for pyerfa: the Earth's axis is good to 0.04 arcsec (1.4 m at a "
    "radius of 7000 km), the Sun's direction to 40 arcsec, the Moon's to 300 arcsec, which moves "
    "a low orbit by up to a decimetre in ten hours"
)

# arguments (l, l', F, D, Omega) of IERS Conventions (2010) eq. 5.43: constant and rate, arcsec
_ARGUMENTS = np.array(
    [
        [485868.249036, 1717915923.2178],
        [1287104.793048, 129596581.0481],
        [335779.526232, 1739527262.8478],
        [1072260.703692, 1602961601.2090],
        [450160.398036, -6962890.5431],
    ]
)
# multiples of the arguments; X: sin and t cos, Y: cos and t sin, arcsec (tables 5.2a and 5.2b)
_TERMS = np.array(
    [
        [0, 0, 0, 0, 1, -6.844318, 0.205833, 9.205236, 0.153042],
        [0, 0, 2, -2, 2, -0.523908, 0.012814, 0.573033, 0.011714],
        [0, 0, 2, 0, 2, -0.090552, 0.002187, 0.097847, 0.002025],
        [0, 0, 0, 0, 2, 0.082169, -0.002004, -0.089618, -0.001837],
        [0, 1, 0, 0, 0, 0.058707, 0.0, 0.0, 0.0],
        [1, 0, 0, 0, 0, 0.028288, 0.0, 0.0, 0.0],
        [0, 1, 2, -2, 2, -0.020558, 0.0, 0.022438, 0.0],
        [0, 0, 2, 0, 1, -0.015407, 0.0, 0.020070, 0.0],
        [1, 0, 2, 0, 2, -0.011992, 0.0, 0.012903, 0.0],
        [0, 1, -2, 2, -2, -0.008585, 0.0, -0.009593, 0.0],
    ]
)


def pole(t: FloatArray) -> FloatArray:
    """Return X, Y, s (..., 3) [rad] at TT centuries since J2000.

    The largest terms of IERS Conventions (2010), section 5.5.4; Capitaine and Wallace, *Concise
    CIO based precession-nutation formulations*, Astronomy and Astrophysics 478 (2008).
    """
    angles = (_ARGUMENTS[:, 0] + _ARGUMENTS[:, 1] * t[..., None]) * ARCSEC
    arg = angles @ _TERMS[:, :5].T
    sin, cos, tt = np.sin(arg), np.cos(arg), t[..., None]
    x = -0.016617 + t * (2004.191898 + t * (-0.4297829 + t * -0.19861834))
    y = -0.006951 + t * (-0.025896 + t * (-22.4072747 + t * 0.00190059))
    x = (x + (sin * _TERMS[:, 5] + tt * cos * _TERMS[:, 6]).sum(axis=-1)) * ARCSEC
    y = (y + (cos * _TERMS[:, 7] + tt * sin * _TERMS[:, 8]).sum(axis=-1)) * ARCSEC
    s = -0.5 * x * y + (94e-6 + t * (3808.65e-6 - 72574.11e-6 * t * t)) * ARCSEC
    return np.stack([x, y, s], axis=-1)


def _equatorial(longitude: FloatArray, latitude: FloatArray, distance: FloatArray) -> FloatArray:
    """Turn ecliptic longitude and latitude [rad] of J2000 into equatorial vectors."""
    x = np.cos(latitude) * np.cos(longitude)
    y = np.cos(latitude) * np.sin(longitude)
    z = np.sin(latitude)
    c, s = np.cos(_OBLIQUITY), np.sin(_OBLIQUITY)
    return np.stack([x, c * y - s * z, s * y + c * z], axis=-1) * distance[..., None]


def sun(t: FloatArray) -> FloatArray:
    """Return the Sun (..., 3) [m] at TT centuries.

    Montenbruck and Gill (2000), section 3.3.2, with the perihelion's motion of 0.3226 degrees a
    century (Simon et al. 1994), which the book leaves out.
    """
    m = (357.52911 + 35999.05029 * t) * DEG
    longitude = (
        (282.9373 + 0.32256 * t) * DEG + m + (6892.0 * np.sin(m) + 72.0 * np.sin(2.0 * m)) * ARCSEC
    )
    distance = (149.619 - 2.499 * np.cos(m) - 0.021 * np.cos(2.0 * m)) * 1e9
    return _equatorial(longitude, np.zeros_like(m), distance)


# multiples of (l, l', F, D) and the amplitude [arcsec] or [km]
_MOON_LONGITUDE = np.array(
    [
        *([1, 0, 0, 0, 22640], [2, 0, 0, 0, 769], [1, 0, 0, -2, -4586], [0, 0, 0, 2, 2370]),
        *([0, 1, 0, 0, -668], [0, 0, 2, 0, -412], [2, 0, 0, -2, -212], [1, 1, 0, -2, -206]),
        *([1, 0, 0, 2, 192], [0, 1, 0, -2, -165], [1, -1, 0, 0, 148], [0, 0, 0, 1, -125]),
        *([1, 1, 0, 0, -110], [0, 0, 2, -2, -55]),
    ],
    dtype=float,
)
_MOON_LATITUDE = np.array(
    [
        *([0, 0, 1, -2, -526], [1, 0, 1, -2, 44], [-1, 0, 1, -2, -31], [-2, 0, 1, 0, -25]),
        *([0, 1, 1, -2, -23], [-1, 0, 1, 0, 21], [0, -1, 1, -2, 11]),
    ],
    dtype=float,
)
_MOON_DISTANCE = np.array(
    [
        *([1, 0, 0, 0, -20905], [-1, 0, 0, 2, -3699], [0, 0, 0, 2, -2956], [2, 0, 0, 0, -570]),
        *([2, 0, 0, -2, 246], [0, 1, 0, -2, -205], [1, 0, 0, 2, -171], [1, 1, 0, -2, -152]),
    ],
    dtype=float,
)


def moon(t: FloatArray) -> FloatArray:
    """Return the Moon (..., 3) [m] at TT centuries (Montenbruck and Gill 2000, eq. 3.47-3.50)."""
    mean = (218.31617 + 481267.88088 * t - 1.3972 * t) * DEG
    arguments = np.stack(
        [
            134.96292 + 477198.86753 * t,
            357.52543 + 35999.04944 * t,
            93.27283 + 483202.01873 * t,
            297.85027 + 445267.11135 * t,
        ],
        axis=-1,
    )
    arguments *= DEG

    def total(table: FloatArray, function: np.ufunc) -> FloatArray:
        terms: FloatArray = function(arguments @ table[:, :4].T) @ table[:, 4]
        return terms

    shift = total(_MOON_LONGITUDE, np.sin) * ARCSEC
    f, l1 = arguments[..., 2], arguments[..., 1]
    node = f + shift + (412.0 * np.sin(2.0 * f) + 541.0 * np.sin(l1)) * ARCSEC
    latitude = (18520.0 * np.sin(node) + total(_MOON_LATITUDE, np.sin)) * ARCSEC
    distance = (385000.0 + total(_MOON_DISTANCE, np.cos)) * 1e3
    return _equatorial(mean + shift, latitude, distance)
