"""`wahba.solve`: its face. Shapes, missing vectors, weights, and errors that say which axis."""

from __future__ import annotations

import pickle
from typing import Any

import numpy as np
import pytest
from celestcore import quaternion as quat
from celestcore import wahba
from celestcore.errors import InputError
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

Array = NDArray[np.float64]
METHODS = pytest.mark.parametrize("method", wahba.METHODS)


def scene(*leading: int, k: int = 5, sigma: float = 1e-3, seed: int = 0) -> tuple[Array, ...]:
    """Return attitudes, noisy body vectors (..., k, 3) and inertial ones (k, 3)."""
    rng = np.random.default_rng(seed)
    q = rng.normal(size=(*leading, 4))
    q /= np.linalg.norm(q, axis=-1, keepdims=True)
    r = rng.normal(size=(k, 3))
    r /= np.linalg.norm(r, axis=-1, keepdims=True)
    b = quat.rotate(quat.conjugate(q)[..., None, :], r)
    return q, b + sigma * rng.normal(size=b.shape), r


@METHODS
@pytest.mark.parametrize("leading", [(), (1,), (7,), (2, 3), (0,), (3, 0)])
def test_shapes(leading: tuple[int, ...], method: str) -> None:
    q, b, r = scene(*leading)
    fix = wahba.solve(b, r, sigma=1e-3, method=method)
    assert fix.q.shape == (*leading, 4)
    assert fix.covariance is not None
    assert fix.covariance.shape == (*leading, 3, 3)
    assert fix.loss.shape == fix.vectors.shape == leading
    assert fix.sigma.shape == (*leading, 3)
    assert fix.vectors.dtype.kind == "i"
    assert np.all(fix.vectors == 5)
    if fix.q.size:
        assert quat.angle_between(fix.q, q).max() < 5e-3


def test_broadcasting_equals_frame_by_frame() -> None:
    q, b, r = scene(4, 3)
    sigma = np.linspace(1e-3, 2e-3, 5)
    fix = wahba.solve(b, r[None, None], sigma=sigma)
    for i in np.ndindex(4, 3):
        one = wahba.solve(b[i], r, sigma=sigma)
        assert np.array_equal(one.covariance, fix.covariance[i])  # type: ignore[index, arg-type]
        assert min(np.abs(one.q - fix.q[i]).max(), np.abs(one.q + fix.q[i]).max()) == 0.0
        assert one.loss == fix.loss[i]
    one_camera = wahba.solve(b[0, 0], np.stack([r, r]), sigma=1.0)
    assert one_camera.q.shape == (2, 4)
    assert len(q)


def test_signs_are_continuous_along_time() -> None:
    q = quat.exp(np.linspace(0.0, 12.0, 200)[:, None] * [0.0, 0.6, 0.8])
    r = np.eye(3)
    b = quat.rotate(quat.conjugate(q)[:, None], r)
    b[50:60] = np.nan
    fix = wahba.solve(b, r, degenerate="nan")
    known = np.isfinite(fix.q[:, 0])
    assert known.sum() == 190
    assert fix.q[0, 0] > 0.0
    assert np.abs(fix.q[known] - q[known]).max() < 1e-14
    whole = wahba.solve(b[60:], r)
    assert np.einsum("ij,ij->i", whole.q[1:], whole.q[:-1]).min() > 0.9


def test_missing_rows_and_any_length() -> None:
    _, b, r = scene(6)
    padded_b = np.concatenate([b, np.full((6, 2, 3), np.nan)], axis=1)
    padded_r = np.concatenate([r, np.ones((2, 3))])
    sigma = np.r_[np.full(5, 1e-3), np.nan, 0.0]
    want = wahba.solve(b, r, sigma=1e-3)
    got = wahba.solve(padded_b, padded_r, sigma=sigma)
    assert np.array_equal(got.q, want.q)
    assert np.array_equal(got.covariance, want.covariance)  # type: ignore[arg-type]
    assert np.all(got.vectors == 5)
    masked = np.ma.masked_invalid(padded_b)
    assert np.array_equal(wahba.solve(masked, padded_r, sigma=sigma).q, want.q)
    for scale in (1e-200, 1e-3, 7.0, 1e200):
        assert np.abs(wahba.solve(scale * b, r / scale, sigma=1e-3).q - want.q).max() < 1e-15


