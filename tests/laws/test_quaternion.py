"""Quaternions against scipy's `Rotation`, to 8e-15 over random and hard inputs, and their laws."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from celestcore import quaternion as quat
from celestcore.errors import InputError
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation, Slerp

Array = NDArray[np.float64]
N = 100_000
TOLERANCE = 8e-15
EPS = float(np.finfo(np.float64).eps)
IDENTITY = np.array([1.0, 0.0, 0.0, 0.0])

LOG_SERIES = 2.0 * np.arcsin(0.1)
"""Angle at which the vector part is 0.1 long and `log` leaves its series."""
EDGES = (0.1, LOG_SERIES, 0.5, np.pi / 2, 1.0, np.pi, 2.0 * np.pi)
TINY = (5e-324, 1e-310, 1e-300, 1e-200, 1e-162, 1e-154, 1e-100, 1e-20, 1e-9, 1e-8, 1e-4)


def unit(v: Array) -> Array:
    return np.asarray(v / np.linalg.norm(v, axis=-1, keepdims=True))


def hard_angles() -> Array:
    """Zero, denormals, the edges of every series, just below and above them."""
    steps = np.array([0.0, EPS, 4 * EPS, 1e-15, 1e-13, 1e-10, 1e-6])
    around = np.concatenate([edge * (1.0 + np.r_[-steps, steps]) for edge in EDGES])
    return np.concatenate([[0.0], TINY, around])


def hard_axes(rng: np.random.Generator) -> Array:
    """Along and against the axes (zeros of both signs), diagonals, and random ones."""
    signs = np.array(np.meshgrid(*[[-1.0, 0.0, 1.0]] * 3)).reshape(3, -1).T
    signs = signs[np.any(signs != 0.0, axis=1)]
    return np.concatenate([unit(signs), -unit(signs), unit(rng.normal(size=(30, 3)))])


def rotation_vectors(seed: int = 0, longest: float = 2.0 * np.pi) -> Array:
    """Return N rotation vectors: the hard ones, then random ones of all lengths."""
    rng = np.random.default_rng(seed)
    hard = (hard_angles()[:, None, None] * hard_axes(rng)).reshape(-1, 3)
    hard = hard[np.linalg.norm(hard, axis=1) <= longest]
    n = N - len(hard)
    assert n > N // 2
    length = np.where(np.arange(n) % 2, rng.uniform(0.0, longest, n), 10 ** rng.uniform(-320, 0, n))
    return np.concatenate([hard, length[:, None] * unit(rng.normal(size=(n, 3)))])


def unit_quaternions(seed: int = 0) -> Array:
    """Return N unit quaternions of both signs: of hard rotations, and evenly spread ones."""
    rng = np.random.default_rng(seed)
    hard = Rotation.from_rotvec(rotation_vectors(seed)[: N // 2]).as_quat(scalar_first=True)
    q = np.concatenate([hard, unit(rng.normal(size=(N - len(hard), 4)))])
    return np.asarray(q * np.where(rng.random(N) < 0.5, -1.0, 1.0)[:, None])


def rotation(q: Array) -> Rotation:
    return Rotation.from_quat(q, scalar_first=True)


def scalar_first(r: Rotation) -> Array:
    return np.asarray(r.as_quat(scalar_first=True))


def apart(a: Array, b: Array) -> float:
    """Largest difference of two stacks, each row up to its sign."""
    return float(np.minimum(np.abs(a - b).max(axis=-1), np.abs(a + b).max(axis=-1)).max())


def angle_of_directions(a: Array, b: Array) -> Array:
    """Return the angle between unit vectors, accurate at 0 and at pi (Kahan)."""
    apart, together = np.linalg.norm(a - b, axis=-1), np.linalg.norm(a + b, axis=-1)
    return np.asarray(2.0 * np.arctan2(apart, together))


# exp and log


def test_exp_equals_scipy() -> None:
    v = rotation_vectors()
    q = quat.exp(v)
    assert q.shape == (N, 4)
    assert np.abs(q - scalar_first(Rotation.from_rotvec(v))).max() < TOLERANCE
    assert np.abs(np.linalg.norm(q, axis=1) - 1.0).max() < 4 * EPS


def test_exp_of_a_short_vector_is_half_of_it() -> None:
    v = np.array(TINY[:-1])[:, None] * unit(np.array([[0.3, -0.7, 0.4]]))
    assert np.array_equal(quat.exp(v)[:-2, 0], np.ones(len(v) - 2))
    assert np.abs(quat.exp(v)[:, 1:] - 0.5 * v).max(axis=1) == pytest.approx(0.0, abs=1e-24)
    normal = np.abs(v).min(axis=1) > 1e-300
    assert np.allclose(quat.exp(v)[normal, 1:], 0.5 * v[normal], rtol=1e-15, atol=0.0)


def test_log_equals_scipy() -> None:
    q = unit_quaternions()
    v, reference = quat.log(q), rotation(q).as_rotvec()
    half_turn = np.abs(q[:, 0]) < TOLERANCE
    assert 50 < half_turn.sum() < N // 10
    assert np.abs(v - reference)[~half_turn].max() < TOLERANCE
    assert apart(v[half_turn], reference[half_turn]) < TOLERANCE
    assert np.linalg.norm(v, axis=1).max() <= np.pi * (1 + EPS)


def test_log_does_not_see_the_sign() -> None:
    q = unit_quaternions(1)
    q = q[q[:, 0] != 0.0]
    assert np.array_equal(quat.log(q), quat.log(-q))


def test_log_undoes_exp_with_every_digit() -> None:
    v = rotation_vectors(2, longest=3.0)
    length = np.linalg.norm(v, axis=1)
    back = quat.log(quat.exp(v))
    representable = np.abs(v).max(axis=1) > 1e-300
    error = np.abs(back - v).max(axis=1)
    relative = error[representable] / np.abs(v[representable]).max(axis=1)
    assert relative.max() < TOLERANCE * 3.0
    assert error[~representable].max() <= 2e-323  # denormals lose a few of their last bits
    assert np.abs(length - np.linalg.norm(back, axis=1)).max() < TOLERANCE


def test_exp_undoes_log() -> None:
    q = unit_quaternions(3)
    assert apart(quat.exp(quat.log(q)), q) < TOLERANCE


def test_series_and_functions_meet_without_a_step() -> None:
    axis = unit(np.array([0.2, -0.5, 0.8]))
    for edge in EDGES:
        angle = edge * (1.0 + np.arange(-50, 51) * 2.0 * EPS)
        q = quat.exp(angle[:, None] * axis)
        exact = np.c_[np.cos(angle / 2), np.sin(angle / 2)[:, None] * axis]
        assert np.abs(q - exact).max() < 2 * EPS
        if edge < 3.0:
            assert np.abs(quat.log(q) - angle[:, None] * axis).max() < 16 * EPS


# product, conjugate, rotate


def test_hamilton() -> None:
    one, i, j, k = np.eye(4)
    table = [(i, j, k), (j, k, i), (k, i, j), (i, i, -one), (j, j, -one), (k, k, -one)]
    for a, b, product in table:
        assert np.array_equal(quat.multiply(a, b), product)
    for a, b, product in table[:3]:
        assert np.array_equal(quat.multiply(b, a), -product)


def test_product_equals_its_matrix_form_and_scipy() -> None:
    rng = np.random.default_rng(4)
    a, b = unit_quaternions(4), unit_quaternions(5)[rng.permutation(N)]
    w, x, y, z = a.T
    left = np.array([[w, -x, -y, -z], [x, w, -z, y], [y, z, w, -x], [z, -y, x, w]])
    product = quat.multiply(a, b)
    assert np.abs(product - np.einsum("ijn,nj->ni", left, b)).max() < 8 * EPS
    assert apart(product, scalar_first(rotation(a) * rotation(b))) < TOLERANCE


def test_product_of_any_length() -> None:
    rng = np.random.default_rng(5)
    a, b, c = rng.normal(size=(3, 1000, 4)) * 10 ** rng.uniform(-20, 20, (3, 1000, 1))
    size = np.linalg.norm(a, axis=1) * np.linalg.norm(b, axis=1)
    ab = quat.multiply(a, b)
    assert np.allclose(np.linalg.norm(ab, axis=1), size, rtol=TOLERANCE)
    reverse = quat.multiply(quat.conjugate(b), quat.conjugate(a))
    assert np.abs((quat.conjugate(ab) - reverse) / size[:, None]).max() < TOLERANCE
    size = size * np.linalg.norm(c, axis=1)
    difference = quat.multiply(ab, c) - quat.multiply(a, quat.multiply(b, c))
    assert np.abs(difference / size[:, None]).max() < TOLERANCE


def test_conjugate_is_the_inverse() -> None:
    q = unit_quaternions(6)
    assert np.array_equal(quat.conjugate(q), q * [1.0, -1.0, -1.0, -1.0])
    assert apart(quat.conjugate(q), scalar_first(rotation(q).inv())) < TOLERANCE
    assert np.abs(quat.multiply(q, quat.conjugate(q)) - IDENTITY).max() < TOLERANCE


def test_rotate_equals_scipy_and_the_product() -> None:
    rng = np.random.default_rng(7)
    q, v = unit_quaternions(7), unit(rng.normal(size=(N, 3)))
    turned = quat.rotate(q, v)
    assert np.abs(turned - rotation(q).apply(v)).max() < TOLERANCE
    pure = np.c_[np.zeros(N), v]
    sandwich = quat.multiply(quat.multiply(q, pure), quat.conjugate(q))
    assert np.abs(np.c_[np.zeros(N), turned] - sandwich).max() < TOLERANCE
    assert np.array_equal(turned, quat.rotate(-q, v))


def test_rotate_scales_with_the_vector() -> None:
    rng = np.random.default_rng(8)
    q, v = unit_quaternions(8)[:1000], rng.normal(size=(1000, 3))
    for scale in (2.0**-900, 2.0**900):
        assert np.allclose(quat.rotate(q, scale * v), scale * quat.rotate(q, v), rtol=0, atol=0)


# matrices


def test_to_matrix_equals_scipy() -> None:
    q = unit_quaternions(9)
    m = quat.to_matrix(q)
    assert m.shape == (N, 3, 3)
    assert np.abs(m - rotation(q).as_matrix()).max() < TOLERANCE
    assert np.abs(m @ m.transpose(0, 2, 1) - np.eye(3)).max() < TOLERANCE


def test_to_matrix_is_not_transposed() -> None:
    q = quat.exp([0.0, 0.0, np.pi / 2])
    assert np.allclose(quat.to_matrix(q) @ [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], atol=1e-15)
    rng = np.random.default_rng(10)
    q, v = unit_quaternions(10)[:1000], rng.normal(size=(1000, 3))
    assert np.allclose(np.einsum("nij,nj->ni", quat.to_matrix(q), v), quat.rotate(q, v), atol=1e-14)


def shepperd_branch(m: Array) -> NDArray[np.intp]:
    """Return which of trace, m11, m22 and m33 is the largest."""
    d = np.diagonal(m, axis1=-2, axis2=-1)
    return np.asarray(np.argmax(np.c_[d.sum(axis=1), d], axis=1))


def test_from_matrix_on_all_four_branches() -> None:
    q = unit_quaternions(11)
    m = rotation(q).as_matrix()
    branch = shepperd_branch(m)
    back = quat.from_matrix(m)
    assert np.all(back[:, 0] >= 0.0)
    assert np.abs(np.linalg.norm(back, axis=1) - 1.0).max() < 4 * EPS
    for k in range(4):
        here = branch == k
        assert here.sum() > 5000
        assert apart(back[here], q[here]) < TOLERANCE
        assert apart(back[here], scalar_first(Rotation.from_matrix(m[here]))) < TOLERANCE


@pytest.mark.parametrize("axis", range(3))
def test_from_matrix_at_half_turns(axis: int) -> None:
    for angle in (np.pi, np.pi - 1e-9, np.pi + 1e-9, np.pi - 1e-15):
        v = angle * np.eye(3)[axis] + 1e-12
        m = Rotation.from_rotvec(v).as_matrix()
        assert shepperd_branch(m[None])[0] == axis + 1
        assert apart(quat.from_matrix(m), quat.exp(v)) < TOLERANCE


def test_from_matrix_where_branches_tie() -> None:
    signs = np.array(np.meshgrid(*[[-0.5, 0.5]] * 4)).reshape(4, -1).T
    assert apart(quat.from_matrix(quat.to_matrix(signs)), signs) < TOLERANCE
    s = np.sqrt(0.5)
    pairs = np.array([[s, s, 0, 0], [0, s, s, 0], [0, s, 0, -s], [0, 0, s, s], [s, 0, 0, s]])
    assert apart(quat.from_matrix(quat.to_matrix(pairs)), pairs) < TOLERANCE


def test_from_matrix_forgives_rounding_only() -> None:
    rng = np.random.default_rng(12)
    m = Rotation.random(100, rng=rng).as_matrix()
    noisy = m + 1e-8 * rng.normal(size=m.shape)
    assert apart(quat.from_matrix(noisy), quat.from_matrix(m)) < 1e-7
    for bad in (2.0 * m[0], -m[0], m[0] + 1e-4, np.full((3, 3), np.nan), np.zeros((3, 3))):
        with pytest.raises(InputError, match=r"r, row 3.*proper rotation matrix") as caught:
            quat.from_matrix(np.stack([*m[:3], bad]))
        assert caught.value.field == "r"
        assert caught.value.row == 3


# angles and interpolation


def test_angle_between_equals_scipy() -> None:
    a = unit_quaternions(13)
    v = rotation_vectors(13)
    b = quat.multiply(a, quat.exp(v))
    angle = quat.angle_between(a, b)
    assert angle.shape == (N,)
    assert np.abs(angle - (rotation(a).inv() * rotation(b)).magnitude()).max() < TOLERANCE
    length = np.linalg.norm(v, axis=1)
    assert np.abs(angle - np.minimum(length, 2 * np.pi - length)).max() < TOLERANCE
    assert np.array_equal(angle, quat.angle_between(a, -b))


def test_slerp_equals_scipy() -> None:
    rng = np.random.default_rng(14)
    keys = unit_quaternions(14)[rng.permutation(N)[:20_001]]
    k = np.arange(len(keys) - 1)
    s = np.where(k % 3, rng.integers(0, 257, len(k)) / 256.0, rng.uniform(0.0, 1.0, len(k)))
    s = (k + s) - k  # as scipy sees it, who wants one time for both
    between = quat.slerp(keys[:-1], keys[1:], s)
    reference = Slerp(np.arange(len(keys)), rotation(keys))(k + s)
    unique = quat.angle_between(keys[:-1], keys[1:]) < np.pi - 1e-6
    assert unique.sum() > 0.99 * len(k)
    error = quat.angle_between(between, reference)
    assert error[unique].max() < TOLERANCE


@pytest.mark.parametrize("s", [0.0, 1e-300, 0.25, 0.5, 1.0, -1.0, 2.0])
def test_slerp_goes_the_shorter_way_from_a(s: float) -> None:
    a = unit_quaternions(15)[::10]
    v = rotation_vectors(15, longest=3.0)[::10]
    b = quat.multiply(a, quat.exp(v))
    expected = quat.multiply(a, quat.exp(s * v))
    assert np.abs(quat.slerp(a, b, s) - expected).max() < TOLERANCE
    assert np.abs(quat.slerp(a, -b, s) - expected).max() < TOLERANCE


def test_slerp_between_opposite_attitudes_ends_at_both() -> None:
    a = unit_quaternions(16)[:2000]
    b = quat.multiply(a, np.c_[np.zeros(2000), unit(a[:, 1:] + 1e-3)])
    assert apart(quat.slerp(a, b, 0.0), a) < TOLERANCE
    assert apart(quat.slerp(a, b, 1.0), b) < TOLERANCE
    assert np.allclose(quat.angle_between(a, quat.slerp(a, b, 0.5)), np.pi / 2, atol=TOLERANCE)


# Jacobians


def jacobian_by_quadrature(v: Array) -> Array:
    """Right Jacobian as the mean of ``exp(-s v)`` over s from 0 to 1, by Gauss and Legendre."""
    nodes, weights = np.polynomial.legendre.leggauss(24)
    out = np.zeros((len(v), 3, 3))
    for s, weight in zip(0.5 * (nodes + 1.0), 0.5 * weights, strict=True):
        out += weight * Rotation.from_rotvec(-s * v).as_matrix()
    return out


def test_right_jacobian_is_the_mean_of_rotations() -> None:
    v = rotation_vectors(17)[:: N // 20_000]
    assert np.abs(quat.right_jacobian(v) - jacobian_by_quadrature(v)).max() < TOLERANCE
    edge = unit(np.array([[1.0, 2.0, -2.0]])) * (0.5 * (1 + np.arange(-20, 21) * EPS))[:, None]
    assert np.abs(quat.right_jacobian(edge) - jacobian_by_quadrature(edge)).max() < TOLERANCE


def test_jacobians_by_differences() -> None:
    v = rotation_vectors(18, longest=3.0)[::500]
    h = 1e-5
    for k, step in enumerate(h * np.eye(3)):
        ahead = quat.log(quat.multiply(quat.conjugate(quat.exp(v)), quat.exp(v + step)))
        behind = quat.log(quat.multiply(quat.conjugate(quat.exp(v)), quat.exp(v - step)))
        column = (ahead - behind) / (2 * h)
        assert np.abs(quat.right_jacobian(v)[:, :, k] - column).max() < 1e-9
        ahead = quat.log(quat.multiply(quat.exp(v), quat.exp(step)))
        behind = quat.log(quat.multiply(quat.exp(v), quat.exp(-step)))
        column = (ahead - behind) / (2 * h)
        assert np.abs(quat.right_jacobian_inverse(v)[:, :, k] - column).max() < 1e-8


def test_jacobians_are_inverse_to_each_other() -> None:
    v = rotation_vectors(19, longest=np.pi * (1 + 1e-6))[::5]
    error = quat.right_jacobian(v) @ quat.right_jacobian_inverse(v) - np.eye(3)
    assert np.abs(error).max() < TOLERANCE


def test_jacobians_are_inverse_up_to_a_full_turn() -> None:
    axes = hard_axes(np.random.default_rng(20))
    short = np.array([1e-1, 1e-2, 1e-4, 1e-6, 1e-8, 1e-10])
    v = ((2.0 * np.pi - short)[:, None, None] * axes).reshape(-1, 3)
    inverse = quat.right_jacobian_inverse(v)
    size = np.abs(inverse).max(axis=(1, 2))
    assert size.max() > 1e9  # it goes to infinity there
    error = np.abs(quat.right_jacobian(v) @ inverse - np.eye(3)).max(axis=(1, 2))
    assert np.all(error < TOLERANCE * size)


def test_jacobians_of_a_short_vector() -> None:
    for size in (0.0, *TINY[:8]):
        v = size * unit(np.array([1.0, -2.0, 3.0]))
        cross = np.cross(v, np.eye(3)).T  # [v]x
        assert np.abs(quat.right_jacobian(v) - (np.eye(3) - 0.5 * cross)).max() < EPS
        assert np.abs(quat.right_jacobian_inverse(v) - (np.eye(3) + 0.5 * cross)).max() < EPS


# sign continuity and propagation


def test_continuous_undoes_sign_flips() -> None:
    rng = np.random.default_rng(21)
    rates = rng.normal(size=(5, 400, 3))
    smooth = quat.propagate(unit(rng.normal(size=(5, 4))), rates, 0.3)
    signs = np.where(rng.random(smooth.shape[:2]) < 0.5, -1.0, 1.0)
    assert np.all(np.abs(np.diff(signs, axis=1)).sum(axis=1) > 100)
    out = quat.continuous(smooth * signs[..., None])
    assert np.array_equal(out, smooth * signs[:, :1, None])


@pytest.mark.parametrize("shape", [(0, 4), (1, 4), (2, 0, 4), (0, 3, 4), (2, 1, 4)])
def test_continuous_of_little(shape: tuple[int, ...]) -> None:
    q = -np.broadcast_to(IDENTITY, shape)
    assert np.array_equal(quat.continuous(q), q)


def test_propagate_each_step_equals_scipy() -> None:
    rng = np.random.default_rng(22)
    dt = 10 ** rng.uniform(-3, 1, N)
    rates = rotation_vectors(22)[rng.permutation(N)] / dt[:, None]
    q = quat.propagate(unit(rng.normal(size=4)), rates, dt)
    assert q.shape == (N + 1, 4)
    assert np.abs(np.linalg.norm(q, axis=1) - 1.0).max() < 4 * EPS
    turned = rotation(q[:-1]) * Rotation.from_rotvec(rates * dt[:, None])
    assert apart(q[1:], scalar_first(turned)) < TOLERANCE


def test_propagate_equals_scipy_over_many_steps() -> None:
    rng = np.random.default_rng(23)
    q0, rates = unit(rng.normal(size=4)), rng.normal(size=(2000, 3))
    r = rotation(q0)
    for w in rates:
        r = r * Rotation.from_rotvec(0.1 * w)
    assert apart(quat.propagate(q0, rates, 0.1)[-1:], scalar_first(r)[None]) < 2000 * EPS


def test_propagate_of_a_constant_rate_is_the_closed_form() -> None:
    w = np.array([0.3, -0.2, 0.5])
    q = quat.propagate(IDENTITY, np.tile(w, (1000, 1)), 0.01)
    assert apart(q, quat.exp(0.01 * np.arange(1001)[:, None] * w)) < 1e-13


def rk4_by_hand(q: Array, w: Array, dt: float) -> Array:
    def derivative(q: Array) -> Array:
        return np.asarray(0.5 * quat.multiply(q, [0.0, *w]))

    k1 = derivative(q)
    k2 = derivative(q + 0.5 * dt * k1)
    k3 = derivative(q + 0.5 * dt * k2)
    k4 = derivative(q + dt * k3)
    q = q + dt / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
    return np.asarray(q / np.linalg.norm(q))


def test_rk4_equals_the_method_written_out() -> None:
    rng = np.random.default_rng(24)
    rates, dt = rng.normal(size=(500, 3)), rng.uniform(0.0, 1.0, 500)
    q = quat.propagate(unit(rng.normal(size=4)), rates, dt, method="rk4")
    for k in range(500):
        assert np.abs(q[k + 1] - rk4_by_hand(q[k], rates[k], float(dt[k]))).max() < TOLERANCE
    exact = quat.propagate(q[0], rates, dt)
    assert apart(q, exact) > 1e-6  # it is the method and not the closed form


def test_rk4_converges_at_fourth_order() -> None:
    w = np.array([0.5, -0.3, 0.4])
    exact = quat.exp(8.0 * w)
    error = []
    for n in (16, 32, 64, 128):
        q = quat.propagate(IDENTITY, np.tile(w, (n, 1)), 8.0 / n, method="rk4")
        error.append(float(quat.angle_between(q[-1], exact)))
    ratio = np.array(error[:-1]) / error[1:]
    assert np.all((ratio > 15.5) & (ratio < 16.5))


def test_propagate_batches() -> None:
    rng = np.random.default_rng(25)
    q0, rates = unit(rng.normal(size=(3, 1, 4))), rng.normal(size=(2, 7, 3))
    dt = rng.uniform(0.1, 1.0, 7)
    for method in ("exponential", "rk4"):
        out = quat.propagate(q0, rates, dt, method=method)
        assert out.shape == (3, 2, 8, 4)
        for i in range(3):
            for j in range(2):
                one = quat.propagate(q0[i, 0], rates[j], dt, method=method)
                assert np.array_equal(out[i, j], one)


def test_propagate_of_nothing() -> None:
    assert np.array_equal(quat.propagate(IDENTITY, np.zeros((0, 3)), 0.1), IDENTITY[None])
    assert np.array_equal(quat.propagate(IDENTITY, np.zeros((0, 3)), []), IDENTITY[None])
    empty = quat.propagate(np.zeros((0, 4)), np.zeros((0, 5, 3)), np.ones(5))
    assert empty.shape == (0, 6, 4)


# the shortest rotation between two directions


def directions(seed: int, n: int = 20_000) -> tuple[Array, Array]:
    rng = np.random.default_rng(seed)
    a, b = unit(rng.normal(size=(2, n, 3)))
    a[:26], b[:26] = hard_axes(rng)[:26], hard_axes(rng)[26:52]
    return a, b


def check_shortest(a: Array, b: Array) -> None:
    """`q` takes `a` to `b`, and its angle is the angle between them."""
    q = quat.shortest_rotation(a, b)
    assert np.abs(np.linalg.norm(q, axis=1) - 1.0).max() < 4 * EPS
    a, b = unit(a), unit(b)
    assert np.abs(quat.rotate(q, a) - b).max() < TOLERANCE
    turned = quat.angle_between(IDENTITY, q)
    assert np.abs(turned - angle_of_directions(a, b)).max() < TOLERANCE


def test_shortest_rotation_of_random_directions() -> None:
    check_shortest(*directions(26))


@pytest.mark.parametrize("angle", [0.0, 1e-300, 1e-16, 1e-12, 1e-8, 1e-3, 0.5, 1.5, 3.0])
def test_shortest_rotation_by_an_angle(angle: float) -> None:
    a, b = directions(27)
    across = unit(np.cross(a[26:], b[26:]))
    check_shortest(a[26:], np.cos(angle) * a[26:] + np.sin(angle) * across)


@pytest.mark.parametrize("short", [1e-2, 1e-4, 1e-8, 1e-10, 2e-12, 1e-12, 1e-13, 1e-14, 1e-15, 0.0])
def test_shortest_rotation_of_nearly_opposite_directions(short: float) -> None:
    a, b = directions(28)
    across = unit(np.cross(a[26:], b[26:]))
    check_shortest(a[26:], -np.cos(short) * a[26:] + np.sin(short) * across)


def test_shortest_rotation_of_equal_and_opposite_directions() -> None:
    a, _ = directions(29)
    assert apart(quat.shortest_rotation(a, a), np.broadcast_to(IDENTITY, (len(a), 4))) < 4 * EPS
    q = quat.shortest_rotation(a, -a)
    assert np.abs(quat.rotate(q, a) + a).max() < TOLERANCE
    assert np.abs(q[:, 0]).max() < TOLERANCE  # half a turn
    assert np.abs(np.einsum("ni,ni->n", q[:, 1:], a)).max() < TOLERANCE  # across a


@pytest.mark.parametrize("size", [2.0**k for k in (-1070, -1030, -700, -530, -60, 60, 530, 1020)])
def test_shortest_rotation_sees_directions_only(size: float) -> None:
    a, b = np.array([3.0, -1.0, 0.0]), np.array([1.0, 1.0, 2.0])
    expected = quat.shortest_rotation(a, b)
    assert np.abs(quat.shortest_rotation(size * a, b) - expected).max() < TOLERANCE
    assert np.abs(quat.shortest_rotation(a, size * b) - expected).max() < TOLERANCE
    assert np.abs(quat.shortest_rotation(size * a, size * b) - expected).max() < TOLERANCE


@pytest.mark.parametrize("bad", [[0.0, 0.0, 0.0], [np.nan, 0.0, 1.0], [np.inf, 0.0, 0.0]])
def test_shortest_rotation_needs_directions(bad: list[float]) -> None:
    good = [1.0, 0.0, 0.0]
    with pytest.raises(InputError, match=r"b, row 1.*has no direction"):
        quat.shortest_rotation([good, good], [good, bad])
    with pytest.raises(InputError, match=r"a, row 0.*has no direction"):
        quat.shortest_rotation(bad, good)


# what goes in and what comes out

UNARY: dict[str, tuple[Callable[..., Array], int, tuple[int, ...]]] = {
    "conjugate": (quat.conjugate, 4, (4,)),
    "exp": (quat.exp, 3, (4,)),
    "log": (quat.log, 4, (3,)),
    "to_matrix": (quat.to_matrix, 4, (3, 3)),
    "right_jacobian": (quat.right_jacobian, 3, (3, 3)),
    "right_jacobian_inverse": (quat.right_jacobian_inverse, 3, (3, 3)),
}
BINARY: dict[str, tuple[Callable[..., Array], int, int, tuple[int, ...]]] = {
    "multiply": (quat.multiply, 4, 4, (4,)),
    "rotate": (quat.rotate, 4, 3, (3,)),
    "angle_between": (quat.angle_between, 4, 4, ()),
    "shortest_rotation": (quat.shortest_rotation, 3, 3, (4,)),
    "slerp": (lambda a, b: quat.slerp(a, b, 0.3), 4, 4, (4,)),
}


@pytest.mark.parametrize("name", UNARY)
def test_unary_shapes(name: str) -> None:
    function, width, tail = UNARY[name]
    x = unit(np.random.default_rng(30).normal(size=(5, 2, width)))
    out = function(x)
    assert out.shape == (5, 2, *tail)
    for i, j in np.ndindex(5, 2):
        assert np.array_equal(function(x[i, j]), out[i, j])
    assert function(x[:0]).shape == (0, 2, *tail)


@pytest.mark.parametrize("name", BINARY)
def test_binary_shapes_broadcast(name: str) -> None:
    function, first, second, tail = BINARY[name]
    rng = np.random.default_rng(31)
    a, b = unit(rng.normal(size=(5, 1, first))), unit(rng.normal(size=(3, second)))
    out = function(a, b)
    assert out.shape == (5, 3, *tail)
    for i, j in np.ndindex(5, 3):
        assert np.array_equal(function(a[i, 0], b[j]), out[i, j])
    assert function(a[:0], b).shape == (0, 3, *tail)
    assert function(a[0, 0], b[0]).shape == tail


def test_slerp_broadcasts_its_fraction() -> None:
    a, b = unit(np.random.default_rng(32).normal(size=(2, 4)))
    s = np.linspace(0.0, 1.0, 6).reshape(2, 3)
    out = quat.slerp(a, b, s)
    assert out.shape == (2, 3, 4)
    for i, j in np.ndindex(2, 3):
        assert np.array_equal(out[i, j], quat.slerp(a, b, s[i, j]))


def layouts(x: Array) -> list[Any]:
    """Return the same numbers in other layouts and containers."""
    wide = np.zeros((2 * len(x), 2 * x.shape[1]))
    wide[::2, ::2] = x
    frozen = x.copy()
    frozen.flags.writeable = False
    return [
        np.asfortranarray(x),
        wide[::2, ::2],
        np.ascontiguousarray(x[::-1, ::-1])[::-1, ::-1],
        x.astype(">f8"),
        x.tolist(),
        list(x),
        frozen,
    ]


@pytest.mark.parametrize("name", UNARY)
def test_layouts(name: str) -> None:
    function, width, _ = UNARY[name]
    x = unit(np.random.default_rng(33).normal(size=(6, width)))
    expected = function(x)
    for other in layouts(x):
        assert np.array_equal(function(other), expected)
    before = x.copy()
    out = function(x)
    assert np.array_equal(x, before)
    assert not np.shares_memory(out, x)
    assert out.dtype == np.float64
    assert out.flags.c_contiguous
    assert out.flags.writeable


def test_other_kinds_of_numbers() -> None:
    v = np.array([[1, 0, 2], [0, -1, 1]])
    for kind in (np.int64, np.int8, np.float32, np.float16, object):
        assert np.array_equal(quat.exp(v.astype(kind)), quat.exp(v.astype(float)))
        turned = quat.rotate(np.array([0, 1, 0, 0]).astype(kind), v.astype(kind))
        assert np.array_equal(turned, v * [1.0, -1.0, -1.0])
    single = (0.1 * v).astype(np.float32)
    assert np.array_equal(quat.exp(single), quat.exp(single.astype(float)))


def test_scipy_rotations_are_taken() -> None:
    r = Rotation.random(7, rng=np.random.default_rng(34))
    q = scalar_first(r)
    assert np.array_equal(quat.from_rotation(r), q)
    assert apart(scalar_first(quat.as_rotation(q)), q) < TOLERANCE
    for function in (quat.conjugate, quat.log, quat.to_matrix, quat.continuous):
        assert np.array_equal(function(r), function(q))
    assert np.array_equal(quat.multiply(r, r[0]), quat.multiply(q, q[0]))
    assert np.array_equal(quat.rotate(r[0], [1.0, 0.0, 0.0]), quat.rotate(q[0], [1.0, 0.0, 0.0]))
    assert np.array_equal(quat.slerp(r[0], r[1], 0.3), quat.slerp(q[0], q[1], 0.3))
    assert np.array_equal(quat.angle_between(r, r[0]), quat.angle_between(q, q[0]))
    rates = np.ones((2, 3))
    assert np.array_equal(quat.propagate(r, rates, 0.1), quat.propagate(q, rates, 0.1))


WRONG: list[tuple[Callable[[], Any], str]] = [
    (lambda: quat.exp([1.0, 2.0]), r"v: needs a last axis of 3, got shape \(2,\)"),
    (lambda: quat.exp(1.0), r"v: needs a last axis of 3, got shape \(\)"),
    (lambda: quat.log(np.ones((5, 3))), r"q: needs a last axis of 4, got shape \(5, 3\)"),
    (lambda: quat.conjugate([]), r"q: needs a last axis of 4"),
    (lambda: quat.multiply(IDENTITY, [1.0]), r"b: needs a last axis of 4, got shape \(1,\)"),
    (lambda: quat.rotate(np.ones(3), np.ones(3)), r"q: needs a last axis of 4"),
    (lambda: quat.rotate(IDENTITY, IDENTITY), r"v: needs a last axis of 3"),
    (lambda: quat.rotate(np.ones((2, 4)), np.ones((3, 3))), r"\(2,\) and \(3,\) do not broadcast"),
    (lambda: quat.slerp(IDENTITY, IDENTITY, "x"), r"s.*not real numbers"),
    (lambda: quat.slerp(np.ones((2, 4)), IDENTITY, np.ones(3)), "do not broadcast"),
    (lambda: quat.from_matrix(np.eye(4)), r"r: needs shape \(\.\.\., 3, 3\), got \(4, 4\)"),
    (lambda: quat.from_matrix([1.0]), r"r: needs shape"),
    (lambda: quat.continuous(IDENTITY), r"q: needs shape \(\.\.\., n, 4\), got \(4,\)"),
    (lambda: quat.continuous(np.ones((4, 3))), r"q: needs shape"),
    (lambda: quat.propagate(IDENTITY, [1.0, 2.0, 3.0], 0.1), r"rates: needs shape"),
    (lambda: quat.propagate(IDENTITY, np.ones((5, 3)), [0.1, 0.2]), r"dt: needs one step or 5"),
    (lambda: quat.propagate(IDENTITY, np.ones((5, 3)), np.ones((5, 1))), r"dt: needs one step"),
    (lambda: quat.propagate(1.0, np.ones((5, 3)), 0.1), r"q0: needs a last axis of 4"),
    (lambda: quat.propagate([1.0], np.ones((5, 3)), 0.1), r"q0: needs a last axis of 4"),
    (lambda: quat.propagate(np.ones((2, 4)), np.ones((3, 5, 3)), 0.1), "do not broadcast"),
    (lambda: quat.propagate(IDENTITY, np.ones((5, 3)), 0.1, method="euler"), "'exponential'"),
    (lambda: quat.exp([1.0, 2.0, 3.0j]), r"v.*not real numbers"),
    (lambda: quat.exp(["a", "b", "c"]), r"v.*not real numbers"),
    (lambda: quat.exp([[1.0, 2.0, 3.0], [1.0]]), r"v: .*same number of columns"),
    (lambda: quat.log([None, object(), 1.0, 1.0]), r"q.*not a real number"),
]


@pytest.mark.parametrize("k", range(len(WRONG)))
def test_wrong_shapes_name_the_argument(k: int) -> None:
    call, message = WRONG[k]
    with pytest.raises(InputError, match=message):
        call()


def test_masked_entries_are_not_a_number() -> None:
    v = np.ma.masked_array([[1.0, 2.0, 3.0], [1.0, 99.0, 3.0]], mask=[[0, 0, 0], [0, 1, 0]])
    q = quat.exp(v)
    assert np.isfinite(q[0]).all()
    assert np.isnan(q[1]).any()
