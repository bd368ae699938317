"""What a campaign with GNSS and star sensor says: errors trial by trial, and over all of them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from celestcore import quaternion
from celestcore._check import FloatArray
from celestcore._scores import Campaign, frame_of, pool, split
from celestcore.gnss.solution import GnssStarSolution

if TYPE_CHECKING:
    import pandas as pd

    from celestcore.gnss.scenario import GnssStarTrial

_RMS = ("rms_position", "rms_velocity", "rms_attitude")
_MEANS = (
    "max_position",
    "max_velocity",
    "max_attitude",
    "nees",
    "nees_attitude",
    "nis",
    "nis_attitude",
    "rejected",
    "seconds",
)
COLUMNS = (*_RMS, *_MEANS)
THREE = ("rms_attitude", "max_attitude")


@dataclass(frozen=True, eq=False)
class GnssStarPooled:
    """What all trials together say, each number with its standard error.

    Attributes
    ----------
    rms_position, rms_velocity : float
        Root mean square of the error's length over all trials [m], [m/s].
    rms_attitude : ndarray (3,)
        Root mean square attitude error about x, y, z of the body [rad]: for small angles roll,
        pitch and yaw.
    max_position, max_velocity : float
        Means over the trials of the largest error [m], [m/s].
    max_attitude : ndarray (3,)
        The same of the attitude [rad].
    nees, nees_attitude, nis, nis_attitude, rejected, seconds : float
        Means over the trials; see `GnssStarScores`.
    error : dict of str to float or ndarray
        Standard errors of the numbers above, by name, from the scatter between trials.
    trials, failed : int
        How many there are, and how many of them are left out because a filter broke down.

    Examples
    --------
    >>> import celestcore as cc
    >>> result = cc.GnssStarNavigator().monte_carlo(cc.gnss.GnssStarScenario(), trials=3, seed=1)
    >>> pooled = result["ekf"].pooled()
    >>> 0.1 < pooled.rms_position < 0.6, pooled.rms_attitude.shape
    (True, (3,))
    """

    rms_position: float
    rms_velocity: float
    rms_attitude: FloatArray
    max_position: float
    max_velocity: float
    max_attitude: FloatArray
    nees: float
    nees_attitude: float
    nis: float
    nis_attitude: float
    rejected: float
    seconds: float
    error: dict[str, Any]
    trials: int
    failed: int


@dataclass(frozen=True, eq=False)
class GnssStarScores:
    """One estimator's errors, trial by trial, over the epochs that are scored.

    Attributes
    ----------
    trial : ndarray of int (n,)
        Numbers of the trials.
    rms_position, max_position : ndarray (n,)
        Root mean square and largest length of the position's error [m].
    rms_velocity, max_velocity : ndarray (n,)
        The same of the velocity [m/s].
    rms_attitude, max_attitude : ndarray (n, 3)
        The same of the attitude's error about x, y, z of the body [rad]; NaN without attitude.
    nees : ndarray (n,)
        Mean normalised estimation error squared of position and velocity; expected 6.
    nees_attitude : ndarray (n,)
        Of the attitude; expected 3.
    nis, nis_attitude : ndarray (n,)
        Mean normalised innovation squared of the measurements used; expected 3.
    rejected : ndarray (n,)
        Share of the receiver's positions and velocities that the gate refused.
    seconds : ndarray (n,)
        Time that the core took [s].
    failures : dict of int to str
        Trials in which a filter broke down, with the reason; they are NaN everywhere.

    Notes
    -----
    Of a smoother `nis`, `nis_attitude` and `rejected` are those of its forward pass.

    Examples
    --------
    >>> import celestcore as cc
    >>> result = cc.GnssStarNavigator().monte_carlo(cc.gnss.GnssStarScenario(), trials=3, seed=1)
    >>> result["ekf"].rms_attitude.shape, result["ekf"].trial
    ((3, 3), array([0, 1, 2]))
    """

    trial: NDArray[np.int64]
    rms_position: FloatArray
    rms_velocity: FloatArray
    rms_attitude: FloatArray
    max_position: FloatArray
    max_velocity: FloatArray
    max_attitude: FloatArray
    nees: FloatArray
    nees_attitude: FloatArray
    nis: FloatArray
    nis_attitude: FloatArray
    rejected: FloatArray
    seconds: FloatArray
    failures: dict[int, str]

    def __len__(self) -> int:
        """Return the number of trials."""
        return len(self.trial)

    def pooled(self) -> GnssStarPooled:
        """Return the numbers over all trials, with standard errors.

        Returns
        -------
        GnssStarPooled

        Examples
        --------
        >>> one, three = np.ones(2), np.ones((2, 3))
        >>> made = GnssStarScores(np.arange(2), one, one, three, one, one, three, *[one] * 6, {})
        >>> made.pooled().rms_position
        1.0
        """
        values, errors = pool(self, _RMS, _MEANS)
        failed = int(np.isnan(self.nees).sum())
        return GnssStarPooled(**values, error=errors, trials=len(self), failed=failed)


class GnssStarMonteCarlo(Campaign[GnssStarScores]):
    """What a campaign returns: `GnssStarScores` by the name of the estimator.

    A smoothed estimate stands under the name with ``"_smoothed"`` after it.

    Attributes
    ----------
    seed, first, trials : int
        What was run: trials ``first`` to ``first + trials - 1`` of the seed.
    skip : float
        Time at the start that is left out of the filters' scores, not of the smoothers' [s].

    Examples
    --------
    >>> GnssStarMonteCarlo({}, seed=1, first=0, trials=0, skip=0.0).pooled()
    {}
    """

    def pooled(self) -> dict[str, GnssStarPooled]:
        """Return each estimator's numbers over all trials; see `GnssStarScores.pooled`.

        Returns
        -------
        dict of str to GnssStarPooled

        Examples
        --------
        >>> GnssStarMonteCarlo({}, seed=1, first=0, trials=0, skip=0.0).pooled()
        {}
        """
        return {name: scores.pooled() for name, scores in self.items()}

    def to_dataframe(self) -> pd.DataFrame:
        """Return one row for each estimator and trial.

        Returns
        -------
        pandas.DataFrame

        Raises
        ------
        MissingDependencyError
            Without pandas.

        Examples
        --------
        >>> one, three = np.ones(2), np.ones((2, 3))
        >>> made = GnssStarScores(np.arange(2), one, one, three, one, one, three, *[one] * 6, {})
        >>> result = GnssStarMonteCarlo({"ekf": made}, seed=1, first=0, trials=2, skip=0.0)
        >>> result.to_dataframe()["trial"].tolist()
        [0, 1]
        """
        return frame_of(_columns(name, scores) for name, scores in self.items())


def _columns(name: str, scores: GnssStarScores) -> dict[str, Any]:
    out: dict[str, Any] = {"estimator": [name] * len(scores), "trial": scores.trial}
    for column in COLUMNS:
        value = getattr(scores, column)
        out |= split(column, value, ("x", "y", "z")) if column in THREE else {column: value}
    return out


def nees_of(error: FloatArray, covariance: FloatArray) -> float:
    """Return the mean normalised square of errors (n, k) with covariances (n, k, k)."""
    solved = np.linalg.solve(covariance, error[:, :, None])[:, :, 0]
    return float(np.mean(np.einsum("ij,ij->i", error, solved)))


def attitude_error(q: FloatArray, truth: FloatArray) -> FloatArray:
    """Return truth less estimate as rotation vectors about the estimate's body axes (n, 3)."""
    return quaternion.log(quaternion.multiply(quaternion.conjugate(q), truth))


