"""Environment tables straight from ERFA, and slow references, for the tests of orbits."""

from __future__ import annotations

from typing import Any

import erfa
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

AU = 149_597_870_700.0
MU, RE = 3.986004415e14, 6378136.3
EPOCH = "2007-07-01T12:00:00"
UTC = (2454283.0, 0.0)
"""`EPOCH` as a Julian date."""
TT = (2454283.0, 65.184 / 86400.0)
DUT1 = -0.1588
"""UT1 - UTC at `EPOCH` [s], near enough."""


def tables(
    duration: float = 36_000.0, *, pole: tuple[float, float] = (1e-6, 2e-6)
) -> dict[str, Any]:
    """Return the tables for `EPOCH`, with constant polar motion and UT1 - TT."""
    earth_t = np.arange(-6.0, duration / 3600.0 + 7.0) * 3600.0
    body_t = np.arange(-3.0, duration / 7200.0 + 4.0) * 7200.0
    x, y, s = erfa.xys06a(TT[0], TT[1] + earth_t / 86400.0)
    sp = erfa.sp00(TT[0], TT[1] + earth_t / 86400.0)
    return {
        "earth_t": earth_t,
        "cip": np.stack([x, y, s], axis=-1),
        "pole": np.tile(pole, (len(earth_t), 1)),
        "sp": sp,
        "ut1": np.array([UTC[0], UTC[1] + DUT1 / 86400.0]),
        "dut1": np.zeros(len(earth_t)),
        "body_t": body_t,
        "sun": sun(body_t),
        "moon": moon(body_t),
    }


def sun(t: Array) -> Array:
    heliocentric, _ = erfa.epv00(TT[0], TT[1] + t / 86400.0)
    return np.ascontiguousarray(-heliocentric["p"] * AU)


def moon(t: Array) -> Array:
    return np.ascontiguousarray(erfa.moon98(TT[0], TT[1] + t / 86400.0)["p"] * AU)


def gcrs_to_itrs(t: float, pole: tuple[float, float] = (1e-6, 2e-6)) -> Array:
    x, y, s = erfa.xys06a(TT[0], TT[1] + t / 86400.0)
    era = erfa.era00(UTC[0], UTC[1] + (DUT1 + t) / 86400.0)
    wobble = erfa.pom00(*pole, erfa.sp00(TT[0], TT[1] + t / 86400.0))
    out: Array = erfa.c2tcio(erfa.c2ixys(x, y, s), era, wobble)
    return out


def start() -> tuple[Array, Array]:
    """Return the paper's orbit: a, e, i, RAAN, argument of perigee, at perigee."""
    a, e, i, node, perigee = 7136.635e3, 1.809e-3, *np.deg2rad([65.0, 30.0, 30.0])
    turn = erfa.rz(-perigee, np.eye(3))
    to_inertial = erfa.rz(-node, np.eye(3)) @ erfa.rx(-i, np.eye(3)) @ turn
    r = to_inertial @ [a * (1 - e), 0.0, 0.0]
    v = to_inertial @ [0.0, np.sqrt(MU / a * (1 + e) / (1 - e)), 0.0]
    return r, v


def harmonics(r: Array, degree: int, order: int, c: Array, s: Array) -> Array:
    """Return the acceleration of a field by unnormalised solid harmonics in extended precision.

    Cunningham's recursion as in Montenbruck and Gill, Satellite Orbits, 2000, eqs. 3.29-3.33, which
    shares neither the normalisation nor the order of summation with the core.
    """
    wide = np.longdouble
    x, y, z = (wide(k) for k in r)
    r2 = x * x + y * y + z * z
    rho, re = wide(RE) * wide(RE) / r2, wide(RE)
    x0, y0, z0 = re * x / r2, re * y / r2, re * z / r2
    n1 = degree + 2
    v, w = np.zeros((n1, n1), dtype=wide), np.zeros((n1, n1), dtype=wide)
    v[0, 0] = re / np.sqrt(r2)
    for m in range(n1):
        if m:
            v[m, m] = (2 * m - 1) * (x0 * v[m - 1, m - 1] - y0 * w[m - 1, m - 1])
            w[m, m] = (2 * m - 1) * (x0 * w[m - 1, m - 1] + y0 * v[m - 1, m - 1])
        for n in range(m + 1, n1):
            for h in (v, w):
                below = h[n - 2, m] if n > m + 1 else wide(0)
                h[n, m] = ((2 * n - 1) * z0 * h[n - 1, m] - (n + m - 1) * rho * below) / (n - m)
    return _summed(v, w, degree, order, c, s)


def _summed(v: Array, w: Array, degree: int, order: int, c: Array, s: Array) -> Array:
    wide = np.longdouble
    total = np.zeros(3, dtype=wide)
    for n in range(degree + 1):
        norm = np.sqrt(wide(2 * n + 1))
        for m in range(min(n, order) + 1):
            if m:
                factor = np.sqrt(wide(2)) if m == 1 else wide(1)
                norm = norm * factor / np.sqrt(wide((n - m + 1) * (n + m)))
            k = n * (n + 1) // 2 + m
            a, b = norm * wide(c[k]), norm * wide(s[k])
            up = np.array(
                [
                    -a * v[n + 1, m + 1] - b * w[n + 1, m + 1],
                    -a * w[n + 1, m + 1] + b * v[n + 1, m + 1],
                ]
            )
            if m == 0:
                total[:2] += [-a * v[n + 1, 1], -a * w[n + 1, 1]]
            else:
                f = wide((n - m + 1) * (n - m + 2))
                down = f * np.array(
                    [
                        a * v[n + 1, m - 1] + b * w[n + 1, m - 1],
                        -a * w[n + 1, m - 1] + b * v[n + 1, m - 1],
                    ]
                )
                total[:2] += (up + down) / 2
            total[2] += (n - m + 1) * (-a * v[n + 1, m] - b * w[n + 1, m])
    return np.asarray(total * wide(MU) / (wide(RE) * wide(RE)))
