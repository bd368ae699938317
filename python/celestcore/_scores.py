"""What a campaign says: errors trial by trial, and pooled over the trials."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Generic, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from celestcore._check import FloatArray
from celestcore._optional import require

if TYPE_CHECKING:
    import pandas as pd

_RMS = ("rms", "rms_all", "rms_before", "rms_bias")
_MEANS = ("nees_attitude", "nees", "nis", "accepted", "seconds")
COLUMNS = (*_RMS, *_MEANS, "final_error")


class Scored(Protocol):
    """What the scores of every kind of campaign have."""

    @property
    def nees(self) -> FloatArray: ...
    @property
    def failures(self) -> dict[int, str]: ...
    def __len__(self) -> int: ...


S = TypeVar("S", bound=Scored)


@dataclass(frozen=True, eq=False)
class Pooled:
    """What all trials together say, each number with its standard error.

    The errors are estimated from the scatter between trials, so they hold whatever the correlation
    within a trial; they are NaN for a single one.

    Attributes
    ----------
    rms, rms_all, rms_before : ndarray (3,)
        Root mean square attitude error over all trials [rad]; see `Scores`.
    rms_bias : ndarray (3,)
        Of the bias [rad/s].
    nees_attitude, nees, nis, accepted, seconds : float
        Means over the trials.
    error : dict of str to ndarray or float
        Standard errors of the numbers above, by name.
    trials, failed : int
        How many there are, and how many of them are left out because the filter broke down.

    Examples
    --------
    >>> from celestcore import monte_carlo, simulate
    >>> truth = simulate.earth_pointing(20.0)
    >>> scenario = simulate.Scenario(truth, simulate.GyroErrors(1e-6), simulate.StarErrors(1e-5))
    >>> result = monte_carlo(scenario, scenario.navigator(), trials=3)
    >>> pooled = result["ekf"].pooled()
    >>> pooled.rms.shape, bool((pooled.error["rms"] > 0.0).all())
    ((3,), True)
    """

    rms: FloatArray
    rms_all: FloatArray
    rms_before: FloatArray
    rms_bias: FloatArray
    nees_attitude: float
    nees: float
    nis: float
    accepted: float
    seconds: float
    error: dict[str, Any]
    trials: int
    failed: int


@dataclass(frozen=True, eq=False)
class Scores:
    """One estimator's errors, trial by trial: the first axis is the trial.

    Errors are truth less estimate, in the body frame, over the time that is scored. A trial in
    which the filter broke down is NaN everywhere.

    Attributes
    ----------
    trial : ndarray of int (n,)
        Numbers of the trials.
    rms : ndarray (n, 3)
        Root mean square attitude error about x, y, z at the fixes, after they are used [rad]. A fix
        between two gyro samples counts at the second.
    rms_all : ndarray (n, 3)
        The same at every gyro sample [rad].
    rms_before : ndarray (n, 3)
        The same at the fixes, before they are used [rad].
    rms_bias : ndarray (n, 3)
        Root mean square bias error at every gyro sample [rad/s].
    nees_attitude : ndarray (n,)
        Mean normalised estimation error squared of the attitude at the fixes; expected 3.
    nees : ndarray (n,)
        Of attitude and bias; expected 6.
    nis : ndarray (n,)
        Mean normalised innovation squared of the fixes that were used; expected 3.
    accepted : ndarray (n,)
        Share of the fixes that the gate let through.
    final_error : ndarray (n, 6)
        Error at the end: attitude [rad], bias [rad/s].
    seconds : ndarray (n,)
        Time that the estimator took, without simulation and scoring [s].
    failures : dict of int to str
        Trials in which the filter broke down, with the reason.

    Notes
    -----
    Of a smoother, `rms_before`, `nis` and `accepted` are those of its forward filter.

    Examples
    --------
    >>> from celestcore import monte_carlo, simulate
    >>> truth = simulate.earth_pointing(20.0)
    >>> scenario = simulate.Scenario(truth, simulate.GyroErrors(1e-6), simulate.StarErrors(1e-5))
    >>> result = monte_carlo(scenario, scenario.navigator(), trials=3)
    >>> result["ekf"].rms.shape, result["ekf"].trial
    ((3, 3), array([0, 1, 2]))
    """

    trial: NDArray[np.int64]
    rms: FloatArray
    rms_all: FloatArray
    rms_before: FloatArray
    rms_bias: FloatArray
    nees_attitude: FloatArray
    nees: FloatArray
    nis: FloatArray
    accepted: FloatArray
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
        >>> from celestcore import monte_carlo, simulate
        >>> truth = simulate.earth_pointing(20.0)
        >>> scenario = simulate.Scenario(
        ...     truth, simulate.GyroErrors(1e-6), simulate.StarErrors(1e-5))
        >>> pooled = monte_carlo(scenario, scenario.navigator(), trials=4)["ekf"].pooled()
        >>> pooled.rms.shape, pooled.trials, pooled.failed
        ((3,), 4, 0)
        """
        values, errors = pool(self, _RMS, _MEANS)
        failed = int(np.isnan(self.nees).sum())
        return Pooled(**values, error=errors, trials=len(self), failed=failed)