def test_inputs_of_other_kinds_stay_unchanged() -> None:
    _, b, r = scene(3)
    want = wahba.solve(b, r)
    kept = b.copy()
    assert np.array_equal(wahba.solve(np.asfortranarray(b), r.tolist()).q, want.q)
    assert np.array_equal(wahba.solve(b[::-1], r).q[::-1] * np.sign(want.q), np.abs(want.q))
    wahba.solve(b.astype(np.float32), r)
    assert np.array_equal(b, kept)


@METHODS
def test_weights(method: str) -> None:
    _, b, r = scene(20)
    sigma = np.array([1e-3, 2e-3, 5e-4, 1e-2, 3e-3])
    by_sigma = wahba.solve(b, r, sigma=sigma, method=method)
    by_weight = wahba.solve(b, r, weights=7.0 / sigma**2, method=method)
    assert by_weight.covariance is None
    with pytest.raises(InputError, match="sigma"):
        _ = by_weight.sigma
    assert np.abs(by_weight.q - by_sigma.q).max() < 1e-14
    assert np.allclose(by_weight.loss, 7.0 * by_sigma.loss, rtol=1e-10, atol=0.0)
    both = wahba.solve(b, r, sigma=sigma, weights=3.0 / sigma**2, method=method)
    assert np.allclose(both.covariance, by_sigma.covariance, rtol=1e-9, atol=1e-18)  # type: ignore[arg-type]
    left_out = wahba.solve(b, r, weights=[1.0, 1.0, 0.0, 1.0, 1.0], method=method)
    some = wahba.solve(b[:, [0, 1, 3, 4]], r[[0, 1, 3, 4]], method=method)
    assert np.array_equal(left_out.q, some.q)
    assert np.all(left_out.vectors == 4)


@METHODS
@pytest.mark.parametrize("k", [1, 2, 4])
def test_collinear_vectors_name_frame_and_axis(method: str, k: int) -> None:
    q, b, r = scene(6, sigma=0.0)
    b[4, :k] = np.array([1.0, -2.0, 0.5, 3.0])[:k, None] * b[4, 0]
    rr = np.tile(r, (6, 1, 1))
    rr[4, :k] = np.array([1.0, -2.0, 0.5, 3.0])[:k, None] * rr[4, 0]
    b[:, k:] = np.where(np.arange(6)[:, None, None] == 4, np.nan, b[:, k:])
    with pytest.raises(InputError, match="unobservable") as caught:
        wahba.solve(b, rr, method=method)
    assert caught.value.row == 4
    assert caught.value.field == "body"
    axis = np.asarray(caught.value.value, dtype=float)
    unit = b[4, 0] / np.linalg.norm(b[4, 0])
    assert np.abs(np.abs(axis @ unit) - 1.0) < 1e-12
    assert "row 4" in str(caught.value)
    assert all(f"{c!r}" in str(caught.value) for c in axis.tolist())
    assert pickle.loads(pickle.dumps(caught.value)).row == 4
    rest = wahba.solve(b, rr, method=method, degenerate="nan")
    assert np.isnan(rest.q[4]).all()
    assert np.isnan(rest.loss[4])
    assert rest.vectors[4] == k
    others = np.arange(6) != 4
    assert quat.angle_between(rest.q[others], q[others]).max() < 1e-14


