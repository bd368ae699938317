"""What a GNSS table gives away about wrong units and wrong frames.

Every check is a comparison of medians over many places of the log, so that neither noise of tens of
metres nor outliers raise a false alarm.
"""

from __future__ import annotations

import numpy as np

from celestcore._check import FloatArray, IntArray
from celestcore._table import typical_size
from celestcore.elements import MU
from celestcore.errors import InputError
from celestcore.frames._rotation import EARTH_RATE

INSIDE = 6.3e6
"""Geocentric radius [m] below which nothing can be: the poles are at 6.357e6."""
FARTHEST = 1e6
"""Radius [km] beyond which no satellite of the Earth is: more than that is not in kilometres."""
PLACES = 500
"""Places of a log that are looked at, at most."""
FEWEST = 3
LONGEST = 150.0
"""Longest time between fixes that are compared [s]."""
CONVERT = "r_e, v_e = celestcore.frames.to_itrs(epoch, t, r_i, v_i) converts"


def check_positions(r: FloatArray, name: str, rows: IntArray | None) -> None:
    """Refuse positions in kilometres and positions inside the Earth.

    Raises
    ------
    InputError
        Names the row and the value.
    """
    radius = np.sqrt(np.einsum("ij,ij->i", r * 1e-7, r * 1e-7)) * 1e7
    bad = ~(radius >= INSIDE)
    if not bad.any():
        return
    k = int(np.argmax(bad))
    row = k if rows is None else int(rows[k])
    typical = typical_size(radius)
    if INSIDE * 1e-3 <= typical < FARTHEST:
        raise InputError(
            f"is {radius[k]:.4g} m from the Earth's centre, and half of the fixes are not farther "
            f"than {typical:.4g} m: positions are in metres; multiply kilometres by celestcore.KM",
            field=f"{name}.r",
            row=row,
            value=r[k],
        )
    raise InputError(
        f"lies inside the Earth, {radius[k]:.4g} m from its centre; write NaN where a fix is "
        "missing or known to be wrong",
        field=f"{name}.r",
        row=row,
        value=r[k],
    )


def check_motion(t: FloatArray, r: FloatArray, v: FloatArray | None, name: str) -> None:
    """Refuse velocities, or positions, of an inertial frame, and kilometres per second.

    Raises
    ------
    InputError
        Says what the fixes look like and how to convert them.
    """
    if len(t) <= FEWEST:
        return
    with np.errstate(all="ignore"):
        if v is not None:
            _check_velocity(t, r, v, name)
        _check_acceleration(t, r, name)


def _neighbours(t: FloatArray, apart: float) -> tuple[IntArray, IntArray]:
    """Return pairs of rows that are about `apart` [s], less where a gap follows."""
    first = np.unique(np.linspace(0, len(t) - 2, PLACES).astype(np.int64))
    second = np.maximum(np.searchsorted(t, t[first] + apart * (1.0 - 1e-9)), first + 1)
    beyond = t[np.minimum(second, len(t) - 1)] - t[first] > LONGEST
    second = np.where((second == len(t)) | beyond, np.maximum(second - 1, first + 1), second)
    close = t[second] - t[first] <= LONGEST
    return first[close], second[close]


def _turning(r: FloatArray) -> FloatArray:
    """Return what the Earth's rotation adds to velocities, omega x r (n, 3)."""
    return EARTH_RATE * np.stack([-r[:, 1], r[:, 0], np.zeros(len(r))], axis=1)


def _median(v: FloatArray) -> float:
    return float(np.median(np.sqrt(np.einsum("ij,ij->i", v, v))))


def _check_velocity(t: FloatArray, r: FloatArray, v: FloatArray, name: str) -> None:
    """Compare velocities with how the positions change over half a minute.

    The mean of two velocities differs from the chord of an orbit by less than 20 m/s over 150 s.
    """
    i, j = _neighbours(t, min(30.0, (t[-1] - t[0]) / (2 * FEWEST)))
    if len(i) < FEWEST:
        return
    moved = (r[j] - r[i]) / (t[j] - t[i])[:, None]
    given = 0.5 * (v[i] + v[j])
    turning = _turning(0.5 * (r[i] + r[j]))
    off, added, speed = _median(given - moved), _median(turning), _median(moved)
    if not (added > 50.0 and off > 0.5 * added):
        if off > 0.5 * speed > 5.0 and _median(1e3 * given - moved) < 0.05 * speed:
            _fail_velocity(
                name, v, "is in km/s by the positions; multiply by celestcore.KM: velocities in m/s"
            )
        return
    absolute = moved + turning
    across = np.hypot(given[:, 0], given[:, 1]) - np.hypot(absolute[:, 0], absolute[:, 1])
    turned = np.stack([across, given[:, 2] - absolute[:, 2], np.zeros(len(i))], axis=1)
    if min(_median(given - absolute), _median(turned)) < 0.25 * min(off, added):
        _fail_velocity(
            name,
            v,
            f"is an inertial velocity: it differs by {off:.4g} m/s from how the Earth-fixed "
            f"positions change, and omega x r of the Earth's rotation explains that; {CONVERT}",
        )
    if off > 0.5 * speed and _median(1e3 * given - moved) < 0.05 * speed:
        _fail_velocity(name, v, "is in km/s by the positions; velocities are in m/s")


def _fail_velocity(name: str, v: FloatArray, message: str) -> None:
    raise InputError(message, field=f"{name}.v", value=v[0])


def _check_acceleration(t: FloatArray, r: FloatArray, name: str) -> None:
    """Compare how the positions bend with gravity, without and with what the rotation adds.

    In an Earth-fixed frame a free fall has the Coriolis and the centrifugal acceleration as well,
    about 1 m/s^2 in low orbits; whoever does not fall freely fits neither.
    """
    apart = min(60.0, (t[-1] - t[0]) / (2 * FEWEST + 2))
    i, j = _neighbours(t, apart)
    k = np.searchsorted(t, t[j] + apart * (1.0 - 1e-9))
    known = k < len(t)
    i, j, k = i[known], j[known], np.maximum(k[known], j[known] + 1)
    close = t[np.minimum(k, len(t) - 1)] - t[j] <= LONGEST
    i, j, k = i[close], j[close], k[close]
    if len(i) < FEWEST:
        return
    before, after = (t[j] - t[i])[:, None], (t[k] - t[j])[:, None]
    v1, v2 = (r[j] - r[i]) / before, (r[k] - r[j]) / after
    bent = 2.0 * (v2 - v1) / (before + after)
    velocity = (after * v1 + before * v2) / (before + after)
    radius = np.sqrt(np.einsum("ij,ij->i", r[j], r[j]))[:, None]
    rest = bent + MU * r[j] / radius**3
    rotation = -2.0 * _turning(velocity) - _turning(_turning(r[j]))
    added = _median(rotation)
    if _median(rest) < 0.1 * added and _median(rest - rotation) > 0.5 * added:
        raise InputError(
            f"moves as in an inertial frame: the Earth's rotation, {added:.2g} m/s^2 of Coriolis "
            f"and centrifugal acceleration, is not in it; positions are Earth-fixed: {CONVERT}",
            field=f"{name}.r",
            value=r[0],
        )
