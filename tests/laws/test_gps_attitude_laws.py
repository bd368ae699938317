"""GPS attitude against scipy, a general least-squares solver, Monte Carlo and symmetries."""

from __future__ import annotations

import numpy as np
import pytest
from celestcore import quaternion
from celestcore.gnss.antennas import Antennas, predict_attitude_sigma
from celestcore.gnss.attitude import GpsAttitude, gps_attitude
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation
from scipy.stats import chi2, kstest

Array = NDArray[np.float64]
LAYOUTS = {
    "pair": [[2.0, 0.0, 0.0], [0.0, 1.5, 0.0]],
    "plane": [[2.0, 0.0, 0.0], [0.0, 1.5, 0.0], [-1.0, -1.2, 0.0]],
    "space": [[2.0, 0.1, 0.0], [0.3, 1.5, 0.2], [-1.0, -1.2, 0.3], [0.5, 0.4, 1.0]],
}
layouts = pytest.mark.parametrize("name", list(LAYOUTS))
masters = pytest.mark.parametrize("master", [True, False])
N = 20_000


def spread(wide: int, seed: int) -> Array:
    """Return some covariance (wide, wide) of 5 mm whose axes differ and are correlated."""
    rng = np.random.default_rng(seed)
    mix = rng.standard_normal((wide, wide)) / np.sqrt(wide) + np.eye(wide)
    return np.asarray(0.005**2 * mix @ mix.T)


def draw(body: Array, turns: Rotation, covariance: Array, seed: int) -> Array:
    rng = np.random.default_rng(seed)
    exact = np.einsum("mab,nb->mna", turns.as_matrix(), body)
    noise = rng.standard_normal((len(exact), 3 * len(body))) @ np.linalg.cholesky(covariance).T
    return np.asarray(exact + noise.reshape(exact.shape))


def error(made: GpsAttitude, turns: Rotation) -> Array:
    back = quaternion.conjugate(quaternion.from_rotation(turns))
    return quaternion.log(quaternion.multiply(back, made.q))


def check_covariance(made: GpsAttitude, turns: Rotation, dof: int) -> None:
    """Errors have the covariance that is told, within 3 %; chi-square has its law."""
    off = error(made, turns)
    lower = np.linalg.cholesky(np.linalg.inv(made.covariance))
    white = np.einsum("mji,mj->mi", lower, off)
    assert np.abs(white.mean(axis=0)).max() < 4.0 / np.sqrt(N)
    assert np.abs(np.cov(white, rowvar=False) - np.eye(3)).max() < 0.03
    assert (made.dof == dof).all()
    assert kstest(made.chi_square, chi2(dof).cdf).pvalue > 1e-3


@layouts
@masters
def test_covariance_is_within_3_percent_of_20000_draws(name: str, master: bool) -> None:
    antennas = Antennas(LAYOUTS[name], shared_master=master)
    turns = Rotation.random(N, rng=1)
    vectors = draw(antennas.baselines, turns, np.kron(antennas.covariance, np.eye(3)), seed=2)
    made = gps_attitude(antennas, vectors, gate=None)
    check_covariance(made, turns, 3 * len(antennas) - 3)
    assert np.allclose(made.sigma, predict_attitude_sigma(antennas), rtol=1e-12)
    found = error(made, turns).std(axis=0)
    assert np.allclose(found, predict_attitude_sigma(antennas), rtol=0.03)


@layouts
def test_covariance_holds_with_a_full_covariance_of_the_measurements(name: str) -> None:
    antennas = Antennas(LAYOUTS[name])
    c = spread(3 * len(antennas), seed=3)
    turns = Rotation.random(N, rng=4)
    made = gps_attitude(antennas, draw(antennas.baselines, turns, c, 5), covariance=c, gate=None)
    check_covariance(made, turns, 3 * len(antennas) - 3)


@layouts
def test_with_independent_baselines_it_is_wahbas_problem(name: str) -> None:
    antennas = Antennas(LAYOUTS[name], shared_master=False)
    turns = Rotation.random(50, rng=6)
    vectors = draw(antennas.baselines, turns, 0.05**2 * np.eye(3 * len(antennas)), seed=7)
    made = gps_attitude(antennas, vectors, gate=None)
    for q, v in zip(made.q, vectors, strict=True):
        known, _ = Rotation.align_vectors(v, antennas.baselines)
        assert quaternion.angle_between(q, known) < 1e-12


