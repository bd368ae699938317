"""The noise of gyro and star camera, from a filter's innovations: maximum likelihood."""

from __future__ import annotations

import copy
import dataclasses
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from celestcore._arguments import checked
from celestcore.analysis._simplex import curvature, maximise
from celestcore.errors import CelestcoreWarning, InputError, NumericalError
from celestcore.log import SensorLog, StarTable, VectorTable
from celestcore.sensors import StarCamera, VectorSensor

if TYPE_CHECKING:
    from celestcore.navigator import StarGyroNavigator
    from celestcore.solution import Solution

__all__ = ["NoiseEstimate", "estimate_noise"]

Array = NDArray[np.float64]

PARAMETERS = ("arw", "rrw", "scale")
_STEP = 1.0
_UNSEEN = 0.1
"""By how much less likely a log may be without a noise, for the noise not to be seen."""
_START_WALK = 300.0
"""Time [s] in which a bias walk nothing is known of would double the gyro's white noise."""
_FEW = 30
_PASSES = 5
"""How often to choose anew, at most, what the gate rejects."""


@dataclass(frozen=True, eq=False)
class NoiseEstimate:
    """Noise that makes a log's innovations most likely.

    Attributes
    ----------
    arw : float
        Angle random walk [rad/sqrt(s)]; next to nothing if the log does not show any.
    rrw : float
        Rate random walk [rad/s/sqrt(s)]; 0 if the log does not show any.
    scale : float
        What the noise of star cameras (and direction sensors) must be multiplied by.
    sigma : dict of str to float
        1-sigma uncertainty of each by its name; 0 for what was held, and for what the log does not
        show how large it may be.
    parameters : tuple of str
        What was estimated and is seen in the log, in the order of `covariance`.
    covariance : ndarray (k, k)
        Of the natural logarithms of the parameters.
    log_likelihood : float
        Of the log with these values.
    gain : float
        By how much more likely, in natural logarithms, the log is than with the noise at the start.
    rejected : int
        Measurements left out because the gate rejected them.
    navigator : StarGyroNavigator
        The navigator with these values. Where fixes bring their own noise, see `rescaled`.

    Examples
    --------
    >>> import numpy as np
    >>> import celestcore as cc
    >>> t, noise = np.arange(300.0), np.random.default_rng(1).standard_normal((2, 300, 3))
    >>> fixes = cc.quaternion.exp(5e-6 * noise[0])  # half of what they claim
    >>> log = cc.SensorLog(gyro=(t, 1e-6 * noise[1]), star=(t, fixes, 1e-5))
    >>> nav = cc.StarGyroNavigator(cc.EKF(), cc.Gyro(1e-6, 1e-9), cc.StarCamera())
    >>> found = estimate_noise(nav, log, ["scale"])
    >>> found.arw, found.scale < 1.0
    (1e-06, True)
    """

    arw: float
    rrw: float
    scale: float
    sigma: dict[str, float]
    parameters: tuple[str, ...]
    covariance: Array
    log_likelihood: float
    gain: float
    rejected: int
    navigator: StarGyroNavigator

    def __str__(self) -> str:
        each = (f"{k} {getattr(self, k):.4g} +- {v:.2g}" for k, v in self.sigma.items())
        return f"{', '.join(each)}; log-likelihood {self.log_likelihood:.1f}"

    def rescaled(self, log: SensorLog) -> SensorLog:
        """Return a log with the noise of each fix multiplied by `scale`.

        Parameters
        ----------
        log : SensorLog
            The log that the noise was estimated from, or one like it.

        Returns
        -------
        SensorLog
            A new log.

        Examples
        --------
        >>> import numpy as np
        >>> import celestcore as cc
        >>> t, noise = np.arange(300.0), np.random.default_rng(1).standard_normal((2, 300, 3))
        >>> fixes = cc.quaternion.exp(5e-6 * noise[0])  # half of what they claim
        >>> log = cc.SensorLog(gyro=(t, 1e-6 * noise[1]), star=(t, fixes, 1e-5))
        >>> nav = cc.StarGyroNavigator(cc.EKF(), cc.Gyro(1e-6, 1e-9), cc.StarCamera())
        >>> found = estimate_noise(nav, log, ["scale"])
        >>> smaller = found.rescaled(log).stars["star"].noise
        >>> bool((smaller < log.stars["star"].noise).all())
        True
        """
        tables = {name: _rescaled(table, self.scale) for name, table in log.tables.items()}
        return _with_tables(log, tables)


