"""Rays through ellipsoidal air by their differential equation; a second standard atmosphere."""

from __future__ import annotations

import numpy as np
from celestcore._check import FloatArray
from scipy.integrate import solve_ivp

A, F = 6378137.0, 1.0 / 298.257223563
LAPSE = np.array([-6.5e-3, 0.0, 1e-3, 2.8e-3, 0.0, -2.8e-3, -2e-3])
FEET = np.array([0.0, 11e3, 20e3, 32e3, 47e3, 51e3, 71e3, 84852.0])
TEMPERATURE = np.array([288.15, 216.65, 216.65, 228.65, 270.65, 270.65, 214.65, 186.946])
PRESSURE = np.array([101325.0, 22632.1, 5474.89, 868.019, 110.906, 66.9389, 3.95642, 0.37338])
"""US Standard Atmosphere 1976 at the feet of its layers, as published."""


def density(height: float) -> tuple[float, float]:
    """Return the density [kg/m3] and its derivative to the height."""
    if height > 86e3:
        rho, slope = density(86e3)
        rho *= float(np.exp((height - 86e3) * slope / rho))
        return rho, rho * slope / density(86e3)[0]
    z = 6356766.0 * height / (6356766.0 + height)
    i = int(np.clip(np.searchsorted(FEET, z, side="right") - 1, 0, 6))
    t, hydrostatic = TEMPERATURE[i] + LAPSE[i] * (z - FEET[i]), 0.0341631947
    if LAPSE[i] == 0.0:
        p = PRESSURE[i] * np.exp(-hydrostatic * (z - FEET[i]) / t)
    else:
        p = PRESSURE[i] * (TEMPERATURE[i] / t) ** (hydrostatic / LAPSE[i])
    rho = float(p / (287.05287 * t))
    stretch = (6356766.0 / (6356766.0 + height)) ** 2
    return rho, -rho * float((hydrostatic + LAPSE[i]) / t * stretch)


def surface(x: FloatArray, flattening: float) -> tuple[float, FloatArray]:
    """Return the height above an ellipsoid and the direction up, by iterating the latitude."""
    e2 = flattening * (2.0 - flattening)
    p = float(np.hypot(x[0], x[1]))
    latitude = np.arctan2(x[2], p * (1.0 - e2))
    for _ in range(6):
        n = A / np.sqrt(1.0 - e2 * np.sin(latitude) ** 2)
        latitude = np.arctan2(x[2] + e2 * n * np.sin(latitude), p)
    n = A / np.sqrt(1.0 - e2 * np.sin(latitude) ** 2)
    up = np.array([x[0] / p * np.cos(latitude), x[1] / p * np.cos(latitude), np.sin(latitude)])
    height = p * np.cos(latitude) + x[2] * np.sin(latitude) - n * (1.0 - e2 * np.sin(latitude) ** 2)
    return float(height), up


def leave(x: FloatArray, way: FloatArray, flattening: float, scale: float) -> list[FloatArray]:
    """Follow a ray from its lowest point out of the air: to where, in which direction."""

    def slopes(_: float, y: FloatArray) -> FloatArray:
        height, up = surface(y[:3], flattening)
        rho, by_height = density(height)
        n = 1.0 + 2.26e-4 * scale * rho
        return np.concatenate([y[3:], n * 2.26e-4 * scale * by_height * up])

    n = 1.0 + 2.26e-4 * scale * density(surface(x, flattening)[0])[0]
    y0, atol = np.concatenate([x, n * way]), [1e-6] * 3 + [1e-14] * 3
    out = solve_ivp(slopes, (0.0, 1.6e6), y0, method="DOP853", rtol=1e-13, atol=atol, max_step=2e4)
    y = out.y[:, -1]
    return [y[:3], y[3:] / np.linalg.norm(y[3:])]


def grazing(
    height: float, latitude: float, azimuth: float, *, flattening: float = F, scale: float = 1.0
) -> tuple[FloatArray, FloatArray, float]:
    """Return satellite, star and bending of the ray whose lowest point is at this height."""
    up = np.array([np.cos(latitude), 0.0, np.sin(latitude)])
    north = np.array([-np.sin(latitude), 0.0, np.cos(latitude)])
    way = np.cos(azimuth) * north + np.sin(azimuth) * np.array([0.0, 1.0, 0.0])
    e2 = flattening * (2.0 - flattening)
    n = A / np.sqrt(1.0 - e2 * np.sin(latitude) ** 2)
    x = n * (up - np.array([0.0, 0.0, e2 * np.sin(latitude)])) + height * up
    far, to_satellite = leave(x, way, flattening, scale)
    _, to_star = leave(x, -way, flattening, scale)
    # on along the straight line to 7138 km
    b, c = far @ to_satellite, far @ far - 7.138e6**2
    bent = np.arcsin(np.linalg.norm(np.cross(to_satellite, to_star)))
    return far + (-b + np.sqrt(b * b - c)) * to_satellite, to_star, float(bent)
