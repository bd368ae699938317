"""Zhang, Chen and Wang (2019): GPS and star sensor, Tables 1 and 2, Figures 3 to 7.

>>> from celestcore.reproduce import gnss_star
>>> gnss_star.GPS  # 1-sigma of positions [m]
(1.0, 10.0)
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from celestcore.gnss import GnssStarScores
from celestcore.reproduce import _gnss_blocks as blocks
from celestcore.reproduce import _gnss_paper as paper
from celestcore.reproduce import _gnss_scores as scores
from celestcore.reproduce._gnss_model import Cell
from celestcore.reproduce._gnss_paper import GPS
from celestcore.reproduce._gnss_reference import AntennaAngles, Covariance, Reference, Slew
from celestcore.reproduce._gnss_series import Series
from celestcore.reproduce._gnss_targets import difference, outlier_ratios, slew_ratio, targets
from celestcore.reproduce._gnss_traces import Observed, Traces
from celestcore.reproduce._pool import trials
from celestcore.reproduce._target import Target
from celestcore.solution import package_version

__all__ = ["GPS", "RUNS", "Result", "run"]

Progress = Callable[[int, int, str], object]

RUNS = 100
"""Runs a cell, as the experiment is defined."""
QUICK_RUNS = 2


@dataclass(frozen=True, eq=False)
class Result:
    """What came out.

    Attributes
    ----------
    runs, seed : int
        Runs a cell; seed.
    cells : dict
        By scenario the navigators' scores run by run, by the names of the JSON.
    references : dict of float to Reference
        By GPS noise what raw sensors, kinematic filters and the paper's scheme come to.
    slew : Slew
        The Euler filters in nominal flight and in a slew.
    gyro_star : dict of str to Series
        Raw star fixes of the runs with a gyro.
    antennas : list of AntennaAngles
        Angles from antenna positions.
    least_squares : list of Covariance
        Attitudes from baselines against their covariance.
    observed : Observed
        What runs with a gyro see of the slow error.
    traces : Traces
        Single runs, for the figures.
    elapsed_s : float
        Time it took, s.

    Examples
    --------
    >>> from celestcore.reproduce import gnss_star
    >>> result = gnss_star.run(seed=3, quick=True)  # doctest: +SKIP
    >>> result.full, result.runs  # doctest: +SKIP
    (False, 2)
    """

    runs: int
    seed: int
    cells: dict[Cell, dict[str, GnssStarScores]]
    references: dict[float, Reference]
    slew: Slew
    gyro_star: dict[str, Series]
    antennas: list[AntennaAngles]
    least_squares: list[Covariance]
    observed: Observed
    traces: Traces
    elapsed_s: float

    @property
    def full(self) -> bool:
        """Whether there were enough runs to judge the targets."""
        return self.runs >= RUNS

    @cached_property
    def figures(self) -> dict[str, scores.Figure]:
        """Every figure by its name, with ``_1m`` or ``_10m`` for the GPS noise at the end."""
        return scores.figures(self)

    def targets(self) -> list[Target]:
        """Return what was asked and what came out.

        Returns
        -------
        list of Target
            With ``block``, ``asked``, ``found`` and ``met``.

        Examples
        --------
        >>> from celestcore.reproduce import gnss_star
        >>> result = gnss_star.run(seed=3, quick=True)  # doctest: +SKIP
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
        >>> from celestcore.reproduce import gnss_star
        >>> result = gnss_star.run(seed=3, quick=True)  # doctest: +SKIP
        >>> result.to_dict()["experiment"]  # doctest: +SKIP
        'gnss-star'
        """
        references = self.references.items()
        return {
            "experiment": "gnss-star",
            "paper": paper.CITATION,
            "version": package_version(),
            "runs": self.runs,
            "seed": self.seed,
            "elapsed_s": self.elapsed_s,
            "figures": {key: figure.to_dict() for key, figure in self.figures.items()},
            "attitude_difference_1m_10m": difference(self),
            "outlier_ratios_1m_10m": outlier_ratios(self),
            "slew_ratio": slew_ratio(self),
            "kinematic_jerk_psd": {
                f"{gps:g}m": [r.kinematic.psd, r.kinematic_smoothed.psd] for gps, r in references
            },
            "paper_scheme_jerk_psd": {f"{gps:g}m": r.literal.psd for gps, r in references},
            "antenna_angles_rad": [row._asdict() for row in self.antennas],
            "least_squares": [row._asdict() for row in self.least_squares],
            "observability": {
                "first_harmonic": self.observed.first.tolist(),
                "all": self.observed.every.tolist(),
                "reported_unobservable": self.observed.unobservable,
            },
            "failures": self._failures(),
            "targets": [target.to_dict() for target in self.targets()],
        }

    def _failures(self) -> dict[str, int]:
        """Return how many runs broke down, of the estimators of which any did."""
        return {
            f"{cell.name}_{cell.gps:g}m_{name}": len(found.failures)
            for cell, every in self.cells.items()
            for name, found in every.items()
            if found.failures
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
        Runs a cell; 100, with `quick` 2.
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
    >>> from celestcore.reproduce import gnss_star
    >>> result = gnss_star.run(seed=3, quick=True)  # doctest: +SKIP
    >>> result.figures["position_20x20_1m"].series.value  # doctest: +SKIP
    """
    runs = trials(runs, seed, quick=quick, defined=(RUNS, QUICK_RUNS))
    begin = time.perf_counter()
    found = blocks.run(blocks.Plan(runs, seed, threads), progress)
    return Result(runs=runs, seed=seed, elapsed_s=time.perf_counter() - begin, **found)
