"""Are innovations white? Their autocorrelation, with bounds and a test over many lags."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from celestcore import _core
from celestcore._arguments import count
from celestcore._check import array, number
from celestcore.analysis.chi_square import accepted_rows
from celestcore.errors import InputError

if TYPE_CHECKING:
    from celestcore.solution import Solution

__all__ = ["Whiteness", "whiteness"]

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Whiteness:
    """Autocorrelation of innovations, axis by axis.

    Attributes
    ----------
    lag : ndarray (k,)
        1, 2, ... in measurements.
    autocorrelation : ndarray (k, axes)
        About zero mean, since that is what innovations should have.
    bound : float
        Between plus and minus this lies each entry with `probability`, if the innovations are
        white (to first order in 1 / their number).
    inside : ndarray (axes,)
        Share of the entries within the bound.
    ljung_box : ndarray (axes,)
        Ljung and Box's statistic over all lags.
    p_value : ndarray (axes,)
        Probability of a statistic at least so large, if the innovations are white.
    mean : ndarray (axes,)
        Mean in units of its own standard error: standard normal if innovations are white.
    probability : float

    Examples
    --------
    >>> import numpy as np
    >>> white = np.random.default_rng(1).standard_normal((1000, 3))
    >>> whiteness(white, lags=10).autocorrelation.shape
    (10, 3)
    """

    lag: NDArray[np.int64]
    autocorrelation: Array
    bound: float
    inside: Array
    ljung_box: Array
    p_value: Array
    mean: Array
    probability: float

    @property
    def white(self) -> bool:
        """Whether no axis is refuted: every p value above ``(1 - probability) / axes``."""
        return bool(np.all(self.p_value > (1.0 - self.probability) / len(self.p_value)))

    def __str__(self) -> str:
        p = "/".join(f"{v:.3g}" for v in self.p_value)
        return f"{'white' if self.white else 'not white'}: p {p} over {len(self.lag)} lags"


def whiteness(
    innovation: Solution | ArrayLike,
    lags: int = 20,
    probability: float = 0.95,
    *,
    sensor: str | None = None,
) -> Whiteness:
    """Test whether innovations are white, as those of a filter with the right model are.

    Parameters
    ----------
    innovation : Solution or array_like (m, axes) or (m,)
        Innovations in order of time, each divided by its predicted 1-sigma; or a solution, whose
        accepted innovations are taken. Correlation between axes does no harm.
    lags : int
        How many lags.
    probability : float
        That white innovations pass.
    sensor : str, optional
        With a solution: which sensor; needed if there are several, because each has its own axes.

    Returns
    -------
    Whiteness

    Raises
    ------
    InputError
        If there are not more innovations than lags, one is not finite, or the sensor is open.

    Notes
    -----
    Mehra, *On the identification of variances and adaptive Kalman filtering*, IEEE Trans. Automatic
    Control 15 (1970); statistic of Ljung and Box, Biometrika 65 (1978), without taking the mean
    out. Slow drift in a filter that is tuned too stiff shows at the first lags.

    Examples
    --------
    >>> import numpy as np
    >>> draws = np.random.default_rng(1).standard_normal((5000, 3))
    >>> whiteness(draws).white, whiteness(np.cumsum(draws, axis=0)).white
    (True, False)
    """
    p = number(probability, "probability", above=0.0)
    if p >= 1.0:
        raise InputError("must be below 1", field="probability", value=p)
    z = _normalised(innovation, sensor)
    k, n = count(lags, "lags"), len(z)
    if n <= k:
        raise InputError(f"needs more than {k} innovations, got {n}", field="innovation")
    power = np.sum(z * z, axis=0)
    if not np.all(power > 0.0):
        raise InputError("is zero throughout", field="innovation")
    r = np.array([np.sum(z[j:] * z[:-j], axis=0) / power for j in range(1, k + 1)])
    return tested(r, n, np.sum(z, axis=0) / np.sqrt(power), p)


def tested(r: Array, n: int, mean: Array, p: float) -> Whiteness:
    """Return the test of an autocorrelation (lags, axes) of `n` innovations."""
    k = len(r)
    lag = np.arange(1, k + 1)
    box = n * (n + 2.0) * np.sum(r * r / (n - lag)[:, None], axis=0)
    bound = float(np.sqrt(_core.chi2_quantile(p, 1.0) / n))
    return Whiteness(
        lag=lag,
        autocorrelation=r,
        bound=bound,
        inside=np.mean(np.abs(r) <= bound, axis=0),
        ljung_box=box,
        p_value=np.array([1.0 - _core.chi2_cdf(float(q), k) for q in box]),
        mean=mean,
        probability=p,
    )


def _normalised(innovation: Any, sensor: str | None) -> Array:
    """Return innovations in units of their 1-sigma (m, axes)."""
    if hasattr(innovation, "innovation_sigma"):
        if hasattr(innovation, "innovations"):
            innovation._need("full", "this")
        rows = accepted_rows(innovation, sensor)
        if len(np.unique(innovation.sensor[rows])) > 1:
            names = ", ".join(innovation.sensor_names)
            raise InputError(f"say which of {names}", field="sensor")
        axes = int(innovation.dof[rows].max(initial=1))
        nu, sigma = innovation.innovation[rows, :axes], innovation.innovation_sigma[rows, :axes]
        z = np.asarray(nu / sigma)
    elif sensor is not None:
        raise InputError("goes with a solution", field="sensor", value=sensor)
    else:
        z = array(innovation, "innovation")
    if z.ndim == 1:
        z = z[:, None]
    if z.ndim != 2:
        raise InputError(f"has shape {z.shape}, needed is (m, axes) or (m,)", field="innovation")
    bad = ~np.isfinite(z).all(axis=1)
    if bad.any():
        row = int(np.argmax(bad))
        raise InputError("must be finite", field="innovation", row=row, value=z[row])
    return z
