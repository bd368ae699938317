"""Campaigns over an orbit: against single runs, over threads and executors, and what is refused."""

from __future__ import annotations

import pickle
import threading
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from dataclasses import replace
from multiprocessing import get_context
from typing import Any

import celestcore as cc
import numpy as np
import pytest
from celestcore import celestial, orbit
from celestcore.celestial import MonteCarlo, Scenario, SkyCamera

T = np.arange(0.0, 7200.0, 30.0)
EPOCH = "2007-07-01T12:00:00"
START = ([7.1e6, 0, 0], [0, 3.2e3, 6.76e3])
ORBIT = orbit.propagate(orbit.ForceModel.j2(), EPOCH, *START, T)
# some epochs are empty
FEW = cc.StarCatalogue.random(1500, seed=3)
A = cc.StarHorizon(correlated=False)
SCENARIO = Scenario(ORBIT, SkyCamera(FEW), A, period=30.0)
DYNAMICS = orbit.OrbitDynamics(orbit.ForceModel.j2(), accel_psd=1e-10)
NAVS = {
    "ekf": cc.CelestialNavigator(cc.EKF(), DYNAMICS, A),
    "ukf": cc.CelestialNavigator(cc.UKF(), DYNAMICS, A, gate=0.9, combine=False),
}
NUMBERS: tuple[str, ...] = (
    "mean_position",
    "max_position",
    "rms_position",
    "mean_velocity",
    "max_velocity",
)
NUMBERS += ("rms_velocity", "nees", "nis", "accepted", "final_error", "trial")


def same(a: MonteCarlo, b: MonteCarlo) -> bool:
    assert list(a) == list(b)
    pairs = [(getattr(a[n], f), getattr(b[n], f)) for n in a for f in NUMBERS]
    return all(np.array_equal(x, y, equal_nan=True) for x, y in pairs)


def small(trials: int = 5, **more: Any) -> MonteCarlo:
    return celestial.monte_carlo(SCENARIO, NAVS, trials, 3, **more)


def expected(scenario: Scenario, sol: cc.OrbitSolution, skip: float) -> dict[str, Any]:
    """The scores of one run, by way of the log and the solution."""
    late = sol.t >= skip
    row = np.searchsorted(scenario.truth.t, sol.t)
    error = np.hstack([sol.r, sol.v]) - scenario.truth.state[row]
    assert sol.covariance is not None
    weighed = np.linalg.solve(sol.covariance, error[..., None])[..., 0]
    used = sol.accepted & (sol.measurement_t >= skip)
    counted = sol.measurement_t >= skip
    out: dict[str, Any] = {
        "nees": (error * weighed).sum(axis=1)[late].mean(),
        "nis": sol.nis[used].sum() / sol.dof[used].sum(),
        "accepted": sol.used[counted].sum() / sol.stars[counted].sum(),
        "final_error": np.concatenate([sol.final["r"], sol.final["v"]]) - scenario.truth.state[-1],
    }
    for name, part in (("position", error[late, :3]), ("velocity", error[late, 3:])):
        length = np.linalg.norm(part, axis=1)
        out[f"mean_{name}"], out[f"max_{name}"] = length.mean(), length.max()
        out[f"rms_{name}"] = np.sqrt((length**2).mean())
    return out


@pytest.mark.parametrize("smooth", [False, True])
@pytest.mark.parametrize("name", list(NAVS))
def test_a_trial_is_a_run_of_its_log(name: str, smooth: bool) -> None:
    # every epoch has a star, so that a log's epochs are the scenario's
    scenario = replace(SCENARIO, cameras=SkyCamera(FEW, (0.4, 0.4)), outliers=(0.03, 30.0))
    assert (scenario.stars.counts > 0).all()
    nav = NAVS[name]
    found = celestial.monte_carlo(scenario, {"a": nav}, 2, 9, first=4, smooth=smooth, skip=600.0)
    for row, trial in enumerate([4, 5]):
        log, (r0, v0) = scenario.log(9, trial), scenario.start(9, trial)
        call = nav.smooth if smooth else nav.run
        sol = call(log, r0, v0, sigma0=scenario.start_sigma, covariance=True)
        scores = found["a_smoothed" if smooth else "a"]
        for field, value in expected(scenario, sol, 600.0).items():
            got = getattr(scores, field)[row]
            np.testing.assert_allclose(got, value, rtol=1e-8, atol=1e-9, err_msg=field)
        assert scores.trial[row] == trial
    assert np.isnan(found["a"].ess).all()