def score(sol: GnssStarSolution, trial: GnssStarTrial, skip: float) -> dict[str, Any]:
    """Return the errors of a solution at a trial's own epochs after `skip` seconds."""
    use = sol.t - sol.t[0] > skip if skip > 0.0 else np.ones(len(sol), bool)
    at = np.searchsorted(trial.t, sol.t[use])
    error_r, error_v = sol.r[use] - trial.r_i[at], sol.v[use] - trial.v_i[at]
    r, v = np.linalg.norm(error_r, axis=1), np.linalg.norm(error_v, axis=1)
    assert sol.orbit_covariance is not None
    out: dict[str, Any] = {
        "rms_position": float(np.sqrt(np.mean(r * r))),
        "rms_velocity": float(np.sqrt(np.mean(v * v))),
        "max_position": float(r.max()),
        "max_velocity": float(v.max()),
        "nees": nees_of(np.hstack([error_r, error_v]), sol.orbit_covariance[use, :6, :6]),
        "nis": float(np.mean(sol.gnss.nis[sol.gnss.accepted])),
        "rejected": float(np.mean(~sol.gnss.accepted)),
        "seconds": sol.elapsed_s,
        "rms_attitude": np.full(3, np.nan),
        "max_attitude": np.full(3, np.nan),
        "nees_attitude": np.nan,
        "nis_attitude": np.nan,
    }
    if sol.q is not None and sol.attitude_covariance is not None:
        e = attitude_error(sol.q[use], trial.q_ib[at])
        out["rms_attitude"] = np.sqrt(np.mean(e * e, axis=0))
        out["max_attitude"] = np.abs(e).max(axis=0)
        out["nees_attitude"] = nees_of(e, sol.attitude_covariance[use, :3, :3])
        out["nis_attitude"] = float(np.mean(sol.attitude.nis[sol.attitude.accepted]))
    return out
