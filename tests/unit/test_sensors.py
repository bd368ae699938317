"""Sensors: what they accept, what they refuse, and mountings against scipy."""

from __future__ import annotations

import dataclasses
import pickle
from typing import Any

import numpy as np
import pytest
from celestcore.errors import CelestcoreWarning, InputError
from celestcore.sensors import Gyro, StarCamera, VectorSensor
from celestcore.units import ARCSEC, DEG
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

ROOT_HALF = np.sqrt(0.5)
# a quarter turn about z: the sensor's x axis is the body's y axis
QUARTER_Z = (ROOT_HALF, 0.0, 0.0, ROOT_HALF)

seeds = st.integers(0, 2**32 - 1)


def random_rotation(seed: int) -> Rotation:
    return Rotation.random(random_state=seed)


def scalar_first(rotation: Rotation) -> np.ndarray[Any, Any]:
    return np.roll(rotation.as_quat(), 1, axis=-1)


def unpack(noise: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    out = np.empty((len(noise), 3, 3))
    for k, (i, j) in enumerate([(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)]):
        out[:, i, j] = out[:, j, i] = noise[:, k]
    return out


@pytest.mark.parametrize(
    ("make", "field", "value"),
    [
        (lambda: Gyro(0.0), "gyro.arw", 0.0),
        (lambda: Gyro(-1e-6), "gyro.arw", -1e-6),
        (lambda: Gyro(np.inf), "gyro.arw", np.inf),
        (lambda: Gyro("fast"), "gyro.arw", "fast"),  # type: ignore[arg-type]
        (lambda: Gyro(None), "gyro.arw", None),  # type: ignore[arg-type]
        (lambda: Gyro([1e-6, 1e-6]), "gyro.arw", None),  # type: ignore[arg-type]
        (lambda: Gyro(1e-6, -1e-9), "gyro.rrw", -1e-9),
        (lambda: Gyro(1e-6, sampling="middle"), "gyro.sampling", "middle"),
        (lambda: Gyro(1e-6, mounting=[2.0, 0.0, 0.0, 0.0]), "gyro.mounting", None),
        (lambda: Gyro(1e-6, mounting=[0.0, 0.0, 0.0, 0.0]), "gyro.mounting", None),
        (lambda: Gyro(1e-6, mounting=[np.nan, 0.0, 0.0, 1.0]), "gyro.mounting", None),
        (lambda: Gyro(1e-6, mounting=np.eye(3)), "gyro.mounting", None),
        (lambda: Gyro(1e-6, mounting=np.eye(4)), "gyro.mounting", None),
        (lambda: Gyro(1e-6, frame=""), "gyro.frame", ""),
        (lambda: Gyro(1e-6, max_gap=0.0), "gyro.max_gap", 0.0),
        (lambda: Gyro(1e-6, gap_rate_sigma=-1.0), "gyro.gap_rate_sigma", -1.0),
        (lambda: StarCamera(0.0), "star.sigma", 0.0),
        (lambda: StarCamera([1e-5, 1e-5, -1e-5]), "star.sigma", -1e-5),
        (lambda: StarCamera([1e-5, 1e-5]), "star.sigma", None),
        (lambda: StarCamera(1e-5, covariance=np.eye(3)), "star", None),
        (lambda: StarCamera(covariance=np.eye(2)), "star.covariance", None),
        (lambda: StarCamera(covariance=np.diag([1.0, 1.0, 0.0])), "star.covariance", None),
        (lambda: StarCamera(covariance=np.diag([1.0, np.nan, 1.0])), "star.covariance", None),
        (lambda: StarCamera(covariance=np.eye(3) + np.eye(3, k=1)), "star.covariance", None),
        (lambda: StarCamera(1e-5, mounting=[1.0, 0.0, 0.0]), "star.mounting", None),
        (lambda: VectorSensor(0.0), "vector.sigma", 0.0),
        (lambda: VectorSensor(np.nan), "vector.sigma", None),
    ],
)
def test_bad_settings_name_the_field(make: Any, field: str, value: object) -> None:
    with pytest.raises(InputError) as caught:
        make()
    assert caught.value.field == field
    assert str(caught.value).startswith(field)
    if value is not None:
        assert caught.value.value == value
    assert "row" not in str(caught.value).split(":")[0]  # a setting has no rows


def test_covariance_that_is_indefinite_only_off_the_diagonal() -> None:
    with pytest.raises(InputError, match="positive definite"):
        StarCamera(covariance=[[1.0, 2.0, 0.0], [2.0, 1.0, 0.0], [0.0, 0.0, 1.0]])


@pytest.mark.parametrize("make", [StarCamera, VectorSensor])
def test_degrees_or_arcseconds_for_radians_warn(make: Any) -> None:
    with pytest.warns(CelestcoreWarning, match=r"celestcore\.ARCSEC"):
        make(5.0)


def test_gyro_in_degrees_warns() -> None:
    with pytest.warns(CelestcoreWarning, match="DEG_PER_SQRT_HOUR"):
        Gyro(0.02)


def test_sensors_are_values() -> None:
    a = Gyro(1e-6, 3e-9, mounting=QUARTER_Z)
    assert a == Gyro(1e-6, rrw=3e-9, mounting=np.array(QUARTER_Z))
    assert hash(a) == hash(pickle.loads(pickle.dumps(a)))
    assert dataclasses.replace(a, rrw=0.0).mounting == a.mounting
    with pytest.raises(dataclasses.FrozenInstanceError):
        a.arw = 1.0  # type: ignore[misc]
    camera = StarCamera([1e-5, 1e-5, 4e-5])
    assert camera == pickle.loads(pickle.dumps(camera))
    assert StarCamera(covariance=np.eye(3) * 1e-10) == StarCamera(covariance=np.eye(3) * 1e-10)


def test_mounting_is_taken_from_scipy_with_its_order() -> None:
    rotation = Rotation.from_euler("z", 90, degrees=True)
    assert np.allclose(Gyro(1e-6, mounting=rotation).mounting, QUARTER_Z, atol=1e-15)  # type: ignore[arg-type]


def test_small_norm_errors_are_normalised() -> None:
    q = Gyro(1e-6, mounting=[1.0005, 0.0, 0.0, 0.0]).mounting
    assert q == (1.0, 0.0, 0.0, 0.0)


def test_gyro_to_body_by_hand() -> None:
    turned = Gyro(1e-6, mounting=QUARTER_Z).to_body([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    assert np.allclose(turned, [[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]], atol=1e-15)
    assert turned.flags.c_contiguous


def test_gyro_without_mounting_copies_nothing() -> None:
    rate = np.ones((5, 3))
    assert Gyro(1e-6).to_body(rate) is rate


def test_camera_to_body_by_hand() -> None:
    # the camera's attitude is the identity, so the body's is the inverse of the mounting
    camera = StarCamera([1e-5, 2e-5, 3e-5], mounting=QUARTER_Z)
    q_ib, noise = camera.to_body([[1.0, 0.0, 0.0, 0.0]])
    assert np.allclose(q_ib, [[ROOT_HALF, 0.0, 0.0, -ROOT_HALF]], atol=1e-15)
    # the camera's x is the body's y: the noise goes with it
    assert np.allclose(noise, [[4e-10, 0.0, 0.0, 1e-10, 0.0, 9e-10]], atol=1e-24)


@given(seeds)
def test_camera_to_body_against_scipy(seed: int) -> None:
    rng = np.random.default_rng(seed)
    n = 4
    mounting, fixes = random_rotation(seed), Rotation.random(n, random_state=seed ^ 1)
    factor = rng.standard_normal((n, 3, 3))
    covariance = 1e-10 * (factor @ factor.transpose(0, 2, 1) + 0.1 * np.eye(3))
    q_ib, noise = StarCamera(mounting=mounting).to_body(scalar_first(fixes), covariance=covariance)
    expected = fixes * mounting.inv()
    assert np.all(
        (Rotation.from_quat(np.roll(q_ib, -1, axis=1)) * expected.inv()).magnitude() < 1e-14
    )
    assert np.allclose(np.linalg.norm(q_ib, axis=1), 1.0, atol=1e-15)
    turn = mounting.as_matrix()
    assert np.allclose(unpack(noise), turn @ covariance @ turn.T, rtol=1e-12, atol=1e-22)


@given(seeds)
def test_noise_is_that_of_an_error_in_the_camera_frame(seed: int) -> None:
    """An error about a camera axis is, seen in the body, along that axis there."""
    mounting, fix = random_rotation(seed), random_rotation(seed ^ 1)
    camera = StarCamera([1e-12, 1e-12, 1e-4], mounting=mounting)  # only about the boresight
    wrong = fix * Rotation.from_rotvec([0.0, 0.0, 1e-4])
    q, noise = camera.to_body(scalar_first(Rotation.concatenate([fix, wrong])))
    right_body, wrong_body = Rotation.from_quat(np.roll(q, -1, axis=1))
    error = (right_body.inv() * wrong_body).as_rotvec()
    assert np.allclose(np.outer(error, error), unpack(noise)[0], atol=1e-17)


def test_noise_of_the_fix_goes_before_the_cameras() -> None:
    q = np.tile([1.0, 0.0, 0.0, 0.0], (2, 1))
    sigma, covariance = np.full((2, 3), 2e-5), np.tile(9e-10 * np.eye(3), (2, 1, 1))
    for camera in (StarCamera(1e-5), StarCamera(covariance=1e-10 * np.eye(3)), StarCamera()):
        assert np.allclose(camera.to_body(q, sigma)[1][:, 0], 4e-10)
        assert np.allclose(camera.to_body(q, sigma, covariance)[1][:, 0], 9e-10)
    assert np.allclose(StarCamera(1e-5).to_body(q)[1], [[1e-10, 0, 0, 1e-10, 0, 1e-10]] * 2)


def test_no_noise_at_all_is_an_error() -> None:
    with pytest.raises(InputError, match=r"StarCamera\(sigma="):
        StarCamera().to_body([[1.0, 0.0, 0.0, 0.0]])


def test_results_are_fresh() -> None:
    q = np.array([[1.0, 0.0, 0.0, 0.0]])
    q_ib, noise = StarCamera(1e-5).to_body(q)
    assert not np.shares_memory(q_ib, q)
    assert noise.flags.c_contiguous
    assert noise.flags.writeable
    assert noise.shape == (1, 6)


@given(seeds)
def test_vector_to_body_against_scipy(seed: int) -> None:
    mounting = random_rotation(seed)
    b = np.random.default_rng(seed).standard_normal((5, 3)) * 1e4
    out = VectorSensor(1 * DEG, mounting=mounting).to_body(b)
    expected = mounting.apply(b / np.linalg.norm(b, axis=1)[:, None])
    assert np.allclose(out, expected, atol=1e-15)


def test_vector_without_direction() -> None:
    with pytest.raises(InputError) as caught:
        VectorSensor(5 * ARCSEC).to_body([[0.0, 0.0, 1.0], [0.0, 0.0, 0.0]])
    assert (caught.value.field, caught.value.row) == ("vector.body", 1)
