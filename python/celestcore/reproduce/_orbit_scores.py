"""What a filter scored in one cell, run by run, and the rows of the JSON."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any, NamedTuple

import numpy as np

from celestcore.reproduce import _orbit_paper as paper
from celestcore.reproduce._orbit_model import LOST, PUBLISHED, SMOOTHED, Array, Cell

MEAN_OVER_RMS = 0.92
"""Mean length over rms length of a normal error in three directions: sqrt(8 / (3 pi))."""
DOF = 6


class Bound(NamedTuple):
    """Posterior Cramer-Rao bounds of one cell with perfect dynamics: rms position [m]."""

    filter: float
    smoother: float


@dataclass(frozen=True, eq=False)
class Scores:
    """One filter's scores in one cell; the axis is the run, NaN where the filter broke down.

    Attributes
    ----------
    mean_position, max_position, rms_position : array (runs,)
        Of a run's position errors [m].
    mean_velocity, max_velocity : array (runs,)
        Of a run's velocity errors [m/s].
    nees : array (runs,)
        Mean over a run; 6 for a filter whose errors are what it says.
    accepted : array (runs,)
        Share of the measurements that were used.
    ess : array (runs,)
        Mean effective sample size; NaN for filters without particles.
    seconds : array (runs,)
        Time in the filter, all orbits.
    """

    mean_position: Array
    max_position: Array
    rms_position: Array
    mean_velocity: Array
    max_velocity: Array
    nees: Array
    accepted: Array
    ess: Array
    seconds: Array

    @classmethod
    def of(cls, found: Any) -> Scores:
        """Take the columns that are needed here from a campaign's."""
        return cls(**{f.name: np.asarray(getattr(found, f.name), float) for f in fields(cls)})

    @classmethod
    def joined(cls, parts: list[Scores]) -> Scores:
        """Put the runs of several campaigns one after the other."""
        names = [f.name for f in fields(cls)]
        return cls(**{n: np.concatenate([getattr(p, n) for p in parts]) for n in names})

    @property
    def good(self) -> Array:
        """Which runs ended well, as numbers of runs."""
        return np.asarray(np.flatnonzero(np.isfinite(self.mean_position)))

    @property
    def failures(self) -> int:
        """How many runs broke down."""
        return len(self.mean_position) - len(self.good)

    @property
    def lost(self) -> int:
        """How many runs broke down or lost the satellite."""
        return int(np.sum(~(self.mean_position < LOST)))

    def median(self) -> float:
        """Return the median of the runs' mean position errors [m]."""
        return float(np.median(np.nan_to_num(self.mean_position, nan=np.inf)))

    def mean(self, name: str = "mean_position") -> float:
        """Return the mean of a column over the runs; NaN if there is none."""
        good = getattr(self, name)[self.good]
        return float(np.mean(good)) if len(good) else float("nan")

    def scatter(self, name: str = "mean_position") -> float:
        """Return the standard deviation of a column from run to run."""
        good = getattr(self, name)[self.good]
        return float(np.std(good, ddof=1)) if len(good) > 1 else float("nan")

    def error(self, name: str = "mean_position") -> float:
        """Return the standard error of `mean`."""
        return self.scatter(name) / float(np.sqrt(max(len(self.good), 1)))

    def rms(self) -> float:
        """Return the rms position error over all runs [m]."""
        good = self.rms_position[self.good]
        return float(np.sqrt(np.mean(good**2))) if len(good) else float("nan")

    def rms_error(self) -> float:
        """Return the standard error of `rms`, from the runs' scatter."""
        squares = self.rms_position[self.good] ** 2
        if len(squares) < 2:
            return float("nan")
        error = np.std(squares, ddof=1) / np.sqrt(len(squares))
        return float(error / (2.0 * np.sqrt(np.mean(squares))))


def bound_of(name: str, bound: Bound | None) -> float | None:
    """Return the bound that goes with a filter, rms position [m]."""
    if bound is None:
        return None
    return bound.smoother if name in SMOOTHED.values() else bound.filter


def row(cell: Cell, name: str, scores: Scores, bound: Bound | None) -> dict[str, Any]:
    """Return one filter's row of Table 1 or 2 for the JSON."""
    printed = paper.row(cell.period, cell.distribution, PUBLISHED.get(name))
    limit = bound_of(name, bound)
    return {
        "period_s": cell.period,
        "filter": name,
        "noise": cell.noise,
        "distribution": cell.distribution,
        "mean_pos_m": plain(scores.mean()),
        "max_pos_m": plain(scores.mean("max_position")),
        "mean_vel_m_s": plain(scores.mean("mean_velocity")),
        "max_vel_m_s": plain(scores.mean("max_velocity")),
        "rms_pos_m": plain(scores.rms()),
        "rms_se_m": plain(scores.rms_error()),
        "run_sd_m": plain(scores.scatter()),
        "nees": plain(scores.mean("nees")),
        "nees_over_6": plain(scores.mean("nees") / DOF),
        "accepted": plain(scores.mean("accepted")),
        "ess": plain(scores.mean("ess")),
        "failures": scores.failures,
        "lost": scores.lost,
        "median_pos_m": plain(scores.median()),
        "paper_mean_pos_m": printed and printed.mean_pos,
        "paper_max_pos_m": printed and printed.max_pos,
        "paper_mean_vel_m_s": printed and printed.mean_vel,
        "paper_max_vel_m_s": printed and printed.max_vel,
        "bound_m": None if limit is None else MEAN_OVER_RMS * limit,
        "bound_rms_m": limit,
    }


def plain(value: Any) -> float | None:
    """Return a number for JSON: None if it is not finite."""
    return float(value) if np.isfinite(value) else None
