"""`analysis.steady_state` against scipy, a closed form, batch least squares and the filter."""

from __future__ import annotations

import celestcore as cc
import numpy as np
import pytest
from celestcore.analysis import SteadyState, steady_state
from celestcore.errors import InputError
from scipy.linalg import solve_discrete_are
from simulate import FloatArray, discretise, exp

ARCSEC = cc.ARCSEC
ORBIT = 1.1102134571e-3
U = np.array([[0.8, 0.5, -0.1], [-0.8, 0.5, -0.1]]) / np.sqrt(0.9)
TWO_CAMERAS = np.linalg.inv(2.0 * np.eye(3) - U.T @ U)
NOISE = np.array([[4.0, 1.0, -0.5], [1.0, 9.0, 2.0], [-0.5, 2.0, 25.0]]) * 1e-10
H = np.hstack([np.eye(3), np.zeros((3, 3))])

# star and gyro [3 sigma, arcsec and arcsec/s], filter, smoother [3 sigma, arcsec] in the paper's
# axes pitch, roll, yaw
PUBLISHED = [
    (5.0, 0.2, (0.436, 0.345, 0.319), (0.305, 0.243, 0.224)),
    (5.0, 2.4, (1.475, 1.165, 1.074), (1.056, 0.841, 0.777)),
    (2.0, 1.2, (0.658, 0.519, 0.477), (0.472, 0.376, 0.347)),
    (1.0, 0.2, (0.192, 0.152, 0.141), (0.136, 0.109, 0.100)),
    (1.0, 2.4, (0.627, 0.481, 0.437), (0.471, 0.372, 0.343)),
]


@pytest.mark.parametrize(("star", "gyro", "filtered", "smoothed"), PUBLISHED)
def test_the_bounds_of_the_star_gyro_experiment(
    star: float, gyro: float, filtered: tuple[float, ...], smoothed: tuple[float, ...]
) -> None:
    sensor = cc.Gyro(arw=gyro / 3 * ARCSEC * np.sqrt(0.1), rrw=1e-5 * ARCSEC)
    noise = TWO_CAMERAS * (star / 3 * ARCSEC) ** 2
    bound = steady_state(sensor, noise, 0.1, 0.2, rate=(ORBIT, 0.0, 0.0))
    # half a unit of the last printed digit
    np.testing.assert_allclose(3 * bound.sigma_filter[:3] / ARCSEC, filtered, atol=5.1e-4)
    np.testing.assert_allclose(3 * bound.sigma_smoother[:3] / ARCSEC, smoothed, atol=5.1e-4)


def turned(covariance: FloatArray) -> FloatArray:
    """Return a covariance of the paper's axes in the body's: x_p = -y_b, y_p = x_b."""
    axes = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    return axes @ covariance @ axes.T


def test_another_frame_gives_the_same_in_that_frame() -> None:
    gyro = cc.Gyro(arw=1e-6, rrw=1e-8)
    there = steady_state(gyro, NOISE, 0.1, 0.7, rate=(0.3, 0.1, -0.2))
    here = steady_state(gyro, turned(NOISE), 0.1, 0.7, rate=(0.1, -0.3, -0.2))
    for name in ("filter", "before", "between", "smoother", "smoother_between"):
        moved = turned(getattr(there, name)[:3, :3])
        np.testing.assert_allclose(getattr(here, name)[:3, :3], moved, atol=1e-12 * moved.max())


