"""GPS attitude from baselines: antennas, direct method, and the tests that turn faults down."""

from __future__ import annotations

import celestcore as cc
import numpy as np
import pytest
from celestcore import frames, quaternion
from celestcore.gnss.antennas import Antennas, predict_attitude_sigma
from celestcore.gnss.attitude import direct_attitude, gps_attitude
from scipy.spatial.transform import Rotation

PAIR = Antennas([[2.0, 0.0, 0.0], [0.0, 1.5, 0.0]])
FOUR = Antennas([[2.0, 0.0, 0.0], [0.0, 1.5, 0.0], [-1.0, -1.2, 0.3], [0.5, 0.4, 1.0]])


def seen(antennas: Antennas, turns: Rotation, seed: int, scale: float = 1.0) -> np.ndarray:
    """Return noisy measured baselines (m, n, 3) of attitudes body to f."""
    rng = np.random.default_rng(seed)
    exact = np.einsum("mab,nb->mna", turns.as_matrix(), antennas.baselines)
    lower = np.linalg.cholesky(antennas.covariance)
    noise = np.einsum("ij,mjk->mik", lower, rng.standard_normal(exact.shape))
    return np.asarray(exact + scale * noise)


# --- antennas ---------------------------------------------------------------------


def test_shared_master_is_the_difference_of_independent_antennas() -> None:
    rng = np.random.default_rng(1)
    master, others = rng.standard_normal((200_000, 1)), rng.standard_normal((200_000, 4))
    found = np.cov((others - master) * FOUR.sigma / np.sqrt(2.0), rowvar=False)
    assert np.allclose(found, FOUR.covariance, rtol=0.02)
    apart = Antennas(FOUR.baselines, sigma=0.01, shared_master=False)
    assert np.array_equal(apart.covariance, 1e-4 * np.eye(4))
    assert len(FOUR) == 4
    assert FOUR.lengths[1] == 1.5


@pytest.mark.parametrize("master", [True, False])
def test_predicted_sigma_is_sigma_over_length(master: bool) -> None:
    """Roll and pitch of baselines along y and x; yaw of the second only where errors are apart."""
    long, wide, s = 2.0, 1.5, 0.005
    sigma = predict_attitude_sigma([[long, 0, 0], [0, wide, 0]], sigma=s, shared_master=master)
    assert sigma[0] == pytest.approx(s / wide, rel=1e-12)
    assert sigma[1] == pytest.approx(s / long, rel=1e-12)
    if not master:
        assert sigma[2] == pytest.approx(s / np.hypot(long, wide), rel=1e-12)
    assert np.array_equal(
        sigma, predict_attitude_sigma(Antennas([[2, 0, 0], [0, 1.5, 0]], s, master))
    )


def test_more_baselines_and_longer_ones_are_better() -> None:
    assert (predict_attitude_sigma(FOUR) < predict_attitude_sigma(PAIR)).all()
    twice = Antennas(2.0 * FOUR.baselines)
    assert np.allclose(predict_attitude_sigma(FOUR), 2.0 * predict_attitude_sigma(twice))


@pytest.mark.parametrize(
    ("baselines", "message"),
    [
        ([[2.0, 0, 0]], r"one baseline leaves the turn about the body axis x unobservable"),
        ([[0, 2.0, 0], [0, -1.0, 0], [0, 1e-9, 0]], r"3 baselines are on one line.*body axis y"),
        ([[1.0, 1.0, 0], [2.0, 2.0, 0]], r"value \(0.707107, 0.707107, 0.0\).*this body axis"),
        (np.empty((0, 3)), r"no turn about any body axis"),
        ([[1.0, 0, 0], [0, 0, 0]], r"row 1.*not zero"),
        ([[1.0, 0, 0], [0, np.nan, 0]], r"row 1.*finite"),
        ([1.0, 0, 0], r"has shape \(3,\)"),
    ],
)
def test_unobservable_layouts_name_the_axis(baselines: object, message: str) -> None:
    with pytest.raises(cc.InputError, match=message):
        Antennas(baselines)  # type: ignore[arg-type]
    with pytest.raises(cc.InputError, match=message):
        predict_attitude_sigma(baselines)  # type: ignore[arg-type]


def test_noise_must_be_positive_and_antennas_are_a_value() -> None:
    with pytest.raises(cc.InputError, match=r"antennas.sigma.*greater than 0"):
        Antennas(PAIR.baselines, sigma=0.0)
    given = np.eye(3)
    kept = Antennas(given)
    given[0] = 9.0
    assert kept.baselines[0, 0] == 1.0
    with pytest.raises(AttributeError):
        kept.sigma = 1.0  # type: ignore[misc]


# --- the direct method ------------------------------------------------------------


