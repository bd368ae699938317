"""Sky cameras: against angles of all stars, one by one, and what is refused."""

from __future__ import annotations

import time
from typing import Any

import celestcore as cc
import numpy as np
import pytest
from celestcore import orbit, quaternion
from celestcore.celestial import SkyCamera, StarsInView

SKY = cc.StarCatalogue.random(4559, seed=3)
T = np.arange(0.0, 6000.0, 20.0)
ORBIT = orbit.propagate(orbit.ForceModel.j2(), None, [7.1e6, 0, 0], [0, 3.2e3, 6.76e3], T)
EARTH = 6378137.0


def seen_by(camera: SkyCamera) -> StarsInView:
    return camera.visible(ORBIT.t, ORBIT.r, ORBIT.v)


def rows_at(camera: SkyCamera, k: int) -> Any:
    """The stars of one epoch, by angles in the orbital frame."""
    q_io = cc.frames.orbital(ORBIT.r[k], ORBIT.v[k])
    stars = SKY.directions
    if not camera.inertial:
        stars = quaternion.rotate(quaternion.conjugate(q_io), stars)
    z = np.asarray(camera.boresight)
    x = np.asarray(camera.along)
    first = np.arctan2(stars @ x, stars @ z)
    second = np.arctan2(stars @ np.cross(z, x), stars @ z)
    inside = (abs(first) <= camera.field_of_view[0] / 2) & (
        abs(second) <= camera.field_of_view[1] / 2
    )
    radius = np.linalg.norm(ORBIT.r[k])
    from_nadir = np.arccos(np.clip(-SKY.directions @ ORBIT.r[k] / radius, -1.0, 1.0))
    inside &= from_nadir > np.arcsin((EARTH + camera.earth_margin) / radius)
    rows = np.flatnonzero(inside)
    rows = rows[np.argsort(SKY.magnitude[rows], kind="stable")]
    return rows if camera.brightest is None else rows[: camera.brightest]


@pytest.mark.parametrize(
    "camera",
    [
        SkyCamera(SKY),
        SkyCamera(SKY, (0.3, 0.1), boresight=(1, 0, -1), along=(0.2, 1, 0.1), brightest=None),
        SkyCamera(SKY, (2.0, 0.8), boresight=(-1, 0.2, 0.45), along=(0, 1, 0), earth_margin=0.0),
        SkyCamera(SKY, (0.5, 0.9), boresight=(0.3, 0.5, 0.8), inertial=True, brightest=3),
    ],
    ids=["zenith", "tilted", "limb", "inertial"],
)
def test_every_star_in_the_field_is_seen_and_no_other(camera: SkyCamera) -> None:
    seen = seen_by(camera)
    assert len(seen.counts) == len(T)
    for k in range(0, len(T), 7):
        np.testing.assert_array_equal(seen.row[seen.epoch == k], rows_at(camera, k))
    np.testing.assert_array_equal(np.bincount(seen.epoch, minlength=len(T)), seen.counts)
    np.testing.assert_array_equal(seen.t, T[seen.epoch])
    np.testing.assert_array_equal(seen.star, SKY.directions[seen.row])


def test_the_order_of_the_catalogue_changes_nothing() -> None:
    order = np.random.default_rng(1).permutation(len(SKY))
    mixed = cc.StarCatalogue(SKY.directions[order], SKY.magnitude[order])
    one, other = seen_by(SkyCamera(SKY)), seen_by(SkyCamera(mixed))
    np.testing.assert_array_equal(one.row, order[other.row])


def test_the_earth_hides_what_is_behind_it() -> None:
    down = seen_by(SkyCamera(SKY, (1.5, 1.5), boresight=(0, 0, 1), brightest=None))
    assert len(down) == 0
    assert (down.counts == 0).all()
    assert repr(down) == "StarsInView(0 stars at 300 epochs, 300 of them without any)"
    limb = {
        m: len(
            seen_by(
                SkyCamera(SKY, (1.0, 1.0), boresight=(-1, 0, 0.5), brightest=None, earth_margin=m)
            )
        )
        for m in (-EARTH, 0.0, 100e3)
    }
    assert limb[-EARTH] > limb[0.0] > limb[100e3]


def test_several_cameras_are_put_side_by_side() -> None:
    cameras = [SkyCamera(SKY), SkyCamera(SKY, boresight=(0, -1, 0), brightest=2)]
    parts = [seen_by(camera) for camera in cameras]
    both = StarsInView.join(parts)
    np.testing.assert_array_equal(both.counts, parts[0].counts + parts[1].counts)
    assert (np.diff(both.epoch) >= 0).all()
    for k in (0, 100, 299):
        at = both.epoch == k
        np.testing.assert_array_equal(
            both.row[at], np.concatenate([p.row[p.epoch == k] for p in parts])
        )
        assert (np.diff(both.camera[at]) >= 0).all()


def test_ten_hours_of_sky_take_less_than_a_second() -> None:
    t = np.arange(12_001) * 3.0
    long = orbit.propagate(orbit.ForceModel.j2(), None, ORBIT.r[0], ORBIT.v[0], t)
    begin = time.perf_counter()
    SkyCamera(SKY).visible(long.t, long.r, long.v)
    assert time.perf_counter() - begin < 1.0


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"field_of_view": (0.1, 0.0)}, "field_of_view"),
        ({"field_of_view": (0.1, 10.0)}, "field_of_view"),
        ({"field_of_view": (0.1,)}, "field_of_view"),
        ({"boresight": (0, 0, 0)}, "boresight"),
        ({"boresight": (np.nan, 0, 1)}, "boresight"),
        ({"along": (0, 0, 2)}, "along"),
        ({"brightest": 0}, "brightest"),
        ({"brightest": 2.5}, "brightest"),
        ({"earth_margin": np.inf}, "earth_margin"),
        ({"earth_margin": -7e6}, "earth_margin"),
        ({"catalogue": [1.0]}, "catalogue"),
    ],
)
def test_cameras_that_cannot_be(change: dict[str, Any], field: str) -> None:
    with pytest.raises(cc.InputError) as caught:
        SkyCamera(**{"catalogue": SKY, **change})
    assert caught.value.field == field


def test_orbits_that_cannot_be() -> None:
    camera = SkyCamera(SKY)
    good = ORBIT[:3]
    kilometres, still, along = good.r.copy(), good.v.copy(), good.v.copy()
    kilometres[1] /= 1e3
    still[2] = 0.0
    along[0] = 1e-3 * good.r[0]
    for r, v, field, row in (
        (kilometres, good.v, "r", 1),
        (good.r, still, "v", 2),
        (good.r, along, "v", 0),
    ):
        with pytest.raises(cc.InputError) as caught:
            camera.visible(good.t, r, v)
        assert (caught.value.field, caught.value.row) == (field, row)
    with pytest.raises(cc.InputError, match="needed is"):
        camera.visible(good.t, good.r[:2], good.v)
