"""Orbital frame, eclipse, geodesy and aberration against ERFA, astropy and first principles."""

from __future__ import annotations

import celestcore as cc
import numpy as np
import pytest
from celestcore import frames, quaternion

erfa = pytest.importorskip("erfa")
pytest.importorskip("astropy_iers_data")

EPOCH = "2007-07-01T12:00:00"
RNG = np.random.default_rng(8)


def directions(n: int) -> np.ndarray:
    v = RNG.standard_normal((n, 3))
    return v / np.linalg.norm(v, axis=1, keepdims=True)


# --- orbital frame -----------------------------------------------------------------


def test_orbital_frame_points_where_it_says() -> None:
    r, v = directions(500) * 7e6, directions(500) * 7.5e3
    q_io = frames.orbital(r, v)
    down = -r / np.linalg.norm(r, axis=1, keepdims=True)
    assert np.allclose(quaternion.rotate(q_io, [0, 0, 1.0]), down, rtol=0, atol=1e-14)
    h = np.cross(r, v)
    y = quaternion.rotate(q_io, [0, 1.0, 0])
    assert np.allclose(y, -h / np.linalg.norm(h, axis=1, keepdims=True), rtol=0, atol=1e-13)
    x = quaternion.rotate(q_io, [1.0, 0, 0])
    assert ((x * v).sum(axis=1) > 0).all()
    assert np.abs((x * r).sum(axis=1)).max() < 1e-7


def test_orbital_frame_does_not_jump_and_keeps_its_axes() -> None:
    orbit = cc.elements.Elements(7.1e6, 0.01, 1.1, 0.5, 0.4, np.linspace(0, 30.0, 4000))
    r, v = cc.elements.to_state(orbit)
    q = frames.orbital(r, v)
    assert np.linalg.norm(np.diff(q, axis=0), axis=1).max() < 0.01
    assert frames.orbital(r[0], v[0]).shape == (4,)
    assert frames.orbital(r.reshape(2, 2000, 3), v.reshape(2, 2000, 3)).shape == (2, 2000, 4)
    with pytest.raises(cc.InputError, match=r"v, row 1: is along the position"):
        frames.orbital([[7e6, 0, 0]] * 2, [[0, 1.0, 0], [1.0, 0, 0]])
    with pytest.raises(cc.InputError, match="not zero"):
        frames.orbital([0.0, 0, 0], [0, 1.0, 0])


# --- eclipse -----------------------------------------------------------------


def covered(a: float, b: float, c: float, n: int = 1500) -> float:
    """Count the points of a disc of radius a that a disc of radius b at distance c covers."""
    x = (np.arange(n) + 0.5) / n * 2 * a - a
    grid = np.array(np.meshgrid(x, x))
    sun = (grid**2).sum(axis=0) < a * a
    earth = ((grid - [[[c]], [[0.0]]]) ** 2).sum(axis=0) < b * b
    return float((sun & earth).sum() / sun.sum())


@pytest.mark.parametrize("distance", [7e6, 4.2e7, 2e9])
def test_eclipse_is_the_covered_part_of_the_disc(distance: float) -> None:
    """Discs by counting points; at 2e9 m the Earth is smaller than the Sun (annular)."""
    sun = np.array([1.496e11, 0.0, 0.0])
    b = np.arcsin(6378137.0 / distance)
    a = np.arcsin(6.957e8 / (1.496e11 + distance))
    assert (b < a) == (distance > 1e9)
    for c in np.linspace(abs(b - a) * 0.5, (a + b) * 1.05, 15):
        # the satellite from which the Sun stands c away from the Earth's centre
        beyond = c + np.arcsin(distance * np.sin(c) / 1.496e11)
        r = -distance * np.array([np.cos(beyond), np.sin(beyond), 0.0])
        seen = frames.eclipse(r, sun)
        to_sun = sun - r
        angle = np.arccos(-(r @ to_sun) / np.linalg.norm(r) / np.linalg.norm(to_sun))
        size = np.arcsin(6.957e8 / np.linalg.norm(to_sun))
        assert seen.lit == pytest.approx(1.0 - covered(size, b, angle), abs=2e-3)


def test_umbra_penumbra_and_sun_follow_each_other() -> None:
    t = np.linspace(0.0, 6000.0, 12001)
    orbit = cc.elements.Elements(7136.635e3, 0.0, 0.4, 0.0, 0.0, 0.0)
    r, _ = cc.elements.to_state(cc.elements.two_body(orbit, t))
    s = frames.sun(EPOCH, t)
    seen = frames.eclipse(r, s)
    assert (seen.lit[seen.umbra] == 0.0).all()
    assert ((seen.lit > 0.0) & (seen.lit < 1.0)).sum() >= seen.penumbra.sum() - 2
    assert (seen.lit[~seen.umbra & ~seen.penumbra] == 1.0).all()
    steps = np.abs(np.diff(seen.lit))
    assert 0.0 < steps.max() < 0.1  # it fades over some seconds, the steps are of 0.5 s
    # the shadow of a low orbit lasts about a third of it
    assert 0.3 < seen.umbra.mean() < 0.37
    # a cylinder's shadow is that of a Sun without width
    point = frames.eclipse(r, s, sun_radius=1.0)
    s /= np.linalg.norm(s, axis=1, keepdims=True)
    along = (r * s).sum(axis=1)
    behind = (along < 0) & (np.linalg.norm(r - along[:, None] * s, axis=1) < 6378137.0)
    assert (behind == point.umbra).mean() > 0.999


