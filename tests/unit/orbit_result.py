"""A result of the orbit experiment that is made up: every target is met, nothing is run."""

from __future__ import annotations

from typing import Any

import numpy as np
from celestcore.reproduce import _orbit_model as model
from celestcore.reproduce import _orbit_paper as paper
from celestcore.reproduce import celestial_orbit
from celestcore.reproduce._orbit_blocks import Traces
from celestcore.reproduce._orbit_model import FILTERS, Cell
from celestcore.reproduce._orbit_scores import Bound, Scores

Result = celestial_orbit.Result

# mean position errors [m] by period, noise A, as they are expected
MEANS = {
    "ekf_taylor": (150, 361, 1088, 3950),
    "ekf_8x8": (53, 104, 149, 214),
    "ekf_21x21": (47, 100, 145, 212),
    "score_21x21": (47, 100, 145, 212),
    "smoothed_21x21": (32, 71, 102, 143),
    "upf_literal": (9e3, 8e3, 7e3, 9e3),
}
UKF = (155, 239, 276, 333)
NOISE_B = (1.3, 1.25, 1.4, 1.35)
OTHER = {
    "score": (198, 92),
    "score_21x21": (73, 15),
    "upf": (222, 179),
    "ekf_21x21": (100, 100),
}


def scores(mean: float, runs: int = 40, nees: float = 6.0, **more: float) -> Scores:
    """Return scores with this mean, to all digits; runs scatter by a tenth."""
    rng = np.random.default_rng(round(mean))
    noise = rng.standard_normal(runs)
    noise = (noise - noise.mean()) / noise.std()
    each = mean * (1.0 + 0.1 * noise)
    one = np.ones(runs)
    return Scores(
        mean_position=each,
        max_position=2.5 * each,
        rms_position=each / 0.92,
        mean_velocity=1e-3 * each,
        max_velocity=2e-3 * each,
        nees=nees * (1.0 + 0.05 * noise),
        accepted=one,
        ess=more.get("ess", np.nan) * one,
        seconds=0.01 * one,
    )


def mean_of(cell: Cell, name: str) -> float:
    k = model.PERIODS.index(cell.period)
    if cell.distribution != "normal" and name in OTHER:
        return float(OTHER[name][model.DISTRIBUTIONS.index(cell.distribution) - 1])
    mean = float(MEANS.get(name, UKF)[k])
    return mean * (NOISE_B[k] if cell.noise == "B" else 1.0)


def filters(cell: Cell) -> dict[str, Scores]:
    """Return all filters of a cell."""
    ess = {"upf": 15.0, "upf_bank": 17.0, "upf_literal": 1.1, "bootstrap": 80.0}
    consistent = ("ekf_8x8", "ekf_21x21", "smoothed_21x21")
    return {
        name: scores(
            mean_of(cell, name),
            nees=6.0 if name in consistent else 15.0,
            ess=ess.get(name, np.nan),
        )
        for name in FILTERS
    }


def made_up() -> Result:
    """Return a result in which every target is met, without running anything."""
    cells = {cell: filters(cell) for cell in model.CELLS}
    two = ("ekf_21x21", "smoothed_21x21")
    long, bounds = {}, {}
    for cell in model.TABLE_1:
        long[cell] = {name: scores(mean_of(cell, name), 200) for name in two}
        bounds[cell] = Bound(*(long[cell][name].rms() for name in two))
    bounds[Cell(15.0, "A", "student_t")] = Bound(75.0, 50.0)
    gated = {"ukf": 2737.0, "ekf_gated": 342.0, "huber": 400.0}
    return Result(
        runs=40,
        long_runs=200,
        seed=7,
        cells=cells,
        long=long,
        bounds=bounds,
        cost=[cost("ekf", "EKF", 3e-4), cost("ukf", "UKF", 8e-4), cost("upf_literal", "UPF", 0.03)],
        outliers={name: scores(mean) for name, mean in gated.items()},
        shapes=[
            {"edge": 0.01, "half_width": w, "mean_pos_m": 93.0, "mean_pos_21x21_m": 15.0}
            for w in (1.0, 1.05)
        ],
        starts=[start("100 km, 100 m/s", "EKF", 30), start("500 km, 500 m/s", "EKF", 13)],
        refraction=[
            refracted("one aft field", "j2", 383.0),
            refracted("one aft field", "21x21", 411.0),
        ],
        traces=traces(),
        sky={"stars": 4559.0, "mean": 5.6, "least": 1.0},
        elapsed_s=200.0,
    )


def cost(name: str, column: str, seconds: float) -> dict[str, Any]:
    return {
        "filter": name,
        "what": name,
        "seconds_per_orbit": seconds,
        "steps_per_orbit": 2000,
        "accelerations_per_step": 4,
        "paper_column": column,
        "paper_seconds": paper.TABLE_3[column],
    }


def start(where: str, what: str, good: int) -> dict[str, Any]:
    return {"start": where, "filter": what.lower(), "what": what, "converged": good, "of": 30}


def refracted(where: str, gravity: str, mean: float) -> dict[str, Any]:
    return {
        "field": where,
        "density": "1 % an occultation",
        "gravity": gravity,
        "mean_pos_m": mean,
        "run_sd_m": 0.2 * mean,
        "expected": "383 / 411",
    }


def traces() -> Traces:
    """Return errors that fall from 1 km to their means."""
    t = np.linspace(0.0, 36e3, 600)
    wave = 1.0 + 0.6 * np.sin(t / 900.0)
    panels = {f"{p:g} s": Cell(p) for p in (3.0, 30.0, 60.0)}
    panels |= {law: Cell(15.0, "A", law) for law in model.DISTRIBUTIONS}
    names = ("ekf_taylor", "ukf", "upf", "score", "ekf_21x21", "smoothed_21x21")
    errors = {
        key: {n: (t, mean_of(cell, n) * wave + 1e3 * np.exp(-t / 3e3)) for n in names}
        for key, cell in panels.items()
    }
    rng = np.random.default_rng(2)
    sizes = {"upf": 15.0, "upf_bank": 18.0, "upf_literal": 1.1}
    ess = {n: (t, np.clip(v + rng.standard_normal(600), 1.0, 20.0)) for n, v in sizes.items()}
    return Traces(errors, ess)
