"""Simulation: truths against geometry, errors against what they are said to be."""

from __future__ import annotations

import pickle
from collections.abc import Callable
from typing import Any

import celestcore as cc
import numpy as np
import pytest
from celestcore import simulate
from celestcore.simulate import GyroErrors, Scenario, StarErrors, Truth
from scipy.linalg import expm
from scipy.spatial.transform import Rotation, Slerp
from scipy.stats import chi2, kstest

ONE = [1.0, 0.0, 0.0, 0.0]
STILL = simulate.constant_rate([0.0, 0.0, 0.0], 2000.0, 0.1)
BRIEF = Truth([0.0, 1.0], [ONE, ONE])


def rotation(q: Any) -> Rotation:
    return Rotation.from_quat(np.roll(q, -1, axis=-1))


def flown(truth: Truth, gyro: GyroErrors, seed: int = 0, trial: int = 0) -> simulate.Simulation:
    return simulate.log(truth, gyro, StarErrors(1e-5, every=len(truth)), seed=seed, trial=trial)


def rates(truth: Truth, gyro: GyroErrors, seed: int = 0, trial: int = 0) -> Any:
    log = flown(truth, gyro, seed, trial).log
    assert log.gyro is not None
    return log.gyro.rate


def likely(sum_of_squares: float, dof: int) -> bool:
    """Whether a sum of squares of standard normal numbers is one of 99.9 %."""
    return bool(5e-4 < chi2.cdf(sum_of_squares, dof) < 1.0 - 5e-4)


# --- truths -------------------------------------------------------------------------------------


def test_earth_pointing_is_the_orbital_frame() -> None:
    a, i, raan, u0 = 7.0e6, 1.1, 0.7, 2.0
    truth = simulate.earth_pointing(
        6000.0, 1.0, semi_major_axis=a, inclination=i, raan=raan, argument_of_latitude=u0
    )
    n = np.sqrt(simulate.MU_EARTH / a**3)
    u = u0 + n * truth.t
    orbit = Rotation.from_euler("ZX", [raan, i])
    r = orbit.apply(np.stack([np.cos(u), np.sin(u), 0 * u], axis=1))
    v = orbit.apply(np.stack([-np.sin(u), np.cos(u), 0 * u], axis=1))
    body = rotation(truth.q)
    np.testing.assert_allclose(body.apply([1.0, 0.0, 0.0]), v, atol=1e-14)
    np.testing.assert_allclose(body.apply([0.0, 1.0, 0.0]), -np.cross(r, v), atol=1e-14)
    np.testing.assert_allclose(body.apply([0.0, 0.0, 1.0]), -r, atol=1e-14)
    np.testing.assert_allclose(truth.rate, np.tile([0.0, -n, 0.0], (len(truth), 1)), atol=1e-15)


def test_the_published_orbit() -> None:
    truth = simulate.earth_pointing(5659.4)
    assert len(truth) == 56_594
    assert truth.rate[0, 1] == pytest.approx(-1.1102134571e-3, rel=1e-9)


def test_constant_rate_against_scipy() -> None:
    w, q0 = np.array([0.02, -0.3, 0.1]), Rotation.random(random_state=3)
    truth = simulate.constant_rate(w, 100.0, 0.25, q0=q0)
    off = rotation(truth.q).inv() * (q0 * Rotation.from_rotvec(truth.t[:, None] * w))
    assert off.magnitude().max() < 1e-13
    np.testing.assert_allclose(truth.rate, np.tile(w, (len(truth), 1)), atol=1e-14)
    assert (np.sum(truth.q[1:] * truth.q[:-1], axis=1) > 0.0).all()


