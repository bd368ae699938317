"""The star camera as an instrument: what it sees, its noise, and the attitude that follows."""

from __future__ import annotations

from typing import Any

import celestcore as cc
import numpy as np
import pytest
from celestcore import CameraModel, StarCatalogue, wahba
from celestcore import quaternion as quat
from celestcore._core import chi2_quantile
from celestcore.errors import InputError
from numpy.typing import NDArray

Array = NDArray[np.float64]
SKY = StarCatalogue.random(15_000, seed=3)
SIGMA = 5.0 * cc.ARCSEC


def model(**changes: Any) -> CameraModel:
    values: dict[str, Any] = {"catalogue": SKY, "sigma": SIGMA, "half_angle": 10 * cc.DEG}
    return CameraModel(**{**values, **changes})


def attitudes(n: int, seed: int = 0) -> tuple[Array, Array]:
    q = np.random.default_rng(seed).normal(size=(n, 4))
    return np.arange(n, dtype=float), q / np.linalg.norm(q, axis=1, keepdims=True)


def test_random_sky_is_even_and_follows_the_counts() -> None:
    sky = StarCatalogue.random(40_000, seed=1)
    d = sky.directions
    assert np.abs(np.linalg.norm(d, axis=1) - 1.0).max() < 1e-15
    # means of components 0 +- sqrt(1/3n), of products 1/3 +- sqrt(4/45n), sqrt(1/15n)
    n = len(sky)
    assert np.abs(d.mean(axis=0)).max() < 4.0 * np.sqrt(1.0 / 3.0 / n)
    assert np.abs(d.T @ d / n - np.eye(3) / 3.0).max() < 4.0 * np.sqrt(4.0 / 45.0 / n)
    for limit, count in ((0, 4), (2, 49), (5, 1600), (6, 4968), (7, 15328)):
        assert abs(np.sum(sky.magnitude < limit) - count) <= 1
    assert np.all(np.diff(sky.magnitude) > 0.0)
    assert np.abs(np.corrcoef(sky.magnitude, d[:, 2])[0, 1]) < 4.0 / np.sqrt(n)
    faint = StarCatalogue.random(400_000, seed=1).magnitude
    assert np.all(np.diff(faint) > 0.0)
    assert 10.0 < faint[-1] < 10.8  # the real sky has 340 000 to magnitude 10
    again = StarCatalogue.random(40_000, seed=1)
    assert np.array_equal(again.directions, d)
    assert not np.array_equal(StarCatalogue.random(40_000, seed=2).directions, d)
    assert len(StarCatalogue.random(0)) == 0


@pytest.mark.parametrize("shape", ["circle", "square"])
@pytest.mark.parametrize("brightest", [5, None])
@pytest.mark.parametrize("limit", [4.5, 6.0])
def test_sees_what_brute_force_sees(shape: str, brightest: int | None, limit: float) -> None:
    half = 12 * cc.DEG
    shuffle = np.random.default_rng(2).permutation(len(SKY))
    sky = StarCatalogue(SKY.directions[shuffle], SKY.magnitude[shuffle])
    camera = model(
        catalogue=sky, half_angle=half, shape=shape, brightest=brightest, magnitude_limit=limit
    )
    t, q = attitudes(50)
    seen = camera.observe(t, q)
    for k in range(len(t)):
        x, y, z = quat.rotate(quat.conjugate(q[k]), sky.directions).T
        if shape == "circle":
            inside = np.arccos(np.clip(z, -1.0, 1.0)) <= half
        else:
            inside = (z > 0) & (np.abs(x / z) <= np.tan(half)) & (np.abs(y / z) <= np.tan(half))
        rows = np.flatnonzero(inside & (sky.magnitude <= limit))
        rows = rows[np.argsort(sky.magnitude[rows])][:brightest]
        assert np.array_equal(seen.rows[k][: seen.stars[k]], rows)
        assert np.all(seen.rows[k][seen.stars[k] :] == -1)
        assert np.isnan(seen.vectors[k][seen.stars[k] :]).all()
    assert seen.stars.sum() > 0


def test_number_of_stars_follows_from_the_solid_angle() -> None:
    t, q = attitudes(2000, seed=1)
    for shape, area in (
        ("circle", 2 * np.pi * (1 - np.cos(0.15))),
        ("square", 4 * np.arcsin(np.sin(np.arctan(np.tan(0.15))) ** 2)),
    ):
        camera = model(half_angle=0.15, shape=shape, magnitude_limit=6.5, brightest=None)
        stars = camera.observe(t, q).stars
        want = np.sum(SKY.magnitude <= 6.5) * area / (4 * np.pi)
        assert stars.mean() == pytest.approx(want, rel=0.03)