def pool(
    scores: Scored, rms: Sequence[str], means: Sequence[str]
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return columns over all trials that did not fail, and their standard errors, by name.

    Those of `rms` are pooled as mean squares.
    """
    good = np.isfinite(scores.nees)
    values: dict[str, Any] = {}
    errors: dict[str, Any] = {}
    for name in rms:
        mean, error = _mean(getattr(scores, name)[good] ** 2)
        root = np.sqrt(mean)
        with np.errstate(all="ignore"):
            spread = np.where(mean > 0.0, error / (2.0 * root), 0.0)
        values[name], errors[name] = _plain(root), _plain(spread)
    for name in means:
        mean, error = _mean(getattr(scores, name)[good])
        values[name], errors[name] = _plain(mean), _plain(error)
    return values, errors


def _plain(value: FloatArray) -> FloatArray | float:
    return value if np.ndim(value) else float(value)


def _mean(values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the mean over the trials and its standard error."""
    n = len(values)
    empty = np.full(values.shape[1:], np.nan)
    if n == 0:
        return empty, empty
    error = np.std(values, axis=0, ddof=1) / np.sqrt(n) if n > 1 else empty
    return np.asarray(values.mean(axis=0)), np.asarray(error)


class Campaign(Mapping[str, S], Generic[S]):
    """Scores by the name of the estimator."""

    def __init__(
        self, scores: Mapping[str, S], *, seed: int, first: int, trials: int, skip: float
    ) -> None:
        self._scores = dict(scores)
        self.seed, self.first, self.trials, self.skip = seed, first, trials, skip

    def __getitem__(self, name: str) -> S:
        """Return one estimator's scores."""
        return self._scores[name]

    def __iter__(self) -> Iterator[str]:
        """Run over the names of the estimators."""
        return iter(self._scores)

    def __len__(self) -> int:
        """Return the number of estimators."""
        return len(self._scores)

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.trials} trials of {', '.join(self)}, seed {self.seed})"


class MonteCarlo(Campaign[Scores]):
    """What a campaign returns: `Scores` by the name of the estimator.

    A smoothed estimate stands under the name with ``"_smoothed"`` after it.

    Attributes
    ----------
    seed, first, trials : int
        What was run: trials ``first`` to ``first + trials - 1`` of the seed.
    skip : float
        Time left out of the scores [s].

    Examples
    --------
    >>> from celestcore import monte_carlo, simulate
    >>> truth = simulate.earth_pointing(20.0)
    >>> scenario = simulate.Scenario(truth, simulate.GyroErrors(1e-6), simulate.StarErrors(1e-5))
    >>> result = monte_carlo(scenario, scenario.navigator(), trials=3)
    >>> list(result), result["ekf"].rms.shape
    (['ekf'], (3, 3))
    """

    def pooled(self) -> dict[str, Pooled]:
        """Return each estimator's numbers over all trials; see `Scores.pooled`.

        Returns
        -------
        dict of str to Pooled

        Examples
        --------
        >>> from celestcore import monte_carlo, simulate
        >>> truth = simulate.earth_pointing(20.0)
        >>> gyro, star = simulate.GyroErrors(1e-6), simulate.StarErrors(1e-5)
        >>> scenario = simulate.Scenario(truth, gyro, star)
        >>> result = monte_carlo(scenario, scenario.navigator(), trials=3)
        >>> list(result.pooled())
        ['ekf']
        """
        return {name: scores.pooled() for name, scores in self.items()}

    def to_dataframe(self) -> pd.DataFrame:
        """Return one row for each estimator and trial.

        Columns ``estimator``, ``trial``, ``rms_x`` ... [rad], ``rms_bias_x`` ... [rad/s] and the
        other fields of `Scores`.

        Returns
        -------
        pandas.DataFrame

        Raises
        ------
        MissingDependencyError
            Without pandas.

        Examples
        --------
        >>> from celestcore import monte_carlo, simulate
        >>> truth = simulate.earth_pointing(20.0)
        >>> gyro, star = simulate.GyroErrors(1e-6), simulate.StarErrors(1e-5)
        >>> scenario = simulate.Scenario(truth, gyro, star)
        >>> result = monte_carlo(scenario, scenario.navigator(), trials=3)
        >>> result.to_dataframe()["trial"].tolist()
        [0, 1, 2]
        """
        return frame_of(_columns(name, scores) for name, scores in self.items())


def frame_of(tables: Iterable[Mapping[str, Any]]) -> pd.DataFrame:
    """Return tables one below the other."""
    pandas = require("pandas", extra="pandas", what="a data frame")
    frame: pd.DataFrame = pandas.concat([pandas.DataFrame(t) for t in tables], ignore_index=True)
    return frame


def _columns(name: str, scores: Scores) -> dict[str, Any]:
    return {"estimator": [name] * len(scores), **score_columns(scores)}


def score_columns(scores: Scores) -> dict[str, Any]:
    """Return a column for each number of a trial."""
    out: dict[str, Any] = {"trial": scores.trial}
    for column in (*_RMS, *_MEANS):
        values = getattr(scores, column)
        parts = {column: values} if values.ndim == 1 else split(column, values, ("x", "y", "z"))
        out.update(parts)
    axes = ("ax", "ay", "az", "bx", "by", "bz")
    return out | split("final_error", scores.final_error, axes)


def split(name: str, values: FloatArray, axes: tuple[str, ...]) -> dict[str, FloatArray]:
    return {f"{name}_{axis}": values[:, i] for i, axis in enumerate(axes)}


def gather(
    kind: Callable[..., S], names: Sequence[str], parts: Sequence[Mapping[str, Any]], first: int
) -> S:
    """Return one estimator's scores, put together from consecutive parts of a campaign."""
    columns = {name: np.concatenate([part[name] for part in parts]) for name in names}
    failures: dict[int, str] = {}
    begin = first
    for part in parts:
        failures |= {begin + row: reason for row, reason in part["failures"]}
        begin += len(part["nees"])
    return kind(trial=np.arange(first, begin, dtype=np.int64), failures=failures, **columns)