def test_slews_are_smooth_and_come_back() -> None:
    truth = simulate.slews(480.0, 0.1, angle=1.0, slew_time=60.0, hold_time=20.0)
    angle = rotation(truth.q).magnitude()
    rows = np.rint(np.array([65.0, 145.0, 225.0, 305.0, 385.0, 465.0]) / 0.1).astype(int)
    np.testing.assert_allclose(angle[rows], [1.0, 0.0, 1.0, 0.0, 1.0, 0.0], atol=1e-12)
    assert np.abs(truth.rate[rows]).max() < 1e-14
    size = np.linalg.norm(truth.rate, axis=1)
    assert size.max() == pytest.approx(1.875 / 60.0, rel=1e-4)
    # no jump of the rate is larger than the largest acceleration, 10 / sqrt(3) A / T^2, allows
    jumps = np.linalg.norm(np.diff(truth.rate, axis=0), axis=1)
    assert jumps.max() < 1.001 * 0.1 * 10.0 / np.sqrt(3.0) / 60.0**2
    for k, axis in enumerate(np.eye(3)):
        turning = truth.rate[(truth.t > 160.0 * k) & (truth.t < 160.0 * k + 59.0)]
        np.testing.assert_allclose(turning - (turning @ axis)[:, None] * axis, 0.0, atol=1e-14)


def test_rates_lead_from_attitude_to_attitude() -> None:
    rng = np.random.default_rng(4)
    t = np.cumsum(rng.uniform(0.05, 0.5, 500))
    truth = simulate.attitude(
        t,
        rng.choice([-1, 1], (500, 1))
        * Rotation.random(500, random_state=5).as_quat()[:, [3, 0, 1, 2]],
    )
    again = cc.quaternion.propagate(truth.q[0], truth.rate[:-1], np.diff(t))
    np.testing.assert_allclose(again, truth.q, atol=1e-12)
    assert (truth.rate[-1] == truth.rate[-2]).all()


def test_between_samples_against_scipy() -> None:
    turns = Rotation.random(6, random_state=1)
    truth = simulate.attitude(np.arange(6.0), turns)
    t = np.linspace(0.0, 5.0, 101)
    expected = Slerp(np.arange(6.0), turns)(t)
    assert (rotation(truth.at(t)).inv() * expected).magnitude().max() < 1e-13
    assert truth.at(2.0).shape == (4,)
    with pytest.raises(cc.InputError, match="within 0 to 5 s") as caught:
        truth.at([1.0, 7.0])
    assert (caught.value.row, caught.value.value) == (1, 7.0)


BAD_TRUTHS: dict[str, tuple[Callable[[], Any], str]] = {
    "t back": (lambda: simulate.attitude([0.0, 0.0], [ONE, ONE]), "truth.t, row 1"),
    "one": (lambda: simulate.attitude([0.0], [ONE]), "two samples"),
    "nan": (lambda: simulate.attitude([0.0, 1.0], [ONE, [np.nan] * 4]), "truth.q, row 1"),
    "norm": (lambda: simulate.attitude([0.0, 1.0], [ONE, [2.0, 0, 0, 0]]), "truth.q, row 1"),
    "rows": (lambda: simulate.attitude([0.0, 1.0], [ONE]), "shape"),
    "duration": (lambda: simulate.earth_pointing(-1.0), "duration"),
    "short": (lambda: simulate.earth_pointing(0.1, 0.1), "1 samples"),
    "long": (lambda: simulate.earth_pointing(1e9, 1e-9), "duration"),
    "dt": (lambda: simulate.earth_pointing(10.0, 0.0), "dt"),
    "half an orbit": (lambda: simulate.earth_pointing(1e5, 3e3), "dt"),
    "fast": (lambda: simulate.constant_rate([0, 0, 4.0], 10.0, 1.0), "half a turn"),
    "fast slew": (lambda: simulate.slews(100.0, 1.0, angle=3.0, slew_time=1.0), "half a turn"),
    "axes": (lambda: simulate.slews(100.0, axes=[[0, 0, 0]]), "axes"),
    "no axes": (lambda: simulate.slews(100.0, axes=np.zeros((0, 3))), "axes"),
    "axis": (lambda: simulate.earth_pointing(10.0, semi_major_axis=0.0), "semi_major_axis"),
    "q0": (lambda: simulate.constant_rate([0, 0, 0], 10.0, q0=[1, 1, 0, 0]), "q0"),
}


