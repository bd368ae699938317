"""GNSS fixes and baselines that cannot be: found, named, and no false alarm."""

from __future__ import annotations

import functools
import warnings
from typing import Any

import celestcore as cc
import numpy as np
import pytest
from celestcore import frames, orbit
from celestcore.log import SensorLog

EPOCH = "2019-01-21T04:00:00"
Array = np.ndarray[Any, Any]
LEO = cc.elements.Elements(6884e3, 0.0012, 97.42 * cc.DEG, 1.75, 1.57, 0.5)
GEO = cc.elements.Elements(42164.2e3, 0.0, 0.001, 0.0, 0.0, 0.5)
GPS = cc.elements.Elements(26560e3, 0.01, 55 * cc.DEG, 0.3, 0.0, 0.5)
HEO = cc.elements.Elements(26600e3, 0.72, 63.4 * cc.DEG, 0.3, 4.7, 0.1)
LOW = cc.elements.Elements(6778e3, 0.001, 20 * cc.DEG, 0.3, 4.7, 0.1)
ORBITS = {"leo": LEO, "geo": GEO, "gps": GPS, "heo": HEO, "low": LOW}


@functools.cache
def flown(name: str, step: float, count: int) -> tuple[Array, ...]:
    """Times, inertial and Earth-fixed states."""
    t = step * np.arange(count)
    r0, v0 = cc.elements.to_state(ORBITS[name])
    made = orbit.propagate(orbit.ForceModel.j2(), None, r0, v0, t)
    r_e, v_e = frames.to_itrs(EPOCH, t, made.r, made.v)
    assert v_e is not None
    return t, made.r, made.v, r_e, v_e


def noise(rng: np.random.Generator, r: Array, sigma: float, share: float = 0.0) -> Array:
    """Return positions with white noise, a share of them with errors of a kilometre."""
    out = r + sigma * rng.standard_normal(r.shape)
    wild = rng.random(len(r)) < share
    out[wild] += 1e3 * rng.standard_normal((int(wild.sum()), 3))
    return np.asarray(out)


CASES = [(step, count) for step in (1.0, 10.0, 60.0, 120.0) for count in (5, 12, 121, 1000)]


@pytest.mark.parametrize("name", ORBITS)
@pytest.mark.parametrize(("step", "count"), CASES)
def test_no_false_alarm(name: str, step: float, count: int) -> None:
    t, _, _, r, v = flown(name, step, count)
    rng = np.random.default_rng(count)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for sigma in (0.0, 1.0, 10.0, 100.0):
            for share in (0.0, 0.05, 0.3):
                given = noise(rng, r, sigma, share)
                speed = noise(rng, v, 0.01 * sigma, share)
                SensorLog(gnss=(t, given, speed))
                SensorLog(gnss=(t, given))


@pytest.mark.parametrize("name", ["leo", "geo", "gps", "low"])
@pytest.mark.parametrize("sigma", [0.0, 10.0])
@pytest.mark.parametrize(("step", "count"), [(1.0, 60), (10.0, 12), (10.0, 121), (60.0, 100)])
def test_inertial_velocity_is_found(name: str, sigma: float, step: float, count: int) -> None:
    t, r_i, v_i, r, v = flown(name, step, count)
    rng = np.random.default_rng(3)
    turning = np.cross([0.0, 0.0, 7.292115e-5], r)
    share = 0.1 if count > 50 else 0.0
    match = r"gnss\.v.*is an inertial velocity.*frames\.to_itrs"
    with pytest.raises(cc.InputError, match=match):  # in the Earth's axes
        SensorLog(gnss=(t, noise(rng, r, sigma, share), v + turning))
    with pytest.raises(cc.InputError, match=match):  # in those of the GCRS
        SensorLog(gnss=(t, noise(rng, r, sigma, share), v_i))
    if step * count > 300.0 and (name == "leo" or (name, sigma) == ("low", 0.0)):
        match = r"gnss\.r.*moves as in an inertial frame.*frames\.to_itrs"
        for more in ((), (v_i,)):
            with pytest.raises(cc.InputError, match=match):
                SensorLog(gnss=(t, noise(rng, r_i, 0.1 * sigma, share), *more))