def test_centroid_noise() -> None:
    t, q = attitudes(4000, seed=5)
    seen = model(sigma=1e-4).observe(t, q, seed=1)
    used = seen.rows >= 0
    exact = quat.rotate(
        quat.conjugate(np.repeat(q, seen.stars, axis=0)), SKY.directions[seen.rows[used]]
    )
    got = seen.vectors[used]
    assert np.abs(np.linalg.norm(got, axis=1) - 1.0).max() < 1e-15
    across = np.cross([0.0, 1.0, 0.0], exact)
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    error = got - exact
    for axis in (across, np.cross(exact, across)):
        noise = np.sum(error * axis, axis=1) / 1e-4
        n = len(noise)
        assert n > 10_000
        assert abs(noise.mean()) < 4.0 / np.sqrt(n)
        assert abs(noise.std() - 1.0) < 4.0 / np.sqrt(2 * n)
    assert np.abs(np.sum(error * exact, axis=1)).max() < 1e-6


@pytest.mark.parametrize("method", wahba.METHODS)
def test_fixes_are_consistent(method: str) -> None:
    t, q = attitudes(3000, seed=6)
    seen = model().observe(t, q, seed=2, method=method)
    keep = seen.stars[seen.frame] >= 4  # with two or three close together the noise is not small
    assert keep.sum() > 2000
    error = quat.log(quat.multiply(quat.conjugate(seen.q), q[seen.frame]))[keep]
    nees = np.einsum("ni,nij,nj->n", error, np.linalg.inv(seen.covariance[keep]), error)
    n = 3 * len(nees)
    assert chi2_quantile(1e-4, n) < nees.sum() < chi2_quantile(1 - 1e-4, n)
    dof = float(np.sum(2 * seen.stars[seen.frame] - 3))
    assert chi2_quantile(1e-4, dof) < 2.0 * seen.loss.sum() < chi2_quantile(1 - 1e-4, dof)


def test_random_numbers_belong_to_seed_trial_and_camera() -> None:
    t, q = attitudes(20)
    camera = model()
    base = camera.observe(t, q, seed=1, trial=2)
    again = camera.observe(t, q, seed=1, trial=2)
    assert np.array_equal(base.vectors, again.vectors, equal_nan=True)
    assert np.array_equal(base.q, again.q)
    for other in ({"seed": 2, "trial": 2}, {"seed": 1}, {"seed": 1, "trial": 2, "camera": 1}):
        assert not np.array_equal(camera.observe(t, q, **other).q, base.q)  # type: ignore[arg-type]
    part = camera.observe(t[:7], q[:7], seed=1, trial=2)
    assert np.array_equal(part.q, base.q[: len(part)])


def test_mounting_and_boresight() -> None:
    t, q = attitudes(200, seed=8)
    mounting = quat.exp([0.4, -2.0, 0.7])
    seen = model(mounting=mounting, sigma=1e-9).observe(t, q)
    truth = quat.multiply(q[seen.frame], mounting)
    assert quat.angle_between(seen.q, truth).max() < 1e-6
    assert np.median(quat.angle_between(seen.q, truth)) < 3e-8
    for direction in ([0.0, 0.0, -2.0], [1.0, 2.0, -0.5]):
        camera = model(boresight=direction)
        assert camera.mounting is not None
        b = quat.rotate(camera.mounting, [0.0, 0.0, 1.0])
        assert np.abs(b - np.array(direction) / np.linalg.norm(direction)).max() < 1e-15
        assert camera.sensor().mounting == camera.mounting
    # the turn about the boresight is the least certain one, by about the field's angle
    sigma = model(boresight=[1.0, 0.0, 0.0]).observe(t, q).sigma
    assert np.median(sigma[:, 2] / sigma[:, 0]) > 5.0


