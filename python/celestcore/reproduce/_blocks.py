"""Blocks R1, R2, their swaps, T and S: every cell, every filter, many seeded orbits."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

import celestcore as cc
from celestcore import simulate
from celestcore._arguments import processors
from celestcore.reproduce import _model as model
from celestcore.reproduce._model import Array, Cell
from celestcore.reproduce._pool import Job, Progress, in_parallel

FITTED = ("r1", "r2", "r1_swapped", "r2_swapped")
TUNED = ("mekf", "ukf", "ukf7", "smoothed")
COLUMN = {"mekf_smoothed": "smoothed"}
TRIALS_APART = 1 << 20
"""Between the numbers of the first trials of two cells: no two share their noise."""
START = 1.0
"""Attitude sigma of the start [rad]: has no effect, the first fix brings its own."""
PERFECT = 1e-3
"""What a filter is told of a sensor without errors, [arcsec] and [arcsec/s], 3 sigma."""

NONE = 1e-6
"""The error of a camera without one [arcsec]: a simulated camera must have some."""


@dataclass(frozen=True)
class Scores:
    """One filter's scores; the leading axes are cell and orbit.

    Attributes
    ----------
    after, everywhere, before : array, (cell, orbit, axis)
        Figures [arcsec, 3 sigma] of single orbits: just after each fix, at every gyro sample, just
        before each fix.
    nees_attitude, nees, nis : array, (cell, orbit)
        Means over an orbit; 3, 6 and 3 degrees of freedom.
    seconds : array, (cell, orbit)
        Time in the filter.
    """

    after: Array
    everywhere: Array
    before: Array
    nees_attitude: Array
    nees: Array
    nis: Array
    seconds: Array

    def pooled(self, metric: str = "after") -> Array:
        """Return the figures over all orbits, (cell, axis) [arcsec, 3 sigma]."""
        return np.asarray(np.sqrt(np.mean(np.square(getattr(self, metric)), axis=1)))

    def standard_error(self, metric: str = "after") -> Array:
        """Return the standard error of `pooled`, from the orbits' scatter, (cell, axis)."""
        squares = np.square(getattr(self, metric))
        if squares.shape[1] < 2:
            return np.full(squares[:, 0].shape, np.nan)
        scatter = np.std(squares, axis=1, ddof=1) / np.sqrt(squares.shape[1])
        return np.asarray(scatter / (2.0 * np.sqrt(np.mean(squares, axis=1))))


def filters() -> dict[str, Any]:
    """Return the filters: the paper's UKF integrates by Runge-Kutta."""
    return {"mekf": cc.EKF(), "ukf": cc.UKF(integrator="rk4"), "ukf7": cc.LiteralUKF()}


def run(
    runs: int, seed: int, *, threads: int | None = None, progress: Progress | None = None
) -> dict[str, Scores]:
    """Run all cells.

    Parameters
    ----------
    runs : int
        Orbits a cell.
    seed : int
    threads : int, optional
        The machine's, by default; the figures are the same for any number.
    progress : callable, optional
        ``progress(done, total)`` in orbits, on the calling thread.

    Returns
    -------
    dict of str to Scores
        By the names in `FITTED` and `TUNED`.
    """
    truth = _truth()
    tasks = [(cell, fitted) for cell in model.cells() for fitted in (True, False)]

    def job(cell: Cell, fitted: bool) -> Job[dict[str, dict[str, Array]]]:
        return lambda heard: _campaign(truth, cell, fitted, (runs, seed), heard)

    jobs = [job(*task) for task in tasks]
    results = in_parallel(jobs, processors(threads, alone=True), progress, runs * len(tasks))
    found: dict[str, list[dict[str, Array]]] = {name: [] for name in (*FITTED, *TUNED)}
    for result in results:
        for name, columns in result.items():
            found[name].append(columns)
    return {name: _scores(rows) for name, rows in found.items()}


