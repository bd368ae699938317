"""Noise from innovations: the truth is found within its errors, whatever the start."""

from __future__ import annotations

import celestcore as cc
import numpy as np
import pytest
from celestcore.analysis import NoiseEstimate, consistency, estimate_noise, whiteness
from celestcore.analysis._simplex import curvature, maximise
from celestcore.errors import InputError
from scipy.spatial.transform import Rotation

ARW, RRW, SIGMA = 1e-5, 3e-7, 3e-5
TRUTH = np.array([ARW, RRW, 0.5])  # the navigators below say twice the noise of the fixes


def made_up(
    seed: int, n: int = 3000, *, rrw: float = RRW, outliers: int = 0, noise: object = None
) -> cc.SensorLog:
    """Return a log at 1 Hz with a fix every 2 s; the gyro's bias walks on within each step."""
    rng = np.random.default_rng(seed)
    t = np.arange(float(n))
    turn = np.array([1e-3, -5e-4, 2e-4])
    step, inner = np.sqrt([1.0, 1.0 / 12.0])[:, None, None] * rng.standard_normal((2, n, 3)) * rrw
    bias = np.cumsum(step, axis=0) - 0.5 * step + inner
    rate = turn + bias + ARW * rng.standard_normal((n, 3))
    error = SIGMA * rng.standard_normal((n, 3))
    bad = rng.choice(np.arange(50, n // 2), outliers, replace=False) * 2
    error[bad] += 40.0 * SIGMA * rng.standard_normal((outliers, 3))
    fixes = (Rotation.from_rotvec(t[:, None] * turn) * Rotation.from_rotvec(error))[::2]
    star = (t[::2], fixes) if noise is None else (t[::2], fixes, noise)
    return cc.SensorLog(gyro=(t, rate), star=star)


def navigator(arw: float = 1e-6, rrw: float = 1e-9, **options: object) -> cc.StarGyroNavigator:
    star = cc.StarCamera(2.0 * SIGMA)
    return cc.StarGyroNavigator(cc.EKF(), cc.Gyro(arw, rrw), star, **options)  # type: ignore[arg-type]


def found(estimate: NoiseEstimate) -> tuple[np.ndarray, np.ndarray]:
    values = np.array([estimate.arw, estimate.rrw, estimate.scale])
    return values, np.array([estimate.sigma[k] for k in ("arw", "rrw", "scale")])


def test_the_truth_is_found_within_its_errors() -> None:
    """24 seeds, from a start ten times off in one noise and three hundred in another."""
    z = []
    for seed in range(24):
        values, sigma = found(estimate_noise(navigator(), made_up(seed, 2400)))
        z.append(np.log(values / TRUTH) * values / sigma)
    assert np.all(np.abs(z) < 4.0)
    assert np.all(np.abs(np.mean(z, axis=0)) < 3.0 / np.sqrt(24))
    # the scatter of a sample of 24 is within 0.55 and 1.5 of the truth but for 1 in 1000
    assert np.all((np.std(z, axis=0) > 0.55) & (np.std(z, axis=0) < 1.5))


def test_the_start_does_not_matter() -> None:
    log = made_up(30)
    one = estimate_noise(navigator(), log)
    other = estimate_noise(navigator(arw=1e-3, rrw=0.0), log)
    for name in ("arw", "rrw", "scale"):
        close = getattr(one, name) - getattr(other, name)
        assert abs(close) < 0.03 * one.sigma[name]
        assert one.sigma[name] == pytest.approx(other.sigma[name], rel=0.05)
    assert one.log_likelihood == pytest.approx(other.log_likelihood, abs=1e-3)


def test_with_what_was_found_the_filter_is_consistent_and_white() -> None:
    log = made_up(31)
    estimate = estimate_noise(navigator(), log)
    sol = estimate.navigator.run(log)
    assert consistency(sol).mean == pytest.approx(1.0, abs=0.002)
    assert whiteness(sol).white
    assert not whiteness(navigator().run(log)).white
    assert estimate.gain > 1000.0


def test_noise_that_fixes_bring_is_scaled_in_the_log() -> None:
    covariance = np.diag([0.9, 1.0, 1.1]) * SIGMA**2 * 4.0
    for noise in (np.full((1500, 3), 2.0 * SIGMA), np.tile(covariance, (1500, 1, 1))):
        log = made_up(32, noise=noise)
        estimate = estimate_noise(navigator(), log)
        assert estimate.scale == pytest.approx(0.5, rel=0.1)
        sol = estimate.navigator.run(estimate.rescaled(log))
        assert consistency(sol).mean == pytest.approx(1.0, abs=0.002)
        before = log.stars["star"].noise
        assert before is not None
        np.testing.assert_array_equal(before, noise)


def test_without_a_walk_none_is_found() -> None:
    estimate = estimate_noise(navigator(), made_up(33, rrw=0.0))
    assert estimate.rrw == 0.0
    assert 0.0 < estimate.sigma["rrw"] < 1e-7
    assert estimate.parameters == ("arw", "scale")
    assert estimate.covariance.shape == (2, 2)
    assert abs(estimate.arw - ARW) < 4 * estimate.sigma["arw"]


@pytest.mark.parametrize(
    ("names", "camera"),
    [(["arw"], SIGMA), (["arw", "rrw"], SIGMA), (["scale"], 2 * SIGMA), (["rrw", "scale"], None)],
    ids=["arw", "gyro", "scale", "walk and scale"],
)
def test_what_is_not_asked_for_is_held(names: list[str], camera: float | None) -> None:
    begin = cc.Gyro(1e-6 if "arw" in names else ARW, 1e-9 if "rrw" in names else RRW)
    star = cc.StarCamera(2.0 * SIGMA if camera is None else camera)
    nav = cc.StarGyroNavigator(cc.EKF(), begin, star)
    estimate = estimate_noise(nav, made_up(34, rrw=RRW), names)
    values, sigma = found(estimate)
    held = [k not in names for k in ("arw", "rrw", "scale")]
    np.testing.assert_array_equal(values[held], np.array([begin.arw, begin.rrw, 1.0])[held])
    assert np.all(sigma[held] == 0.0)
    if names != ["arw"]:  # with the walk held at next to nothing, white noise stands in for it
        truth = np.array([ARW, RRW, SIGMA / float(star.sigma)])  # type: ignore[arg-type]
        free = ~np.array(held)
        assert np.all(np.abs(np.log(values / truth)[free]) < 4.0 * (sigma / values)[free])


def test_outliers_are_left_out_by_the_gate() -> None:
    log = made_up(35, outliers=40)
    gated = estimate_noise(navigator(3e-6, 1e-8, gate=0.9999), log)
    values, sigma = found(gated)
    assert 35 <= gated.rejected <= 45
    assert np.all(np.abs(np.log(values / TRUTH)) < 4.0 * sigma / values)
    assert gated.navigator.gate == 0.9999
    assert estimate_noise(navigator(3e-6, 1e-8), log).scale > 1.5


def test_every_filter_says_the_same() -> None:
    log = made_up(36, 1500)
    each = []
    for kind in (cc.EKF(), cc.UKF(), cc.SRUKF()):
        nav = navigator()
        nav = cc.StarGyroNavigator(kind, nav.gyro, nav.star)
        each.append(found(estimate_noise(nav, log))[0])
    np.testing.assert_allclose(each[1], each[0], rtol=1e-3)
    np.testing.assert_allclose(each[2], each[0], rtol=1e-3)


def test_directions_and_named_cameras_are_scaled_too() -> None:
    rng = np.random.default_rng(37)
    log = made_up(37)
    gyro, star = log.gyro, log.stars["star"]
    assert gyro is not None
    known = rng.standard_normal((1500, 3))
    known /= np.linalg.norm(known, axis=1)[:, None]
    truth = Rotation.from_rotvec(star.t[:, None] * np.array([1e-3, -5e-4, 2e-4]))
    seen = Rotation.from_rotvec(SIGMA * rng.standard_normal((1500, 3))).apply(
        truth.inv().apply(known)
    )
    both = cc.SensorLog(
        gyro=(gyro.t, gyro.rate), star=(star.t, star.q), vector_sun=(star.t, seen, known)
    )
    nav = cc.StarGyroNavigator(
        cc.EKF(),
        cc.Gyro(1e-6, 1e-9),
        {"star": cc.StarCamera(covariance=np.eye(3) * (2 * SIGMA) ** 2)},
        {"sun": cc.VectorSensor(2 * SIGMA)},
    )
    estimate = estimate_noise(nav, both)
    values, sigma = found(estimate)
    assert np.all(np.abs(np.log(values / TRUTH)) < 4.0 * sigma / values)
    sol = estimate.navigator.run(both)
    assert consistency(sol).mean == pytest.approx(1.0, abs=0.002)


def test_the_log_and_the_navigator_are_not_changed() -> None:
    log, nav = made_up(38, 500), navigator()
    before = repr(nav), log.stars["star"].q.copy()
    first, again = estimate_noise(nav, log), estimate_noise(nav, log)
    assert repr(nav) == before[0]
    np.testing.assert_array_equal(log.stars["star"].q, before[1])
    assert (first.arw, first.rrw, first.scale) == (again.arw, again.rrw, again.scale)
    assert "arw" in str(first)


def test_bad_questions_are_named() -> None:
    log = made_up(39, 300)
    for parameters in (["arw", "sigma"], [], "bias"):
        with pytest.raises(InputError, match="choose from"):
            estimate_noise(navigator(), log, parameters)
    with pytest.raises(InputError, match="at least 30"):
        estimate_noise(navigator(), made_up(39, 40))
    assert log.gyro is not None
    with pytest.raises(InputError, match="star camera"):
        estimate_noise(navigator(), cc.SensorLog(gyro=(log.gyro.t, log.gyro.rate)))
    with pytest.raises(InputError, match="log"):
        estimate_noise(navigator(), None)  # type: ignore[arg-type]


def test_the_maximiser_climbs_a_bent_valley() -> None:
    def rosenbrock(x: np.ndarray) -> float:
        return -float(100.0 * (x[1] - x[0] ** 2) ** 2 + (1.0 - x[0]) ** 2)

    x, height = maximise(rosenbrock, np.array([-1.2, 1.0]), 0.5, tolerance=1e-10)
    np.testing.assert_allclose(x, 1.0, atol=1e-3)
    assert height == pytest.approx(0.0, abs=1e-6)


def test_the_curvature_of_a_parabola_is_its_matrix() -> None:
    root = np.random.default_rng(40).standard_normal((3, 3)) * np.array([1.0, 20.0, 0.3])
    matrix = root.T @ root
    centre = np.array([1.0, -2.0, 0.5])

    def parabola(x: np.ndarray) -> float:
        return 7.0 - 0.5 * float((x - centre) @ matrix @ (x - centre))

    np.testing.assert_allclose(curvature(parabola, centre, 7.0), matrix, rtol=1e-8, atol=1e-8)
