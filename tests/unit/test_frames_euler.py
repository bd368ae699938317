"""Euler angles against scipy, near and at the singularity; the geodetic orbital frame."""

from __future__ import annotations

import celestcore as cc
import numpy as np
import pytest
from celestcore import frames, quaternion
from scipy.interpolate import BarycentricInterpolator
from scipy.spatial.transform import Rotation

RNG = np.random.default_rng(6)
EPOCH = "2026-01-01T00:00:00"


def unit(v: np.ndarray) -> np.ndarray:
    return np.asarray(v / np.linalg.norm(v, axis=-1, keepdims=True))


# --- 3-2-1 angles -----------------------------------------------------------------


def test_angles_are_scipys_zyx() -> None:
    turns = Rotation.random(5000, rng=1)
    made = frames.euler_321(turns)
    yaw, pitch, roll = turns.as_euler("ZYX").T
    assert np.allclose(made.yaw, yaw, rtol=0, atol=2e-12)
    assert np.allclose(made.pitch, pitch, rtol=0, atol=1e-12)
    assert np.allclose(made.roll, roll, rtol=0, atol=2e-12)
    back = frames.from_euler_321(yaw, pitch, roll)
    assert quaternion.angle_between(back, quaternion.from_rotation(turns)).max() < 1e-14


def test_quaternion_of_either_sign_matrix_and_rotation_give_the_same() -> None:
    turns = Rotation.random(200, rng=2)
    q = quaternion.from_rotation(turns).reshape(10, 20, 4)
    first = frames.euler_321(q)
    assert first.yaw.shape == first.near_singular.shape == (10, 20)
    for other in (-q, turns.as_matrix().reshape(10, 20, 3, 3)):
        for a, b in zip(first, frames.euler_321(other), strict=True):
            assert np.allclose(a, b, rtol=0, atol=1e-12)
    assert frames.euler_321(q[0, 0]).pitch.shape == ()


def test_the_matrix_is_made_of_elementary_frame_turns() -> None:
    """R3, R2, R1 of the textbooks take components of the first frame to the turned one."""
    yaw, pitch, roll = 0.3, -0.4, 0.5
    c, s = np.cos, np.sin
    r3 = np.array([[c(yaw), s(yaw), 0], [-s(yaw), c(yaw), 0], [0, 0, 1]])
    r2 = np.array([[c(pitch), 0, -s(pitch)], [0, 1, 0], [s(pitch), 0, c(pitch)]])
    r1 = np.array([[1, 0, 0], [0, c(roll), s(roll)], [0, -s(roll), c(roll)]])
    made = quaternion.to_matrix(frames.from_euler_321(yaw, pitch, roll))
    assert np.allclose(made, (r1 @ r2 @ r3).T, rtol=0, atol=1e-15)


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize("off", [1e-3, 1e-6, 1e-8])
def test_pitch_and_the_sum_stay_exact_near_the_singularity(side: float, off: float) -> None:
    yaw, roll = RNG.uniform(-1.5, 1.5, (2, 500))
    made = frames.euler_321(frames.from_euler_321(yaw, side * (np.pi / 2 - off), roll))
    assert np.allclose(made.pitch, side * (np.pi / 2 - off), rtol=0, atol=1e-15)
    apart = (made.yaw - side * made.roll) - (yaw - side * roll)
    assert np.abs((apart + np.pi) % (2 * np.pi) - np.pi).max() < 2e-15
    assert np.abs(made.yaw - yaw).max() < 4e-16 / off
    assert made.near_singular.all()


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_at_the_singularity_yaw_takes_the_whole_turn(side: float) -> None:
    yaw, roll = RNG.uniform(-3, 3, (2, 500))
    q = frames.from_euler_321(yaw, side * np.pi / 2, roll)
    made = frames.euler_321(q)
    assert (made.roll == 0.0).all()
    assert np.abs(made.yaw).max() <= np.pi
    back = frames.from_euler_321(made.yaw, made.pitch, made.roll)
    assert quaternion.angle_between(back, q).max() < 1e-14


def test_the_flag_has_a_margin() -> None:
    pitch = np.radians([0.0, 85.0, -89.85, 89.95, -89.95])
    q = frames.from_euler_321(0.1, pitch, 0.2)
    assert frames.euler_321(q).near_singular.tolist() == [False, False, False, True, True]
    wide = frames.euler_321(q, margin=np.radians(6.0)).near_singular
    assert wide.tolist() == [False, True, True, True, True]


def test_missing_rows_stay_missing_and_bad_ones_are_named() -> None:
    gone = frames.euler_321([[np.nan] * 4, [1.0, 0, 0, 0]])
    assert np.isnan(gone.yaw[0])
    assert gone.yaw[1] == 0.0
    assert not gone.near_singular.any()
    matrices = np.stack([np.full((3, 3), np.nan), np.eye(3)])
    assert np.isnan(frames.euler_321(matrices).roll).tolist() == [True, False]
    with pytest.raises(cc.InputError, match=r"attitude, row 1.*unit quaternion"):
        frames.euler_321([[1.0, 0, 0, 0], [2.0, 0, 0, 0]])
    with pytest.raises(cc.InputError, match="not a proper rotation matrix"):
        frames.euler_321(np.diag([1.0, 1.0, -1.0]))
    with pytest.raises(cc.InputError, match=r"shape \(3,\)"):
        frames.euler_321([0.1, 0.2, 0.3])
    with pytest.raises(cc.InputError, match="do not fit"):
        frames.from_euler_321([0.1, 0.2], [0.1, 0.2, 0.3], 0.0)