def test_frames_without_enough_stars_are_skipped_and_counted() -> None:
    t, q = attitudes(500, seed=9)
    seen = model(half_angle=4 * cc.DEG, magnitude_limit=5.5).observe(t, q)
    assert 0 < seen.skipped < 500
    assert seen.skipped == np.sum(seen.stars < 2)
    assert np.array_equal(seen.frame, np.flatnonzero(seen.stars >= 2))
    assert np.array_equal(seen.t, t[seen.frame])
    assert len(seen) == len(seen.q) == len(seen.covariance) == len(seen.loss)
    blind = model(magnitude_limit=-5.0).observe(t, q)
    assert (len(blind), blind.skipped, blind.vectors.shape) == (0, 500, (500, 0, 3))
    one = model(brightest=1).observe(t, q)
    assert len(one) == 0
    empty = model(catalogue=StarCatalogue.random(0)).observe(t, q)
    assert empty.skipped == 500
    assert "500 without a fix" in repr(empty)


def test_times_between_the_truth() -> None:
    t = np.linspace(0.0, 100.0, 11)
    q = quat.exp(np.outer(t, [0.0, 0.001, 0.002]))
    at = np.array([0.0, 3.3, 10.0, 55.5, 100.0])
    seen = model(sigma=1e-9, brightest=None).observe(t, -q, times=at)
    assert np.array_equal(seen.times, at)
    truth = quat.exp(np.outer(seen.t, [0.0, 0.001, 0.002]))
    assert quat.angle_between(seen.q, truth).max() < 1e-6
    assert np.einsum("ij,ij->i", seen.q[1:], seen.q[:-1]).min() > 0.0


def test_two_cameras_together() -> None:
    """Solved in the body frame, each camera holds the other's turn about the boresight."""
    t, q = attitudes(300, seed=10)
    pair = [model(boresight=b) for b in ([1.0, 0.0, 0.0], [0.0, 1.0, 0.0])]
    seen = [c.observe(t, q, camera=k) for k, c in enumerate(pair)]
    body, inertial = [], []
    for c, s in zip(pair, seen, strict=True):
        assert c.mounting is not None
        body.append(quat.rotate(c.mounting, s.vectors))
        inertial.append(np.where(s.rows[..., None] >= 0, SKY.directions[s.rows], np.nan))
    fix = wahba.solve(
        np.concatenate(body, axis=1),
        np.concatenate(inertial, axis=1),
        sigma=SIGMA,
        degenerate="nan",
    )
    good = np.isfinite(fix.loss) & (seen[0].stars >= 3) & (seen[1].stars >= 3)
    assert fix.covariance is not None
    error = quat.log(quat.multiply(quat.conjugate(fix.q[good]), q[good]))
    nees = np.einsum("ni,nij,nj->n", error, np.linalg.inv(fix.covariance[good]), error)
    n = 3 * len(nees)
    assert chi2_quantile(1e-4, n) < nees.sum() < chi2_quantile(1 - 1e-4, n)
    assert np.median(fix.sigma[good]) < np.median(seen[0].sigma[:, 2]) / 3.0


def test_a_navigator_takes_the_fixes() -> None:
    n, dt = 3000, 0.2
    rng = np.random.default_rng(11)
    t = dt * np.arange(n)
    rate = np.tile([0.0, -1.1e-3, 0.0], (n, 1))
    q = quat.propagate(quat.exp([0.3, 1.0, -2.0]), rate[:-1], dt)
    arw = 1e-6
    gyro = rate + 2e-6 + arw / np.sqrt(dt) * rng.normal(size=(n, 3))
    cameras = {f"star_{k}": model(boresight=b) for k, b in enumerate([(1, 0, 0), (0, 1, -1)])}
    fixes = {
        name: c.observe(t, q, times=t[::5], seed=4, camera=k)
        for k, (name, c) in enumerate(cameras.items())
    }
    log = cc.SensorLog(
        gyro=(t, gyro), **{name: (s.t, s.q, s.covariance) for name, s in fixes.items()}
    )
    nav = cc.StarGyroNavigator(
        gyro=cc.Gyro(arw=arw), star={name: c.sensor() for name, c in cameras.items()}
    )
    sol = nav.run(log)
    late = sol.t > 100.0
    truth = q[np.searchsorted(t, sol.t[late])]
    error = quat.log(quat.multiply(quat.conjugate(sol.q[late]), truth))
    ratio = error / sol.sigma[late][:, :3]
    assert 0.6 < np.sqrt(np.mean(ratio**2)) < 1.5
    assert np.sqrt(np.mean(error**2)) < 2.0 * cc.ARCSEC
    assert sol.accepted.mean() > 0.97