def estimate_noise(
    navigator: StarGyroNavigator,
    log: SensorLog,
    parameters: Sequence[str] = PARAMETERS,
    **start: Any,
) -> NoiseEstimate:
    """Estimate gyro and star camera noise from the innovations of a log.

    The values under which the filter's innovations are most likely. Needs a log longer than the
    filter takes to settle. Errors of scale, alignment or timing count as noise.

    Parameters
    ----------
    navigator : StarGyroNavigator
        Its noise is where the search starts; a factor of a hundred off is no harm. With a gate, the
        measurements it rejects are left out, and chosen again with the noise that was found.
        Weights (`huber`, `student_t`) and `adaptive` are not used: wrong fixes need a gate.
    log : SensorLog
        With a gyro and fixes.
    parameters : sequence of {"arw", "rrw", "scale"}
        What to estimate; the rest is held at the navigator's values. Only with the noise of fixes
        well known is it wise to hold `scale`.
    **start
        ``t0``, ``q0``, ``bias0``, ``sigma0``, ``covariance0`` for `StarGyroNavigator.run`; the
        uncertainty of the start is scaled like that of the fixes.

    Returns
    -------
    NoiseEstimate

    Raises
    ------
    InputError
        If a parameter is unknown or the log has too few fixes.
    NumericalError
        If the likelihood has no top.

    Notes
    -----
    Schweppe, *Evaluation of likelihood functions for Gaussian signals*, IEEE Trans. Information
    Theory 11 (1965): ``-1/2 sum(nu' S^-1 nu + ln det S + m ln 2 pi)``. A common factor of all noise
    leaves the gain as it is, so its best value follows from the mean NIS without a search. Errors
    from the curvature at the top.

    Examples
    --------
    >>> import numpy as np
    >>> import celestcore as cc
    >>> rng = np.random.default_rng(1)
    >>> t = np.arange(2000.0)
    >>> log = cc.SensorLog(gyro=(t, 2e-5 * rng.standard_normal((2000, 3))),
    ...                    star=(t, cc.quaternion.exp(3e-5 * rng.standard_normal((2000, 3)))))
    >>> nav = cc.StarGyroNavigator(cc.EKF(), cc.Gyro(arw=1e-6), cc.StarCamera(1e-4))
    >>> found = estimate_noise(nav, log, ["arw", "scale"])
    >>> abs(found.scale - 0.3) < 4 * found.sigma["scale"]
    True
    """
    names = _parameters(parameters)
    log = checked(log, "log", SensorLog)
    kept, rejected = _accepted(navigator, log, start)
    found = _search(navigator, kept, names, start)
    for _ in range(_PASSES if navigator.gate is not None else 0):
        better, before = _tuned(navigator, found[0]), rejected
        kept, rejected = _accepted(better, _scaled_log(log, found[0][2]), start)
        if rejected == before:
            break
        found = _search(navigator, _scaled_log(kept, 1.0 / found[0][2]), names, start)
    values, sigma, free, covariance, height, gain = found
    return NoiseEstimate(
        arw=float(values[0]),
        rrw=float(values[1]),
        scale=float(values[2]),
        sigma=dict(zip(PARAMETERS, sigma.tolist(), strict=True)),
        parameters=tuple(PARAMETERS[k] for k in free),
        covariance=covariance,
        log_likelihood=height,
        gain=gain,
        rejected=rejected,
        navigator=_tuned(navigator, values),
    )


