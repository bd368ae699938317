"""The Earth's orientation as the IERS measured it: pole, UT1 and pole offsets from daily tables.

The tables come with the package `astropy-iers-data`; nothing is downloaded. Series C04 is used as
far as it reaches, then Bulletin A with its predictions of one year.
"""

from __future__ import annotations

import functools
from importlib import import_module
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from celestcore._check import BoolArray, FloatArray, warn
from celestcore.errors import InputError
from celestcore.frames._time import DAY, TT_TAI, Instant, leap_seconds
from celestcore.units import ARCSEC

TABLES = ("iers", "zero")
NO_TABLE = (
    "the Earth's pole and UT1 - UTC are taken as zero: directions fixed to the Earth are wrong by "
    "up to 14 arcsec, that is 460 m at a radius of 7000 km, and an orbit of ten hours by metres"
)


class Orientation(NamedTuple):
    """Where the Earth's pole was and how far it had turned; each (...).

    Attributes
    ----------
    xp, yp : ndarray
        Pole in the Earth-fixed frame [rad].
    ut1_tt : ndarray
        UT1 - TT [s].
    dx, dy : ndarray
        Celestial pole offsets from IAU 2006/2000A [rad].
    predicted : ndarray of bool
        Where the table holds a prediction.
    """

    xp: FloatArray
    yp: FloatArray
    ut1_tt: FloatArray
    dx: FloatArray
    dy: FloatArray
    predicted: BoolArray


class Table(NamedTuple):
    """Daily values at 0h UTC: columns xp, yp [rad], UT1 - TT [s], dx, dy [rad]."""

    mjd: FloatArray
    values: FloatArray
    measured_until: float


def _columns(path: Path, start: int, cuts: list[tuple[int, int]]) -> FloatArray:
    """Read fixed columns of a text file whose rows all have one length; blanks become NaN."""
    lines = path.read_bytes().splitlines()[start:]
    grid = np.array([line.ljust(128)[:128] for line in lines], dtype="S128")
    letters = grid.view("S1").reshape(len(lines), 128)
    out = np.full((len(lines), len(cuts)), np.nan)
    for k, (first, last) in enumerate(cuts):
        text = np.ascontiguousarray(letters[:, first:last]).view(f"S{last - first}")[:, 0]
        full = np.char.strip(text) != b""
        out[full, k] = text[full].astype(float)
    return out


@functools.cache
def table() -> Table | None:
    """Return the tables of `astropy-iers-data` as one, or None if it is not installed."""
    try:
        data = import_module("astropy_iers_data")
    except ImportError:
        return None
    final = _columns(
        Path(data.IERS_B_FILE), 6, [(16, 26), (26, 38), (38, 50), (50, 62), (62, 74), (74, 86)]
    )
    rapid = _columns(
        Path(data.IERS_A_FILE), 0, [(7, 15), (18, 27), (37, 46), (58, 68), (97, 106), (116, 125)]
    )
    rapid[:, 4:] *= 1e-3  # milliarcsec; blank, and taken as 0, where nobody predicts
    rapid = rapid[(rapid[:, 0] > final[-1, 0]) & np.isfinite(rapid[:, 3])]
    rows = np.vstack([final[final[:, 0] >= 41317.0], rapid])
    values = rows[:, 1:].copy()
    values[:, [0, 1, 3, 4]] *= ARCSEC
    values[:, 2] -= leap_seconds(rows[:, 0]) + TT_TAI
    values[:, 3:] = np.nan_to_num(values[:, 3:])
    return Table(rows[:, 0], values, float(final[-1, 0]))


def span() -> str:
    """Return in words what the table covers."""
    have = table()
    if have is None:
        return "no table"
    first, last = (np.datetime64("1858-11-17") + int(m) for m in have.mjd[[0, -1]])
    return f"{first} to {last}"


def orientation(start: Instant, t: ArrayLike, source: str = "iers") -> Orientation:
    """Interpolate the tables, or return zeros, `t` seconds (...) after the start.

    Four-point Lagrange interpolation of daily values, as the IERS does it; tides within the day
    (0.3 mas, 1 cm on the ground) are left out. Zero means the pole at its origin and UT1 = UTC,
    with the leap seconds of the start.
    """
    days = start.mjd + (start.seconds + np.asarray(t, dtype=float)) / DAY
    have = table() if source == "iers" else None
    if have is None:
        zero = np.zeros_like(days)
        tai = start.seconds - TT_TAI
        day = start.mjd + int(np.floor(tai / DAY))
        day = start.mjd + int(np.floor((tai - float(leap_seconds(day))) / DAY))
        ut1_tt = zero - (float(leap_seconds(day)) + TT_TAI)
        return Orientation(zero, zero, ut1_tt, zero, zero, np.zeros(days.shape, dtype=bool))
    nodes = have.mjd + (leap_seconds(have.mjd) + TT_TAI) / DAY
    outside = ~((days >= nodes[0]) & (days <= nodes[-1]))
    if outside.any():
        raise InputError(
            f"is outside the table of the Earth's orientation, which covers {span()}: update "
            "astropy-iers-data, or ask for orientation='zero' and lose up to 14 arcsec",
            field="epoch",
            value=str(np.datetime64("1858-11-17") + int(days[outside].flat[0])),
        )
    first = np.clip(np.searchsorted(nodes, days, side="right") - 2, 0, len(nodes) - 4)
    out = np.zeros((*days.shape, 5))
    for j in range(4):
        weight = np.ones_like(days)
        for k in range(4):
            if k != j:
                weight *= (days - nodes[first + k]) / (nodes[first + j] - nodes[first + k])
        out += weight[..., None] * have.values[first + j]
    xp, yp, ut1_tt, dx, dy = np.moveaxis(out, -1, 0)
    return Orientation(xp, yp, ut1_tt, dx, dy, days > have.measured_until)


def check(source: str) -> None:
    """Refuse an unknown source, and warn of what the choice costs."""
    if source not in TABLES:
        raise InputError("must be 'iers' or 'zero'", field="orientation", value=source)
    if source == "zero":
        warn(NO_TABLE)
    elif table() is None:
        warn(f"astropy-iers-data is not installed: {NO_TABLE}; pip install 'celestcore[orbit]'")


def tt_minus_ut1(mjd: int, seconds: float) -> float:
    """Return TT - UT1 [s] where UT1 is given."""
    if table() is None:
        raise InputError(
            "in UT1 needs the Earth's orientation: pip install 'celestcore[orbit]'", field="epoch"
        )
    offset = 0.0
    for _ in range(3):  # UT1 - TT changes by milliseconds a day
        offset = -float(orientation(Instant(mjd, seconds + offset), 0.0).ut1_tt)
    return offset