def test_direct_angles_are_the_321_angles_of_the_attitude() -> None:
    turns = Rotation.random(500, rng=3)
    second = np.array([0.4, -1.5, 0.7])
    vectors = np.stack([turns.apply([2.0, 0, 0]), turns.apply(second)], axis=1)
    made = direct_attitude(vectors, second)
    known = frames.euler_321(turns)
    for a, b in zip(made[:3], known[:3], strict=True):
        assert np.allclose(a, b, rtol=0, atol=1e-10)
    assert np.array_equal(made.near_singular, known.near_singular)
    batch = direct_attitude(vectors.reshape(5, 100, 2, 3), second)
    assert np.array_equal(batch.roll.reshape(-1), made.roll)


@pytest.mark.parametrize("pitch", [0.0, 40.0, 70.0])
def test_direct_errors_follow_the_closed_forms(pitch: float) -> None:
    """sigma / L in pitch, sigma / (L cos pitch) in yaw, sigma / L2 in roll at no pitch."""
    truth = Rotation.from_euler("ZYX", np.tile(np.radians([20.0, pitch, -10.0]), (20_000, 1)))
    made = direct_attitude(seen(PAIR, truth, seed=4), PAIR.baselines[1])
    s = PAIR.sigma
    assert made.pitch.std() == pytest.approx(s / 2.0, rel=0.03)
    assert made.yaw.std() == pytest.approx(s / (2.0 * np.cos(np.radians(pitch))), rel=0.03)
    if pitch == 0.0:
        assert made.roll.std() == pytest.approx(s / 1.5, rel=0.03)


def test_least_squares_is_no_worse_than_the_direct_method() -> None:
    truth = Rotation.identity(20_000)
    vectors = seen(PAIR, truth, seed=5)
    direct = direct_attitude(vectors, PAIR.baselines[1])
    best = frames.euler_321(gps_attitude(PAIR, vectors, gate=None).q)
    assert best.pitch.std() <= 1.001 * direct.pitch.std()
    assert best.roll.std() <= 1.001 * direct.roll.std()
    assert best.yaw.std() < 0.75 * direct.yaw.std()


def test_direct_refuses_a_second_baseline_along_the_first() -> None:
    with pytest.raises(cc.InputError, match=r"second.*body axis x \(roll\) is unobservable"):
        direct_attitude(np.eye(3)[:2], [1.5, 0.0, 0.0])
    with pytest.raises(cc.InputError, match=r"baselines: has shape \(3, 3\)"):
        direct_attitude(np.eye(3), [0.0, 1.0, 0.0])
    gone = direct_attitude([[[np.nan] * 3, [0, 1.0, 0]], [[1.0, 0, 0], [0, 1.0, 0]]], [0, 1.0, 0])
    assert np.isnan(gone.yaw).tolist() == [True, False]


# --- shapes, signs, missing baselines ------------------------------------------------


def test_leading_axes_are_kept_and_signs_do_not_jump() -> None:
    turns = Rotation.from_rotvec(np.outer(np.linspace(0, 20.0, 400), [0.1, 0.6, -0.7]))
    vectors = seen(FOUR, turns, seed=6, scale=0.1)
    one = gps_attitude(FOUR, vectors)
    assert np.linalg.norm(np.diff(one.q, axis=0), axis=1).max() < 0.1
    assert (one.q[:, 0] < -0.5).any()
    many = gps_attitude(FOUR, vectors.reshape(2, 200, 4, 3))
    assert many.covariance.shape == (2, 200, 3, 3)
    assert many.used.shape == (2, 200, 4)
    apart = quaternion.angle_between(many.q.reshape(-1, 4), one.q)
    assert apart.max() < 1e-12
    single = gps_attitude(FOUR, vectors[7])
    assert single.q.shape == (4,)
    assert single.chi_square == pytest.approx(one.chi_square[7])
    assert gps_attitude(FOUR, np.empty((0, 4, 3))).q.shape == (0, 4)
    assert one.as_rotation().as_matrix().shape == (400, 3, 3)


def test_a_missing_baseline_is_as_if_it_were_not_there() -> None:
    turns = Rotation.random(50, rng=7)
    vectors = seen(FOUR, turns, seed=8)
    vectors[:, 2, 1] = np.nan
    fewer = Antennas(np.delete(FOUR.baselines, 2, axis=0))
    made = gps_attitude(FOUR, vectors)
    known = gps_attitude(fewer, np.delete(vectors, 2, axis=1))
    assert np.allclose(made.covariance, known.covariance, rtol=1e-12)
    assert np.allclose(made.chi_square, known.chi_square, rtol=1e-9)
    assert quaternion.angle_between(made.q, known.q).max() < 1e-12
    assert (made.dof == 6).all()
    assert not made.used[:, 2].any()


