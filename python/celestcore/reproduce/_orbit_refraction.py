"""The paper's second way: the orbit from stars that are refracted in the atmosphere."""

from __future__ import annotations

from typing import Any

import numpy as np

import celestcore as cc
from celestcore._arguments import processors
from celestcore.reproduce import _orbit_model as model
from celestcore.reproduce._orbit_bench import Bench, Plan, effort
from celestcore.reproduce._orbit_model import Array, Cell
from celestcore.reproduce._orbit_scores import plain
from celestcore.reproduce._pool import Job, Progress, in_parallel

FIELDS: dict[str, list[str | float] | None] = {
    "one aft field": ["aft"],
    "aft and side": ["aft", "right"],
    "all azimuths": None,
}
"""Where cameras of 10 x 10 degrees look at the limb."""
CASES = [(name, 0.0) for name in FIELDS] + [("aft and side", 0.01)]
"""Fields, and the relative error of the air's density that all stars share."""
EXPECTED = {
    ("one aft field", 0.0): "383 / 411",
    ("aft and side", 0.0): "144 / 56",
    ("all azimuths", 0.0): "47 / 16",
    ("aft and side", 0.01): "about 290",
}
GRAVITIES = ("j2", "21x21")
CELL = Cell(15.0)
MOST_RUNS = 10


def refraction_runs(plan: Plan) -> int:
    """Return how many runs of a filter there are."""
    return len(CASES) * len(GRAVITIES) * min(plan.runs, MOST_RUNS)


def refraction(bench: Bench) -> list[dict[str, Any]]:
    """Return position errors by fields of view, density error and gravity."""
    sensor = cc.celestial.StarRefraction(oblate=False)
    scenario = bench.scenario(CELL)
    seen = {
        name: cc.celestial.refracted_stars(
            scenario.truth, model.catalogue(), sensor, fields=fields, field_of_view=model.FIELD
        )
        for name, fields in FIELDS.items()
    }
    trials = min(bench.plan.runs, MOST_RUNS)
    tasks = [(*case, gravity) for case in CASES for gravity in GRAVITIES]

    def job(name: str, bias: float, gravity: str) -> Job[Array]:
        dynamics = cc.orbit.OrbitDynamics(model.force(gravity), model.ACCEL_PSD[gravity])
        made = cc.CelestialNavigator(cc.EKF(), dynamics, sensor)
        return lambda heard: _runs(bench, made, (scenario, seen[name]), bias, (trials, heard))

    before, share = bench.done, effort(CELL)
    found = in_parallel(
        [job(*task) for task in tasks],
        processors(bench.plan.threads, alone=True),
        lambda done, _: bench.told(before + share * done, "refraction"),
        len(tasks) * trials,
    )
    stars = {name: float(np.mean(rows.counts)) for name, rows in seen.items()}
    return [_row(task, errors, stars) for task, errors in zip(tasks, found, strict=True)]


def _runs(
    bench: Bench, made: Any, flight: tuple[Any, Any], bias: float, work: tuple[int, Progress]
) -> Array:
    """Return mean and maximum errors of position and velocity, (trials, 4)."""
    scenario, seen = flight
    trials, heard = work
    truth, seed, out = scenario.truth, bench.plan.seed, []
    late = truth.t >= model.SKIP
    for trial in range(trials):
        log = cc.CelestialLog(
            refraction=seen.measured(seed, trial, density_bias=bias), epoch=model.EPOCH
        )
        r0, v0 = scenario.start(seed, trial)
        sol = made.run(log, r0, v0, sigma0=model.START, t0=truth.t[0], t_output=truth.t)
        position = np.linalg.norm(sol.r - truth.r, axis=1)[late]
        velocity = np.linalg.norm(sol.v - truth.v, axis=1)[late]
        out.append([f(x) for x in (position, velocity) for f in (np.mean, np.max)])
        heard(trial + 1, trials)
    return np.array(out)


def _row(task: tuple[str, float, str], errors: Array, stars: dict[str, float]) -> dict[str, Any]:
    name, bias, gravity = task
    mean = errors.mean(axis=0)
    scatter = errors[:, 0].std(ddof=1) if len(errors) > 1 else np.nan
    return {
        "field": name,
        "stars": stars[name],
        "density": f"{100 * bias:g} % for all stars" if bias else "1 % for each pass",
        "gravity": gravity,
        "runs": len(errors),
        "mean_pos_m": float(mean[0]),
        "max_pos_m": float(mean[1]),
        "mean_vel_m_s": float(mean[2]),
        "max_vel_m_s": float(mean[3]),
        "run_sd_m": plain(scatter),
        "expected": EXPECTED[name, bias],
    }
