"""`steady_state`: the covariance that a filter and a smoother settle at."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from celestcore._arguments import checked, three
from celestcore._check import array, covariances, number
from celestcore.analysis._linear import (
    Array,
    farrenkopf,
    gyro_step,
    riccati,
    smoothed,
    symmetric,
    transposed,
    updated,
)
from celestcore.errors import InputError
from celestcore.sensors import Gyro, StarCamera
from celestcore.units import ARCSEC

__all__ = ["Star", "SteadyState", "settle", "star_covariance", "steady_state"]

Star: TypeAlias = "StarCamera | Mapping[str, StarCamera] | ArrayLike"

_UNPACK = np.array([[0, 1, 2], [1, 3, 4], [2, 4, 5]])


@dataclass(frozen=True, eq=False, repr=False)
class SteadyState:
    """Covariances that a gyro and star camera settle at; what a tuned filter cannot beat.

    Order of the error state: attitude x, y, z (body-frame rotation vector, rad), gyro bias x, y, z
    (rad/s).

    Attributes
    ----------
    filter : ndarray (6, 6)
        Just after a fix.
    before : ndarray (6, 6)
        Just before a fix.
    between : ndarray (6, 6)
        Mean over all gyro samples; at those with a fix, after it.
    smoother : ndarray (6, 6)
        At a fix, with all fixes before and after it (not causal).
    smoother_between : ndarray (6, 6)
        The same as a mean over all gyro samples.
    gain : ndarray (6, 3)
        Gain of a filter with these covariances.
    time_constant : float
        Time [s] in which the slowest error falls to 1/e: a run is in steady state after a few.
        With ``rrw = 0`` that of the attitude alone: the bias then settles like one over time.
    gyro_dt, star_dt : float
        Steps of the sensors [s].

    Examples
    --------
    >>> import celestcore as cc
    >>> steady_state(cc.Gyro(arw=1e-6, rrw=1e-9), 5 * cc.ARCSEC, gyro_dt=0.1, star_dt=0.2)
    SteadyState(1 sigma arcsec x/y/z: filter ..., smoother ...)
    """

    filter: Array
    before: Array
    between: Array
    smoother: Array
    smoother_between: Array
    gain: Array
    time_constant: float
    gyro_dt: float
    star_dt: float

    def __repr__(self) -> str:
        def text(sigma: Array) -> str:
            return "/".join(f"{s:.3g}" for s in sigma[:3] / ARCSEC)

        return (
            f"SteadyState(1 sigma arcsec x/y/z: filter {text(self.sigma_filter)}, "
            f"smoother {text(self.sigma_smoother)})"
        )

    @property
    def sigma_filter(self) -> Array:
        """1-sigma just after a fix (6,)."""
        return sigma(self.filter)

    @property
    def sigma_before(self) -> Array:
        """1-sigma just before a fix (6,)."""
        return sigma(self.before)

    @property
    def sigma_between(self) -> Array:
        """Root mean variance over all gyro samples (6,)."""
        return sigma(self.between)

    @property
    def sigma_smoother(self) -> Array:
        """1-sigma at a fix, smoothed (6,)."""
        return sigma(self.smoother)

    @property
    def sigma_smoother_between(self) -> Array:
        """Root mean variance over all gyro samples, smoothed (6,)."""
        return sigma(self.smoother_between)


def sigma(covariance: Array) -> Array:
    return np.sqrt(np.diagonal(covariance, axis1=-2, axis2=-1))


def steady_state(
    gyro: Gyro,
    star: Star,
    gyro_dt: float,
    star_dt: float,
    rate: ArrayLike = (0.0, 0.0, 0.0),
) -> SteadyState:
    """Compute the covariance that a filter and a smoother settle at.

    The discrete Riccati equation of the linearised system, over one step from fix to fix, with the
    exact discretisation of a constant body rate; the smoother is the fixed point of the
    Rauch-Tung-Striebel recursion. It holds where errors are small and runs much longer than
    `SteadyState.time_constant`.

    Parameters
    ----------
    gyro : Gyro
        Its `arw` and `rrw`. White noise of s [rad/s] per sample is ``arw = s * sqrt(gyro_dt)``.
        With ``rrw = 0`` the bias is a constant, known perfectly in the end.
    star : StarCamera, dict of StarCamera, float, array_like (3,) or (3, 3)
        The camera; or several that all give fixes at the same times; or its noise in the body
        frame: 1-sigma [rad], one per axis [rad], or the covariance [rad^2].
    gyro_dt : float
        Time between gyro samples [s].
    star_dt : float
        Time between fixes [s]. Where it is no multiple of `gyro_dt`, the noise of a sample that
        is split by a fix is taken as independent in both parts, as the filters do.
    rate : array_like (3,)
        Constant body rate [rad/s], in the frame of the noise.

    Returns
    -------
    SteadyState

    Raises
    ------
    InputError
        Names the field and the value.
    NumericalError
        If the noises differ by so many orders that nothing settles.

    Notes
    -----
    Structured doubling after Chu, Fan, Lin and Wang, *Int. J. Control* 77 (2004); smoother after
    Rauch, Tung and Striebel, *AIAA Journal* 3 (1965). For one axis at rest the result is that of
    Farrenkopf, *Journal of Guidance and Control* 1 (1978).

    Examples
    --------
    A gyro with 0.2 arcsec/s (3 sigma) at 10 Hz, fixes of 5 arcsec (3 sigma) at 5 Hz:

    >>> import numpy as np
    >>> import celestcore as cc
    >>> gyro = cc.Gyro(arw=0.2 / 3 * cc.ARCSEC * np.sqrt(0.1), rrw=1e-5 * cc.ARCSEC)
    >>> bound = steady_state(gyro, 5 / 3 * cc.ARCSEC, 0.1, 0.2)
    >>> (3 * bound.sigma_filter[:3] / cc.ARCSEC).round(3)
    array([0.379, 0.379, 0.379])
    """
    gyro = checked(gyro, "gyro", Gyro)
    noise = star_covariance(star)
    dt, period = number(gyro_dt, "gyro_dt", above=0.0), number(star_dt, "star_dt", above=0.0)
    w = np.array(three(rate, "rate"))
    f, q, after, before, units = settle(gyro.arw, gyro.rrw, noise, period, w)
    smooth = smoothed(f, q, after, before)
    n = len(f)
    between, smooth_between = np.zeros((n, n)), np.zeros((n, n))
    times = phases(dt, period)
    for t in times:
        there = _predicted(gyro, w, t, after, units)
        rest, _ = scaled(*gyro_step(gyro.arw, gyro.rrw, w, period - t), units)
        c = transposed(np.asarray(np.linalg.solve(before, rest[:n, :n] @ there)))
        between += there / len(times)
        smooth_between += (there + c @ (smooth - before) @ c.T) / len(times)
    gain = updated(before, noise / np.outer(units[:3], units[:3]))[1]
    slowest = float(np.abs(np.linalg.eigvals(f - gain @ f[:3])).max())
    k = np.zeros((6, 3))
    k[:n] = gain * units[:n, None] / units[:3]
    with np.errstate(divide="ignore"):
        constant = -period / np.log(min(slowest, 1.0))
    return SteadyState(
        filter=_full(after, units),
        before=_full(before, units),
        between=_full(between, units),
        smoother=_full(smooth, units),
        smoother_between=_full(smooth_between, units),
        gain=k,
        time_constant=float(abs(constant)),
        gyro_dt=dt,
        star_dt=period,
    )


def settle(
    arw: ArrayLike, rrw: float, noise: Array, period: float, rate: Array
) -> tuple[Array, Array, Array, Array, Array]:
    """Return transition, noise, covariance after and before a fix, and their units, for many cases.

    Parameters
    ----------
    arw : array_like (...)
        Angle random walks [rad/sqrt(s)].
    rrw : float
        Rate random walk [rad/s/sqrt(s)]; with 0 the bias is left out, and n is 3 instead of 6.
    noise : ndarray (..., 3, 3)
        Covariances of a fix [rad^2].
    period : float
        Time between fixes [s].
    rate : ndarray (3,)
        Body rate [rad/s].

    Returns
    -------
    f, q, after, before : ndarray (..., n, n)
        In units in which all variances are of order one, or the bias would drown in rounding.
    units : ndarray (..., 6)
        Multiply entry i, j by the units i and j.
    """
    scale = np.linalg.det(noise / _size(noise)) ** (1.0 / 6.0) * np.sqrt(_size(noise)[..., 0, 0])
    attitude, _, bias, _ = farrenkopf(arw, rrw, scale, period)
    units = np.repeat(np.stack([np.sqrt(attitude), np.sqrt(bias)], axis=-1), 3, axis=-1)
    f, q = gyro_step(arw, rrw, rate, period)
    if rrw == 0.0:
        units[..., 3:] = 1.0
    f, q = scaled(f, q, units)
    n = 3 if rrw == 0.0 else 6
    f, q = f[..., :n, :n], q[..., :n, :n]
    r = noise / (units[..., :3, None] * units[..., None, :3])
    information = np.zeros(q.shape)
    information[..., :3, :3] = symmetric(np.linalg.inv(r))
    before = riccati(f, q, information)
    return f, q, updated(before, r)[0], before, units


def _size(noise: Array) -> Array:
    return np.asarray(np.trace(noise, axis1=-2, axis2=-1)[..., None, None] / 3.0)


def scaled(f: Array, q: Array, units: Array) -> tuple[Array, Array]:
    rows, columns = units[..., :, None], units[..., None, :]
    return f * columns / rows, q / (rows * columns)


def _full(p: Array, units: Array) -> Array:
    """Return a covariance (6, 6) in rad and rad/s."""
    n = p.shape[-1]
    out = np.zeros((*p.shape[:-2], 6, 6))
    out[..., :n, :n] = p * units[..., :n, None] * units[..., None, :n]
    return out


def _predicted(gyro: Gyro, rate: Array, t: float, after: Array, units: Array) -> Array:
    """Return the scaled covariance a time `t` after a fix."""
    n = len(after)
    f, q = scaled(*gyro_step(gyro.arw, gyro.rrw, rate, t), units)
    return np.asarray(f[:n, :n] @ after @ f[:n, :n].T + q[:n, :n])


def phases(gyro_dt: float, star_dt: float) -> Array:
    """Return the times after the last fix [s] at which gyro samples fall in the long run."""
    count = max(1, Fraction(star_dt / gyro_dt).limit_denominator(100).numerator)
    return np.asarray(star_dt * np.arange(count) / count)


def star_covariance(star: Star) -> Array:
    """Return the noise covariance (3, 3) of fixes in the body frame [rad^2].

    Raises
    ------
    InputError
        If there is none, or it is not positive definite.
    """
    if isinstance(star, StarCamera):
        packed: Array = star.to_body([[1.0, 0.0, 0.0, 0.0]])[1][0]
        return np.asarray(packed[_UNPACK])
    if isinstance(star, Mapping):
        if not star:
            raise InputError("names no camera", field="star")
        each = [star_covariance(checked(c, str(k), StarCamera)) for k, c in star.items()]
        return symmetric(np.linalg.inv(np.linalg.inv(np.array(each)).sum(axis=0)))
    given = array(star, "star")
    if given.shape in ((), (1,), (3,)):
        return star_covariance(StarCamera(given))
    return np.asarray(covariances(array(given, "star", (3, 3))[None], "star", 1, one=True)[0])