def test_eclipse_refuses_what_is_inside_the_earth() -> None:
    with pytest.raises(cc.InputError, match=r"r, row 1, value 7000.*inside the Earth"):
        frames.eclipse([[7e6, 0, 0], [7e3, 0, 0]], [1.5e11, 0, 0])


# --- geodesy -----------------------------------------------------------------


def test_geodetic_is_erfas_and_comes_back() -> None:
    heights = RNG.uniform(-5e3, 5e7, 3000)
    r_e = directions(3000) * (6371e3 + heights[:, None])
    r_e = np.vstack([r_e, [[0, 0, 7e6], [0, 0, -7e6], [7e6, 0, 0], [-7e6, 0, 1e-3]]])
    place = frames.geodetic(r_e)
    lon, lat, height = erfa.gc2gd(1, r_e)
    # ERFA's way there stops after one step (1 mm at 50 000 km); its way back is exact
    assert np.abs(place.latitude - lat).max() < 3e-11
    assert np.abs(place.longitude - lon).max() < 1e-15
    assert np.abs(place.height - height).max() < 1e-5
    back = erfa.gd2gc(1, place.longitude, place.latitude, place.height)
    assert np.abs(back - r_e).max() < 3e-8
    assert np.abs(frames.from_geodetic(*place) - r_e).max() < 3e-8
    with pytest.raises(cc.InputError, match=r"r_e, row 0.*kilometres"):
        frames.geodetic([[7000.0, 0.0, 0.0]])


def test_ground_track_and_nadir() -> None:
    t = np.linspace(0.0, 6000.0, 50)
    orbit = cc.elements.Elements(7136.635e3, 1.8e-3, 1.134, 0.5, 0.5, 0.0)
    r, _ = cc.elements.to_state(cc.elements.two_body(orbit, t))
    track = frames.ground_track(EPOCH, t, r)
    r_e = (frames.gcrs_to_itrs(EPOCH, t) @ r[..., None])[..., 0]
    back = erfa.gd2gc(1, track.longitude, track.latitude, track.height)
    assert np.abs(back - r_e).max() < 1e-8
    down = frames.nadir(EPOCH, t, r)
    assert np.allclose(np.linalg.norm(down, axis=1), 1.0, rtol=0, atol=1e-15)
    # down by the height one stands on the ellipsoid
    foot = frames.ground_track(EPOCH, t, r + track.height[:, None] * down)
    assert np.abs(foot.height).max() < 1e-6
    centre = -r / np.linalg.norm(r, axis=1, keepdims=True)
    apart = np.linalg.norm(np.cross(centre, down), axis=1)
    assert 0.15 < np.rad2deg(apart.max()) < 0.19
    with pytest.raises(cc.InputError, match="r: has shape"):
        frames.nadir(EPOCH, t, r[:10])


# --- aberration -----------------------------------------------------------------


def test_aberration_is_erfas() -> None:
    u, v = directions(200), directions(200) * 3.1e4
    beta = v / frames._orbit.LIGHT
    lag = np.sqrt(1.0 - (beta**2).sum(axis=1))
    want = erfa.ab(u, beta, 1e30, lag)
    assert np.abs(frames.aberrate(u, v) - want).max() < 3e-16
    assert np.abs(frames.aberrate(frames.aberrate(u, v), -v) - u).max() < 1e-15
    # the Sun's potential, which is left out
    assert np.abs(frames.aberrate(u, v) - erfa.ab(u, beta, 1.0, lag)).max() < 1e-6 * cc.ARCSEC
    assert np.abs(frames.aberrate(2.0 * u, np.zeros(3)) - u).max() < 3e-16


def test_aberration_at_any_speed_and_no_faster() -> None:
    seen = frames.aberrate([0.0, 1.0, 0.0], [0.6 * frames._orbit.LIGHT, 0, 0])
    assert np.allclose(seen, [0.6, 0.8, 0.0])
    with pytest.raises(cc.InputError, match="speed of light"):
        frames.aberrate([0.0, 1.0, 0.0], [3e8, 0, 0])
    with pytest.raises(cc.InputError, match="not zero"):
        frames.aberrate([0.0, 0.0, 0.0], [3e4, 0, 0])
