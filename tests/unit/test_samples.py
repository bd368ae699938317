"""The shipped logs: what they hold, and that their conventions are understood."""

from __future__ import annotations

import re

import celestcore.samples
import numpy as np
import pytest
from celestcore.config import Settings
from celestcore.errors import CelestcoreError, InputError
from celestcore.samples import sample, sample_names, sample_path
from celestcore.units import ARCSEC, DEG
from scipy.spatial.transform import Rotation


def rotations(q: np.ndarray) -> Rotation:
    return Rotation.from_quat(q[:, [1, 2, 3, 0]])


def rates_from_attitude(t: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Mean body rates (n-1, 3) rad/s between the fixes, q_ib body to inertial."""
    r = rotations(q)
    return np.asarray((r[:-1].inv() * r[1:]).as_rotvec() / np.diff(t)[:, None])


def rms(error: np.ndarray) -> np.ndarray:
    return np.asarray(np.sqrt(np.mean(error**2, axis=0)))


def test_names_and_paths() -> None:
    assert sample_names() == ("fermi", "noaa20")
    for name in sample_names():
        assert sample_path(name).is_file()
        assert sample_path(name).with_suffix(".toml").is_file()


def test_unknown_sample_lists_the_known_ones() -> None:
    with pytest.raises(InputError, match=r"'hubble'.*fermi, noaa20") as caught:
        sample("hubble")
    assert isinstance(caught.value, CelestcoreError)
    assert caught.value.value == "hubble"
    with pytest.raises(InputError):
        sample_path("../fermi")


def test_samples_are_small_and_documented() -> None:
    folder = sample_path("fermi").parent
    assert sum(f.stat().st_size for f in folder.iterdir()) < 3_000_000
    text = (folder / "README.md").read_text(encoding="utf-8").partition("# Gravity fields")[0]
    for word in ("gbmgeometry", "1.0.7", "space_packet_parser", "6.2.0", "MIT", "BSD-3-Clause"):
        assert word in text
    logs = text.partition("# Gravity")[0]
    assert len(re.findall(r"`[0-9a-f]{64}`", logs)) == 2


@pytest.mark.parametrize("name", ["fermi", "noaa20"])
def test_settings_are_complete(name: str) -> None:
    log = sample(name)
    assert set(log.settings["log"]) == {"title", "epoch", "source", "licence"}
    assert log.frames["inertial"] == "GCRS"
    assert log.missing == 0
    assert log.title is not None
    assert log.epoch is not None
    Settings.from_log(log)


def test_fermi_holds_what_the_readme_says() -> None:
    log = sample("fermi")
    assert log.gyro is not None
    assert log.epoch == "2015-10-13T08:00:00"
    star = log.stars["star"]
    assert len(log.gyro) == len(star) == 43_195
    assert np.array_equal(log.gyro.t, star.t)
    step = np.diff(star.t)
    assert np.sum(np.abs(step - 1.0) > 0.01) == 9
    assert step.min() > 0.79
    assert step.max() < 2.01
    assert 0.36 < np.linalg.norm(log.gyro.rate, axis=1).max() / DEG < 0.37


def test_fermi_rates_agree_with_quaternion_differences() -> None:
    log = sample("fermi")
    assert log.gyro is not None
    star, rate = log.stars["star"], log.gyro.rate
    turned = rates_from_attitude(star.t, star.q)
    errors = {
        "average": rms(turned - 0.5 * (rate[:-1] + rate[1:])),
        "hold": rms(turned - rate[:-1]),
        "integrated": rms(turned - rate[1:]),
    }
    assert np.all(errors["average"] > 0.8 * ARCSEC)
    assert np.all(errors["average"] < 1.6 * ARCSEC)
    assert log.settings["gyro"]["sampling"] == "average"
    assert np.all(errors["average"] < errors["hold"])
    assert np.all(errors["average"] < errors["integrated"])


def test_fermi_wrong_conventions_would_show() -> None:
    log = sample("fermi")
    assert log.gyro is not None
    star, rate = log.stars["star"], log.gyro.rate
    mean = 0.5 * (rate[:-1] + rate[1:])
    r = rotations(star.q)
    inertial_rates = (r[1:] * r[:-1].inv()).as_rotvec() / np.diff(star.t)[:, None]
    wrong = {
        "inverse": rates_from_attitude(star.t, star.q * [1, -1, -1, -1]),
        "inertial": inertial_rates,
        "scalar last": rates_from_attitude(star.t, star.q[:, [3, 0, 1, 2]]),
    }
    for name, turned in wrong.items():
        assert rms(turned - mean).max() > 30 * ARCSEC, name


def test_noaa20_holds_what_the_readme_says() -> None:
    log = sample("noaa20")
    star, gnss = log.stars["star"], log.gnss
    assert gnss is not None
    assert log.gyro is None
    assert log.epoch == "2021-04-09T00:00:00"
    assert len(star) == len(gnss) == 7200
    assert np.allclose(gnss.t - star.t, 0.1, rtol=0, atol=1e-9)
    assert star.t[0] == -0.069059
    radius = np.linalg.norm(gnss.r, axis=1)
    assert radius.min() > 7.19e6
    assert radius.max() < 7.22e6
    assert gnss.v is not None
    moved = (gnss.r[2:] - gnss.r[:-2]) / (gnss.t[2:] - gnss.t[:-2])[:, None]
    assert rms(moved - gnss.v[1:-1]).max() < 0.2


def test_noaa20_body_follows_the_orbit() -> None:
    """Forward, right, nadir: to 0.2 degrees, as it points to the geodetic nadir."""
    coordinates = pytest.importorskip("astropy.coordinates")
    from astropy import units as u
    from astropy.time import Time, TimeDelta
    from astropy.utils import iers

    log = sample("noaa20")
    star, gnss = log.stars["star"], log.gnss
    assert gnss is not None
    assert gnss.v is not None
    rows = slice(0, None, 300)
    with iers.conf.set_temp("auto_download", False):
        when = Time(log.epoch, scale="utc") + TimeDelta(gnss.t[rows], format="sec")
        speed = coordinates.CartesianDifferential(*(gnss.v[rows].T * u.m / u.s))
        place = coordinates.CartesianRepresentation(*(gnss.r[rows].T * u.m), differentials=speed)
        there = coordinates.ITRS(place, obstime=when).transform_to(coordinates.GCRS(obstime=when))
    r = there.cartesian.xyz.to_value(u.m).T
    v = there.cartesian.differentials["s"].d_xyz.to_value(u.m / u.s).T
    z = -r / np.linalg.norm(r, axis=1)[:, None]
    h = np.cross(r, v)
    y = -h / np.linalg.norm(h, axis=1)[:, None]
    orbital = Rotation.from_matrix(np.stack([np.cross(y, z), y, z], axis=-1))
    turn = rates_from_attitude(star.t, star.q)
    turn = np.vstack([turn, turn[-1:]]) * 0.1
    body = rotations(star.q) * Rotation.from_rotvec(turn)
    off = (orbital.inv() * body[rows]).as_rotvec()
    assert np.abs(off).max() < 0.2 * DEG
    assert np.abs(off[:, 2]).max() < 3.0 * ARCSEC


def test_names_do_not_depend_on_the_working_directory(
    monkeypatch: pytest.MonkeyPatch, tmp_path: object
) -> None:
    monkeypatch.chdir(str(tmp_path))
    assert celestcore.samples.sample_names() == ("fermi", "noaa20")
