"""Campaigns: against single runs, over threads and executors, and what is refused."""

from __future__ import annotations

import os
import pickle
import signal
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import replace
from multiprocessing import get_context
from typing import Any

import celestcore as cc
import numpy as np
import pytest
from celestcore import _campaign, simulate
from celestcore.montecarlo import MonteCarlo, Scores
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

GYRO = simulate.GyroErrors(2e-5, 1e-7, bias_sigma=1e-4)
STAR = simulate.StarErrors((2e-5, 2e-5, 1e-4), every=2)
SCENARIO = simulate.Scenario(simulate.slews(60.0, 0.1), GYRO, STAR)
NAVS = {"ekf": SCENARIO.navigator(cc.EKF()), "ukf": SCENARIO.navigator(cc.UKF())}
NUMBERS = ("rms", "rms_all", "rms_before", "rms_bias", "nees_attitude", "nees", "nis", "accepted")
NUMBERS += ("final_error", "trial")

# everything that may be mounted is, and the cameras differ
MOUNTED = simulate.Scenario(
    SCENARIO.truth,
    simulate.GyroErrors(2e-5, 1e-7, bias_sigma=1e-4, mounting=Rotation.random(random_state=1)),
    {
        "star": simulate.StarErrors(
            (2e-5, 2e-5, 1e-4), every=2, mounting=Rotation.random(random_state=2)
        ),
        "star_2": simulate.StarErrors(
            (3e-5, 3e-5, 2e-4), every=5, offset=3, mounting=Rotation.random(random_state=3)
        ),
    },
)


def same(a: MonteCarlo, b: MonteCarlo) -> bool:
    assert list(a) == list(b)
    pairs = [(getattr(a[n], f), getattr(b[n], f)) for n in a for f in NUMBERS]
    return all(np.array_equal(x, y, equal_nan=True) for x, y in pairs)


def small(trials: int = 7, **more: Any) -> MonteCarlo:
    return cc.monte_carlo(SCENARIO, NAVS, trials, 3, **more)


# --- against single runs ------------------------------------------------------------------------


def expected(
    made: simulate.Simulation, sol: cc.Solution, skip: float, until: float = np.inf
) -> dict[str, Any]:
    """The scores of one run, by way of the log and the solution."""
    error = made.error(sol)
    fixed = np.isin(sol.t, np.concatenate([star.t for star in made.log.stars.values()]))
    late = (sol.t >= skip) & (sol.t <= until)
    measured = (sol.measurement_t >= skip) & (sol.measurement_t <= until)
    assert sol.covariance is not None
    at = late & fixed

    def nees(n: int) -> float:
        e, p = error[at, :n], sol.covariance[at, :n, :n]  # type: ignore[index]
        return float(np.mean(np.einsum("ki,ki->k", e, np.linalg.solve(p, e[..., None])[..., 0])))

    def rms(e: Any) -> Any:
        return np.sqrt(np.mean(e**2, axis=0))

    return {
        "rms": rms(error[at, :3]),
        "rms_all": rms(error[late, :3]),
        "rms_bias": rms(error[late, 3:]),
        "nees_attitude": nees(3),
        "nees": nees(6),
        "nis": np.mean(sol.nis[measured & sol.accepted]),
        "accepted": np.mean(sol.accepted[measured]),
        "final_error": error[-1],
    }


@pytest.mark.parametrize("gate", [None, 0.9])
@pytest.mark.parametrize("scenario", [SCENARIO, MOUNTED], ids=["plain", "mounted"])
@pytest.mark.parametrize("kind", [cc.EKF(), cc.UKF(), cc.SRUKF()], ids=lambda f: f.kind)
def test_a_trial_is_a_run_of_its_log(kind: Any, scenario: Any, gate: float | None) -> None:
    tuned = scenario.navigator(kind)
    nav = cc.StarGyroNavigator(kind, tuned.gyro, tuned.star, gate=gate)
    sigma0 = (1.0, (1e-4, 2e-4, 3e-4))
    found = cc.monte_carlo(scenario, nav, 2, 9, first=4, skip=20.0, sigma0=sigma0)[kind.kind]
    for row, trial in enumerate([4, 5]):
        made = scenario.simulate(9, trial)
        sol = nav.run(made.log, sigma0=sigma0, covariance=True)
        for name, value in expected(made, sol, 20.0).items():
            np.testing.assert_allclose(getattr(found, name)[row], value, rtol=1e-8, err_msg=name)
        assert found.trial[row] == trial
    assert (found.accepted < 1.0).all() == (gate is not None)