def test_an_empty_sky_is_predicted_only() -> None:
    """Epochs without stars are scored; without any star the orbit is the start's."""
    dark = replace(SCENARIO, cameras=SkyCamera(FEW, boresight=(0, 0, 1)))
    assert not dark.stars.counts.any()
    found = celestial.monte_carlo(dark, NAVS, 2, 3)["ekf"]
    for row in range(2):
        r0, v0 = dark.start(3, row)
        alone = orbit.propagate(DYNAMICS.force, None, r0, v0, dark.truth.t, method="rk4", step=30.0)
        length = np.linalg.norm(alone.r - dark.truth.r, axis=1)
        assert found.mean_position[row] == pytest.approx(length.mean(), rel=1e-6)
        assert found.max_position[row] == pytest.approx(length.max(), rel=1e-6)
    assert np.isnan(found.nis).all()
    assert np.isnan(found.accepted).all()
    assert (found.nees < 30.0).all()
    assert 0 < (SCENARIO.stars.counts == 0).sum() < len(SCENARIO.truth)


def test_a_filter_that_knows_everything_is_consistent() -> None:
    found = celestial.monte_carlo(SCENARIO, NAVS["ekf"], 60, 1, skip=1800.0, smooth=True)
    for scores in found.values():
        pooled = scores.pooled()
        assert abs(pooled.nees - 6.0) < 4.0 * pooled.error["nees"]
        assert abs(pooled.nis - 1.0) < 4.0 * pooled.error["nis"]
    assert found["ekf_smoothed"].pooled().rms_position < 0.9 * found["ekf"].pooled().rms_position


def test_any_threads_parts_and_executors_give_the_same_bits() -> None:
    whole = small()
    assert same(whole, small(threads=1))
    assert same(whole, small(threads=3))
    parts = [small(2), small(3, first=2)]
    for name, scores in whole.items():
        joined = np.concatenate([p[name].rms_position for p in parts])
        np.testing.assert_array_equal(scores.rms_position, joined)
    with ThreadPoolExecutor(2) as pool:
        assert same(whole, small(executor=pool, chunk=2))
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as pool:
        assert same(whole, small(executor=pool))


def test_environments_are_shared_and_travel() -> None:
    real = orbit.OrbitDynamics(orbit.ForceModel(gravity=4, sun=True), accel_psd=1e-8)
    navs = {name: cc.CelestialNavigator(cc.EKF(), real, A) for name in ("one", "two")}
    here = celestial.monte_carlo(SCENARIO, navs, 2, 3)
    assert np.array_equal(here["one"].rms_position, here["two"].rms_position)
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        assert same(here, celestial.monte_carlo(SCENARIO, navs, 2, 3, executor=pool))


def test_progress_and_an_end_before_the_end() -> None:
    told: list[tuple[int, int]] = []
    small(progress=lambda done, total: told.append((done, total)))
    assert told[-1] == (5, 5)

    def stop(done: int, total: int) -> None:
        raise ZeroDivisionError

    before = threading.active_count()
    with pytest.raises(ZeroDivisionError):
        celestial.monte_carlo(SCENARIO, NAVS, 10**6, 3, progress=stop)
    assert threading.active_count() == before