def _campaign(
    truth: simulate.Truth, cell: Cell, fitted: bool, run: tuple[int, int], heard: Progress
) -> dict[str, dict[str, Array]]:
    """Run one cell's R blocks or its tuned filters; both see the same noise."""
    bias_sigma = model.FIT_BIAS_SIGMA if fitted else model.BIAS_SIGMA
    result = cc.monte_carlo(
        _scenario(truth, cell.star, cell.gyro, bias_sigma),
        _fitted(cell) if fitted else _tuned(cell),
        trials=run[0],
        seed=run[1],
        first=cell.index * TRIALS_APART,
        smooth=() if fitted else ("mekf",),
        skip=model.SKIP,
        sigma0=(START, bias_sigma),
        threads=1,
        progress=heard,
    )
    heard(run[0], run[0])
    return {COLUMN.get(name, name): _columns(result[name]) for name in result}


def error_free(seed: int) -> list[dict[str, Any]]:
    """Run what the paper names without giving results: sensors without errors, one orbit each.

    The filter is told that such a sensor has an error of `PERFECT`.

    Returns
    -------
    list of dict
        ``star_arcsec``, ``gyro_arcsec_per_s``: the errors, 0 for none; ``pitch``, ``roll``,
        ``yaw``: MEKF, just after fixes [arcsec, 3 sigma].
    """
    truth = _truth()
    out = []
    for k, (star, gyro) in enumerate(((0.0, 0.2), (0.0, 2.4), (5.0, 0.0), (1.0, 0.0), (0.0, 0.0))):
        told = Cell(star or PERFECT, gyro or PERFECT, -1)
        result = cc.monte_carlo(
            _scenario(truth, star, gyro, model.BIAS_SIGMA if gyro else 0.0),
            {"mekf": model.tuned(told, cc.EKF())},
            trials=1,
            seed=seed,
            first=(100 + k) * TRIALS_APART,
            skip=model.SKIP,
            sigma0=(START, model.BIAS_SIGMA),
        )
        figures = model.figures(_columns(result["mekf"])["rms"][0])
        out.append(
            {"star_arcsec": star, "gyro_arcsec_per_s": gyro}
            | dict(zip(("pitch", "roll", "yaw"), figures.tolist(), strict=True))
        )
    return out


def _truth() -> simulate.Truth:
    return simulate.earth_pointing(
        model.DURATION, model.GYRO_STEP, semi_major_axis=model.SEMI_MAJOR_AXIS
    )


def _fitted(cell: Cell) -> dict[str, Any]:
    kinds = filters()
    r1, r2 = (model.R1_GYRO, 0.0), (model.R2_GYRO, model.R2_WALK)
    return {
        "r1": model.fitted(cell, kinds["ukf"], *r1),
        "r2": model.fitted(cell, kinds["mekf"], *r2),
        "r1_swapped": model.fitted(cell, kinds["mekf"], *r1),
        "r2_swapped": model.fitted(cell, kinds["ukf"], *r2),
    }


def _tuned(cell: Cell) -> dict[str, Any]:
    return {name: model.tuned(cell, kind) for name, kind in filters().items()}


def _scenario(truth: simulate.Truth, star: float, gyro: float, bias_sigma: float) -> Any:
    return simulate.Scenario(
        truth,
        simulate.GyroErrors(
            arw=model.angle_random_walk(gyro),
            rrw=model.BIAS_WALK if gyro else 0.0,
            bias_sigma=bias_sigma,
        ),
        simulate.StarErrors(covariance=model.star_covariance(star or NONE), every=2),
    )


def _columns(result: Any) -> dict[str, Array]:
    names = ("rms", "rms_all", "rms_before", "nees_attitude", "nees", "nis", "seconds")
    return {name: np.asarray(getattr(result, name)) for name in names}


def _scores(rows: list[dict[str, Array]]) -> Scores:
    column = {name: np.array([row[name] for row in rows]) for name in rows[0]}
    return Scores(
        after=model.figures(column["rms"]),
        everywhere=model.figures(column["rms_all"]),
        before=model.figures(column["rms_before"]),
        **{name: column[name] for name in ("nees_attitude", "nees", "nis", "seconds")},
    )
