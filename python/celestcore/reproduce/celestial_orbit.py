"""Ning and Ma (2010): a satellite's orbit from stars and the horizon, Tables 1 to 3, Figures 3, 4.

>>> from celestcore.reproduce import celestial_orbit
>>> celestial_orbit.PAPER_TABLE_1[30.0]["UKF"].mean_pos  # period 30 s [m]
238.9116
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from celestcore.reproduce import _orbit_blocks as blocks
from celestcore.reproduce import _orbit_model as model
from celestcore.reproduce import _orbit_paper as paper
from celestcore.reproduce._orbit_bench import Plan
from celestcore.reproduce._orbit_model import FILTERS, TABLE_1, TABLE_2, Cell
from celestcore.reproduce._orbit_paper import TABLE_1 as PAPER_TABLE_1
from celestcore.reproduce._orbit_paper import TABLE_2 as PAPER_TABLE_2
from celestcore.reproduce._orbit_scores import Bound, Scores, row
from celestcore.reproduce._orbit_targets import LONG_RUNS, targets
from celestcore.reproduce._pool import trials
from celestcore.reproduce._target import Target
from celestcore.solution import package_version

__all__ = ["PAPER_TABLE_1", "PAPER_TABLE_2", "RUNS", "Result", "run"]

Progress = Callable[[int, int, str], object]

RUNS = 40
"""Runs a cell, as the experiment is defined."""
QUICK_RUNS = 2
START_RUNS = 30


@dataclass(frozen=True, eq=False)
class Result:
    """What came out.

    Attributes
    ----------
    runs, long_runs, seed : int
        Runs a cell; runs of the 21x21 filter and smoother against the bound; seed.
    cells : dict
        By scenario the filters' scores, by the names of the JSON.
    long : dict
        The same for the long campaign.
    bounds : dict
        By scenario the posterior Cramer-Rao bounds.
    cost : list of dict
        Seconds an orbit at T = 3 s.
    outliers : dict of str to Scores
        5 % of the angles wrong by 50 sigma.
    shapes : list of dict
        The score filter under uniform noise, by how well it knows the noise.
    starts : list of dict
        Starts with large errors: how many runs converge.
    refraction : list of dict
        The orbit from stars seen through the atmosphere.
    traces : Traces
        Single runs, for the figures.
    sky : dict
        How many stars there are, and how many are seen.
    elapsed_s : float
        Time it took, s.

    Examples
    --------
    >>> from celestcore.reproduce import celestial_orbit
    >>> result = celestial_orbit.run(seed=3, quick=True)  # doctest: +SKIP
    >>> result.full, result.runs  # doctest: +SKIP
    (False, 2)
    """

    runs: int
    long_runs: int
    seed: int
    cells: dict[Cell, dict[str, Scores]]
    long: dict[Cell, dict[str, Scores]]
    bounds: dict[Cell, Bound]
    cost: list[dict[str, Any]]
    outliers: dict[str, Scores]
    shapes: list[dict[str, Any]]
    starts: list[dict[str, Any]]
    refraction: list[dict[str, Any]]
    traces: blocks.Traces
    sky: dict[str, float]
    elapsed_s: float

    @property
    def full(self) -> bool:
        """Whether there were enough runs to judge the targets."""
        return self.runs >= RUNS

    def table1(self) -> list[dict[str, Any]]:
        """Return Table 1: periods, noise A and B, every filter.

        Returns
        -------
        list of dict
            Positions in m, velocities in m/s; ``paper_...`` None where the paper has no figure.

        Examples
        --------
        >>> from celestcore.reproduce import celestial_orbit
        >>> result = celestial_orbit.run(seed=3, quick=True)  # doctest: +SKIP
        >>> result.table1()[0]["filter"]  # doctest: +SKIP
        'ekf_taylor'
        """
        return self._rows(TABLE_1)

    def table2(self) -> list[dict[str, Any]]:
        """Return Table 2: distributions of the noise at T = 15 s, every filter.

        Returns
        -------
        list of dict
            As `table1`.

        Examples
        --------
        >>> from celestcore.reproduce import celestial_orbit
        >>> result = celestial_orbit.run(seed=3, quick=True)  # doctest: +SKIP
        >>> {row["distribution"] for row in result.table2()}  # doctest: +SKIP
        {'normal', 'student_t', 'uniform'}
        """
        return self._rows(TABLE_2)

    def _rows(self, cells: list[Cell]) -> list[dict[str, Any]]:
        return [
            row(cell, name, self.cells[cell][name], self.bounds.get(cell))
            for cell in cells
            for name in FILTERS
            if name in self.cells[cell]
        ]

    def targets(self) -> list[Target]:
        """Return what was asked and what came out.

        Returns
        -------
        list of Target
            With ``block``, ``asked``, ``found`` and ``met``.

        Examples
        --------
        >>> from celestcore.reproduce import celestial_orbit
        >>> result = celestial_orbit.run(seed=3, quick=True)  # doctest: +SKIP
        >>> [target.met for target in result.targets()]  # doctest: +SKIP
        """
        return targets(self)

    def to_dict(self) -> dict[str, Any]:
        """Return every figure, ready for JSON; what ``--json`` writes.

        Returns
        -------
        dict
            Of plain numbers, text, lists and dicts.

        Examples
        --------
        >>> from celestcore.reproduce import celestial_orbit
        >>> result = celestial_orbit.run(seed=3, quick=True)  # doctest: +SKIP
        >>> result.to_dict()["experiment"]  # doctest: +SKIP
        'celestial-orbit'
        """
        outliers = model.OUTLIERS
        return {
            "experiment": "celestial-orbit",
            "paper": paper.CITATION,
            "version": package_version(),
            "runs": self.runs,
            "seed": self.seed,
            "elapsed_s": self.elapsed_s,
            "table1": self.table1(),
            "table2": self.table2(),
            "table3": self.cost,
            "long_runs": self.long_runs,
            "long": [
                row(cell, name, scores, self.bounds.get(cell))
                for cell, found in self.long.items()
                for name, scores in found.items()
            ],
            "outliers": [_unprinted(outliers, n, s) for n, s in self.outliers.items()],
            "shapes": self.shapes,
            "starts": self.starts,
            "refraction": self.refraction,
            "sky": self.sky,
            "targets": [target.to_dict() for target in self.targets()],
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
        Runs a cell; 40, with `quick` 2.
    seed : int
        Of all random numbers, at least 0.
    threads : int, optional
        The machine's, by default; the figures are the same for any number.
    quick : bool
        Two runs a cell: too few to judge the targets.
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
    >>> from celestcore.reproduce import celestial_orbit
    >>> result = celestial_orbit.run(seed=3, quick=True)  # doctest: +SKIP
    >>> result.table1()[0]["mean_pos_m"]  # doctest: +SKIP
    """
    runs = trials(runs, seed, quick=quick, defined=(RUNS, QUICK_RUNS))
    begin = time.perf_counter()
    long_runs = runs if quick else max(runs, LONG_RUNS)
    found = blocks.run(
        Plan(runs, long_runs, runs if quick else START_RUNS, seed, threads), progress
    )
    return Result(
        runs=runs,
        long_runs=long_runs,
        seed=seed,
        elapsed_s=time.perf_counter() - begin,
        **found,
    )


def _unprinted(cell: Cell, name: str, scores: Scores) -> dict[str, Any]:
    """Return a row of what the paper has no figures for."""
    return {k: v for k, v in row(cell, name, scores, None).items() if not k.startswith("paper_")}
