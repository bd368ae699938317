"""Wahba's problem: Markley's test cases, scipy as a reference, symmetries and consistency."""

from __future__ import annotations

import numpy as np
import pytest
from celestcore import quaternion as quat
from celestcore import wahba
from celestcore._core import chi2_quantile
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

Array = NDArray[np.float64]
METHODS = pytest.mark.parametrize("method", wahba.METHODS)

TRUTH = np.array([[0.352, 0.864, 0.360], [-0.864, 0.152, 0.480], [0.360, -0.480, 0.800]])
"""The attitude matrix of the test cases, inertial to body."""
AXES = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
TURNED = [[0.6, 0.8, 0.0], [0.8, -0.6, 0.0]]
CLOSE = [[1.0, 0.0, 0.0], [1.0, 0.01, 0.0], [1.0, 0.0, 0.01]]
WIDE = [[1.0, 0.0, 0.0], [0.96, 0.28, 0.0], [0.96, 0.0, 0.28]]
FIVE = [[1.0, 0.0, 0.0]] + [
    [0.99712, y, z] for y, z in ((0.07584, 0.0), (-0.07584, 0.0), (0.0, 0.07584), (0.0, -0.07584))
]
BEHIND = [[1.0, 0.0, 0.0], [-0.99712, 0.07584, 0.0], [-0.99712, -0.07584, 0.0]]
ARCSEC, DEG = np.pi / 648000.0, np.pi / 180.0

# Markley, Attitude determination using vector observations: a fast optimal matrix algorithm,
# J. Astronautical Sciences 41(2), 1993
CASES: dict[str, tuple[list[list[float]], list[float]]] = {
    "1": (AXES, [1e-6] * 3),
    "2": (AXES[:2], [1e-6] * 2),
    "3": (AXES, [1e-2] * 3),
    "4": (AXES[:2], [1e-2] * 2),
    "5": (TURNED, [1e-6] * 2),
    "6": (TURNED, [1e-2] * 2),
    "7": (CLOSE, [1e-6] * 3),
    "8": (CLOSE[:2], [1e-6] * 2),
    "9": (CLOSE, [1e-2] * 3),
    "10": (CLOSE[:2], [1e-2] * 2),
    "11": (WIDE, [1e-6, 1e-2, 1e-2]),
    "12": (WIDE[:2], [1e-6, 1e-2]),
    # Markley and Mortari 2000: a star tracker, and accuracies that differ by 3600
    "tracker": (FIVE, [6.0 * ARCSEC] * 5),
    "unequal": (BEHIND, [ARCSEC, DEG, DEG]),
}
BEYOND_LINEAR = ("9", "10")
"""In these the noise is as large as the angle between the vectors."""
N = 1000


def unit(v: Array) -> Array:
    return np.asarray(v / np.linalg.norm(v, axis=-1, keepdims=True))


def noisy(name: str) -> tuple[Array, Array, Array]:
    """Return N frames of noisy body vectors, the inertial ones and sigma."""
    seed = list(CASES).index(name)
    rng = np.random.default_rng(1000 + seed)
    exact, s = unit(np.array(CASES[name][0])), np.array(CASES[name][1])
    noise = s[:, None] * rng.normal(size=(N, len(s), 3))
    across = noise - np.sum(noise * exact, axis=-1, keepdims=True) * exact
    return unit(exact + across), exact @ unit_matrix(), s


def unit_matrix() -> Array:
    """Return the attitude matrix, orthonormal to the last digit."""
    u, _, v = np.linalg.svd(TRUTH)
    assert np.abs(u @ v - TRUTH).max() < 1e-15
    return np.asarray(u @ v)


def truth() -> Array:
    return quat.from_matrix(unit_matrix().T)


def conditioning(b: Array, r: Array, s: Array) -> Array:
    """Smallest over largest curvature of the loss at its optimum (Markley 1988)."""
    profile = np.einsum("k,ki,nkj->nij", s.min() ** 2 / s**2, r, b)
    u, d, v = np.linalg.svd(profile)
    third = d[:, 2] * np.sign(np.linalg.det(u) * np.linalg.det(v))
    return np.asarray((d[:, 1] + third) / (d[:, 0] + d[:, 1]))


def loss(q: Array, b: Array, r: Array, s: Array) -> Array:
    left = r - np.einsum("nij,nkj->nki", quat.to_matrix(q), b)
    return np.asarray(0.5 * np.einsum("nki,nki,k->n", left, left, 1.0 / s**2))


@METHODS
@pytest.mark.parametrize("case", CASES)
def test_markleys_cases_against_scipy(case: str, method: str) -> None:
    b, r, s = noisy(case)
    fix = wahba.solve(b, r, sigma=s, method=method)
    rotations = [Rotation.align_vectors(r, frame, weights=1.0 / s**2)[0] for frame in b[:200]]
    want = Rotation.concatenate(rotations).as_quat(scalar_first=True)
    gap = quat.angle_between(fix.q[:200], want)
    rounding = 8e-15 / conditioning(b, r, s)[:200]
    quest = 1e-8 if method == "quest" else 0.0
    assert np.all(gap < np.maximum(rounding, quest))
    assert np.allclose(fix.loss, loss(fix.q, b, r, s), rtol=1e-6, atol=1e-9)
    if method != "quest":
        assert np.all(fix.loss[:200] <= loss(want, b[:200], r, s) * (1.0 + 1e-9) + 1e-9)


