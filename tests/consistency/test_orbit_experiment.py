"""The orbit experiment against theory and against a filter written for this test."""

from __future__ import annotations

import celestcore as cc
import numpy as np
import pytest
from celestcore.reproduce import _orbit_bench as blocks
from celestcore.reproduce import _orbit_model as model
from celestcore.reproduce._orbit_model import Cell
from celestcore.reproduce._orbit_scores import Scores
from celestcore.reproduce._orbit_targets import TAYLOR, UKF
from numpy.typing import NDArray

Array = NDArray[np.float64]
PLAN = blocks.Plan(runs=24, long_runs=24, start_runs=2, seed=11, threads=None)


@pytest.fixture(scope="module")
def bench() -> blocks.Bench:
    return blocks.Bench(PLAN, None, 1.0)


def run(bench: blocks.Bench, cell: Cell, *names: str, **options: object) -> dict[str, Scores]:
    return bench.campaign(cell, blocks.navigators(names, cell), "test", **options)


def acceleration(r: Array) -> Array:
    """Return eq. 1 of the paper with (Re/r)^2, (n, 3)."""
    field = cc.orbit.GravityField.jgm3()
    length = np.linalg.norm(r, axis=1, keepdims=True)
    z2 = (r[:, 2:] / length) ** 2
    k = field.j2 * (field.radius / length) ** 2
    shape = 1.0 - k * (7.5 * z2 - np.array([1.5, 1.5, 4.5]))
    return np.asarray(-field.mu * r / length**3 * shape)


def flow(x: Array) -> Array:
    return np.hstack([x[:, 3:], acceleration(x[:, :3])])


def step(x: Array, dt: float, taylor: bool) -> Array:
    """Return states (n, 6) a time later: Runge-Kutta, or the paper's second-order step."""
    if taylor:
        f, e = flow(x), 1e-3  # A f is the derivative of f along f
        along = (flow(x + e * f) - flow(x - e * f)) / (2.0 * e)
        return x + dt * f + 0.5 * dt**2 * along
    a = flow(x)
    b = flow(x + 0.5 * dt * a)
    c = flow(x + 0.5 * dt * b)
    return x + dt / 6.0 * (a + 2.0 * b + 2.0 * c + flow(x + dt * c))


def transition(x: Array, dt: float, taylor: bool) -> Array:
    """Return the transition matrix (6, 6) of one step: by differences, or the paper's I + A T."""
    size = np.array([10.0, 10.0, 10.0, 0.01, 0.01, 0.01])
    moved = np.vstack([x + np.diag(size), x - np.diag(size)])
    out = flow(moved) if taylor else step(moved, dt, taylor)
    slope = ((out[:6] - out[6:]) / (2.0 * size[:, None])).T
    return np.eye(6) + dt * slope if taylor else slope


def plain_filter(log: cc.CelestialLog, x: Array, psd: float, dt: float, taylor: bool) -> Array:
    """Return the states (n, 6) of an extended filter: one joint update an epoch, noise A."""
    sigma = np.hypot(model.SIGMA_NADIR, model.SIGMA_STAR)
    p, eye = np.diag(np.repeat(np.square(model.START), 3)), np.eye(3)
    q = psd * np.block([[dt**3 / 3 * eye, dt**2 / 2 * eye], [dt**2 / 2 * eye, dt * eye]])
    table, out = log.horizon, []
    for k in range(round(model.DURATION / dt) + 1):
        if k:
            f = transition(x, dt, taylor)
            x, p = step(x[None], dt, taylor)[0], f @ p @ f.T + q
        rows = np.abs(table.t - k * dt) < 1e-6
        star, length = table.star[rows], np.linalg.norm(x[:3])
        u = -x[:3] / length
        cosine = star @ u
        h = np.zeros((len(star), 6))
        h[:, :3] = (star - cosine[:, None] * u) / (length * np.sqrt(1.0 - cosine**2))[:, None]
        gain = np.linalg.solve(h @ p @ h.T + sigma**2 * np.eye(len(star)), h @ p).T
        x = x + gain @ (table.angle[rows] - np.arccos(cosine))
        p = (np.eye(6) - gain @ h) @ p
        out.append(x)
    return np.array(out)


@pytest.mark.parametrize(("name", "taylor"), [("ekf", False), ("ekf_taylor", True)])
@pytest.mark.parametrize("dt", [15.0, 60.0])
def test_filters_are_those_of_the_paper(
    bench: blocks.Bench, name: str, taylor: bool, dt: float
) -> None:
    """The library's run of one trial beside the same equations in numpy."""
    cell = Cell(dt)
    scenario = bench.scenario(cell)
    log, start = scenario.log(5), np.concatenate(scenario.start(5))
    psd = model.TAYLOR_PSD[dt] if taylor else model.ACCEL_PSD["j2"]
    wanted = plain_filter(log, start, psd, dt, taylor)
    found = blocks.navigator(name, cell).run(log, start[:3], start[3:], sigma0=model.START)
    late = found.t >= model.SKIP
    error = np.linalg.norm(wanted[late, :3] - scenario.truth.r[late], axis=1).mean()
    apart = np.linalg.norm(found.r[late] - wanted[late, :3], axis=1).mean()
    assert apart < 0.03 * error


@pytest.mark.parametrize("period", [15.0, 30.0, 60.0])
def test_ukf_and_taylor_columns_come_out(bench: blocks.Bench, period: float) -> None:
    found = run(bench, Cell(period), "ukf", "ekf", "ekf_taylor")
    k = model.PERIODS.index(period)
    for name, wanted in (("ukf", UKF[k]), ("ekf_taylor", TAYLOR[k])):
        assert found[name].mean() == pytest.approx(wanted, rel=0.1)
    assert found["ekf"].mean() == pytest.approx(found["ukf"].mean(), abs=0.2)


@pytest.mark.parametrize("noise", model.NOISES)
def test_filter_and_smoother_reach_the_bound(bench: blocks.Bench, noise: str) -> None:
    cell = Cell(30.0, noise)
    found = run(bench, cell, "ekf_21x21", trials=80, smooth=("ekf_21x21",))
    limit = cc.analysis.posterior_bound(bench.scenario(cell)).rms(model.SKIP)[0]
    smooth = cc.analysis.posterior_bound(bench.scenario(cell), smoother=True).rms(model.SKIP)[0]
    for scores, bound in ((found["ekf_21x21"], limit), (found["smoothed_21x21"], smooth)):
        assert abs(scores.rms() - bound) < 3.5 * scores.rms_error()
        assert abs(scores.mean("nees") - 6.0) < 3.5 * scores.error("nees")


def test_the_likelihood_of_the_noise_is_worth_something(bench: blocks.Bench) -> None:
    for law, most in (("student_t", 215.0), ("uniform", 100.0)):
        found = run(bench, Cell(15.0, "A", law), "ekf", "score", trials=12)
        assert found["score"].mean() < min(most, 0.9 * found["ekf"].mean())


def test_gates_save_a_filter_from_outliers(bench: blocks.Bench) -> None:
    found = run(bench, model.OUTLIERS, "ukf", "ekf_gated", "huber", trials=12)
    clean = run(bench, model.OUTLIERS._replace(outliers=None), "ekf", trials=12)["ekf"].mean()
    assert found["ukf"].mean() > 5.0 * clean
    assert found["ekf_gated"].mean() < 1.1 * clean
    assert found["huber"].mean() < 2.0 * clean
    assert found["ekf_gated"].mean("accepted") == pytest.approx(0.95, abs=0.01)