def test_outages_and_few_fixes() -> None:
    t, _, _, r, v = flown("leo", 10.0, 1000)
    rows = np.r_[0:3, 300:303, 700:704, 800, 900]
    inertial = v + np.cross([0.0, 0.0, 7.292115e-5], r)
    SensorLog(gnss=(t[rows], r[rows], v[rows]))
    with pytest.raises(cc.InputError, match="inertial"):
        SensorLog(gnss=(t[rows], r[rows], inertial[rows]))
    SensorLog(gnss=(t[:3], r[:3], inertial[:3]))  # too few to tell
    SensorLog(gnss=(t[::50], r[::50], inertial[::50]))  # and too far apart


def test_kilometres() -> None:
    t, _, _, r, v = flown("leo", 10.0, 121)
    with pytest.raises(cc.InputError, match=r"gnss\.r, row 0, value .*celestcore\.KM"):
        SensorLog(gnss=(t, r * 1e-3))
    with pytest.raises(cc.InputError, match=r"celestcore\.KM"):
        SensorLog(gnss=(t, flown("geo", 10.0, 121)[3] * 1e-3))
    with pytest.raises(cc.InputError, match=r"gnss\.v.*km/s"):
        SensorLog(gnss=(t, r, v * 1e-3))


def test_a_whole_orbit_inside_the_earth_is_not_in_kilometres() -> None:
    t, _, _, r, _ = flown("leo", 10.0, 121)
    with pytest.raises(cc.InputError, match=r"row 0, value .*lies inside the Earth") as caught:
        SensorLog(gnss=(t, 0.5 * r))
    assert "KM" not in str(caught.value)


def test_inside_the_earth() -> None:
    t, _, _, r, v = flown("leo", 10.0, 121)
    bad = r.copy()
    bad[3], bad[17], bad[60] = np.nan, 0.0, 1e6
    with pytest.raises(cc.InputError, match=r"inside the Earth, 0 m.*write NaN") as caught:
        SensorLog(gnss=(t, bad, v))
    assert (caught.value.field, caught.value.row) == ("gnss.r", 17)
    bad[17] = np.nan
    with pytest.raises(cc.InputError, match=r"1\.732e\+06 m") as caught:
        SensorLog(gnss=(t, bad, v))
    assert caught.value.row == 60
    assert np.array_equal(np.asarray(caught.value.value), [1e6] * 3)


def test_on_the_ground_and_on_the_way_up() -> None:
    t = np.arange(0.0, 600.0, 10.0)
    still = np.tile([4.2e6, 0.2e6, 4.78e6], (len(t), 1))
    SensorLog(gnss=(t, still, 0.0 * still))
    up = still * (1.0 + 1e-7 * t[:, None] ** 2)
    SensorLog(gnss=(t, up, still * 2e-7 * t[:, None]))
    with pytest.raises(cc.InputError, match="inertial"):
        SensorLog(gnss=(t, still, np.cross([0.0, 0.0, 7.292115e-5], still)))


ROW = [[2.0, 0.0, 0.0], [0.0, 1.5, 0.0]]
BAD: dict[str, tuple[Any, str, int | None, str]] = {
    "one": ([[ROW[0]]], "baselines.b", None, "2 to 64 baselines"),
    "two axes": (ROW[:1], "baselines.b", None, "needed is (n, k, 3)"),
    "rows": ([ROW, ROW], "baselines.b", None, "2 rows but baselines.t has 1"),
    "all missing": (np.full((1, 2, 3), np.nan), "baselines", None, "all 1 rows are missing"),
    "zero": ([[ROW[0], [0.0] * 3]], "baselines.b", 0, "is zero"),
    "positions": ([[[7e6, 0, 0], [7e6, 1.5, 0]]], "baselines.b", None, "positions of antennas"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_baselines(name: str) -> None:
    b, field, row, part = BAD[name]
    with pytest.raises(cc.InputError) as caught:
        SensorLog(baselines=([0.0], b))
    assert (caught.value.field, caught.value.row) == (field, row)
    assert part in str(caught.value)


def test_millimetres_warn() -> None:
    with pytest.warns(cc.CelestcoreWarning, match="millimetres"):
        SensorLog(baselines=([0.0], np.array([ROW]) * 1e3))