@layouts
@pytest.mark.parametrize("full", [True, False])
def test_it_is_the_minimum_that_a_general_solver_finds(name: str, full: bool) -> None:
    antennas = Antennas(LAYOUTS[name], sigma=0.05)
    wide = 3 * len(antennas)
    c = 100.0 * spread(wide, seed=8) if full else np.kron(antennas.covariance, np.eye(3))
    white = np.linalg.inv(np.linalg.cholesky(c))
    turns = Rotation.random(20, rng=9)
    vectors = draw(antennas.baselines, turns, c, seed=10)
    made = gps_attitude(antennas, vectors, covariance=c if full else None, gate=None)
    for k, (v, turn) in enumerate(zip(vectors, turns, strict=True)):

        def rest(d: Array, v: Array = v, turn: Rotation = turn) -> Array:
            model = (turn * Rotation.from_rotvec(d)).apply(antennas.baselines)
            return np.asarray(white @ (v - model).ravel())

        found = least_squares(rest, np.zeros(3), xtol=1e-14, ftol=1e-14, gtol=1e-14)
        assert quaternion.angle_between(made.q[k], turn * Rotation.from_rotvec(found.x)) < 1e-6
        assert made.chi_square[k] == pytest.approx(2.0 * found.cost, rel=1e-9)


@layouts
def test_a_full_covariance_of_equal_axes_changes_nothing(name: str) -> None:
    antennas = Antennas(LAYOUTS[name])
    c = np.kron(antennas.covariance, np.eye(3))
    vectors = draw(antennas.baselines, Rotation.random(100, rng=11), c, seed=12)
    vectors[::7, 0, 1] = np.nan
    plain, full = gps_attitude(antennas, vectors), gps_attitude(antennas, vectors, covariance=c)
    good = plain.valid
    assert np.array_equal(plain.valid, full.valid)
    assert np.array_equal(plain.used, full.used)
    assert quaternion.angle_between(plain.q[good], full.q[good]).max() < 1e-11
    assert np.allclose(plain.covariance[good], full.covariance[good], rtol=1e-9)
    assert np.allclose(plain.chi_square[good], full.chi_square[good], rtol=1e-6)


@masters
def test_turning_the_frame_turns_the_attitude(master: bool) -> None:
    antennas = Antennas(LAYOUTS["space"], shared_master=master)
    c = np.kron(antennas.covariance, np.eye(3))
    vectors = draw(antennas.baselines, Rotation.random(60, rng=13), c, seed=14)
    turn = Rotation.from_rotvec([0.5, -1.0, 2.0])
    before = gps_attitude(antennas, vectors)
    after = gps_attitude(antennas, turn.apply(vectors.reshape(-1, 3)).reshape(vectors.shape))
    expected = quaternion.multiply(turn, before.q)
    assert quaternion.angle_between(after.q, expected).max() < 1e-12
    assert np.allclose(after.chi_square, before.chi_square, rtol=1e-9)


def test_the_choice_of_the_master_antenna_does_not_matter() -> None:
    """With the full covariance the same antennas give the same attitude from any master."""
    places = np.array([[0.0, 0, 0], *LAYOUTS["space"]])
    rng = np.random.default_rng(15)
    turns = Rotation.random(40, rng=rng)
    at = np.einsum("mab,nb->mna", turns.as_matrix(), places)
    at = at + 0.01 * rng.standard_normal(at.shape)
    made = []
    for master in (0, 3):
        others = [k for k in range(5) if k != master]
        antennas = Antennas(places[others] - places[master], sigma=0.01 * np.sqrt(2.0))
        made.append(gps_attitude(antennas, at[:, others] - at[:, [master]], gate=None))
    assert quaternion.angle_between(made[0].q, made[1].q).max() < 1e-12
    assert np.allclose(made[0].covariance, made[1].covariance, rtol=1e-9)
    assert np.allclose(made[0].chi_square, made[1].chi_square, rtol=1e-9)
