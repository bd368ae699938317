"""Physical star cameras in a scenario: against the camera itself, single runs and campaigns."""

from __future__ import annotations

import pickle
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import celestcore as cc
import numpy as np
import pytest
from celestcore import simulate
from celestcore.simulate import GyroErrors, Scenario, StarErrors, StarField
from scipy.spatial.transform import Rotation

SKY = cc.StarCatalogue.random(15_000, seed=3)
SIGMA = 15 * cc.ARCSEC
TRUTH = simulate.slews(60.0, 0.1)
GYRO = GyroErrors(2e-5, 1e-7, bias_sigma=1e-4)


def camera(**changes: Any) -> cc.CameraModel:
    values: dict[str, Any] = {"catalogue": SKY, "sigma": SIGMA, "half_angle": 8 * cc.DEG}
    return cc.CameraModel(**{**values, **changes})


# few stars: some frames have none or one
POOR = camera(half_angle=8 * cc.DEG, magnitude_limit=4.2, boresight=(0.0, 1.0, -0.3))
ONE = Scenario(TRUTH, GYRO, StarField(camera(), every=2))
SEVERAL = Scenario(
    TRUTH,
    GyroErrors(2e-5, 1e-7, bias_sigma=1e-4, mounting=Rotation.random(random_state=1)),
    {
        "star": StarErrors((2e-5, 2e-5, 1e-4), every=2, mounting=Rotation.random(random_state=2)),
        "star_poor": StarField(POOR, every=5, offset=3),
        "star_late": StarField(camera(mounting=Rotation.random(random_state=4)), period=0.75),
    },
)
NUMBERS = ["rms", "rms_all", "rms_before", "rms_bias", "nees_attitude", "nees", "nis", "accepted"]
NUMBERS += ["final_error"]


@pytest.mark.parametrize("scenario", [ONE, SEVERAL], ids=["one", "several"])
def test_a_log_holds_what_the_cameras_observe(scenario: Scenario) -> None:
    made = scenario.simulate(7, 5)
    for place, (name, flown) in enumerate(scenario.cameras.items()):
        star = made.log.stars[name]
        if not isinstance(flown, StarField):
            assert star.covariance is None
            continue
        if flown.period is None:
            rows = slice(int(flown.offset), None, flown.every)
            t, q = TRUTH.t[rows], TRUTH.q[rows]
        else:  # also between samples
            t, q = TRUTH._snapped(np.arange(len(star) + star.missing) * flown.period)
        seen = flown.camera.observe(t, q, seed=7, trial=5, camera=place)
        assert star.missing == seen.skipped
        np.testing.assert_array_equal(star.t, seen.t)
        np.testing.assert_array_equal(np.abs(star.q), np.abs(seen.q))
        np.testing.assert_array_equal(star.covariance, seen.covariance)
    if scenario is SEVERAL:
        assert 0 < made.log.stars["star_poor"].missing < 100


def test_a_camera_alone_looks_at_every_sample() -> None:
    alone, wrapped = (Scenario(TRUTH, GYRO, c).simulate(1) for c in (camera(), StarField(camera())))
    assert len(alone.log.stars["star"]) == len(TRUTH)
    np.testing.assert_array_equal(alone.log.stars["star"].q, wrapped.log.stars["star"].q)
    short = simulate.log(TRUTH, GYRO, {"star_1": camera()}, seed=1)
    np.testing.assert_array_equal(short.log.stars["star_1"].q, alone.log.stars["star"].q)


def test_trials_and_cameras_have_noise_of_their_own() -> None:
    scenario = Scenario(TRUTH, GYRO, {"star": camera(), "star_2": camera()})
    first, second = (scenario.simulate(1, k).log.stars for k in (0, 1))
    assert (first["star"].q != second["star"].q).any()
    assert (first["star"].q != first["star_2"].q).any()
    # a camera that is added last changes nothing of the others
    alone = Scenario(TRUTH, GYRO, camera()).simulate(1, 0).log
    np.testing.assert_array_equal(alone.stars["star"].q, first["star"].q)