@pytest.mark.parametrize("case", BAD_TRUTHS)
def test_bad_truths_are_refused(case: str) -> None:
    make, message = BAD_TRUTHS[case]
    with pytest.raises(cc.InputError, match=message):
        make()


# --- the gyro -----------------------------------------------------------------------------------


def test_without_errors_the_gyro_reads_the_truth() -> None:
    truth = simulate.slews(300.0, 0.1)
    assert (rates(truth, GyroErrors()) == truth.rate).mean() > 0.5
    np.testing.assert_allclose(rates(truth, GyroErrors()), truth.rate, rtol=1e-15)


def test_scale_misalignment_bias_and_mounting() -> None:
    truth = simulate.slews(600.0, 0.5)
    mounting = Rotation.random(random_state=8)
    bias = np.array([1e-4, -2e-4, 3e-4])
    gyro = GyroErrors(
        bias=bias, scale=[1e-3, 2e-3, -3e-3], misalignment=[1, 2, 3, 4, 5, 6], mounting=mounting
    )
    response = np.array([[1.001, 1, 2], [3, 1.002, 4], [5, 6, 0.997]])
    np.testing.assert_allclose(gyro.response, response, rtol=1e-15)
    expected = mounting.inv().apply(truth.rate.copy()) @ response.T + bias
    made = flown(truth, gyro)
    assert made.log.gyro is not None
    np.testing.assert_allclose(made.log.gyro.rate, expected, atol=1e-15)
    np.testing.assert_allclose(
        made.bias, np.tile(mounting.apply(bias), (len(truth), 1)), atol=1e-18
    )
    full = GyroErrors(scale=[1e-3, 2e-3, -3e-3], misalignment=response - np.diag(np.diag(response)))
    np.testing.assert_allclose(full.response, response, rtol=1e-15)


def test_white_noise_is_white_and_as_large_as_said() -> None:
    arw = np.array([1e-6, 2e-6, 5e-6])
    w = rates(STILL, GyroErrors(arw)) / (arw / np.sqrt(0.1))
    n = len(w)
    for axis in w.T:
        assert likely(np.sum(axis**2), n)
        assert kstest(axis, "norm").pvalue > 1e-3
    # sums of products of neighbours, and of two axes, have variance n
    assert np.abs(np.sum(w[1:] * w[:-1], axis=0)).max() < 4.0 * np.sqrt(n)
    assert np.abs(np.sum(w * np.roll(w, 1, axis=1), axis=0)).max() < 4.0 * np.sqrt(n)


def van_loan(a: Any, density: Any, h: float) -> tuple[Any, Any]:
    """Return transition and noise over a step (Van Loan 1978)."""
    n = len(a)
    big = np.block([[-a, density], [np.zeros((n, n)), a.T]])
    out = expm(big * h)
    f = out[n:, n:].T
    return f, f @ out[:n, n:]


