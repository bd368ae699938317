"""What a campaign over an orbit says: errors trial by trial, and over all of them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from celestcore._check import FloatArray
from celestcore._scores import Campaign, frame_of, pool, split

if TYPE_CHECKING:
    import pandas as pd

_RMS = ("rms_position", "rms_velocity")
_MEANS = (
    "mean_position",
    "max_position",
    "mean_velocity",
    "max_velocity",
    "nees",
    "nis",
    "accepted",
    "ess",
    "seconds",
)
COLUMNS = (*_RMS, *_MEANS, "final_error")


@dataclass(frozen=True, eq=False)
class Pooled:
    """What all trials together say, each number with its standard error.

    Attributes
    ----------
    mean_position, max_position : float
        Means over the trials of the mean and of the largest position error [m].
    rms_position : float
        Root mean square position error over all trials [m].
    mean_velocity, max_velocity, rms_velocity : float
        The same of the velocity [m/s].
    nees, nis, accepted, ess, seconds : float
        Means over the trials; see `Scores`.
    error : dict of str to float
        Standard errors of the numbers above, by name, from the scatter between trials; NaN for a
        single one.
    trials, failed : int
        How many there are, and how many of them are left out because the filter broke down.

    Examples
    --------
    >>> import celestcore as cc
    >>> scenario = cc.celestial.Scenario(
    ...     cc.orbit.propagate(cc.orbit.ForceModel.j2(), None, [7e6, 0, 0], [0, 4e3, 6.4e3],
    ...                        np.arange(0.0, 600.0, 60.0)),
    ...     cc.celestial.SkyCamera(cc.StarCatalogue.random(5000)), cc.StarHorizon(), period=60.0)
    >>> dynamics = cc.orbit.OrbitDynamics(cc.orbit.ForceModel.j2(), accel_psd=1e-9)
    >>> nav = cc.CelestialNavigator(cc.EKF(), dynamics, cc.StarHorizon())
    >>> pooled = cc.celestial.monte_carlo(scenario, {"ekf": nav}, trials=3)["ekf"].pooled()
    >>> pooled.mean_position < pooled.rms_position < pooled.max_position, pooled.failed
    (True, 0)
    """

    mean_position: float
    max_position: float
    rms_position: float
    mean_velocity: float
    max_velocity: float
    rms_velocity: float
    nees: float
    nis: float
    accepted: float
    ess: float
    seconds: float
    error: dict[str, float]
    trials: int
    failed: int


@dataclass(frozen=True, eq=False)
class Scores:
    """One estimator's errors, trial by trial, over the epochs that are scored.

    Errors are lengths of vectors, estimate less truth. A trial in which the filter broke down is
    NaN everywhere.

    Attributes
    ----------
    trial : ndarray of int (n,)
        Numbers of the trials.
    mean_position, max_position, rms_position : ndarray (n,)
        Mean, largest and root mean square position error [m].
    mean_velocity, max_velocity, rms_velocity : ndarray (n,)
        The same of the velocity [m/s].
    nees : ndarray (n,)
        Mean normalised estimation error squared; expected 6.
    nis : ndarray (n,)
        Squared normalised innovations over their degrees of freedom, of the measurements used;
        expected 1.
    accepted : ndarray (n,)
        Share of the angles that were used.
    ess : ndarray (n,)
        Mean effective number of particles over all measurements; NaN for other filters.
    final_error : ndarray (n, 6)
        Estimate less truth at the end [m], [m/s].
    seconds : ndarray (n,)
        Time that the estimator took, without simulation and scoring [s].
    failures : dict of int to str
        Trials in which the filter broke down, with the reason.

    Notes
    -----
    Of a smoother, `nis` and `accepted` are those of its forward filter.

    Examples
    --------
    >>> import celestcore as cc
    >>> scenario = cc.celestial.Scenario(
    ...     cc.orbit.propagate(cc.orbit.ForceModel.j2(), None, [7e6, 0, 0], [0, 4e3, 6.4e3],
    ...                        np.arange(0.0, 600.0, 60.0)),
    ...     cc.celestial.SkyCamera(cc.StarCatalogue.random(5000)), cc.StarHorizon(), period=60.0)
    >>> dynamics = cc.orbit.OrbitDynamics(cc.orbit.ForceModel.j2(), accel_psd=1e-9)
    >>> nav = cc.CelestialNavigator(cc.EKF(), dynamics, cc.StarHorizon())
    >>> scores = cc.celestial.monte_carlo(scenario, {"ekf": nav}, trials=3)["ekf"]
    >>> scores.mean_position.shape, scores.trial
    ((3,), array([0, 1, 2]))
    """

    trial: NDArray[np.int64]
    mean_position: FloatArray
    max_position: FloatArray
    rms_position: FloatArray
    mean_velocity: FloatArray
    max_velocity: FloatArray
    rms_velocity: FloatArray
    nees: FloatArray
    nis: FloatArray
    accepted: FloatArray
    ess: FloatArray
    final_error: FloatArray
    seconds: FloatArray
    failures: dict[int, str]

    def __len__(self) -> int:
        """Return the number of trials."""
        return len(self.trial)

    def pooled(self) -> Pooled:
        """Return the numbers over all trials, with standard errors.

        Root mean squares are pooled as mean squares; the error of the root follows to first order.

        Returns
        -------
        Pooled

        Examples
        --------
        >>> zeros = np.zeros(2)
        >>> made = Scores(np.arange(2), *[zeros + 1.0] * 10, np.zeros((2, 6)), zeros, {})
        >>> made.pooled().mean_position
        1.0
        """
        values, errors = pool(self, _RMS, _MEANS)
        failed = int(np.isnan(self.nees).sum())
        return Pooled(**values, error=errors, trials=len(self), failed=failed)


class MonteCarlo(Campaign[Scores]):
    """What a campaign over an orbit returns: `Scores` by the name of the estimator.

    A smoothed estimate stands under the name with ``"_smoothed"`` after it.

    Attributes
    ----------
    seed, first, trials : int
        What was run: trials ``first`` to ``first + trials - 1`` of the seed.
    skip : float
        Time at the start that is left out of the scores [s].

    Examples
    --------
    >>> MonteCarlo({}, seed=1, first=0, trials=0, skip=0.0).pooled()
    {}
    """

    def pooled(self) -> dict[str, Pooled]:
        """Return each estimator's numbers over all trials; see `Scores.pooled`.

        Returns
        -------
        dict of str to Pooled

        Examples
        --------
        >>> MonteCarlo({}, seed=1, first=0, trials=0, skip=0.0).pooled()
        {}
        """
        return {name: scores.pooled() for name, scores in self.items()}

    def to_dataframe(self) -> pd.DataFrame:
        """Return one row for each estimator and trial.

        Columns ``estimator``, ``trial`` and the fields of `Scores`; the final error as
        ``final_error_rx`` ... [m], ``final_error_vx`` ... [m/s].

        Returns
        -------
        pandas.DataFrame

        Raises
        ------
        MissingDependencyError
            Without pandas.

        Examples
        --------
        >>> zeros = np.zeros(2)
        >>> made = Scores(np.arange(2), *[zeros] * 10, np.zeros((2, 6)), zeros, {})
        >>> result = MonteCarlo({"ekf": made}, seed=1, first=0, trials=2, skip=0.0)
        >>> result.to_dataframe()["trial"].tolist()
        [0, 1]
        """
        return frame_of(_columns(name, scores) for name, scores in self.items())


def _columns(name: str, scores: Scores) -> dict[str, Any]:
    out: dict[str, Any] = {"estimator": [name] * len(scores), "trial": scores.trial}
    out.update({column: getattr(scores, column) for column in (*_RMS, *_MEANS)})
    axes = ("rx", "ry", "rz", "vx", "vy", "vz")
    return out | split("final_error", scores.final_error, axes)