@METHODS
def test_nearly_collinear(method: str) -> None:
    def pair(apart: float) -> Array:
        return np.array([[1.0, 0.0, 0.0], [np.cos(apart), np.sin(apart), 0.0]])

    with pytest.raises(InputError, match="unobservable") as caught:
        wahba.solve(pair(1e-7), pair(1e-7), method=method)
    assert caught.value.row is None
    assert np.abs(np.asarray(caught.value.value) - [1.0, 0.0, 0.0]).max() < 1e-6
    fix = wahba.solve(pair(1e-5), pair(1e-5), sigma=1e-6, method=method)
    assert fix.sigma[0] == pytest.approx(1e-6 * np.sqrt(2.0) / 1e-5, rel=1e-5)


@METHODS
def test_no_vectors(method: str) -> None:
    for body in (np.empty((0, 3)), np.full((3, 3), np.nan)):
        with pytest.raises(InputError, match="no axis is observable") as caught:
            wahba.solve(body, np.ones(body.shape), method=method)
        assert caught.value.row is None
    with pytest.raises(InputError) as caught:
        wahba.solve(np.empty((2, 0, 3)), np.empty((0, 3)), method=method)
    assert caught.value.row == 0
    fix = wahba.solve(np.empty((2, 0, 3)), np.empty((0, 3)), sigma=1.0, degenerate="nan")
    assert np.isnan(fix.q).all()
    assert np.isnan(fix.sigma).all()


@METHODS
def test_contradicting_vectors(method: str) -> None:
    with pytest.raises(InputError, match="contradicting"):
        wahba.solve(np.eye(3), -np.eye(3), method=method)


E = np.eye(3)


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ({"body": [1.0, 0.0, 0.0]}, r"body: has shape \(3,\)"),
        ({"inertial": np.eye(4)}, r"inertial: has shape \(4, 4\)"),
        ({"inertial": E[:2]}, "inertial: holds 2 vectors"),
        ({"body": np.tile(E, (2, 1, 1)), "inertial": np.tile(E, (3, 1, 1))}, "broadcast"),
        ({"sigma": [1.0, 2.0]}, "sigma: has 2 columns for 3"),
        ({"weights": [1.0, 2.0]}, "weights: has 2 columns for 3"),
        ({"sigma": 1.0, "weights": [1.0, 2.0]}, "weights: has 2 columns for 3"),
        (
            {"body": np.tile(E, (2, 1, 1)), "sigma": 1.0, "weights": np.ones((4, 3))},
            r"weights: leading axes \(4,\) do not broadcast to \(2,\)",
        ),
        ({"sigma": 0.0}, "sigma, value 0.0: vector 0"),
        ({"sigma": [1.0, np.nan, 1.0]}, "sigma, value nan: vector 1"),
        ({"weights": [1.0, 1.0, -1.0]}, "weights, value -1.0: vector 2"),
        ({"weights": np.inf}, "weights, value inf"),
        ({"body": [[1.0, 0, 0], [0, 0, 0], [0, 0, 1.0]]}, "body: vector 1 is zero"),
        ({"body": np.stack([E, 0.0 * E])}, "body, row 1: vector 0 is zero"),
        ({"body": [["a"] * 3] * 3}, "body"),
        ({"method": "foam"}, "method, value 'foam'"),
        ({"degenerate": "skip"}, "degenerate, value 'skip'"),
        ({"body": E[:1], "inertial": E[:1], "sigma": [1.0, 2.0, 3.0]}, "3 columns for 1"),
    ],
)
def test_wrong_input(arguments: dict[str, Any], says: str) -> None:
    with pytest.raises(InputError, match=says):
        wahba.solve(**{"body": E, "inertial": E, **arguments})


def test_as_rotation() -> None:
    q, b, r = scene(3, sigma=0.0)
    rotation = wahba.solve(b, r).as_rotation()
    assert isinstance(rotation, Rotation)
    assert np.abs(rotation.apply(b[:, 0]) - r[0]).max() < 1e-14
    assert len(q) == 3