def reference(
    arw: float, rrw: float, noise: FloatArray, period: float, rate: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the covariances before and after a fix, by scipy."""
    f, q = discretise(rate, period, arw, rrw)
    size = float(np.sqrt(np.trace(noise) / 3))
    units = np.repeat([size, size / period], 3)
    r = noise / size**2
    p = solve_discrete_are(
        (f / units[:, None] * units).T, H.T, q / np.outer(units, units), r, balanced=True
    )
    gain = np.linalg.solve(p[:3, :3] + r, p[:3]).T
    after = p - gain @ p[:3]
    return p * np.outer(units, units), after * np.outer(units, units)


@pytest.mark.parametrize("rate", [(0.0, 0.0, 0.0), (1e-3, 0.0, 0.0), (0.5, -0.8, 0.7)])
@pytest.mark.parametrize(("arw", "rrw", "period"), [(1e-5, 1e-6, 1.0), (1e-6, 1e-6, 4.0)])
def test_agrees_with_scipy(
    arw: float, rrw: float, period: float, rate: tuple[float, float, float]
) -> None:
    bound = steady_state(cc.Gyro(arw=arw, rrw=rrw), NOISE, 0.25, period, rate)
    before, after = reference(arw, rrw, NOISE, period, np.array(rate))
    for found, known in ((bound.before, before), (bound.filter, after)):
        sigma = np.sqrt(np.diag(known))
        np.testing.assert_allclose(
            found / np.outer(sigma, sigma), known / np.outer(sigma, sigma), atol=1e-8
        )
    s = before[:3, :3] + NOISE
    units = np.repeat([1.0, np.sqrt(before[3, 3] / before[0, 0])], 3)[:, None]
    gain = before[:, :3] @ np.linalg.inv(s)
    np.testing.assert_allclose(bound.gain / units, gain / units, atol=1e-8)


@pytest.mark.parametrize("rrw", [1e-9, 1e-7, 1e-4])
@pytest.mark.parametrize("arw", [1e-9, 1e-6, 1e-3])
@pytest.mark.parametrize("sigma", [1e-7, 1e-5, 1e-3])
def test_one_axis_at_rest_is_farrenkopfs(arw: float, rrw: float, sigma: float) -> None:
    """Over noises that differ by many orders, the bias and its correlation included."""
    period = 2.0
    bound = steady_state(cc.Gyro(arw=arw, rrw=rrw), sigma, 0.1, period)
    u, v = rrw * period**1.5 / sigma, arw * np.sqrt(period) / sigma
    gamma = np.sqrt(1.0 + v**2 / 4 + u**2 / 48)
    zeta = gamma + u / 4 + 0.5 * np.sqrt(2 * gamma * u + v**2 + u**2 / 3)
    for found, known in (
        (bound.before[0, 0], sigma**2 * (zeta**2 - 1)),
        (bound.filter[1, 1], sigma**2 * (1 - zeta**-2)),
        (bound.before[2, 5], -rrw * np.sqrt(period) * sigma * zeta),
        (bound.filter[3, 3], (sigma / period) ** 2 * (u * (zeta - 1 / zeta) - u**2 / 2)),
    ):
        # the closed form itself cancels where zeta is near one
        assert found == pytest.approx(known, rel=1e-8 + 4e-15 / (zeta - 1) ** 2)


def batch(
    gyro: cc.Gyro, noise: FloatArray, dt: float, every: int, rate: FloatArray, fixes: int
) -> FloatArray:
    """Return the covariances (every, 6, 6) from a fix to the next in the middle of a long log.

    Batch least squares over all states at once: a banded information matrix, inverted.
    """
    f, q = discretise(rate, dt, gyro.arw, gyro.rrw)
    units = np.repeat([np.sqrt(np.trace(noise) / 3), np.sqrt(gyro.rrw * gyro.arw)], 3)
    f, q = f / units[:, None] * units, q / np.outer(units, units)
    steps = fixes * every
    inverse, star = np.linalg.inv(q), np.zeros((6, 6))
    star[:3, :3] = np.linalg.inv(noise / np.outer(units[:3], units[:3]))
    total = np.zeros((6 * (steps + 1), 6 * (steps + 1)))
    for k in range(steps + 1):
        at = slice(6 * k, 6 * k + 6)
        if k % every == 0:
            total[at, at] += star
        if k < steps:
            ahead = slice(6 * k + 6, 6 * k + 12)
            total[at, at] += f.T @ inverse @ f
            total[at, ahead] -= f.T @ inverse
            total[ahead, at] -= inverse @ f
            total[ahead, ahead] += inverse
    p = np.linalg.inv(total)
    middle = fixes // 2 * every
    rows = [slice(6 * k, 6 * k + 6) for k in range(middle, middle + every)]
    return np.array([p[r, r] for r in rows]) * np.outer(units, units)


def test_the_smoother_is_batch_least_squares() -> None:
    gyro, rate = cc.Gyro(arw=1e-5, rrw=1e-5), np.array([0.5, -0.8, 0.7])
    known = batch(gyro, NOISE, 0.5, 2, rate, 160)
    bound = steady_state(gyro, NOISE, 0.5, 1.0, rate)
    sigma = np.outer(bound.sigma_smoother, bound.sigma_smoother)
    np.testing.assert_allclose(bound.smoother / sigma, known[0] / sigma, atol=1e-8)
    np.testing.assert_allclose(
        bound.smoother_between / sigma, known.mean(axis=0) / sigma, atol=1e-8
    )
    assert np.all(bound.sigma_smoother < bound.sigma_filter)


def run(dt: float, every: int, rate: FloatArray, bound: SteadyState) -> cc.Solution:
    t = dt * np.arange(400 * every + 1)
    log = cc.SensorLog(
        gyro=(t, np.tile(rate, (len(t), 1))),
        star=(t[::every], exp(t[::every, None] * rate), np.tile(NOISE, (401, 1, 1))),
    )
    nav = cc.StarGyroNavigator(cc.EKF(), cc.Gyro(arw=1e-5, rrw=1e-5))
    start = {"q0": [1.0, 0.0, 0.0, 0.0], "covariance0": bound.before}
    return nav.run(log, **start, covariance=True)


def test_the_filter_settles_there_between_fixes_too() -> None:
    rate = np.array([0.5, -0.8, 0.7])
    bound = steady_state(cc.Gyro(arw=1e-5, rrw=1e-5), NOISE, 0.25, 1.0, rate)
    sol = run(0.25, 4, rate, bound)
    assert sol.covariance is not None
    sigma = np.outer(bound.sigma_filter, bound.sigma_filter)
    at = sol.covariance[-1 - 4 * 50 : -1]
    np.testing.assert_allclose(sol.covariance[-1] / sigma, bound.filter / sigma, atol=1e-6)
    np.testing.assert_allclose(at.mean(axis=0) / sigma, bound.between / sigma, atol=1e-6)


def test_errors_of_the_linear_system_have_these_covariances() -> None:
    """4000 seeded runs of 60 fixes with the fixed gain, started at the steady state itself."""
    rng = np.random.default_rng(11)
    gyro, rate = cc.Gyro(arw=1e-5, rrw=1e-5), np.array([0.2, -0.1, 0.3])
    bound = steady_state(gyro, NOISE, 1.0, 1.0, rate)
    f, q = discretise(rate, 1.0, gyro.arw, gyro.rrw)
    scale = bound.sigma_filter
    root = np.linalg.cholesky(q / np.outer(scale, scale)) * scale[:, None]
    noise = np.linalg.cholesky(NOISE)
    error = np.zeros((4000, 6))
    for _ in range(60):
        error = error @ f.T + rng.standard_normal((4000, 6)) @ root.T
        before = error
        fix = error[:, :3] + rng.standard_normal((4000, 3)) @ noise.T
        error = error - fix @ bound.gain.T
    for found, known in ((error, bound.filter), (before, bound.before)):
        sigma = np.sqrt(np.diag(known))
        sample = (found / sigma).T @ (found / sigma) / 4000
        # the standard error of an entry is at most sqrt(2 / 4000) = 0.022; 36 entries
        np.testing.assert_allclose(sample, known / np.outer(sigma, sigma), atol=4 * 0.0224)


def test_without_rate_random_walk_the_bias_is_known_in_the_end() -> None:
    slow = steady_state(cc.Gyro(arw=1e-6, rrw=1e-14), NOISE, 0.1, 0.2, (1e-3, 0.0, 0.0))
    none = steady_state(cc.Gyro(arw=1e-6), NOISE, 0.1, 0.2, (1e-3, 0.0, 0.0))
    assert np.all(none.sigma_filter[3:] == 0.0)
    assert np.all(none.gain[3:] == 0.0)
    for name in ("sigma_filter", "sigma_before", "sigma_between", "sigma_smoother"):
        np.testing.assert_allclose(getattr(none, name)[:3], getattr(slow, name)[:3], rtol=1e-5)
    assert none.time_constant < slow.time_constant


def test_the_time_constant_is_that_of_the_slowest_error() -> None:
    gyro = cc.Gyro(arw=1e-4, rrw=1e-6)  # overdamped
    bound = steady_state(gyro, 1e-5, 0.25, 1.0)
    f, _ = discretise(np.zeros(3), 1.0, gyro.arw, gyro.rrw)
    left = f - bound.gain @ H @ f
    error = np.linalg.matrix_power(left, 1000) @ np.ones(6)
    later = np.linalg.matrix_power(left, 50) @ error
    ratio = np.linalg.norm(later[3:]) / np.linalg.norm(error[3:])
    assert ratio == pytest.approx(np.exp(-50 / bound.time_constant), rel=1e-6)


def test_cameras_are_fused_and_mountings_used() -> None:
    gyro = cc.Gyro(arw=1e-6, rrw=1e-9)
    one = steady_state(gyro, 5 * ARCSEC, 0.1, 0.2)
    two = {"star_1": cc.StarCamera(7 * ARCSEC), "star_2": cc.StarCamera(7 * ARCSEC)}
    both = steady_state(gyro, two, 0.1, 0.2)
    half = steady_state(gyro, 7 * ARCSEC / np.sqrt(2), 0.1, 0.2)
    np.testing.assert_allclose(both.filter, half.filter, rtol=1e-9, atol=1e-30)
    assert both.filter[0, 0] < one.filter[0, 0]
    quarter = cc.quaternion.exp([0.0, np.pi / 2, 0.0])  # camera z is body x
    camera = cc.StarCamera(np.array([2.0, 3.0, 20.0]) * ARCSEC, mounting=quarter)
    mounted = steady_state(gyro, camera, 0.1, 0.2).sigma_filter[:3]
    plain = steady_state(gyro, np.array([20.0, 3.0, 2.0]) * ARCSEC, 0.1, 0.2).sigma_filter[:3]
    np.testing.assert_allclose(mounted, plain, rtol=1e-9)


@pytest.mark.parametrize("gyro_dt", [0.1, 0.25, 0.3, 1.0, 5.0])
def test_any_pair_of_steps(gyro_dt: float) -> None:
    bound = steady_state(cc.Gyro(arw=1e-5, rrw=1e-6), NOISE, gyro_dt, 1.0)
    assert np.all(bound.sigma_filter <= bound.sigma_between * (1 + 1e-12))
    assert np.all(bound.sigma_between < bound.sigma_before)
    assert np.all(bound.sigma_smoother < bound.sigma_filter)
    if gyro_dt >= 1.0:
        np.testing.assert_allclose(bound.between, bound.filter)


def test_bad_input_is_named() -> None:
    gyro = cc.Gyro(arw=1e-6, rrw=1e-9)
    for arguments, field in (
        ((1e-6, 1e-5, 0.1, 0.2), "gyro"),
        ((gyro, 1e-5, 0.0, 0.2), "gyro_dt"),
        ((gyro, 1e-5, 0.1, np.nan), "star_dt"),
        ((gyro, -1e-5, 0.1, 0.2), "star"),
        ((gyro, np.diag([1.0, 1.0, -1.0]), 0.1, 0.2), "star"),
        ((gyro, {}, 0.1, 0.2), "star"),
        ((gyro, cc.StarCamera(), 0.1, 0.2), "star"),
        ((gyro, np.ones((2, 2)), 0.1, 0.2), "star"),
        ((gyro, 1e-5, 0.1, 0.2, (1.0, 2.0)), "rate"),
    ):
        with pytest.raises(InputError, match=field):
            steady_state(*arguments)  # type: ignore[arg-type]


def test_the_repr_says_the_sigmas() -> None:
    text = repr(steady_state(cc.Gyro(arw=1e-6, rrw=1e-9), 5 * ARCSEC, 0.1, 0.2))
    assert "filter 0.68/0.68/0.68" in text