@pytest.mark.parametrize("scenario", [SCENARIO, MOUNTED], ids=["plain", "mounted"])
def test_a_smoothed_trial_is_a_smoothed_log(scenario: Any) -> None:
    navs = {"a": scenario.navigator(cc.EKF()), "b": scenario.navigator(cc.UKF())}
    found = cc.monte_carlo(scenario, navs, 2, 9, skip=15.0, smooth=["b"])
    assert list(found) == ["a", "b", "b_smoothed"]
    for trial in range(2):
        made = scenario.simulate(9, trial)
        sol = navs["b"].smooth(made.log, covariance=True)
        until = float(scenario.truth.t[-1]) - 15.0
        for name, value in expected(made, sol, 15.0, until).items():
            row = getattr(found["b_smoothed"], name)[trial]
            np.testing.assert_allclose(row, value, rtol=1e-8, err_msg=name)
    assert (found["b_smoothed"].rms < 0.9 * found["b"].rms).all()
    everything = cc.monte_carlo(scenario, navs, 1, 9, skip=15.0, smooth=True)
    assert list(everything) == ["a", "b", "a_smoothed", "b_smoothed"]


@pytest.mark.parametrize(
    "kind", [cc.IteratedEKF(), cc.InvariantEKF(), cc.LiteralUKF()], ids=lambda f: f.kind
)
def test_every_filter_runs(kind: Any) -> None:
    nav = SCENARIO.navigator(kind)
    found = cc.monte_carlo(SCENARIO, nav, 1, 9, skip=20.0)[kind.kind]
    made = SCENARIO.simulate(9)
    for name, value in expected(made, nav.run(made.log, covariance=True), 20.0).items():
        np.testing.assert_allclose(getattr(found, name)[0], value, rtol=1e-8, err_msg=name)


def test_a_gyro_whose_errors_are_known() -> None:
    m = np.array([[1e-2, 2e-2, -1e-2], [3e-2, -2e-2, 1e-2], [-1e-2, 2e-2, 3e-2]])
    scenario = simulate.Scenario(
        SCENARIO.truth, simulate.GyroErrors(2e-5, bias_sigma=1e-4, misalignment=m), STAR
    )
    star = scenario.navigator().star
    navs = {
        "known": cc.StarGyroNavigator(cc.EKF(), cc.Gyro(2e-5, 1e-9, errors=m), star),
        "unknown": cc.StarGyroNavigator(cc.EKF(), cc.Gyro(2e-5, 1e-9), star),
    }
    found = cc.monte_carlo(scenario, navs, 20, 1, skip=10.0).pooled()
    assert abs(found["known"].nees / 6.0 - 1.0) < 5.0 * found["known"].error["nees"] / 6.0
    assert found["unknown"].nees > 20.0
    # what is seen of a bias is behind the correction
    calm = simulate.GyroErrors(1e-7, bias=[1.0, 2.0, 3.0], misalignment=m)
    quiet = simulate.Scenario(simulate.constant_rate([0, 0, 0], 60.0), calm, STAR)
    nav = cc.StarGyroNavigator(cc.EKF(), cc.Gyro(1e-7, errors=m), star)
    one = cc.monte_carlo(quiet, nav, 1, 1, sigma0=(1.0, 1e3))["ekf"]
    assert np.abs(one.final_error[0, 3:]).max() < 1e-4


def test_the_error_before_a_fix() -> None:
    """Of a run that leaves one fix out, at the time of that fix."""
    made = SCENARIO.simulate(3, 0)
    star = made.log.stars["star"]
    nav, gyro = NAVS["ekf"], made.log.gyro
    assert gyro is not None
    before = []
    for k in range(150, len(star)):
        cut = np.searchsorted(gyro.t, star.t[k], side="right")
        log = cc.SensorLog(gyro=(gyro.t[:cut], gyro.rate[:cut]), star=(star.t[:k], star.q[:k]))
        before.append(made.error(nav.run(log))[-1, :3])
    found = small(1, skip=float(star.t[150]))["ekf"].rms_before[0]
    np.testing.assert_allclose(found, np.sqrt(np.mean(np.square(before), axis=0)), rtol=1e-9)