class _Likelihood:
    """Log-likelihood of (arw, rrw, scale) [rad/sqrt(s), rad/s/sqrt(s), 1]."""

    def __init__(self, navigator: StarGyroNavigator, log: SensorLog, start: dict[str, Any]) -> None:
        # the log is without what the gate rejects: from here on every measurement counts, in full
        plain = navigator._like(gate=None, huber=None, student_t=None, adaptive=None)
        self.navigator, self.log, self.start = plain, log, start
        self.known: dict[tuple[float, float], tuple[float, float, float]] = {}

    def run(self, arw: float, rrw: float) -> tuple[float, float, float]:
        """Return log-likelihood, sum of NIS and their degrees of freedom at scale 1."""
        if (arw, rrw) not in self.known:
            try:
                sol = _run(_tuned(self.navigator, (arw, rrw, 1.0)), self.log, self.start)
            except NumericalError:
                return -np.inf, 0.0, 1.0
            used = sol.accepted & np.isfinite(sol.nis)
            if used.sum() < _FEW:
                raise InputError(
                    f"uses {used.sum()} fixes, at least {_FEW} are needed", field="log"
                )
            sums = float(sol.nis[used].sum()), float(sol.dof[used].sum())
            self.known[arw, rrw] = (sol.log_likelihood, *sums)
        return self.known[arw, rrw]

    def __call__(self, arw: float, rrw: float, scale: float) -> float:
        height, squares, count = self.run(arw / scale, rrw / scale)
        return height + 0.5 * squares * (1.0 - scale**-2) - count * float(np.log(scale))

    def scale(self, arw: float, rrw: float) -> float:
        """Return the best scale if these are the gyro's noises over the scale."""
        _, squares, count = self.run(arw, rrw)
        return float(np.sqrt(squares / count)) or 1.0


_Found = tuple[Array, Array, list[int], Array, float, float]


def _search(
    navigator: StarGyroNavigator, log: SensorLog, names: list[str], start: dict[str, Any]
) -> _Found:
    """Return values and sigmas (3,), free parameters, covariance, height and gain."""
    likelihood = _Likelihood(navigator, log, start)
    values = np.array([navigator.gyro.arw, navigator.gyro.rrw, 1.0])
    before = likelihood(*values)
    free = [k for k, name in enumerate(PARAMETERS) if name in names]
    if 1 in free and values[1] == 0.0:
        values[1] = values[0] / _START_WALK
    values, height = _top(likelihood, values, free)
    unseen: list[int] = []
    for k, least in ((1, 0.0), (0, 1e-3)):
        without = values.copy()
        without[k] *= least
        if k in free and height - likelihood(*without) < _UNSEEN:
            free, unseen = [m for m in free if m != k], [*unseen, k]
            values, height = _top(likelihood, without, free)
    if not np.isfinite(height):
        raise NumericalError("the log is impossible under any noise near the navigator's")
    covariance = _covariance(likelihood, values, free, height)
    sigma = np.zeros(3)
    sigma[free] = values[free] * np.sqrt(np.diag(covariance))
    for k in unseen:
        sigma[k] = _largest(likelihood, values, height, k)
    return values, sigma, free, covariance, height, float(height - before)


def _top(likelihood: _Likelihood, values: Array, free: list[int]) -> tuple[Array, float]:
    """Return the most likely values, the others held, and their log-likelihood."""
    search = [k for k in free if k != 2]
    # relative to the scale: then it need not be searched for, unless something else is held fast
    held = [k for k in (0, 1) if k not in free and values[k] > 0.0]
    if 2 in free and held:
        search = free

    def complete(x: Array) -> Array:
        out = values.copy()
        out[search] = np.exp(x)
        if 2 in free and not held:
            out[2] = likelihood.scale(out[0], out[1])
            out[:2] *= out[2]
        return out

    start = np.log(values[search])
    if not search:
        found = complete(start)
        return found, likelihood(*found)
    x, height = maximise(lambda x: likelihood(*complete(x)), start, _STEP)
    x, height = maximise(lambda x: likelihood(*complete(x)), x, 0.2)
    return complete(x), height


def _covariance(likelihood: _Likelihood, values: Array, free: list[int], height: float) -> Array:
    """Return the covariance (k, k) of the logarithms of the free values."""
    if not free:
        return np.zeros((0, 0))

    def f(x: Array) -> float:
        out = values.copy()
        out[free] = np.exp(x)
        return likelihood(*out)

    information = curvature(f, np.log(values[free]), height)
    if not (np.isfinite(information).all() and np.linalg.eigvalsh(information)[0] > 0.0):
        names = ", ".join(PARAMETERS[k] for k in free)
        raise NumericalError(f"the log does not tell {names} apart: hold one of them")
    return np.asarray(np.linalg.inv(information))