@pytest.mark.parametrize("gate", [None, 0.9])
@pytest.mark.parametrize("kind", [cc.EKF(), cc.UKF()], ids=lambda f: f.kind)
@pytest.mark.parametrize("scenario", [ONE, SEVERAL], ids=["one", "several"])
def test_a_trial_is_a_run_of_its_log(scenario: Scenario, kind: Any, gate: float | None) -> None:
    tuned = scenario.navigator(kind)
    nav = cc.StarGyroNavigator(kind, tuned.gyro, tuned.star, gate=gate)
    found = cc.monte_carlo(scenario, nav, 2, 9, first=4, skip=20.0)[kind.kind]
    for row, trial in enumerate([4, 5]):
        made = scenario.simulate(9, trial)
        sol = nav.run(made.log, covariance=True)
        assert sol.covariance is not None
        error = made.error(sol)
        times = np.concatenate([star.t for star in made.log.stars.values()])
        # a fix between samples counts at the next one
        grid = TRUTH.t[np.minimum(np.searchsorted(TRUTH.t, times), len(TRUTH) - 1)]
        late = sol.t >= 20.0
        at = late & np.isin(sol.t, grid[times <= TRUTH.t[-1]])
        used = sol.measurement_t >= 20.0
        e, p = error[at], sol.covariance[at]
        expected = {
            "rms": np.sqrt(np.mean(e[:, :3] ** 2, axis=0)),
            "rms_all": np.sqrt(np.mean(error[late & np.isin(sol.t, TRUTH.t), :3] ** 2, axis=0)),
            "nees": np.mean(np.einsum("ki,ki->k", e, np.linalg.solve(p, e[..., None])[..., 0])),
            "nis": np.mean(sol.nis[used & sol.accepted]),
            "accepted": np.mean(sol.accepted[used]),
            "final_error": error[-1],
        }
        for name, value in expected.items():
            np.testing.assert_allclose(getattr(found, name)[row], value, rtol=1e-8, err_msg=name)


def test_the_same_bits_whoever_computes() -> None:
    navs = {"ekf": SEVERAL.navigator(cc.EKF()), "ukf": SEVERAL.navigator(cc.UKF())}
    options: dict[str, Any] = {"trials": 7, "seed": 3, "skip": 10.0, "smooth": ["ekf"]}
    one = cc.monte_carlo(SEVERAL, navs, **options, threads=1)
    others = [cc.monte_carlo(SEVERAL, navs, **options, threads=n) for n in (2, 5)]
    with ThreadPoolExecutor(2) as pool:
        others.append(cc.monte_carlo(SEVERAL, navs, **options, executor=pool, chunk=2))

    class Pickling:
        def submit(self, fn: Any, *args: Any) -> Any:
            with ThreadPoolExecutor(1) as pool:
                return pool.submit(*pickle.loads(pickle.dumps((fn, *args))))

    others.append(cc.monte_carlo(SEVERAL, navs, **options, executor=Pickling(), chunk=3))
    for other in others:
        for name in one:
            for column in NUMBERS:
                a, b = getattr(one[name], column), getattr(other[name], column)
                np.testing.assert_array_equal(a, b, err_msg=f"{name} {column}")
    again = navs["ekf"].monte_carlo(SEVERAL, **options | {"smooth": False})["ekf"]
    np.testing.assert_array_equal(again.rms, one["ekf"].rms)


def test_a_filter_knows_which_fixes_are_good() -> None:
    """The covariance of each fix beats one and the same for all of them."""
    told = ONE.navigator()
    made = ONE.simulate(1)
    covariance = made.log.stars["star"].covariance
    assert covariance is not None
    assert covariance[:, 2, 2].max() > 2.0 * covariance[:, 2, 2].min()
    assert told.star["star"].sigma is None  # type: ignore[index]
    # a navigator's own noise gives way to that of the fixes, in a campaign as in a run
    guess = cc.StarGyroNavigator(cc.EKF(), told.gyro, cc.StarCamera(1e-2))
    found = cc.monte_carlo(ONE, {"told": told, "guess": guess}, 3, 1)
    np.testing.assert_array_equal(found["told"].rms, found["guess"].rms)


BLIND = camera(half_angle=0.2 * cc.DEG, magnitude_limit=1.0)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: StarField(3), "star.camera"),  # type: ignore[arg-type]
        (lambda: StarField(camera(), period=1.0, every=2), "star.period"),
        (lambda: StarField(camera(), period=0.0), "star.period"),
        (lambda: StarField(camera(), every=0), "star.every"),
        (lambda: StarField(camera(), offset=0.5), "star.offset"),
        (lambda: Scenario(TRUTH, GYRO, SKY), r"star.*StarField\(\.\.\.\) or CameraModel"),  # type: ignore[arg-type]
        (lambda: Scenario(TRUTH, GYRO, {"camera": camera()}), "begin with 'star_'"),
        (lambda: Scenario(TRUTH, GYRO, {}), "needs 1 to 64"),
        (lambda: Scenario(TRUTH, GYRO, StarField(camera(), offset=1e4)).simulate(), "star.offset"),
        (
            lambda: Scenario(TRUTH, GYRO, {"star_1": BLIND}).simulate(),
            "star_1: the camera sees fewer than two stars in all of its 600 frames",
        ),
        (
            lambda: cc.monte_carlo(Scenario(TRUTH, GYRO, BLIND), ONE.navigator(), 2),
            "star: the camera sees fewer than two stars",
        ),
    ],
)
def test_bad_values_are_refused(call: Any, message: str) -> None:
    with pytest.raises(cc.InputError, match=message):
        call()