def test_fixes_between_samples_count_at_the_next() -> None:
    star = simulate.StarErrors(2e-5, period=0.75, offset=0.33)
    scenario = simulate.Scenario(SCENARIO.truth, GYRO, star)
    found = cc.monte_carlo(scenario, scenario.navigator(), 1, 9, skip=20.0)["ekf"]
    made = scenario.simulate(9)
    sol = scenario.navigator().run(made.log, every=1)
    # the start lies between samples: the solution's first row is no sample's
    assert sol.t[0] == pytest.approx(0.33)
    error = made.error(sol)
    after = np.isin(
        sol.t, SCENARIO.truth.t[np.searchsorted(SCENARIO.truth.t, made.log.stars["star"].t)]
    )
    late = sol.t >= 20.0
    for name, rows in (("rms", after & late), ("rms_all", late)):
        value = np.sqrt(np.mean(error[rows, :3] ** 2, axis=0))
        np.testing.assert_allclose(getattr(found, name)[0], value, rtol=1e-8)
    everything = cc.monte_carlo(scenario, scenario.navigator(), 1, 9)["ekf"]
    np.testing.assert_allclose(
        everything.rms_all[0], np.sqrt(np.mean(error[1:, :3] ** 2, axis=0)), rtol=1e-8
    )


def test_a_drawn_start_is_drawn_from_its_covariance() -> None:
    """With stars and gyro that say nothing the last error is the first."""
    scenario = simulate.Scenario(
        simulate.constant_rate([0.0, 0.0, 0.0], 2.0, 1.0),
        simulate.GyroErrors(1e-9, bias_sigma=1e-3),
        simulate.StarErrors(1e-2, offset=1),
    )
    sigma0 = ((1e-5, 2e-5, 3e-5), (1e-8, 2e-8, 3e-8))
    nav = cc.StarGyroNavigator(cc.EKF(), cc.Gyro(1e-9), cc.StarCamera(0.1))
    found = cc.monte_carlo(scenario, nav, 2000, 1, start="drawn", sigma0=sigma0)["ekf"]
    z = found.final_error / np.concatenate(sigma0)
    for axis in z.T:
        assert 5e-4 < chi2.cdf(np.sum(axis**2), len(z)) < 1.0 - 5e-4
    assert np.abs(np.corrcoef(z.T) - np.eye(6)).max() < 4.0 / np.sqrt(len(z))


def test_each_estimator_has_its_own_start() -> None:
    sigmas = {"ekf": (1e-3, 1e-6), "ukf": (1e-3, 1e-3)}
    both = small(3, sigma0=sigmas)
    for name, sigma0 in sigmas.items():
        alone = cc.monte_carlo(SCENARIO, {name: NAVS[name]}, 3, 3, sigma0=sigma0)
        np.testing.assert_array_equal(both[name].rms, alone[name].rms)
    assert (both["ekf"].rms_bias != both["ukf"].rms_bias).all()


# --- the same bits, whoever computes ------------------------------------------------------------


def test_any_number_of_threads() -> None:
    one = small(threads=1)
    assert all(same(one, small(threads=n)) for n in (2, 3, 16))
    assert not same(one, cc.monte_carlo(SCENARIO, NAVS, 7, 4))


def test_a_campaign_in_parts() -> None:
    whole, part = small(7), small(3, first=4)
    for name in whole:
        np.testing.assert_array_equal(whole[name].rms[4:], part[name].rms)
        assert part[name].trial.tolist() == [4, 5, 6]


@pytest.mark.parametrize("chunk", [None, 1, 3, 100])
def test_a_pool_of_threads(chunk: int | None) -> None:
    with ThreadPoolExecutor(2) as pool:
        assert same(small(), small(executor=pool, chunk=chunk))


def test_a_pool_of_processes() -> None:
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as pool:
        assert same(small(), small(executor=pool, chunk=3))


class AtOnce:
    """The least that an executor can be."""

    def __init__(self) -> None:
        self.sizes: list[int] = []

    def submit(self, fn: Callable[..., Any], *args: Any) -> Any:
        self.sizes.append(args[-1])
        result = pickle.loads(pickle.dumps(fn))(*pickle.loads(pickle.dumps(args)))

        class Done:
            def result(self) -> Any:
                return result

        return Done()


def test_anything_that_submits() -> None:
    executor, told = AtOnce(), []
    found = small(executor=executor, chunk=3, progress=lambda *x: told.append(x))
    assert same(small(), found)
    assert executor.sizes == [3, 3, 1]
    assert told == [(3, 7), (6, 7), (7, 7)]
    many = AtOnce()
    cc.monte_carlo(SCENARIO, NAVS["ekf"], 100, executor=many)
    assert many.sizes == [8] * 12 + [4]  # what runs side by side stays together
    # short tasks, whatever a trial takes: 600 steps and 300 fixes here
    size = _campaign.Job({"t": np.zeros(600), "cameras": [(np.zeros(300),)]}, [{}], 0, 0, 1, False)
    assert [size.part(n) for n in (1, 100, 1280, 10**9)] == [8, 8, 16, 336]
    long = replace(size, flight={"t": np.zeros(10**6), "cameras": []})
    assert long.part(10**6) == 1