T2 = np.array([0.0, 1.0])
Q2 = np.array([[1.0, 0.0, 0.0, 0.0]] * 2)


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"catalogue": [[1.0, 0.0, 0.0]]}, "catalogue.*must be a StarCatalogue"),
        ({"sigma": 0.0}, "sigma, value 0.0"),
        ({"sigma": np.nan}, "sigma"),
        ({"half_angle": 10.0}, "half_angle, value 10.0: must be below pi/2"),
        ({"half_angle": -1.0}, "half_angle"),
        ({"shape": "hexagon"}, "shape, value 'hexagon'"),
        ({"magnitude_limit": np.inf}, "magnitude_limit"),
        ({"brightest": 0}, "brightest"),
        ({"brightest": 2.5}, "brightest, value 2.5: must be a whole number"),
        ({"mounting": [1.0, 0.0, 0.0, 0.0], "boresight": [0.0, 0.0, 1.0]}, "not both"),
        ({"mounting": [2.0, 0.0, 0.0, 0.0]}, "mounting"),
        ({"boresight": [0.0, 0.0, 0.0]}, "no direction"),
    ],
)
def test_wrong_models(changes: dict[str, Any], says: str) -> None:
    with pytest.raises(InputError, match=says):
        model(**changes)


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ({"t": [1.0, 0.0]}, "t, row 1, value 0.0"),
        ({"q": Q2[:1]}, r"q: has shape \(1, 4\)"),
        ({"q": 2.0 * Q2}, "q, row 0"),
        ({"q": np.nan * Q2}, "q, row 0: the true attitude must be finite"),
        ({"times": [0.5, 1.5]}, r"times, row 1, value 1.5: lies outside the truth, 0.0 to 1.0 s"),
        ({"times": [0.5, 0.5]}, "times, row 1"),
        ({"seed": -1}, "seed, value -1"),
        ({"seed": 2**64}, r"seed, value \d+: must be below 2\*\*64"),
        ({"seed": 0.5}, "seed, value 0.5: must be a whole number"),
        ({"trial": 2**56}, r"trial, value \d+: must be below 2\*\*56"),
        ({"camera": 64}, "camera, value 64: must be below 64"),
        ({"method": "foam"}, "method, value 'foam'"),
    ],
)
def test_wrong_observations(arguments: dict[str, Any], says: str) -> None:
    with pytest.raises(InputError, match=says):
        model().observe(**{"t": T2, "q": Q2, **arguments})


@pytest.mark.parametrize(
    ("directions", "magnitude", "says"),
    [
        ([[1.0, 0.0, 0.0], [0.0, 0.0, 0.0]], [1.0, 2.0], "directions, row 1"),
        ([[1.0, 0.0, 0.0]], [1.0, 2.0], "magnitude"),
        ([[1.0, 0.0, 0.0]], [np.nan], "magnitude, row 0"),
        ([1.0, 0.0, 0.0], [1.0], "directions: has shape"),
    ],
)
def test_wrong_catalogues(directions: Any, magnitude: Any, says: str) -> None:
    with pytest.raises(InputError, match=says):
        StarCatalogue(directions, magnitude)


def test_catalogue_is_a_value() -> None:
    given = np.array([[0.0, 0.0, 3.0]])
    sky = StarCatalogue(given, [1])
    given[:] = 1.0
    assert np.array_equal(sky.directions, [[0.0, 0.0, 1.0]])
    with pytest.raises(ValueError, match="read-only"):
        sky.directions[0, 0] = 1.0
    sky = StarCatalogue.from_radec([np.pi / 2], [np.pi / 4], [3.0])
    assert np.abs(sky.directions - [0.0, np.sqrt(0.5), np.sqrt(0.5)]).max() < 1e-15
    assert repr(sky) == "StarCatalogue(1 stars of magnitude 3.0 to 3.0)"


@pytest.mark.parametrize("shape", ["circle", "square"])
def test_frames_that_follow_each_other_are_like_frames_alone(shape: str) -> None:
    """Stars near the frame before are searched first; none may be lost."""
    t = np.arange(300.0)
    q = quat.exp(t[:, None] * [0.011, -0.004, 0.002])
    camera = model(shape=shape, brightest=None)
    along = camera.observe(t, q)
    for k in range(0, 300, 7):
        alone = camera.observe(t[k : k + 1], q[k : k + 1])
        assert along.rows[k, : along.stars[k]].tolist() == alone.rows[0].tolist()
