"""Allan deviation of a gyro's log, and the noise densities fitted to it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from celestcore import _core
from celestcore._arguments import checked
from celestcore._check import array, number
from celestcore.analysis._allan_law import ARW, RRW, TERMS, scatter, slopes
from celestcore.errors import InputError

if TYPE_CHECKING:
    from celestcore.log import SensorLog
    from celestcore.sensors import Gyro

__all__ = ["AllanDeviation", "AllanFit", "allan_deviation", "fit_allan"]

Array = NDArray[np.float64]

_UNIFORM = 0.01
_SHORTEST = 16
_APART = 1.3
_SEEN = 3.0


@dataclass(frozen=True, eq=False)
class AllanDeviation:
    """Overlapping Allan deviation.

    Attributes
    ----------
    tau : ndarray (k,)
        Averaging times [s].
    deviation : ndarray (k, axes)
        Allan deviation of the rate [rad/s].
    sigma : ndarray (k, axes)
        Its 1-sigma uncertainty, the larger of those for white noise and for random walk.
    samples : ndarray of int (k,)
        Samples in an averaging time.
    dt : float
        Step of the log [s].
    n : int
        Samples of the log.

    Examples
    --------
    >>> import numpy as np
    >>> white = 1e-5 * np.random.default_rng(1).standard_normal(10_000)
    >>> curve = allan_deviation(white, 0.1)
    >>> curve.deviation.shape == curve.sigma.shape == (len(curve.tau), 1)
    True
    """

    tau: Array
    deviation: Array
    sigma: Array
    samples: NDArray[np.int64]
    dt: float
    n: int


@dataclass(frozen=True, eq=False)
class AllanFit:
    """Noise of a gyro, fitted to its Allan deviation, axis by axis.

    Attributes
    ----------
    arw : ndarray (axes,)
        Angle random walk N [rad/sqrt(s)].
    rrw : ndarray (axes,)
        Rate random walk K [rad/s/sqrt(s)].
    bias_instability : ndarray (axes,)
        Bias instability B [rad/s], the flicker floor over 0.664; 0 where it is not seen.
    quantisation : ndarray (axes,)
        Angle quantisation Q [rad], least count over sqrt(12); 0 where it is not seen.
    sigma : dict of str to ndarray (axes,)
        1-sigma uncertainty of each by its name. Where the estimate is 0, what it may have been; NaN
        where the term was left out.
    p_value : ndarray (axes,)
        Probability of a worse fit, if the model is right; near 0 the curve holds something else.

    Examples
    --------
    >>> import numpy as np
    >>> white = 1e-5 * np.random.default_rng(1).standard_normal(10_000)
    >>> fit = fit_allan(allan_deviation(white, 0.1))
    >>> bool(abs(fit.arw[0] - 1e-5 * 0.1**0.5) < 4 * fit.sigma["arw"][0])
    True
    """

    arw: Array
    rrw: Array
    bias_instability: Array
    quantisation: Array
    sigma: dict[str, Array]
    p_value: Array

    def deviation(self, tau: ArrayLike) -> Array:
        """Return the fitted Allan deviation.

        Parameters
        ----------
        tau : array_like (k,)
            Averaging times [s].

        Returns
        -------
        ndarray (k, axes)
            Of the rate [rad/s].

        Raises
        ------
        InputError
            If the shape is wrong.

        Examples
        --------
        >>> import numpy as np
        >>> white = 1e-5 * np.random.default_rng(1).standard_normal(10_000)
        >>> fit_allan(allan_deviation(white, 0.1)).deviation([1.0, 10.0]).shape
        (2, 1)
        """
        values = np.stack([getattr(self, name) for name in TERMS])
        return np.asarray(np.sqrt(slopes(array(tau, "tau", (None,))) @ values**2))

    def gyro(self, **options: Any) -> Gyro:
        """Return a `Gyro` with the root mean square of the noise over the axes.

        Parameters
        ----------
        **options
            For `Gyro`: ``sampling``, ``mounting`` ...

        Returns
        -------
        Gyro

        Raises
        ------
        InputError
            If there is no angle random walk.

        Examples
        --------
        >>> import numpy as np
        >>> white = 1e-5 * np.random.default_rng(1).standard_normal(10_000)
        >>> fit_allan(allan_deviation(white, 0.1)).gyro(sampling="integrated").sampling
        'integrated'
        """
        from celestcore.sensors import Gyro

        arw, rrw = (float(np.sqrt(np.mean(x**2))) for x in (self.arw, self.rrw))
        return Gyro(arw=arw, rrw=rrw, **options)


def allan_deviation(
    rate: SensorLog | ArrayLike, dt: ArrayLike | None = None, taus: ArrayLike | None = None
) -> AllanDeviation:
    """Compute the overlapping Allan deviation of a gyro's readings.

    The gyro must be at rest or turn at a constant rate: the spacecraft's motion counts as noise.

    Parameters
    ----------
    rate : SensorLog or array_like (n,) or (n, axes)
        Readings at equal steps [rad/s]; or a log, whose gyro is taken.
    dt : float or array_like (n,)
        Step [s], or the times of the readings [s]. Comes with a log.
    taus : array_like (k,), optional
        Averaging times [s], rounded to whole steps. By default two an octave, up to a quarter of
        the log.

    Returns
    -------
    AllanDeviation

    Raises
    ------
    InputError
        If there are fewer than 16 readings, one is missing, or steps are not equal.

    Notes
    -----
    IEEE Std 952-1997, annex C; the overlapping estimate of Howe, Allan and Barnes (1981):
    ``1/(2 tau^2 M) * sum of (theta[k+2m] - 2 theta[k+m] + theta[k])^2``.

    Examples
    --------
    >>> import numpy as np
    >>> white = 1e-5 * np.random.default_rng(1).standard_normal(10_000)
    >>> curve = allan_deviation(white, 0.1, [0.1, 10.0])
    >>> curve.deviation.ravel().round(7)
    array([1.e-05, 9.e-07])
    """
    w, step = _readings(rate, dt)
    n = len(w)
    m = _samples(taus, step, n)
    # the mean is taken out so that a long log's angle keeps its digits; differences do not see it
    angle = np.concatenate([np.zeros((1, w.shape[1])), np.cumsum(w - w.mean(axis=0), axis=0)])
    tau: Array = np.asarray(m * step, dtype=np.float64)
    variance = np.empty((len(m), w.shape[1]))
    for row, k in enumerate(m.tolist()):
        second = angle[2 * k :] - 2.0 * angle[k:-k] + angle[: -2 * k]
        variance[row] = np.mean(second**2, axis=0) / (2.0 * k * k)
    deviation = np.sqrt(variance)
    spread = np.array([scatter(m[i : i + 1], n, step)[:2, :2, 0, 0] for i in range(len(m))])
    unit = slopes(tau)
    relative = [np.sqrt(spread[:, a, a]) / unit[:, a] for a in (ARW, RRW)]
    sigma = 0.5 * deviation * np.maximum(*relative)[:, None]
    return AllanDeviation(tau, deviation, sigma, m, step, n)


def fit_allan(curve: AllanDeviation, terms: Sequence[str] | None = None) -> AllanFit:
    """Fit noise densities to an Allan deviation.

    Generalised least squares of the Allan variance, with the covariance that the fitted noise
    itself gives the estimates (they overlap and are far from independent), repeated until it
    settles. No term is negative.

    Parameters
    ----------
    curve : AllanDeviation
        From `allan_deviation`; neighbours closer than a factor of 1.3 are thinned.
    terms : sequence of str, optional
        Which of ``"arw"``, ``"rrw"``, ``"bias_instability"`` and ``"quantisation"`` to fit. By
        default the first two, and of the others those that are seen with three sigma.

    Returns
    -------
    AllanFit

    Raises
    ------
    InputError
        If a term is unknown, there are fewer averaging times than terms, or the log is all zeros.

    Notes
    -----
    Terms after IEEE Std 952-1997, annex C. How the estimates scatter is exact for Gaussian noise.

    Examples
    --------
    >>> import numpy as np
    >>> rng = np.random.default_rng(1)
    >>> walk = np.cumsum(1e-7 * rng.standard_normal(20_000))
    >>> fit = fit_allan(allan_deviation(1e-5 * rng.standard_normal(20_000) + walk, 1.0))
    >>> abs(fit.arw - 1e-5) < 4 * fit.sigma["arw"], abs(fit.rrw - 1e-7) < 4 * fit.sigma["rrw"]
    (array([ True]), array([ True]))
    """
    checked(curve, "curve", AllanDeviation)
    chosen = _terms(terms)
    rows = _thinned(curve.samples)
    most = len(TERMS) if chosen is None else len(chosen)
    if len(rows) <= most:
        raise InputError(
            f"needs more than {most} averaging times a factor of {_APART} apart, got {len(rows)}",
            field="curve.tau",
        )
    unit, spread = slopes(curve.tau[rows]), scatter(curve.samples[rows], curve.n, curve.dt)
    each = [_fit(v, unit, spread, chosen) for v in (curve.deviation[rows] ** 2).T]
    size = np.sqrt(np.array([squares for squares, _, _ in each]))
    error = np.array([errors for _, errors, _ in each])
    with np.errstate(divide="ignore", invalid="ignore"):
        sigma = np.where(size > 0.0, error / (2.0 * size), np.sqrt(error))
    return AllanFit(
        **{name: size[:, k] for k, name in enumerate(TERMS)},
        sigma={name: sigma[:, k] for k, name in enumerate(TERMS)},
        p_value=np.array([p for _, _, p in each]),
    )


def _fit(
    variance: Array, unit: Array, spread: Array, chosen: list[int] | None
) -> tuple[Array, Array, float]:
    """Return squares (4,) of the terms, their errors (4,) and the p value of the fit."""
    if not np.all(variance > 0.0):
        raise InputError("is zero: the readings do not change", field="curve.deviation")
    if chosen is not None:
        return _squares(variance, unit, spread, chosen)
    best, kept = _squares(variance, unit, spread, [ARW, RRW]), [ARW, RRW]
    for extra in range(RRW + 1, len(TERMS)):
        tried = _squares(variance, unit, spread, [*kept, extra])
        if tried[0][extra] > _SEEN * tried[1][extra]:
            best, kept = tried, [*kept, extra]
    return best


def _squares(
    variance: Array, unit: Array, spread: Array, terms: list[int]
) -> tuple[Array, Array, float]:
    squares, error = np.zeros(len(TERMS)), np.full(len(TERMS), np.nan)
    covariance = np.diag((variance / np.arange(len(variance), 0, -1)) ** 2)
    active: list[int] = terms
    for _ in range(50):
        root = np.linalg.cholesky(covariance / np.outer(variance, variance))
        design = np.linalg.solve(root, unit / variance[:, None])
        target = np.linalg.solve(root, np.ones(len(variance)))
        scale = np.linalg.norm(design, axis=0)
        active = _positive(design / scale, target, terms)
        found = np.zeros(len(TERMS))
        found[active] = np.linalg.lstsq(design[:, active] / scale[active], target, rcond=None)[0]
        found[active] /= scale[active]
        settled = np.allclose(found, squares, rtol=1e-6, atol=0.0)
        squares = found
        if settled:
            break
        covariance = np.einsum("a,b,abij->ij", squares, squares, spread)
    normal = (design[:, terms] / scale[terms]).T @ (design[:, terms] / scale[terms])
    error[terms] = np.sqrt(np.diag(np.linalg.inv(normal))) / scale[terms]
    left = target - design[:, active] @ squares[active]
    below = _core.chi2_cdf(float(left @ left), float(len(variance) - len(active)))
    return squares, error, float(1.0 - below)


def _positive(design: Array, target: Array, terms: list[int]) -> list[int]:
    """Return the terms that stay when those that would be negative are dropped, worst first."""
    active = list(terms)
    while len(active) > 1:
        found = np.linalg.lstsq(design[:, active], target, rcond=None)[0]
        if found.min() >= 0.0:
            break
        active.pop(int(np.argmin(found)))
    return active


def _terms(terms: Sequence[str] | None) -> list[int] | None:
    if terms is None:
        return None
    names = [terms] if isinstance(terms, str) else list(terms)
    unknown = [name for name in names if name not in TERMS]
    if unknown or not names:
        raise InputError(f"choose from {', '.join(TERMS)}", field="terms", value=unknown)
    return [k for k, name in enumerate(TERMS) if name in names]


def _thinned(m: NDArray[np.int64]) -> list[int]:
    """Return rows in order of time, each at least the factor `_APART` after the one before."""
    rows: list[int] = []
    for row in np.argsort(m, kind="stable").tolist():
        if not rows or m[row] >= _APART * m[rows[-1]]:
            rows.append(row)
    return rows


def _readings(rate: Any, dt: ArrayLike | None) -> tuple[Array, float]:
    """Return readings (n, axes) and their step [s]."""
    if hasattr(rate, "gyro"):
        if dt is not None:
            raise InputError("comes with the log; leave it out", field="dt")
        if rate.gyro is None:
            raise InputError("has no gyro table", field="log")
        rate, dt = rate.gyro.rate, rate.gyro.t
    if dt is None:
        raise InputError("is needed: the step, or the times of the readings [s]", field="dt")
    w = array(rate, "rate")
    w = w[:, None] if w.ndim == 1 else w
    if w.ndim != 2 or len(w) < _SHORTEST:
        raise InputError(
            f"has shape {w.shape}, needed is (n,) or (n, axes) with n of at least {_SHORTEST}",
            field="rate",
        )
    bad = ~np.isfinite(w).all(axis=1)
    if bad.any():
        row = int(np.argmax(bad))
        raise InputError("must be finite; cut the log there", field="rate", row=row, value=w[row])
    times = array(dt, "dt")
    if times.size == 1:
        return w, number(times, "dt", above=0.0)
    steps = np.diff(array(dt, "dt", (len(w),)))
    step = float(np.median(steps))
    uneven = ~(np.abs(steps - step) <= _UNIFORM * abs(step))
    if uneven.any() or not step > 0.0:
        row = int(np.argmax(uneven)) + 1
        raise InputError(
            f"steps must be equal, the median is {step:g} s; cut the log at gaps or resample it",
            field="dt",
            row=row,
            value=times[row],
        )
    return w, float((times[-1] - times[0]) / (len(times) - 1))


def _samples(taus: ArrayLike | None, dt: float, n: int) -> NDArray[np.int64]:
    """Return averaging times as whole numbers of steps, each once, increasing."""
    if taus is None:
        k = np.arange(0.0, 2.0 * np.log2(n / 4.0) + 1e-9)
        return np.unique(np.round(2.0 ** (0.5 * k)).astype(np.int64))
    wanted = array(taus, "taus")
    if wanted.size == 0:
        raise InputError("is empty", field="taus")
    wanted = wanted.reshape(-1)
    bad = ~((wanted >= 0.5 * dt) & (wanted <= (n // 2) * dt))
    if bad.any():
        row = int(np.argmax(bad))
        raise InputError(
            f"must lie between the step, {dt:g} s, and half the log, {n // 2 * dt:g} s",
            field="taus",
            row=row,
            value=wanted[row],
        )
    return np.unique(np.maximum(1, np.round(wanted / dt)).astype(np.int64))