@METHODS
@pytest.mark.parametrize("case", CASES)
def test_markleys_cases_are_consistent(case: str, method: str) -> None:
    b, r, s = noisy(case)
    fix = wahba.solve(b, r, sigma=s, method=method)
    assert fix.covariance is not None
    dof = 2 * len(s) - 3
    tail = 1e-4
    low, high = (chi2_quantile(p, N * dof) / (N * dof) for p in (tail, 1.0 - tail))
    if case not in BEYOND_LINEAR:
        assert low < 2.0 * fix.loss.mean() / dof < high
    info = np.einsum(
        "nkij,k->nij", np.eye(3) - b[..., :, None] * b[..., None, :], s.min() ** 2 / s**2
    )
    want = np.linalg.inv(info) * s.min() ** 2
    scale = np.abs(want).max(axis=(1, 2), keepdims=True)
    least = np.linalg.eigvalsh(info)[:, 0] / np.linalg.eigvalsh(info)[:, 2]
    rounding = 1e-14 / least[:, None, None]
    assert np.all(np.abs(fix.covariance - want) <= rounding * scale)
    if case in BEYOND_LINEAR:
        return
    error = quat.log(quat.multiply(quat.conjugate(fix.q), truth()))
    nees = np.einsum("ni,nij,nj->n", error, np.linalg.inv(fix.covariance), error)
    low, high = (chi2_quantile(p, 3 * N) / (3 * N) for p in (tail, 1.0 - tail))
    assert low < nees.mean() / 3.0 < high


def test_closed_form_covariances() -> None:
    """Two and three vectors along the axes: sigma of the axes by hand."""
    for name, sigma in (("1", [0.5, 0.5, 0.5]), ("2", [1.0, 1.0, 0.5])):
        exact = np.array(CASES[name][0])
        fix = wahba.solve(exact, exact, sigma=1e-6)
        assert np.allclose(fix.sigma, 1e-6 * np.sqrt(sigma), rtol=1e-12)
    # one star camera vector and one coarse one: the coarse one alone holds the turn about the first
    exact = unit(np.array(WIDE[:2]))
    fix = wahba.solve(exact, exact, sigma=[1e-6, 1e-2])
    assert fix.sigma[0] == pytest.approx(1e-2 / 0.28, rel=1e-7)


@METHODS
def test_every_attitude_from_exact_vectors(method: str) -> None:
    """Random attitudes and all half turns about axes and diagonals."""
    rng = np.random.default_rng(3)
    q = unit(rng.normal(size=(20_000, 4)))
    signs = np.array(np.meshgrid(*[[-1.0, 0.0, 1.0]] * 4)).reshape(4, -1).T
    q = np.concatenate([q, unit(signs[np.any(signs != 0.0, axis=1)])])
    r = unit(rng.normal(size=(3, 3)))
    fix = wahba.solve(quat.rotate(quat.conjugate(q)[:, None], r), r, method=method)
    assert quat.angle_between(fix.q, q).max() < (1e-12 if method == "quest" else 1e-14)
    assert np.abs(np.einsum("ij,ij->i", fix.q, fix.q) - 1.0).max() < 1e-15


@METHODS
def test_symmetries(method: str) -> None:
    """A turn of either frame turns the answer; order and common scale of the weights do nothing."""
    rng = np.random.default_rng(4)
    r = unit(rng.normal(size=(6, 3)))
    b = unit(r + 0.02 * rng.normal(size=(50, 6, 3)))
    w = rng.uniform(0.2, 2.0, 6)
    fix = wahba.solve(b, r, weights=w, sigma=0.02, method=method)
    assert fix.covariance is not None
    turn = unit(rng.normal(size=(50, 4)))
    body = wahba.solve(quat.rotate(turn[:, None], b), r, weights=w, sigma=0.02, method=method)
    assert body.covariance is not None
    back = quat.multiply(fix.q, quat.conjugate(turn))
    assert quat.angle_between(body.q, back).max() < 1e-13
    matrix = quat.to_matrix(turn)
    want = matrix @ fix.covariance @ np.swapaxes(matrix, 1, 2)
    assert np.abs(body.covariance - want).max() < 1e-13 * np.abs(want).max()
    inertial = wahba.solve(b, quat.rotate(turn[:, None], r), weights=w, method=method)
    assert quat.angle_between(inertial.q, quat.multiply(turn, fix.q)).max() < 1e-13
    order = rng.permutation(6)
    shuffled = wahba.solve(b[:, order], r[order], weights=1e9 * w[order], method=method)
    assert quat.angle_between(shuffled.q, fix.q).max() < 1e-13


def test_weights_of_another_kind_are_consistent() -> None:
    """Equal weights on unequal vectors: the covariance tells the cost, and it is higher."""
    rng = np.random.default_rng(5)
    n = 4000
    s = np.array([1e-4, 3e-4, 1e-3, 3e-3])
    r = unit(rng.normal(size=(4, 3)))
    q = unit(rng.normal(size=(n, 4)))
    exact = quat.rotate(quat.conjugate(q)[:, None], r)
    b = unit(exact + s[:, None] * rng.normal(size=exact.shape))
    best = wahba.solve(b, r, sigma=s)
    fix = wahba.solve(b, r, sigma=s, weights=np.ones(4))
    assert best.covariance is not None
    assert fix.covariance is not None
    error = quat.log(quat.multiply(quat.conjugate(fix.q), q))
    nees = np.einsum("ni,nij,nj->n", error, np.linalg.inv(fix.covariance), error)
    low, high = (chi2_quantile(p, 3 * n) / (3 * n) for p in (1e-4, 1.0 - 1e-4))
    assert low < nees.mean() / 3.0 < high
    trace = [np.trace(f.covariance, axis1=1, axis2=2) for f in (fix, best)]  # type: ignore[arg-type]
    assert np.all(trace[0] > trace[1])