def test_arrays_that_lie_anywhere() -> None:
    """As they come out of a message: neither aligned nor contiguous."""

    def moved(value: Any) -> Any:
        if isinstance(value, np.ndarray):
            raw = np.zeros(2 * value.nbytes + 1, dtype=np.uint8)
            spread = raw[1:].view(np.float64).reshape(*value.shape, 2)[..., 0]
            spread[...] = value
            assert not spread.flags.aligned
            return spread
        if isinstance(value, dict):
            return {k: moved(v) for k, v in value.items()}
        return type(value)(map(moved, value)) if isinstance(value, list | tuple) else value

    class Moving(AtOnce):
        def submit(self, fn: Callable[..., Any], *args: Any) -> Any:
            job = args[0]
            flight, estimators = moved(dict(job.flight)), moved(job.estimators)
            return super().submit(fn, replace(job, flight=flight, estimators=estimators), *args[1:])

    more: dict[str, Any] = {"start": "drawn", "sigma0": (1e-3, 1e-4)}
    assert same(small(**more), small(executor=Moving(), **more))


def test_what_goes_wrong_in_an_executor_comes_out() -> None:
    class Broken(ThreadPoolExecutor):
        made: list[Future[Any]] = []  # noqa: RUF012

        def submit(self, fn: Any, /, *args: Any, **more: Any) -> Future[Any]:
            future: Future[Any] = Future()
            if self.made:
                future.set_exception(RuntimeError("worker lost"))
            else:
                future = super().submit(fn, *args)
            self.made.append(future)
            if len(self.made) > 3:
                self.made[-1] = future = Future()  # never runs
            return future

    with Broken(1) as pool, pytest.raises(RuntimeError, match="worker lost"):
        small(executor=pool, chunk=1)
    assert all(future.cancelled() for future in pool.made[3:])


# --- progress, Ctrl-C, failures -----------------------------------------------------------------


def test_progress_is_told() -> None:
    told: list[tuple[int, int]] = []
    cc.monte_carlo(SCENARIO, NAVS, 2000, progress=lambda *x: told.append(x))
    done = [d for d, _ in told]
    assert done == sorted(set(done))
    assert done[-1] == 2000
    assert len(done) >= 2
    assert {total for _, total in told} == {2000}


@pytest.mark.parametrize("kind", [RuntimeError, KeyboardInterrupt, cc.CelestcoreError])
def test_an_error_in_progress_comes_out(kind: type[BaseException]) -> None:
    error = kind("stop here")

    def progress(done: int, total: int) -> None:
        raise error

    began = time.perf_counter()
    with pytest.raises(kind) as caught:
        cc.monte_carlo(SCENARIO, NAVS, 10**6, progress=progress)
    assert caught.value is error
    assert time.perf_counter() - began < 5.0


@contextmanager
def interrupted_after(delay: float) -> Iterator[list[float]]:
    sent: list[float] = []

    def kill() -> None:
        sent.append(time.perf_counter())
        os.kill(os.getpid(), signal.SIGINT)

    timer = threading.Timer(delay, kill)
    timer.start()
    try:
        yield sent
    finally:
        timer.cancel()
        timer.join()


@pytest.mark.skipif(os.name == "nt", reason="os.kill ends the process there")
def test_ctrl_c_within_a_fifth_of_a_second() -> None:
    waited = []
    for _ in range(3):  # a busy machine may let one attempt wait
        with interrupted_after(0.1) as sent, pytest.raises(KeyboardInterrupt):
            cc.monte_carlo(SCENARIO, NAVS, 10**6)
        waited.append(time.perf_counter() - sent[0])
        if waited[-1] < 0.2:
            break
    assert min(waited) < 0.2


def test_a_filter_that_breaks_down_is_a_result() -> None:
    scenario = simulate.Scenario(
        simulate.earth_pointing(60.0, 1.0), simulate.GyroErrors(1e-6), simulate.StarErrors(1e-11)
    )
    # a negative weight, and a start that it matters for
    navs = {"ukf": scenario.navigator(cc.UKF(beta=0.0)), "srukf": scenario.navigator(cc.SRUKF())}
    with pytest.warns(cc.CelestcoreWarning, match="ukf broke down in . of 8 trials; trial"):
        found = cc.monte_carlo(scenario, navs, 8, first=10, start="drawn", sigma0=(3.0, 1.0))
    bad, good = found["ukf"], found["srukf"]
    assert bad.failures
    assert set(bad.failures) <= set(range(10, 18))
    assert "not positive definite" in next(iter(bad.failures.values()))
    nan = np.isnan(bad.rms).all(axis=1)
    assert bad.trial[nan].tolist() == list(bad.failures)
    assert bad.pooled().failed == len(bad.failures)
    assert np.isfinite(bad.pooled().rms).all()
    assert np.isfinite(good.rms).all()
    assert not good.failures


