"""The inverse question: which gyro, or which star camera, reaches a given accuracy."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from celestcore._arguments import checked, three
from celestcore._check import array, number
from celestcore.analysis._linear import Array, gyro_step, smoothed
from celestcore.analysis.steady import Star, phases, scaled, settle, star_covariance
from celestcore.errors import InputError
from celestcore.sensors import Gyro
from celestcore.units import ARCSEC

__all__ = ["attained", "judged", "required_gyro", "required_star"]

AXES = ("worst", "total", "x", "y", "z")
AT = ("filter", "before", "between", "smoother")
_REACH = 1e7
_TOLERANCE = 1e-9


def required_gyro(
    target: ArrayLike,
    star: Star,
    gyro_dt: float,
    star_dt: float,
    *,
    rrw: float = 0.0,
    rate: ArrayLike = (0.0, 0.0, 0.0),
    axis: str = "worst",
    level: float = 1.0,
    at: str = "filter",
) -> float:
    """Return the largest angle random walk with which the attitude reaches a target.

    Parameters
    ----------
    target : float or array_like (3,)
        Wanted attitude error [rad], about each body axis, at `level` sigma.
    star : StarCamera, dict of StarCamera, float, array_like (3,) or (3, 3)
        The camera, as for `steady_state`.
    gyro_dt, star_dt : float
        Time between gyro samples, and between fixes [s].
    rrw : float
        Rate random walk of the gyro [rad/s/sqrt(s)].
    rate : array_like (3,)
        Constant body rate [rad/s].
    axis : {"worst", "total", "x", "y", "z"}
        Which error counts; ``"total"`` is the root of the sum of all three variances.
    level : float
        Multiple of sigma that the target is: 3 for a 3-sigma requirement.
    at : {"filter", "before", "between", "smoother"}
        Which of the covariances of `SteadyState`.

    Returns
    -------
    float
        Angle random walk [rad/sqrt(s)]; ``arw / sqrt(gyro_dt)`` is the white noise per sample
        [rad/s]. Infinite if fixes alone reach the target.

    Raises
    ------
    InputError
        If no gyro reaches the target; says what is attained at best.

    Examples
    --------
    Which gyro reaches 1 arcsec with a camera of 2 arcsec, all 3 sigma, 10 and 5 Hz?

    >>> import celestcore as cc
    >>> arw = required_gyro(1 * cc.ARCSEC, 2 / 3 * cc.ARCSEC, 0.1, 0.2, level=3)
    >>> round(3 * arw / 0.1**0.5 / cc.ARCSEC, 2)  # arcsec/s, 3 sigma per sample
    4.08
    """
    score = _score(target, gyro_dt, star_dt, rate, axis, level, at)
    noise, walk = star_covariance(star), number(rrw, "rrw", at_least=0.0)
    natural = float(np.sqrt(np.trace(noise) / 3.0 / number(star_dt, "star_dt")))

    def of(arw: float) -> float:
        return score(arw, walk, noise)

    if of(natural / _REACH) > 1.0:
        raise InputError(
            f"no gyro reaches it: with this camera and rrw {_best(of(natural / _REACH), target)}",
            field="target",
            value=target,
        )
    return natural * _largest(lambda x: of(natural * x))


def required_star(
    target: ArrayLike,
    gyro: Gyro,
    gyro_dt: float,
    star_dt: float,
    *,
    star: Star | None = None,
    rate: ArrayLike = (0.0, 0.0, 0.0),
    axis: str = "worst",
    level: float = 1.0,
    at: str = "filter",
) -> float:
    """Return the largest noise of the star camera with which the attitude reaches a target.

    Parameters
    ----------
    target, gyro_dt, star_dt, rate, axis, level, at
        As for `required_gyro`.
    gyro : Gyro
        The gyro.
    star : StarCamera, dict of StarCamera, float, array_like (3,) or (3, 3)
        The camera whose noise is scaled; by default the same about all axes.

    Returns
    -------
    float
        By how much the camera's sigma may be multiplied; for the default camera that is the 1-sigma
        noise [rad] itself. Infinite if the target is met whatever the camera.

    Raises
    ------
    InputError
        If no camera reaches the target; says what is attained at best.

    Examples
    --------
    >>> import celestcore as cc
    >>> sigma = required_star(1 * cc.ARCSEC, cc.Gyro(arw=1e-6, rrw=1e-9), 0.1, 0.2)
    >>> round(sigma / cc.ARCSEC, 2)
    10.65
    """
    score = _score(target, gyro_dt, star_dt, rate, axis, level, at)
    gyro = checked(gyro, "gyro", Gyro)
    noise = np.eye(3) if star is None else star_covariance(star)
    size = float(np.trace(noise)) / 3.0
    natural = gyro.arw * np.sqrt(number(star_dt, "star_dt"))

    def of(sigma: float) -> float:
        return score(gyro.arw, gyro.rrw, noise * (sigma * sigma / size))

    if of(natural / _REACH) > 1.0:
        raise InputError(
            f"no camera reaches it: with this gyro {_best(of(natural / _REACH), target)}",
            field="target",
            value=target,
        )
    return float(natural / np.sqrt(size) * _largest(lambda x: of(natural * x)))


def attained(
    arw: ArrayLike,
    rrw: float,
    noise: Array,
    gyro_dt: float,
    star_dt: float,
    rate: Array,
    at: str,
) -> Array:
    """Return 1-sigma attitude errors (..., 3) [rad] of many gyros and cameras at once.

    Parameters
    ----------
    arw : array_like (...)
        Angle random walks [rad/sqrt(s)].
    rrw : float
        Rate random walk [rad/s/sqrt(s)].
    noise : ndarray (..., 3, 3)
        Covariances of a fix [rad^2].
    gyro_dt, star_dt : float
        Steps [s].
    rate : ndarray (3,)
        Body rate [rad/s].
    at : str
        As for `required_gyro`.
    """
    f, q, after, before, units = settle(arw, rrw, noise, star_dt, rate)
    if at == "smoother":
        p = smoothed(f, q, after, before)
    elif at == "between":
        times, n, p = phases(gyro_dt, star_dt), f.shape[-1], np.zeros(after.shape)
        for t in times:
            step, walk = scaled(*gyro_step(arw, rrw, rate, t), units)
            step = step[..., :n, :n]
            p += (step @ after @ np.swapaxes(step, -1, -2) + walk[..., :n, :n]) / len(times)
    else:
        p = before if at == "before" else after
    variance = np.diagonal(p[..., :3, :3], axis1=-2, axis2=-1)
    return np.asarray(units[..., :3] * np.sqrt(variance))


def judged(sigma: Array, axis: str) -> Array:
    """Return the error that counts (...), of errors about three axes (..., 3)."""
    if axis == "worst":
        return np.asarray(sigma.max(axis=-1))
    if axis == "total":
        return np.asarray(np.sqrt(np.sum(sigma * sigma, axis=-1)))
    return np.asarray(sigma[..., "xyz".index(axis)])


def one_of(value: Any, field: str, known: tuple[str, ...]) -> str:
    if value not in known:
        raise InputError(f"must be one of {', '.join(known)}", field=field, value=value)
    return str(value)


def _score(
    target: ArrayLike,
    gyro_dt: float,
    star_dt: float,
    rate: ArrayLike,
    axis: str,
    level: float,
    at: str,
) -> Callable[[float, float, Array], float]:
    """Return what says, of a gyro and a camera's noise, the error that counts over the target."""
    one_of(axis, "axis", AXES)
    one_of(at, "at", AT)
    w, k = np.array(three(rate, "rate")), number(level, "level", above=0.0)
    dt, period = number(gyro_dt, "gyro_dt", above=0.0), number(star_dt, "star_dt", above=0.0)
    wanted = array(target, "target")
    if wanted.shape not in ((), (1,), (3,)) or not np.all((wanted > 0.0) & np.isfinite(wanted)):
        raise InputError("needs one positive angle or three", field="target", value=target)
    if wanted.size == 3 and axis == "total":
        raise InputError("needs one angle for the total", field="target", value=target)

    def score(arw: float, rrw: float, noise: Array) -> float:
        sigma = attained(arw, rrw, noise, dt, period, w, at)
        return float(judged(k * sigma / wanted, axis))

    return score


def _best(score: float, target: ArrayLike) -> str:
    wanted = np.asarray(target, dtype=np.float64)
    if wanted.size == 1:
        return f"{score * float(wanted.reshape(-1)[0]) / ARCSEC:.4g} arcsec is attained at best"
    return f"{score:.4g} times the target is attained at best"


def _largest(score: Callable[[float], float]) -> float:
    """Return the largest x with ``score(x) <= 1``, of a score that grows with x."""
    low, high = 1.0 / _REACH, 1.0
    while score(high) <= 1.0:
        low, high = high, 10.0 * high
        if high > _REACH:
            return float("inf")
    while high / low > 1.0 + _TOLERANCE:
        middle = float(np.sqrt(low * high))
        low, high = (middle, high) if score(middle) <= 1.0 else (low, middle)
    return low