@pytest.mark.parametrize("x", [0.0, 1e-3, 0.02, 0.3, 0.6, 3.0])
def test_walk_and_drift_over_uneven_steps(x: float) -> None:
    """Integral and end over a step, jointly, against a matrix exponential; x = step / time."""
    h = np.tile([0.1, 0.4, 0.2], 4000)
    t = np.concatenate([[0.0], np.cumsum(h)])
    truth = Truth(t, np.tile(ONE, (len(t), 1)))
    size, tau = 3e-6, (0.4 / x if x else np.inf)
    gyro = GyroErrors(rrw=size) if x == 0.0 else GyroErrors(markov_sigma=size, markov_time=tau)
    made = flown(truth, gyro, seed=2)
    assert made.log.gyro is not None
    integral = made.log.gyro.rate[:-1] * h[:, None]
    decay, density = (0.0, 1.0) if x == 0.0 else (-1.0 / tau, 2.0 / tau)
    for step in (0.1, 0.2, 0.4):
        # state: value, and its integral
        f, q = van_loan(np.array([[decay, 0.0], [1.0, 0.0]]), np.diag([density, 0.0]), step)
        at = np.flatnonzero(h == step)
        value, end = made.bias[at], made.bias[at + 1]
        drawn = np.stack([end - f[0, 0] * value, integral[at] - f[1, 0] * value]) / size
        unit = np.sqrt(np.diag(q))
        root = np.linalg.cholesky(q / np.outer(unit, unit))
        z = np.linalg.solve(root, drawn.reshape(2, -1) / unit[:, None])
        n = z.shape[1]
        assert likely(np.sum(z[0] ** 2), n)
        assert likely(np.sum(z[1] ** 2), n)
        assert abs(np.sum(z[0] * z[1])) < 4.0 * np.sqrt(n)


def test_start_of_bias_and_drift() -> None:
    gyro = GyroErrors(
        bias=[1.0, 2.0, 3.0], bias_sigma=[0.1, 0.2, 0.3], markov_sigma=0.5, markov_time=10.0
    )
    start = np.array([flown(BRIEF, gyro, 1, trial).bias[0] for trial in range(2000)])
    z = (start - [1.0, 2.0, 3.0]) / np.sqrt(np.array([0.1, 0.2, 0.3]) ** 2 + 0.25)
    for axis in z.T:
        assert kstest(axis, "norm").pvalue > 1e-3
    assert np.abs(np.corrcoef(z.T) - np.eye(3)).max() < 4.0 / np.sqrt(2000)


def test_an_infinite_correlation_time_is_a_constant() -> None:
    bias = flown(STILL, GyroErrors(markov_sigma=1e-5)).bias
    assert (bias == bias[0]).all()
    assert (bias[0] != 0.0).all()


def test_quantisation_loses_nothing() -> None:
    truth = simulate.slews(300.0, 0.1)
    coarse = GyroErrors(arw=1e-5, quantisation=1e-4)
    counts = rates(truth, coarse) * 0.1 / 1e-4
    np.testing.assert_allclose(counts, np.round(counts), atol=1e-6)
    exact = rates(truth, GyroErrors(arw=1e-5)) * 0.1
    off = np.cumsum(counts * 1e-4 - exact, axis=0)
    assert np.abs(off).max() <= 0.5e-4 * (1.0 + 1e-6)
    assert len(np.unique(np.round(counts))) > 10


# --- star cameras -------------------------------------------------------------------------------


def test_star_noise_has_the_full_covariance() -> None:
    root = np.random.default_rng(1).standard_normal((3, 3)) * 1e-5
    r, mounting = root @ root.T, Rotation.random(random_state=2)
    star = StarErrors(covariance=r, mounting=mounting)
    made = simulate.log(STILL, GyroErrors(1e-6), star, seed=4)
    true = rotation(STILL.q) * mounting
    e = (true.inv() * rotation(made.log.stars["star"].q)).as_rotvec()
    z = np.linalg.solve(np.linalg.cholesky(r), e.T)
    n = z.shape[1]
    for k in range(3):
        assert likely(np.sum(z[k] ** 2), n)
        assert kstest(z[k], "norm").pvalue > 1e-3
        assert abs(np.sum(z[k] * z[(k + 1) % 3])) < 4.0 * np.sqrt(n)
        assert abs(np.sum(z[k, 1:] * z[k, :-1])) < 4.0 * np.sqrt(n)