# --- what it says -------------------------------------------------------------------------------


def test_pooled_numbers() -> None:
    scores = small(40)["ekf"]
    pooled = scores.pooled()
    np.testing.assert_allclose(pooled.rms, np.sqrt(np.mean(scores.rms**2, axis=0)))
    assert pooled.nees == pytest.approx(np.mean(scores.nees))
    assert pooled.error["nees"] == pytest.approx(np.std(scores.nees, ddof=1) / np.sqrt(40))
    # the error of the root against the jackknife
    left = [np.sqrt(np.mean(np.delete(scores.rms, k, axis=0) ** 2, axis=0)) for k in range(40)]
    jackknife = np.sqrt(39.0 / 40.0 * np.sum((left - np.mean(left, axis=0)) ** 2, axis=0))
    np.testing.assert_allclose(pooled.error["rms"], jackknife, rtol=0.05)
    assert (pooled.trials, pooled.failed) == (40, 0)
    one = small(1)["ekf"].pooled()
    assert np.isnan(one.error["rms"]).all()
    assert np.isfinite(one.rms).all()


def test_a_data_frame() -> None:
    found = small(3, first=2)
    frame = found.to_dataframe()
    assert frame["trial"].tolist() == [2, 3, 4] * 2
    assert frame["estimator"].tolist() == ["ekf"] * 3 + ["ukf"] * 3
    assert frame["rms_y"][4] == found["ukf"].rms[1, 1]
    assert frame["final_error_bz"][0] == found["ekf"].final_error[0, 5]
    assert np.isfinite(frame.drop(columns="estimator").to_numpy(float)).all()


def test_the_result_is_a_mapping_and_pickles() -> None:
    found = small(2)
    assert list(found) == ["ekf", "ukf"]
    assert len(found["ekf"]) == 2
    assert isinstance(found["ekf"], Scores)
    assert repr(found) == "MonteCarlo(2 trials of ekf, ukf, seed 3)"
    assert same(found, pickle.loads(pickle.dumps(found)))
    assert found.pooled()["ukf"].rms.shape == (3,)
    assert (found["ekf"].seconds > 0.0).all()


# --- what is refused ----------------------------------------------------------------------------


def refused(
    field: str, navs: Any = NAVS, scenario: Any = SCENARIO, trials: Any = 2, **more: Any
) -> Any:
    return pytest.param(lambda: cc.monte_carlo(scenario, navs, trials, **more), field, id=field)


UNKNOWN = cc.StarGyroNavigator(cc.EKF(), cc.Gyro(1e-6))
LATE = cc.StarGyroNavigator(cc.EKF(), cc.Gyro(1e-6, sampling="integrated"), cc.StarCamera(1e-5))


@pytest.mark.parametrize(
    ("call", "message"),
    [
        refused("scenario", scenario=3),
        refused("navigators", navs=3),
        refused("navigators: needs", navs={}),
        refused("star.sigma", navs=UNKNOWN),
        refused("gyro.sampling", navs=LATE),
        refused("no star sensor", navs=SCENARIO.navigator(), scenario=MOUNTED),
        refused("trials", trials=0),
        refused("seed", seed=-1),
        refused("first", first=-1),
        refused("2\\*\\*56", first=2**56 - 1),
        refused("skip", skip=60.0),
        refused("skip, value 30", skip=30.0, smooth=True),
        refused("skip, value -1", skip=-1.0),
        refused("start", start="truth"),
        refused("sigma0: is needed", start="drawn"),
        refused("sigma0: needs one", sigma0={"ekf": (1e-3, 1e-3)}),
        refused("smooth, value 'srukf'", smooth=["srukf"]),
        refused("ekf_smoothed", navs=NAVS | {"ekf_smoothed": NAVS["ekf"]}, smooth="ekf"),
        refused("threads", threads=0),
        refused("executor", executor=3),
        refused("chunk, value 0", executor=AtOnce(), chunk=0),
        refused("chunk, value 0", chunk=0),
        refused("chunk, value -1", executor=AtOnce(), chunk=-1),
        refused("chunk, value -1", chunk=-1),
        refused("progress", progress=3),
    ],
)
def test_bad_values_are_refused(call: Callable[[], Any], message: str) -> None:
    with pytest.raises(cc.InputError, match=message):
        call()
