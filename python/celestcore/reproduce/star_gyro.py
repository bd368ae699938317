"""Wang and Jiang (2020): star camera and gyro, Tables 3 to 5, Figures 2 to 7.

>>> from celestcore.reproduce import star_gyro
>>> star_gyro.PAPER_UKF[2, 0].tolist()  # camera 1 arcsec, gyro 0.2 arcsec/s: pitch, roll, yaw
[0.28, 0.19, 0.16]
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from celestcore.errors import InputError
from celestcore.reproduce import _blocks, _model, _n_block, _paper
from celestcore.reproduce._blocks import FITTED, TUNED, Scores
from celestcore.reproduce._paper import EKF as PAPER_EKF
from celestcore.reproduce._paper import UKF as PAPER_UKF
from celestcore.reproduce._pool import trials
from celestcore.reproduce._target import Target
from celestcore.reproduce._targets import N_RUNS, targets
from celestcore.reproduce._theory import Theory, theory
from celestcore.solution import package_version

__all__ = ["PAPER_EKF", "PAPER_UKF", "RUNS", "Result", "run"]

Array = NDArray[np.float64]
Progress = Callable[[int, int, str], object]

RUNS = 16
"""Orbits a cell, as the experiment is defined."""
QUICK_RUNS, QUICK_N_RUNS = 1, 10


@dataclass(frozen=True, eq=False)
class Result:
    """What came out.

    Attributes
    ----------
    runs, n_runs, seed : int
        Orbits a cell, runs a case of block N, seed.
    scores : dict of str to Scores
        Blocks R1, R2, their swaps, T and S, by the names of the JSON.
    theory : Theory
        Bounds of every cell.
    n_block : list of dict
        Rows of block N.
    error_free : list of dict
        Runs with sensors without errors.
    elapsed_s : float
        Time it took, s.

    Examples
    --------
    >>> from celestcore.reproduce import star_gyro
    >>> result = star_gyro.run(seed=3, quick=True)  # doctest: +SKIP
    >>> result.full, result.runs  # doctest: +SKIP
    (False, 1)
    """

    runs: int
    n_runs: int
    seed: int
    scores: dict[str, Scores]
    theory: Theory
    n_block: list[dict[str, Any]]
    error_free: list[dict[str, Any]]
    elapsed_s: float

    @property
    def full(self) -> bool:
        """Whether there were enough runs to judge the targets."""
        return self.runs >= RUNS and self.n_runs >= N_RUNS

    def figures(self, name: str, metric: str = "after") -> Array:
        """Return one column of Tables 3 to 5, (camera, gyro, axis) [arcsec, 3 sigma].

        Parameters
        ----------
        name : str
            "paper_ekf", "paper_ukf", "bound_filter", "bound_smoother", or a filter: "r1", "r2",
            "r1_swapped", "r2_swapped", "mekf", "ukf", "ukf7", "smoothed".
        metric : {"after", "everywhere", "before"}
            Of a filter: just after each fix, at every gyro sample, just before each fix.

        Returns
        -------
        ndarray (3, 12, 3)
            Cameras 5, 2, 1 arcsec; gyros 0.2 ... 2.4 arcsec/s; pitch, roll, yaw.

        Raises
        ------
        InputError
            If the name is unknown.

        Examples
        --------
        >>> from celestcore.reproduce import star_gyro
        >>> result = star_gyro.run(seed=3, quick=True)  # doctest: +SKIP
        >>> result.figures("bound_filter")[0, 0].round(3)  # doctest: +SKIP
        array([0.436, 0.345, 0.319])
        """
        fixed = {
            "paper_ekf": PAPER_EKF,
            "paper_ukf": PAPER_UKF,
            "bound_filter": self.theory.filter,
            "bound_smoother": self.theory.smoother,
        }
        if name not in fixed and name not in self.scores:
            known = ", ".join([*fixed, *self.scores])
            raise InputError(f"must be one of {known}", field="name", value=name)
        column = fixed[name] if name in fixed else self.scores[name].pooled(metric)
        return np.asarray(column).reshape(PAPER_UKF.shape)

    def targets(self) -> list[Target]:
        """Return what was asked and what came out, block by block.

        Returns
        -------
        list of Target
            With ``block``, ``asked``, ``found`` and ``met``.

        Examples
        --------
        >>> from celestcore.reproduce import star_gyro
        >>> result = star_gyro.run(seed=3, quick=True)  # doctest: +SKIP
        >>> [target.met for target in result.targets()]  # doctest: +SKIP
        """
        return targets(self)

    def to_dict(self) -> dict[str, Any]:
        """Return every figure, ready for JSON; what ``--json`` writes.

        All figures are in arcsec, 3 sigma, just after the fixes, unless their key says otherwise.

        Returns
        -------
        dict
            Of plain numbers, text, lists and dicts.

        Examples
        --------
        >>> from celestcore.reproduce import star_gyro
        >>> result = star_gyro.run(seed=3, quick=True)  # doctest: +SKIP
        >>> result.to_dict()["experiment"]  # doctest: +SKIP
        'star-gyro'
        """
        return {
            "experiment": "star-gyro",
            "paper": _paper.CITATION,
            "version": package_version(),
            "runs": self.runs,
            "seed": self.seed,
            "elapsed_s": self.elapsed_s,
            "cells": self._cells(),
            "nees": {name: _consistency(self.scores[name]) for name in self.scores},
            "n_runs": self.n_runs,
            "n_block": self.n_block,
            "error_free": self.error_free,
            "gains_percent": self.gains(),
            "readings": self.readings(),
            "cost": self.cost(),
            "targets": [target.to_dict() for target in self.targets()],
        }

    def _cells(self) -> list[dict[str, Any]]:
        main = ("paper_ekf", "paper_ukf", *FITTED, *TUNED, "bound_filter", "bound_smoother")
        columns = {name: self.figures(name).reshape(-1, 3) for name in main}
        extra = {
            f"{name}_{key}": self.figures(name, metric).reshape(-1, 3)
            for name in self.scores
            for key, metric in (("10hz", "everywhere"), ("before", "before"))
            if (name, key) != ("smoothed", "before")  # a smoother has no prediction
        }
        errors = {f"{name}_se": score.standard_error() for name, score in self.scores.items()}
        scatter = self.theory.scatter_filter / np.sqrt(self.runs)
        extra |= errors | {
            "bound_filter_10hz": self.theory.between,
            "bound_filter_before": self.theory.before,
            "expected_relative_se": scatter,
        }
        return [
            {"star_arcsec": cell.star, "gyro_arcsec_per_s": cell.gyro, "axis": axis}
            | {name: _plain(column[cell.index, k]) for name, column in columns.items()}
            | {name: _plain(column[cell.index, k]) for name, column in extra.items()}
            for cell in _model.cells()
            for k, axis in enumerate(_paper.AXES)
        ]

    def gains(self) -> dict[str, Any]:
        """Return by how much UKF is better than EKF, (camera, axis) [%]: printed and recomputed.

        Returns
        -------
        dict
            Lists (camera, axis) by where they come from, and counts.

        Examples
        --------
        >>> from celestcore.reproduce import star_gyro
        >>> result = star_gyro.run(seed=3, quick=True)  # doctest: +SKIP
        >>> result.gains()["paper_ekf_better"]  # doctest: +SKIP
        10
        """
        wins = PAPER_EKF < PAPER_UKF
        return {
            "printed": [list(row) for row in _paper.GAINS],
            "from_paper_tables": _paper.gains(PAPER_UKF, PAPER_EKF).tolist(),
            "from_paper_tables_where_ukf_wins": _paper.gains(
                PAPER_UKF, PAPER_EKF, wins_only=True
            ).tolist(),
            "from_r1_r2": _paper.gains(self.figures("r1"), self.figures("r2")).tolist(),
            "same_tuning": _paper.gains(self.figures("ukf"), self.figures("mekf")).tolist(),
            "paper_ekf_better": int(np.sum(wins)),
            "paper_equal": int(np.sum(PAPER_EKF == PAPER_UKF)),
        }

    def readings(self) -> list[dict[str, Any]]:
        """Return the gyro that an accuracy of 1 arcsec asks for: printed, and read off columns.

        Returns
        -------
        list of dict
            Gyro errors in arcsec/s, 3 sigma.

        Examples
        --------
        >>> from celestcore.reproduce import star_gyro
        >>> result = star_gyro.run(seed=3, quick=True)  # doctest: +SKIP
        >>> result.readings()[0]["what"]  # doctest: +SKIP
        """
        columns = {"EKF": ("paper_ekf", "r2"), "UKF": ("paper_ukf", "r1")}
        out = []
        for what, column, star, axis, printed in _paper.READINGS:
            names = (*columns[column], "mekf", "smoothed")
            read = {name: _paper.reading(self.figures(name), star, axis) for name in names}
            out.append({"what": what, "column": column, "printed": printed} | read)
        return out

    def cost(self) -> dict[str, Any]:
        """Return the time of each filter for an orbit [s], and as multiples of the MEKF's.

        Returns
        -------
        dict
            Medians over the trials.

        Examples
        --------
        >>> from celestcore.reproduce import star_gyro
        >>> result = star_gyro.run(seed=3, quick=True)  # doctest: +SKIP
        >>> result.cost()["seconds_per_orbit"]  # doctest: +SKIP
        """
        seconds = {name: float(np.median(self.scores[name].seconds)) for name in TUNED}
        base = seconds["mekf"]
        return {
            "paper_factor": "2n + 1: 15 with its n = 7, 13 with n = 6",
            "seconds_per_orbit": seconds,
            "times_mekf": {
                name: _plain(s / base if base else np.nan) for name, s in seconds.items()
            },
        }


def run(
    runs: int | None = None,
    seed: int = 0,
    *,
    threads: int | None = None,
    quick: bool = False,
    progress: Progress | None = None,
) -> Result:
    """Run the whole experiment.

    Parameters
    ----------
    runs : int, optional
        Orbits a cell; 16, with `quick` 1.
    seed : int
        Of all random numbers, at least 0.
    threads : int, optional
        The machine's, by default; the figures are the same for any number.
    quick : bool
        One orbit a cell and 10 runs a case of block N: too few to judge the targets.
    progress : callable, optional
        ``progress(done, total, what)``.

    Returns
    -------
    Result

    Raises
    ------
    InputError
        If `runs` or `seed` is out of range.
    KeyboardInterrupt
        On Ctrl-C.

    Examples
    --------
    >>> from celestcore.reproduce import star_gyro
    >>> result = star_gyro.run(seed=3, quick=True)  # doctest: +SKIP
    >>> result.figures("mekf").shape  # doctest: +SKIP
    (3, 12, 3)
    """
    runs = trials(runs, seed, quick=quick, defined=(RUNS, QUICK_RUNS))
    n_runs = QUICK_N_RUNS if quick else N_RUNS
    begin = time.perf_counter()
    scores = _blocks.run(runs, seed, threads=threads, progress=_named(progress, "orbits"))
    rows = _n_block.run(n_runs, seed, progress=_named(progress, "block N"))
    return Result(
        runs=runs,
        n_runs=n_runs,
        seed=seed,
        scores=scores,
        theory=theory(_model.cells()),
        n_block=rows,
        error_free=_blocks.error_free(seed),
        elapsed_s=time.perf_counter() - begin,
    )


def _named(progress: Progress | None, what: str) -> Callable[[int, int], object] | None:
    return None if progress is None else lambda done, total: progress(done, total, what)


def _consistency(score: Scores) -> dict[str, Any]:
    return {
        "attitude_over_3": _plain(np.mean(score.nees_attitude) / 3.0),
        "full_over_6": _plain(np.mean(score.nees) / 6.0),
        "nis_over_3": _plain(np.mean(score.nis) / 3.0),
    }


def _plain(value: Any) -> float | None:
    return float(value) if np.isfinite(value) else None
