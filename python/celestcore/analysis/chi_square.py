"""Are errors as large as the covariance says? NEES and NIS with their chi-square bounds."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from celestcore import _core
from celestcore._check import array, number
from celestcore.errors import InputError

if TYPE_CHECKING:
    from celestcore.solution import Solution

__all__ = ["Consistency", "consistency", "nees", "nis"]

Array = NDArray[np.float64]


def nees(error: ArrayLike, covariance: ArrayLike) -> Array:
    """Return the normalised estimation error squared, ``e' P^-1 e``.

    Parameters
    ----------
    error : array_like (..., n)
        True less estimated error state, for example ``quaternion.log(conj(q_hat) * q)`` [rad], body
        frame, and bias less estimated bias [rad/s].
    covariance : array_like (..., n, n)
        What the filter says of it, same order. Leading axes broadcast.

    Returns
    -------
    ndarray (...)
        Of mean n, if the filter is consistent; ``nees(...) / n`` of mean 1.

    Raises
    ------
    InputError
        If shapes do not fit, something is not finite, or a covariance is not positive definite.

    Notes
    -----
    Bar-Shalom, Li and Kirubarajan, *Estimation with Applications to Tracking and Navigation*, 2001,
    eq. 5.4.2-1.

    Examples
    --------
    >>> nees([3.0, 4.0], [[9.0, 0.0], [0.0, 4.0]])
    array(5.)
    """
    e, p = array(error, "error"), array(covariance, "covariance")
    if e.ndim < 1 or p.ndim < 2 or p.shape[-2:] != (e.shape[-1], e.shape[-1]):
        raise InputError(
            f"has shape {p.shape}, needed is (..., n, n) for errors (..., n) of shape {e.shape}",
            field="covariance",
        )
    try:
        np.broadcast_shapes(e.shape[:-1], p.shape[:-2])
    except ValueError:
        raise InputError(
            f"has leading axes {p.shape[:-2]}, which do not go with {e.shape[:-1]} of the errors",
            field="covariance",
        ) from None
    _fail_at(~np.isfinite(e).all(axis=-1), "error", "must be finite")
    _fail_at(~np.isfinite(p).all(axis=(-1, -2)), "covariance", "must be finite")
    diagonal = np.diagonal(p, axis1=-2, axis2=-1)
    message = "must be positive definite"
    _fail_at(~(diagonal > 0.0).all(axis=-1), "covariance", message)
    size = np.sqrt(diagonal)  # attitude and bias differ by orders: correlations do not
    scaled = p / (size[..., :, None] * size[..., None, :])
    try:
        root = np.linalg.cholesky(scaled)
    except np.linalg.LinAlgError:
        _fail_at(~(np.linalg.eigvalsh(scaled)[..., 0] > 0.0), "covariance", message)
        raise InputError(message, field="covariance") from None
    white = np.linalg.solve(root, (e / size)[..., None])[..., 0]
    return np.asarray(np.sum(white * white, axis=-1))


def _fail_at(bad: Any, field: str, message: str) -> None:
    """Raise for the first row, counted along flattened leading axes, that is bad."""
    rows = np.asarray(bad)
    if rows.any():
        raise InputError(message, field=field, row=int(np.argmax(rows)) if rows.ndim else None)


def nis(solution: Solution, sensor: str | None = None) -> Array:
    """Return the normalised innovations squared of the accepted measurements.

    Parameters
    ----------
    solution : Solution
    sensor : str, optional
        Of one sensor, by its name in ``solution.sensor_names``; by default of all.

    Returns
    -------
    ndarray (m,)
        Chi-square distributed with 3 degrees of freedom for a star camera and 2 for a direction, if
        the filter's model is right; and independent of each other.

    Raises
    ------
    InputError
        If the sensor is unknown, or the measurements were not kept.

    Examples
    --------
    >>> import celestcore as cc
    >>> log = cc.sample("fermi")
    >>> sol = cc.Settings.from_log(log).navigator().run(log)
    >>> len(nis(sol, "star")) == sol.counts["accepted"]
    True
    """
    return solution.nis[accepted_rows(solution, sensor)]


def accepted_rows(solution: Solution, sensor: str | None) -> NDArray[np.bool_]:
    """Say which measurements were accepted, of all sensors or of one (m,)."""
    if hasattr(solution, "innovations"):
        solution._need("nis", "this")
    rows = solution.accepted & np.isfinite(solution.nis)
    if sensor is None:
        return rows
    if sensor not in solution.sensor_names:
        known = ", ".join(solution.sensor_names) or "none"
        raise InputError(f"no such sensor; there are {known}", field="sensor", value=sensor)
    return np.asarray(rows & (solution.sensor == solution.sensor_names.index(sensor)))


@dataclass(frozen=True, eq=False)
class Consistency:
    """Normalised squared errors against their chi-square law; every mean is per degree of freedom.

    Attributes
    ----------
    mean : float
        Sum of all values over the sum of their degrees of freedom: 1 if consistent, above if the
        filter is overconfident, below if it is too careful.
    bounds : (float, float)
        Between these lies `mean` with `probability`, if all values are independent. NIS are; NEES
        along a run are not: use `standard_error`, or `epoch` with `epoch_bounds`.
    p_value : float
        Two-sided probability of a `mean` at least so far out, under the same condition.
    standard_error : float
        Of `mean`, from the scatter of the runs' means: holds for any correlation along a run. NaN
        for one run.
    run : ndarray (runs,)
        Mean of each run.
    epoch : ndarray (times,)
        Mean over the runs at each time.
    epoch_bounds : ndarray (times, 2)
        Between these lies an entry of `epoch` with `probability`.
    inside : float
        Share of the times with `epoch` inside its bounds: about `probability` if consistent.
    probability : float

    Examples
    --------
    >>> import numpy as np
    >>> values = np.random.default_rng(1).chisquare(3, size=(20, 500))
    >>> consistency(values, dof=3).consistent
    True
    """

    mean: float
    bounds: tuple[float, float]
    p_value: float
    standard_error: float
    run: Array
    epoch: Array
    epoch_bounds: Array
    inside: float
    probability: float

    @property
    def consistent(self) -> bool:
        """Whether `mean` lies within `bounds`."""
        return self.bounds[0] <= self.mean <= self.bounds[1]

    def __str__(self) -> str:
        return (
            f"mean {self.mean:.4g} per degree of freedom, "
            f"{100 * self.probability:g} % bounds {self.bounds[0]:.4g} to {self.bounds[1]:.4g}; "
            f"{100 * self.inside:.1f} % of the times inside theirs"
        )


def consistency(
    value: Solution | ArrayLike,
    dof: ArrayLike | None = None,
    probability: float = 0.95,
    *,
    sensor: str | None = None,
) -> Consistency:
    """Compare NEES or NIS with two-sided chi-square bounds, over runs and time.

    Parameters
    ----------
    value : Solution or array_like (runs, times) or (times,)
        Normalised squares: NEES of Monte Carlo runs at common times, NIS of one run; or a solution,
        whose NIS are taken.
    dof : int or array_like (times,)
        Degrees of freedom: 3 for attitude NEES, 6 with the bias, as measured for NIS. Comes with a
        solution.
    probability : float
        That a consistent filter stays within the bounds.
    sensor : str, optional
        With a solution: only this sensor's measurements.

    Returns
    -------
    Consistency

    Raises
    ------
    InputError
        If there are no values, one is negative or not finite, or `dof` is missing.

    Notes
    -----
    Bar-Shalom, Li and Kirubarajan, *Estimation with Applications to Tracking and Navigation*, 2001,
    section 5.4.2: the sum of N values of m degrees of freedom is chi-square with N m.

    Examples
    --------
    >>> import numpy as np
    >>> draws = np.random.default_rng(1).chisquare(3, size=(50, 200))
    >>> result = consistency(draws, 3)
    >>> result.consistent, bool(abs(result.mean - 1.0) < 4 * result.standard_error)
    (True, True)
    """
    p = number(probability, "probability", above=0.0)
    if p >= 1.0:
        raise InputError("must be below 1", field="probability", value=p)
    values, m = _values(value, dof, sensor)
    runs = len(values)
    total = runs * float(m.sum())
    low, high = _bounds(total, p)
    below = _core.chi2_cdf(float(values.sum()), total)
    mean_run = values.sum(axis=1) / m.sum()
    epoch = values.sum(axis=0) / (runs * m)
    each = {k: _bounds(runs * k, p) for k in np.unique(m).tolist()}
    epoch_bounds = np.array([each[k] for k in m.tolist()])
    inside = (epoch >= epoch_bounds[:, 0]) & (epoch <= epoch_bounds[:, 1])
    scatter = float(mean_run.std(ddof=1) / np.sqrt(runs)) if runs > 1 else np.nan
    return Consistency(
        mean=float(values.sum() / total),
        bounds=(low, high),
        p_value=float(min(1.0, 2.0 * min(below, 1.0 - below))),
        standard_error=scatter,
        run=mean_run,
        epoch=epoch,
        epoch_bounds=epoch_bounds,
        inside=float(np.mean(inside)),
        probability=p,
    )


def _values(value: Any, dof: ArrayLike | None, sensor: str | None) -> tuple[Array, Array]:
    """Return values (runs, times) and their degrees of freedom (times,)."""
    if hasattr(value, "nis"):
        if dof is not None:
            raise InputError("comes with the solution; leave it out", field="dof")
        rows = accepted_rows(value, sensor)
        value, dof = value.nis[rows], value.dof[rows]
    elif sensor is not None:
        raise InputError("goes with a solution", field="sensor", value=sensor)
    values = array(value, "value")
    if values.ndim not in (1, 2) or values.size == 0:
        raise InputError(
            f"has shape {values.shape}, needed is (runs, times) or (times,), not empty",
            field="value",
        )
    values = np.atleast_2d(values)
    _fail_at(~(np.isfinite(values) & (values >= 0.0)), "value", "must be finite and not negative")
    if dof is None:
        raise InputError("is needed: the degrees of freedom of a value", field="dof")
    m = array(dof, "dof")
    if m.ndim > 1 or m.size not in (1, values.shape[1]):
        raise InputError(f"needs one number, or one for each of {values.shape[1]}", field="dof")
    _fail_at(~(m >= 1.0), "dof", "must be at least 1")
    return values, np.array(np.broadcast_to(m, values.shape[1:]))


def _bounds(dof: float, probability: float) -> tuple[float, float]:
    """Return what a chi-square number over its degrees of freedom stays between."""
    tail = 0.5 * (1.0 - probability)
    low, high = (_core.chi2_quantile(q, dof) / dof for q in (tail, 1.0 - tail))
    return float(low), float(high)
