"""Everything that is run: Tables 1 to 3, long campaigns, outliers, starts, single runs."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

import celestcore as cc
from celestcore.reproduce import _orbit_model as model
from celestcore.reproduce import _orbit_paper as paper
from celestcore.reproduce._orbit_bench import (
    Bench,
    Plan,
    Progress,
    effort,
    horizon,
    navigator,
    navigators,
)
from celestcore.reproduce._orbit_model import FILTERS, SMOOTHED, Array, Cell
from celestcore.reproduce._orbit_refraction import refraction, refraction_runs
from celestcore.reproduce._orbit_scores import Bound, Scores

Trace = tuple[Array, Array]

LONG = ("ekf_21x21",)
"""Filters of the long campaign; with their smoother."""
ROBUST = ("ekf", "ukf", "ekf_gated", "huber", "score", "upf")
LAST_ORBIT, CONVERGED = 30_000.0, 5e3
"""A start is overcome if no position error is above this [m] from this time [s] on."""
POINTS = 1200
"""Of a curve in a figure."""
COST_TRIALS = 5
ACCELERATIONS = {"ekf_taylor": 1, "ukf": 52, "srukf": 52, "upf": 52, "ukf_21x21": 52}
ACCELERATIONS |= {"upf_literal": 1120, "upf_bank": 1040, "bootstrap": 4000}
"""A step of 3 s is one Runge-Kutta step: 4 accelerations; 13 sigma points, 20 or 1000 particles."""


@dataclass(frozen=True)
class Traces:
    """Single runs: by panel and filter times [s] and position errors [m], and sample sizes."""

    errors: dict[str, dict[str, Trace]] = field(default_factory=dict)
    ess: dict[str, Trace] = field(default_factory=dict)


def run(plan: Plan, progress: Progress | None) -> dict[str, Any]:
    """Run everything; the parts of a `Result` by name."""
    bench = Bench(plan, progress, _total(plan))
    cost = costs(bench)
    cells = {cell: tables(bench, cell) for cell in model.CELLS}
    return {
        "cost": cost,
        "cells": cells,
        "long": {cell: long(bench, cell, cells[cell]) for cell in model.TABLE_1},
        "bounds": bounds(bench),
        "outliers": bench.campaign(
            model.OUTLIERS, navigators(ROBUST, model.OUTLIERS, robust=True), "outliers"
        ),
        "shapes": shapes(bench),
        "starts": starts(bench),
        "refraction": refraction(bench),
        "traces": traces(bench),
        "sky": sky(bench),
    }


def _names() -> list[str]:
    return [name for name in FILTERS if name not in SMOOTHED.values()]


def _total(plan: Plan) -> float:
    """Return all work, in the units of `effort`."""
    names, more = len(_names()), plan.long_runs - plan.runs
    return (
        sum(effort(c) for c in model.CELLS) * plan.runs * names
        + sum(effort(c) for c in model.TABLE_1) * more * len(LONG)
        + effort(model.OUTLIERS) * plan.runs * len(ROBUST)
        + sum(effort(c) for c in model.STARTS.values()) * plan.start_runs * len(START_FILTERS)
        + effort(Cell(15.0)) * (plan.runs * 2 * len(SHAPES) + refraction_runs(plan))
        + effort(COST_CELL) * cost_trials(plan) * len(COST_FILTERS)
    )


def tables(bench: Bench, cell: Cell) -> dict[str, Scores]:
    """Run all filters of Tables 1 and 2 in one cell."""
    found = bench.campaign(cell, navigators(_names(), cell), "tables", smooth=tuple(SMOOTHED))
    return {name: found[name] for name in FILTERS}


def long(bench: Bench, cell: Cell, first: dict[str, Scores]) -> dict[str, Scores]:
    """Go on with the 21x21 filter and smoother up to the runs of the comparison with the bound."""
    names = [*LONG, *(SMOOTHED[name] for name in LONG)]
    more = bench.plan.long_runs - bench.plan.runs
    if more <= 0:
        return {name: first[name] for name in names}
    found = bench.campaign(
        cell,
        navigators(LONG, cell),
        "bound",
        trials=more,
        first=bench.plan.runs,
        smooth=LONG,
    )
    return {name: Scores.joined([first[name], found[name]]) for name in names}


def bounds(bench: Bench) -> dict[Cell, Bound]:
    """Return the posterior Cramer-Rao bounds, rms position [m]; none exists for uniform noise."""
    found = {}
    for cell in model.CELLS:
        if cell.distribution != "uniform":
            scenario = bench.scenario(cell)
            both = (
                cc.analysis.posterior_bound(scenario, smoother=smoother).rms(model.SKIP)[0]
                for smoother in (False, True)
            )
            found[cell] = Bound(*both)
    return found


COST_CELL = Cell(paper.PERIOD_3)
COST_FILTERS = (
    "ekf_taylor",
    "ekf",
    "ukf",
    "srukf",
    "upf",
    "upf_literal",
    "upf_bank",
    "score",
    "bootstrap",
    "ekf_8x8",
    "ekf_21x21",
    "ukf_21x21",
)


def cost_trials(plan: Plan) -> int:
    """Return how often the filters are timed; the fastest counts."""
    return min(COST_TRIALS, plan.runs)


def costs(bench: Bench) -> list[dict[str, Any]]:
    """Return Table 3: seconds an orbit with one thread, before anything else runs."""
    made = navigators(COST_FILTERS, COST_CELL)
    found = bench.campaign(COST_CELL, made, "cost", trials=cost_trials(bench.plan), threads=1)
    out = []
    for name in COST_FILTERS:
        column = model.PUBLISHED.get(name) if name != "ekf" else "EKF"
        out.append(
            {
                "filter": name,
                "what": FILTERS.get(name, "UKF, 21×21 gravity, Sun, Moon"),
                "seconds_per_orbit": float(np.min(found[name].seconds)) / model.ORBITS,
                "steps_per_orbit": round(model.DURATION / model.ORBITS / COST_CELL.period),
                "accelerations_per_step": ACCELERATIONS.get(name, 4),
                "paper_column": column,
                "paper_seconds": None if column is None else paper.TABLE_3[column],
                "paper_operations_full": column and paper.complexity(column),
                "paper_operations_diagonal": column and paper.complexity(column, diagonal=True),
            }
        )
    return out


SHAPES = [(edge, width) for edge in (0.05, 0.01) for width in (0.95, 1.0, 1.05)]


def shapes(bench: Bench) -> list[dict[str, Any]]:
    """Return the score filter's errors under uniform noise by how well it knows the noise."""
    cell = Cell(15.0, "A", "uniform")
    names = {"score": "pos_m", "score_21x21": "pos_21x21_m"}
    made = {}
    for name in names:
        dynamics = navigator(name, cell).dynamics
        for edge, width in SHAPES:
            told = horizon(cell, edge, width)
            made[f"{name} {edge} {width}"] = cc.CelestialNavigator(cc.ScoreEKF(), dynamics, told)
    found = bench.campaign(cell, made, "shapes")
    return [
        {"edge": edge, "half_width": width}
        | {f"mean_{key}": found[f"{n} {edge} {width}"].mean() for n, key in names.items()}
        for edge, width in SHAPES
    ]