@pytest.mark.parametrize(
    ("star", "expected"),
    [
        (StarErrors(1e-5), np.arange(100) * 0.1),
        (StarErrors(1e-5, every=2), np.arange(50) * 0.2),
        (StarErrors(1e-5, every=3, offset=2), 0.2 + np.arange(33) * 0.3),
        (StarErrors(1e-5, period=0.2), np.arange(50) * 0.2),
        (StarErrors(1e-5, period=0.25, offset=0.05), 0.05 + np.arange(40) * 0.25),
        (StarErrors(1e-5, period=100.0, offset=9.9), [9.9]),
    ],
)
def test_times_of_fixes(star: StarErrors, expected: Any) -> None:
    truth = simulate.earth_pointing(10.0)
    made = simulate.log(truth, GyroErrors(1e-6), star)
    table = made.log.stars["star"]
    np.testing.assert_allclose(table.t, expected, atol=1e-9)
    off = (rotation(truth.at(table.t)).inv() * rotation(table.q)).magnitude()
    assert off.max() < 6e-5
    # a time that is a sample's is that sample's, to the last bit
    near = np.abs(table.t[:, None] - truth.t).min(axis=1)
    assert ((near == 0.0) | (near > 1e-3)).all()


def test_error_of_a_solution() -> None:
    truth = simulate.slews(100.0, 0.1)
    scenario = Scenario(truth, GyroErrors(1e-6, 1e-8, bias_sigma=1e-4), StarErrors(1e-5, every=5))
    made = scenario.simulate(seed=3)
    sol = scenario.navigator().run(made.log, every=7)
    error = made.error(sol)
    expected = (rotation(sol.q).inv() * rotation(truth.q[::7])).as_rotvec()
    np.testing.assert_allclose(error[:, :3], expected, atol=1e-14)
    np.testing.assert_allclose(error[:, 3:], made.bias[::7] - sol.bias, atol=1e-18)


# --- random numbers -----------------------------------------------------------------------------

FULL = GyroErrors(1e-6, 1e-8, 0.0, 1e-5, 1e-6, 100.0)
STARS = {"star": StarErrors(1e-5, every=2), "star_2": StarErrors(2e-5, every=3)}


def same(a: simulate.Simulation, b: simulate.Simulation) -> bool:
    assert a.log.gyro is not None
    assert b.log.gyro is not None
    return bool(
        (a.log.gyro.rate == b.log.gyro.rate).all()
        and (a.bias == b.bias).all()
        and all((a.log.stars[n].q == b.log.stars[n].q).all() for n in a.log.stars)
    )


def test_the_same_seed_and_trial_give_the_same_bits() -> None:
    scenario = Scenario(simulate.earth_pointing(100.0), FULL, STARS)
    made = scenario.simulate(5, 17)
    scenario.simulate(5, 18)
    assert same(made, scenario.simulate(5, 17))
    assert same(made, pickle.loads(pickle.dumps(scenario)).simulate(5, 17))
    assert not same(made, scenario.simulate(5, 18))
    assert not same(made, scenario.simulate(6, 17))
    assert (made.seed, made.trial) == (5, 17)


def test_one_source_does_not_change_the_others() -> None:
    white = rates(STILL, GyroErrors(1e-6))
    walk = rates(STILL, GyroErrors(rrw=1e-8))
    drift = rates(STILL, GyroErrors(markov_sigma=1e-6, markov_time=100.0))
    both = rates(STILL, GyroErrors(1e-6, 1e-8, markov_sigma=1e-6, markov_time=100.0))
    np.testing.assert_allclose(both, white + walk + drift, atol=1e-20, rtol=1e-12)
    truth = simulate.earth_pointing(50.0)
    one = simulate.log(truth, FULL, STARS["star"]).log.stars["star"].q
    two = simulate.log(truth, GyroErrors(1e-3), STARS).log.stars["star"].q
    assert (one == two).all()


def test_a_longer_run_begins_the_same() -> None:
    short, long = (rates(simulate.earth_pointing(d), FULL) for d in (50.0, 80.0))
    assert (short[:-1] == long[: len(short) - 1]).all()