def test_too_few_baselines_leave_a_row_not_valid() -> None:
    vectors = seen(PAIR, Rotation.identity(4), seed=9)
    vectors[1, 0] = np.nan
    vectors[3] = np.nan
    made = gps_attitude(PAIR, vectors)
    assert made.valid.tolist() == [True, False, True, False]
    assert made.dof.tolist() == [3, 0, 3, 0]
    assert np.isnan(made.q[[1, 3]]).all()
    assert np.isnan(made.covariance[1]).all()
    assert np.isnan(made.chi_square).tolist() == [False, True, False, True]
    line = Antennas([[2.0, 0, 0], [1.0, 0, 0], [0, 1.0, 0]])
    measured = np.array(line.baselines)
    measured[2] = np.nan
    assert not gps_attitude(line, measured).valid


# --- faults -----------------------------------------------------------------------


@pytest.mark.parametrize("gate", [0.99, 0.999])
@pytest.mark.parametrize("antennas", [PAIR, FOUR])
def test_good_baselines_pass_with_the_probability_of_the_gate(
    antennas: Antennas, gate: float
) -> None:
    m = 40_000
    made = gps_attitude(antennas, seen(antennas, Rotation.random(m, rng=10), seed=11), gate=gate)
    lost = 1.0 - made.used.all(axis=1).mean()
    assert lost < (1.0 - gate) + 3.0 * np.sqrt((1.0 - gate) / m)
    assert lost > 0.4 * (1.0 - gate)


@pytest.mark.parametrize("wrong", [0, 1, 2, 3])
def test_a_wrong_ambiguity_is_found_and_the_rest_serves(wrong: int) -> None:
    """A cycle of L1 in a random direction, 27 sigma."""
    rng = np.random.default_rng(12)
    turns = Rotation.random(4000, rng=rng)
    vectors = seen(FOUR, turns, seed=13)
    way = rng.standard_normal((4000, 3))
    vectors[:, wrong] += 0.19 * way / np.linalg.norm(way, axis=1, keepdims=True)
    made = gps_attitude(FOUR, vectors)
    expected = np.ones(4, dtype=bool)
    expected[wrong] = False
    right = (made.used == expected).all(axis=1)
    assert right.mean() > 0.99
    assert made.valid[right].all()
    back = quaternion.conjugate(quaternion.from_rotation(turns))[right]
    off = quaternion.log(quaternion.multiply(back, made.q[right]))
    nees = np.einsum("mi,mij,mj->m", off, np.linalg.inv(made.covariance[right]), off)
    assert nees.mean() == pytest.approx(3.0, abs=0.15)


def test_two_wrong_baselines_of_five_are_both_left_out() -> None:
    antennas = Antennas([*FOUR.baselines.tolist(), [-1.5, 0.8, -0.4]])
    vectors = seen(antennas, Rotation.random(500, rng=14), seed=15)
    vectors[:, 1, 0] += 0.4
    vectors[:, 3, 2] -= 0.38
    made = gps_attitude(antennas, vectors)
    assert (made.used == [True, False, True, False, True]).all(axis=1).mean() > 0.95


def test_two_baselines_show_that_one_is_wrong_but_not_which() -> None:
    vectors = seen(PAIR, Rotation.random(300, rng=16), seed=17)
    vectors[::2, 1] *= 1.0 + 0.19 / 1.5
    made = gps_attitude(PAIR, vectors)
    assert not made.valid[::2].any()
    assert made.valid[1::2].mean() > 0.97
    assert np.isnan(made.q[::2]).all()
    assert not made.used[::2].any()
    assert (made.chi_square[::2] > 100.0).all()
    kept = gps_attitude(PAIR, vectors, gate=None)
    assert kept.valid.all()
    assert np.isfinite(kept.q).all()


def test_wrong_input_is_named() -> None:
    good = np.array(PAIR.baselines)
    with pytest.raises(cc.InputError, match="Antennas"):
        gps_attitude(PAIR.baselines, good)  # type: ignore[arg-type]
    with pytest.raises(cc.InputError, match=r"measured: has shape \(3, 3\), needed is \(..., 2, 3"):
        gps_attitude(PAIR, np.eye(3))
    for gate in (0.0, 1.0, 2.0):
        with pytest.raises(cc.InputError, match="gate"):
            gps_attitude(PAIR, good, gate=gate)
    with pytest.raises(cc.InputError, match=r"covariance: has shape \(3, 3\), needed is \(6, 6\)"):
        gps_attitude(PAIR, good, covariance=np.eye(3))
    bad = np.stack([np.eye(6), -np.eye(6)])
    with pytest.raises(cc.InputError, match=r"covariance, row 1: .*positive definite"):
        gps_attitude(PAIR, np.stack([good, good]), covariance=bad)
    skew = np.eye(6)
    skew[0, 3] = 0.5
    with pytest.raises(cc.InputError, match=r"covariance: .*symmetric"):
        gps_attitude(PAIR, good, covariance=skew)