# --- geodetic nadir ---------------------------------------------------------------


def test_the_geodetic_frame_points_down_and_its_y_is_nearest_the_normal() -> None:
    pytest.importorskip("erfa")
    r, v = unit(RNG.standard_normal((300, 3))) * 7.2e6, RNG.standard_normal((300, 3)) * 4e3
    t = np.arange(300.0)
    q = frames.orbital_geodetic(EPOCH, t, r, v)
    x, y, z = np.moveaxis(quaternion.to_matrix(q), -1, 0)
    assert np.abs(z - frames.nadir(EPOCH, t, r)).max() < 1e-15
    normal = -unit(np.cross(r, v))
    # no other direction across z is nearer: the normal has no part along x
    assert np.abs((normal * x).sum(axis=1)).max() < 1e-15
    assert ((normal * y).sum(axis=1) > 0.99).all()
    apart = quaternion.angle_between(q, frames.orbital(r, v))
    assert 0.15 < np.degrees(apart).max() < 0.2
    one = frames.orbital_geodetic(EPOCH, 5.0, r[5], v[5])
    assert quaternion.angle_between(one, q[5]) < 1e-15


def test_over_the_pole_and_the_equator_both_nadirs_are_one() -> None:
    pytest.importorskip("erfa")
    ends = np.array([[0, 0, 7e6], [0, 0, -7e6], [7e6, 0, 0], [0, -7e6, 0]])
    r, _ = frames.to_gcrs(EPOCH, np.zeros(4), ends)
    v = np.cross(r, [0.3, 0.4, 0.5]) * 1e-3
    apart = quaternion.angle_between(
        frames.orbital_geodetic(EPOCH, np.zeros(4), r, v), frames.orbital(r, v)
    )
    assert apart.max() < 1e-8


def test_the_geodetic_frame_names_bad_rows() -> None:
    r = [[7e6, 0, 0]] * 2
    with pytest.raises(cc.InputError, match=r"v, row 1, .*no orbital plane"):
        frames.orbital_geodetic(EPOCH, [0.0, 1.0], r, [[0, 7e3, 0], [7e3, 0, 0]])
    with pytest.raises(cc.InputError, match=r"v, row 0, .*no orbital plane"):
        frames.orbital_geodetic(EPOCH, [0.0, 1.0], r, [[np.nan] * 3, [0, 7e3, 0]])
    with pytest.raises(cc.InputError, match=r"v: has shape \(3,\)"):
        frames.orbital_geodetic(EPOCH, [0.0, 1.0], r, [0, 7e3, 0])


# --- a real spacecraft ------------------------------------------------------------


def _at(t: np.ndarray, known: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Interpolate rows by cubics through the four nearest samples."""
    first = np.clip(np.searchsorted(known, t) - 2, 0, len(known) - 4)
    out = np.empty((len(t), 3))
    for row, k in enumerate(first):
        part = slice(k, k + 4)
        out[row] = BarycentricInterpolator(known[part] - t[row], values[part])(0.0)
    return out


def test_noaa20_keeps_to_the_geodetic_frame_of_its_own_gps() -> None:
    """The frame chain against a real log: position and attitude are independent of each other."""
    pytest.importorskip("erfa")
    log = cc.sample("noaa20")
    star, gnss = log.stars["star"], log.gnss
    assert gnss is not None
    inside = (star.t >= gnss.t[0]) & (star.t <= gnss.t[-1])
    t, q_ib = star.t[inside][::4], star.q[inside][::4]
    assert np.median(gnss.t[:7000] - star.t[:7000]) == pytest.approx(0.1, abs=1e-3)
    r_e, v_e = _at(t, gnss.t, gnss.r), _at(t, gnss.t, gnss.v)
    r, v = frames.to_gcrs(log.epoch, t, r_e, v_e)
    assert v is not None
    q_io = frames.orbital_geodetic(log.epoch, t, r, v)
    off = np.degrees(quaternion.log(quaternion.multiply(quaternion.conjugate(q_io), q_ib)))
    assert np.allclose(off.std(axis=0), [0.00060, 0.00080, 0.00016], rtol=0, atol=2e-5)
    assert np.abs(off).max() < 0.0042
    assert np.abs(off.mean(axis=0)).max() < 5e-5
    # the centre of the Earth instead of the nadir
    q_io = frames.orbital(r, v)
    off = np.degrees(quaternion.log(quaternion.multiply(quaternion.conjugate(q_io), q_ib)))
    assert 0.16 < np.abs(off).max() < 0.19