def test_trials_and_seeds_are_independent() -> None:
    gyro = GyroErrors(np.sqrt(0.1))
    drawn = [rates(STILL, gyro, s, k).ravel() for s, k in ((0, 0), (0, 1), (0, 256), (1, 0))]
    z = np.array(drawn)
    off = z @ z.T / z.shape[1] - np.eye(4)
    assert np.abs(off).max() < 4.5 / np.sqrt(z.shape[1])


# --- what is refused ----------------------------------------------------------------------------

BAD: dict[str, tuple[Callable[[], Any], str]] = {
    "arw": (lambda: GyroErrors(-1.0), "gyro.arw"),
    "nan": (lambda: GyroErrors([np.nan] * 3), "gyro.arw"),
    "rrw": (lambda: GyroErrors(rrw=[0.0, -1.0, 0.0]), "gyro.rrw"),
    "time": (lambda: GyroErrors(markov_time=0.0), "gyro.markov_time"),
    "misalignment": (lambda: GyroErrors(misalignment=[1.0] * 5), "gyro.misalignment"),
    "infinite": (lambda: GyroErrors(misalignment=[np.inf] * 6), "gyro.misalignment"),
    "quantisation": (lambda: GyroErrors(quantisation=-1.0), "gyro.quantisation"),
    "gyro mounting": (lambda: GyroErrors(mounting=[1, 1, 1, 1]), "gyro.mounting"),
    "no noise": (lambda: StarErrors(), "star.sigma"),
    "sigma": (lambda: StarErrors(0.0), "star.sigma"),
    "both": (lambda: StarErrors(1e-5, covariance=np.eye(3)), "star"),
    "covariance": (lambda: StarErrors(covariance=np.diag([1.0, 1.0, -1.0])), "star.covariance"),
    "period and every": (lambda: StarErrors(1e-5, period=1.0, every=2), "star.period"),
    "period": (lambda: StarErrors(1e-5, period=0.0), "star.period"),
    "every": (lambda: StarErrors(1e-5, every=0), "star.every"),
    "offset": (lambda: StarErrors(1e-5, offset=0.5), "star.offset"),
    "late": (lambda: simulate.log(BRIEF, GyroErrors(), StarErrors(1e-5, offset=2)), "star.offset"),
    "later": (
        lambda: simulate.log(BRIEF, GyroErrors(), StarErrors(1e-5, period=1.0, offset=9.0)),
        "star.offset",
    ),
    "truth": (lambda: Scenario(3, GyroErrors(), StarErrors(1e-5)), "truth"),  # type: ignore[arg-type]
    "gyro": (lambda: Scenario(BRIEF, cc.Gyro(1.0), StarErrors(1e-5)), "gyro"),  # type: ignore[arg-type]
    "star": (lambda: Scenario(BRIEF, GyroErrors(), {}), "star"),
    "name": (lambda: Scenario(BRIEF, GyroErrors(), {"left": StarErrors(1e-5)}), "left"),
    "seed": (lambda: flown(BRIEF, GyroErrors(), seed=-1), "seed"),
    "half": (lambda: flown(BRIEF, GyroErrors(), seed=0.5), "seed"),  # type: ignore[arg-type]
    "trial": (lambda: flown(BRIEF, GyroErrors(), trial=2**56), "trial"),
    "no white noise": (
        lambda: Scenario(BRIEF, GyroErrors(), StarErrors(1e-5)).navigator(),
        "gyro.arw",
    ),
}


@pytest.mark.filterwarnings("ignore:.*is .* rad.*:celestcore.CelestcoreWarning")
@pytest.mark.parametrize("case", BAD)
def test_bad_values_are_refused(case: str) -> None:
    make, message = BAD[case]
    with pytest.raises(cc.InputError, match=message):
        make()


def test_largest_seed_and_trial() -> None:
    assert flown(BRIEF, FULL, 2**64 - 1, 2**56 - 1).log.gyro is not None
