"""The simulation that judges the filters is right itself."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation
from simulate import (
    discretise,
    discretise_small_angle,
    exp,
    local,
    multiply,
    skew,
)


def test_quaternions_agree_with_scipy() -> None:
    rng = np.random.default_rng(1)
    a, b = Rotation.random(50, random_state=rng), Rotation.random(50, random_state=rng)
    qa, qb = (r.as_quat()[:, [3, 0, 1, 2]] for r in (a, b))
    product = Rotation.from_quat(multiply(qa, qb)[:, [1, 2, 3, 0]])
    assert (product * (a * b).inv()).magnitude().max() < 1e-14
    np.testing.assert_allclose(local(qa, qb), (a.inv() * b).as_rotvec(), atol=1e-14)
    np.testing.assert_allclose(
        local(qa, multiply(qa, exp(b.as_rotvec()))), b.as_rotvec(), atol=1e-14
    )
    np.testing.assert_allclose(local(qa, qa), 0.0, atol=1e-15)
    v = rng.standard_normal((2, 50, 3))
    np.testing.assert_allclose((skew(v[0]) @ v[1][..., None])[..., 0], np.cross(v[0], v[1]))


def test_noise_is_the_sum_of_the_noise_of_tiny_steps() -> None:
    """Two to the 14 steps, each too small to turn in, against the matrix exponential."""
    rate, dt, arw, rrw = np.array([[0.3, -0.9, 0.6]]), 0.8, 1e-5, 2e-5
    f, q = discretise_small_angle(rate, dt / 2**14, arw, rrw)
    f = f.copy()
    f[:, :3, :3] = Rotation.from_rotvec(-rate * dt / 2**14).as_matrix()
    for _ in range(14):
        f, q = f @ f, f @ q @ f.swapaxes(1, 2) + q
    exact_f, exact_q = discretise(rate, dt, arw, rrw)
    np.testing.assert_allclose(exact_f, f, atol=1e-4)
    sigma = np.sqrt(np.diagonal(exact_q[0]))
    np.testing.assert_allclose(
        exact_q / np.outer(sigma, sigma), q / np.outer(sigma, sigma), atol=1e-4
    )
    assert np.abs(q - discretise_small_angle(rate, dt, arw, rrw)[1]).max() > 0.01 * q.max()