def _largest(likelihood: _Likelihood, values: Array, height: float, k: int) -> float:
    """Return the size of a noise that is not seen which makes the log less likely by one sigma."""

    def drop(size: float) -> float:
        tried = values.copy()
        tried[k] = size
        return height - likelihood(*tried)

    low, high = 0.0, max(1e-6 * float(values[0]), float(values[k]))
    while drop(high) < 0.5 and high < 1.0:
        low, high = high, 2.0 * high
    for _ in range(6):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if drop(middle) < 0.5 else (low, middle)
    return high


def _run(navigator: StarGyroNavigator, log: SensorLog, start: dict[str, Any]) -> Solution:
    assert log.gyro is not None
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", CelestcoreWarning)
        return navigator.run(log, **start, every=len(log.gyro))


def _tuned(navigator: StarGyroNavigator, values: Sequence[float] | Array) -> StarGyroNavigator:
    """Return the navigator with the noise (arw, rrw, scale)."""
    out = copy.copy(navigator)
    with warnings.catch_warnings():  # a search looks at noises that nobody would give
        warnings.simplefilter("ignore", CelestcoreWarning)
        out.gyro = dataclasses.replace(navigator.gyro, arw=float(values[0]), rrw=float(values[1]))
        out.star = _each(navigator.star, float(values[2]))
        out.vector = _each(navigator.vector, float(values[2]))
    return out


def _each(sensors: Any, scale: float) -> Any:
    """Return a sensor, or a mapping of them, with its noise multiplied."""
    if isinstance(sensors, Mapping):
        return {name: _each(sensor, scale) for name, sensor in sensors.items()}
    if isinstance(sensors, StarCamera) and sensors.covariance is not None:
        return dataclasses.replace(sensors, covariance=scale**2 * np.asarray(sensors.covariance))
    if isinstance(sensors, StarCamera) and sensors.sigma is not None:
        return dataclasses.replace(sensors, sigma=scale * np.asarray(sensors.sigma))
    if isinstance(sensors, VectorSensor):
        return dataclasses.replace(sensors, sigma=scale * sensors.sigma)
    return sensors


def _rescaled(table: Any, scale: float) -> Any:
    """Return a table with the noise that its rows bring multiplied."""
    changes: dict[str, Any] = {}
    if isinstance(table, StarTable | VectorTable) and table.sigma is not None:
        changes["sigma"] = scale * table.sigma
    if isinstance(table, StarTable) and table.covariance is not None:
        changes["covariance"] = scale**2 * table.covariance
    return dataclasses.replace(table, **changes) if changes else table


def _scaled_log(log: SensorLog, scale: float) -> SensorLog:
    return _with_tables(log, {name: _rescaled(table, scale) for name, table in log.tables.items()})


def _with_tables(log: SensorLog, tables: dict[str, Any]) -> SensorLog:
    return SensorLog(
        epoch=log.epoch, title=log.title, frames=log.frames, settings=log.settings, **tables
    )


def _accepted(
    navigator: StarGyroNavigator, log: SensorLog, start: dict[str, Any]
) -> tuple[SensorLog, int]:
    """Return the log without what the navigator's gate rejects, and how much that was."""
    if log.gyro is None or not (log.stars or log.vectors):
        raise InputError("needs a gyro and a star camera with fixes", field="log")
    if navigator.gate is None:
        return log, 0
    sol = _run(navigator, log, start)
    tables: dict[str, Any] = dict(log.tables)
    for k, name in enumerate(sol.sensor_names):
        table = tables[name]
        rows = ~np.isin(table.t, sol.measurement_t[~sol.accepted & (sol.sensor == k)])
        columns = {
            f.name: getattr(table, f.name)[rows]
            for f in dataclasses.fields(table)
            if isinstance(getattr(table, f.name), np.ndarray)
        }
        if rows.any():
            tables[name] = dataclasses.replace(table, **columns)
        else:
            del tables[name]
    return _with_tables(log, tables), int(np.count_nonzero(~sol.accepted))


def _parameters(parameters: Sequence[str]) -> list[str]:
    names = [parameters] if isinstance(parameters, str) else list(parameters)
    unknown = [name for name in names if name not in PARAMETERS]
    if unknown or not names:
        raise InputError(
            f"choose from {', '.join(PARAMETERS)}", field="parameters", value=unknown or None
        )
    return names