def test_one_navigator_goes_by_its_filter() -> None:
    result = NAVS["ukf"].monte_carlo(SCENARIO, 3, seed=3, skip=100.0)
    assert repr(result) == "MonteCarlo(3 trials of ukf, seed 3)"
    assert (result.seed, result.first, result.trials, result.skip) == (3, 0, 3, 100.0)
    assert result["ukf"].pooled().trials == 3


def test_tables_and_pooled_numbers() -> None:
    pytest.importorskip("pandas")
    result = small()
    frame = result.to_dataframe()
    assert len(frame) == 10
    assert list(frame["trial"][:5]) == [0, 1, 2, 3, 4]
    assert {"estimator", "mean_position", "final_error_rx", "final_error_vz"} <= set(frame)
    one = result.pooled()["ekf"]
    scores = result["ekf"]
    assert one.mean_position == pytest.approx(scores.mean_position.mean())
    assert one.rms_position == pytest.approx(np.sqrt((scores.rms_position**2).mean()))
    wanted = scores.mean_position.std(ddof=1) / np.sqrt(5)
    assert one.error["mean_position"] == pytest.approx(wanted)


def test_a_filter_that_breaks_down_is_counted() -> None:
    """A start so far off that numbers overflow."""
    wild = replace(SCENARIO, start_sigma=(1e3, 1e45))
    with pytest.warns(cc.CelestcoreWarning, match="broke down"):
        found = celestial.monte_carlo(wild, NAVS["ekf"], 3, 3)["ekf"]
    assert found.failures
    assert found.pooled().failed == len(found.failures)
    for trial, reason in found.failures.items():
        assert "not positive definite" in reason
        assert np.isnan(found.rms_position[trial])
        assert np.isnan(found.final_error[trial]).all()


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"trials": 0}, "trials"),
        ({"seed": -1}, "seed"),
        ({"first": -1}, "first"),
        ({"skip": 1e6}, "skip"),
        ({"skip": -1.0}, "skip"),
        ({"smooth": ["kf"]}, "smooth"),
        ({"threads": 0}, "threads"),
        ({"executor": 1}, "executor"),
        ({"chunk": 0}, "chunk"),
        ({"progress": 1}, "progress"),
        ({"navigators": {}}, "navigators"),
        ({"navigators": [1]}, "navigators"),
        ({"scenario": 1}, "scenario"),
    ],
)
def test_campaigns_that_cannot_be(change: dict[str, Any], field: str) -> None:
    given: dict[str, Any] = {"scenario": SCENARIO, "navigators": NAVS, "trials": 2, **change}
    if "chunk" in change:
        with ThreadPoolExecutor(1) as pool, pytest.raises(cc.InputError) as caught:
            celestial.monte_carlo(**given, executor=pool)
    else:
        with pytest.raises(cc.InputError) as caught:
            celestial.monte_carlo(**given)
    assert caught.value.field == field


def test_a_force_that_needs_an_epoch() -> None:
    nameless = replace(SCENARIO, orbit=replace(ORBIT, epoch=None))
    real = orbit.OrbitDynamics(orbit.ForceModel(gravity=4), accel_psd=1e-8)
    with pytest.raises(cc.InputError) as caught:
        celestial.monte_carlo(nameless, cc.CelestialNavigator(cc.EKF(), real, A), 1)
    assert caught.value.field == "epoch"


def test_scenarios_can_be_pickled() -> None:
    again = pickle.loads(pickle.dumps(SCENARIO))
    log, other = SCENARIO.log(1).horizon, again.log(1).horizon
    assert log is not None
    assert np.array_equal(log.angle, other.angle)


@pytest.mark.parametrize("also", [(), (A,)], ids=["alone", "beside the horizon"])
def test_what_a_scenario_does_not_simulate_is_not_left_out_in_silence(also: Any) -> None:
    nav = cc.CelestialNavigator(cc.EKF(), DYNAMICS, [*also, cc.StarRefraction()])
    with pytest.raises(cc.InputError, match="does not simulate"):
        celestial.monte_carlo(SCENARIO, {"both": nav}, trials=1)