START_FILTERS = {
    "ekf": "EKF",
    "ukf": "UKF, n + τ = 3",
    "ukf_scaled": "scaled UKF",
    "ekf_apart": "EKF, angle by angle",
    "ukf_apart": "UKF, n + τ = 3, angle by angle",
    "ukf_scaled_apart": "scaled UKF, angle by angle",
}


def starts(bench: Bench) -> list[dict[str, Any]]:
    """Return how many runs converge from large errors."""
    out = []
    for name, cell in model.STARTS.items():
        found = bench.campaign(
            cell,
            navigators(START_FILTERS, cell),
            "starts",
            trials=bench.plan.start_runs,
            skip=LAST_ORBIT,
        )
        for kind, scores in found.items():
            good = np.nan_to_num(scores.max_position, nan=np.inf) < CONVERGED
            count = {"converged": int(good.sum()), "of": len(good), "failures": scores.failures}
            out.append({"start": name, "filter": kind, "what": START_FILTERS[kind]} | count)
    return out


def traces(bench: Bench) -> Traces:
    """Run single trials for the figures."""
    panels = {f"{p:g} s": Cell(p) for p in (3.0, 30.0, 60.0)}
    panels |= {d: Cell(15.0, "A", d) for d in model.DISTRIBUTIONS}
    errors: dict[str, dict[str, Trace]] = {}
    for key, cell in panels.items():
        names = ["ekf_taylor", "ukf", "upf", *(["score"] if cell.period == 15.0 else LONG)]
        errors[key] = {name: _error(bench, cell, name) for name in names}
        if cell.period != 15.0:
            errors[key]["smoothed_21x21"] = _error(bench, cell, "smoothed_21x21")
    ess = {}
    for name in model.PARTICLE_FORMS:
        sol = _single(bench, Cell(15.0), name)
        ess[name] = (sol.measurement_t, np.asarray(sol.ess))
    return Traces(errors, ess)


def _single(bench: Bench, cell: Cell, name: str) -> Any:
    """Run trial 0 of a cell."""
    scenario, seed = bench.scenario(cell), bench.plan.seed
    back = name in SMOOTHED.values()
    causal = next((k for k, v in SMOOTHED.items() if v == name), name)
    made = navigator(causal, cell)
    go = made.smooth if back else made.run
    r0, v0 = scenario.start(seed)
    return go(scenario.log(seed), r0, v0, sigma0=cell.start, t0=float(scenario.truth.t[0]))


def _error(bench: Bench, cell: Cell, name: str) -> Trace:
    sol, truth = _single(bench, cell, name), bench.scenario(cell).truth
    rows = np.searchsorted(truth.t, sol.t)
    error = np.linalg.norm(sol.r - truth.r[rows], axis=1)
    thin = slice(None, None, max(1, len(error) // POINTS))
    return sol.t[thin], error[thin]


def sky(bench: Bench) -> dict[str, float]:
    """Return how many stars there are, and how many are seen at an epoch."""
    counts = bench.scenario(Cell(model.STEP)).stars.counts
    found = {"mean": float(np.mean(counts)), "least": float(np.min(counts))}
    return {"stars": float(len(model.catalogue())), **found}
