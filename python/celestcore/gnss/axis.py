"""Classical filters of single coordinates, and the paper's scheme of three of them on Euler angles.

Kept as the reference that the navigator is held against, not as a way to go.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from celestcore import _core
from celestcore._check import FloatArray, array, number, times
from celestcore.errors import InputError

__all__ = ["AxisEstimate", "axis_filter", "euler_filter"]


@dataclass(frozen=True, eq=False)
class AxisEstimate:
    """A coordinate with its rate and acceleration over time.

    Attributes
    ----------
    t : ndarray (n,)
        [s].
    value, rate, acceleration : ndarray (n,) or (n, axes)
        In the unit of what was measured, per s, per s^2.
    sigma : ndarray (n, 3) or (n, axes, 3)
        Their 1-sigma.

    Examples
    --------
    >>> AxisEstimate(np.zeros(1), *[np.zeros(1)] * 3, np.zeros((1, 3))).value
    array([0.])
    """

    t: FloatArray
    value: FloatArray
    rate: FloatArray
    acceleration: FloatArray
    sigma: FloatArray


def _parabola(
    first: FloatArray, variance: float, dt: float
) -> tuple[list[float], list[list[float]]]:
    """State and covariance at the third of three samples: of the parabola through them."""
    state = [
        float(first[2]),
        float(1.5 * first[2] - 2.0 * first[1] + 0.5 * first[0]) / dt,
        float(first[2] - 2.0 * first[1] + first[0]) / dt**2,
    ]
    r = variance
    covariance = [
        [r, 1.5 * r / dt, r / dt**2],
        [1.5 * r / dt, 6.5 * r / dt**2, 6.0 * r / dt**3],
        [r / dt**2, 6.0 * r / dt**3, 6.0 * r / dt**4],
    ]
    return state, covariance


def axis_filter(
    t: ArrayLike,
    value: ArrayLike,
    sigma: float,
    jerk_psd: float,
    *,
    rate: ArrayLike | None = None,
    sigma_rate: float | None = None,
    wraps: bool = False,
    smooth: bool = False,
) -> AxisEstimate:
    """Kalman filter of one coordinate whose third derivative is white noise, H = [1 0 0].

    Transition ``[1 T T^2/2; 0 1 T; 0 0 1]``, process noise ``q [T^5/20 T^4/8 T^3/6; . T^3/3 T^2/2;
    . . T]``, Joseph's form. It starts from the first three samples: the parabola through them, with
    its covariance ``R [1 3/(2T) 1/T^2; . 13/(2T^2) 6/T^3; . . 6/T^4]``.

    Parameters
    ----------
    t : array_like (n,)
        Times [s], increasing; four at least, equal steps in the first three.
    value : array_like (n,)
        What is measured.
    sigma : float
        Its 1-sigma.
    jerk_psd : float
        Density of the third derivative [unit^2/s^5].
    rate : array_like (n,), optional
        Measured rates [unit/s], with `sigma_rate`.
    sigma_rate : float, optional
        Their 1-sigma.
    wraps : bool
        Whether it is an angle [rad], with differences by the shorter way.
    smooth : bool
        Whether to go back over it, too.

    Returns
    -------
    AxisEstimate
        At every time; the first three are the parabola's own.

    Raises
    ------
    InputError
        Names the field and the value.

    Notes
    -----
    Zhang, Chen and Wang 2019 (GPS and star sensor), eqs 6-14; process noise and start are those
    usual for the model, inferred: the paper's are not legible.

    Examples
    --------
    >>> made = axis_filter(np.arange(6.0), np.arange(6.0) * 2.0, 0.1, 1e-6)
    >>> made.value.round(6), float(made.rate[-1].round(6))
    (array([ 0.,  2.,  4.,  6.,  8., 10.]), 2.0)
    """
    at = times(t, "t")
    z = array(value, "value", (len(at),))
    if len(at) < 4:
        raise InputError("needs four samples at least", field="t", value=len(at))
    variance = number(sigma, "sigma", above=0.0) ** 2
    q = number(jerk_psd, "jerk_psd", above=0.0)
    first = z[:3].copy()
    if wraps:
        first = np.unwrap(first)
    dt = float(at[1] - at[0])
    state, p = _parabola(first, variance, dt)
    columns = [(at[3:], np.zeros(len(at) - 3, bool), z[3:], np.full(len(at) - 3, variance))]
    if rate is not None:
        own = array(rate, "rate", (len(at),))
        noise = number(np.nan if sigma_rate is None else sigma_rate, "sigma_rate", above=0.0) ** 2
        # the rates of the first two samples are left out: the parabola stands for them
        late = slice(2, None)
        n = len(at) - 2
        columns.append((at[late], np.ones(n, bool), own[late], np.full(n, noise)))
    joined = [np.concatenate(part) for part in zip(*columns, strict=True)]
    order = np.lexsort((joined[1], joined[0]))
    when, is_rate, measured, noises = (np.ascontiguousarray(part[order]) for part in joined)
    fixes = (when, is_rate, measured, noises)
    stops = (np.ascontiguousarray(at[2:]), np.ones(len(at) - 2, bool), None)
    out = _core.gnss_axis(q, stops, fixes, (float(at[2]), state, p), bool(wraps), bool(smooth))
    return _estimate(at, out, dt)


def _estimate(at: FloatArray, out: dict[str, Any], dt: float) -> AxisEstimate:
    """Put the first two samples before the core's answer: its parabola, carried back."""
    state, sigma = out["state"], out["sigma"]
    head = []
    for back in (2.0 * dt, dt):
        x, v, a = state[0]
        head.append([x - v * back + 0.5 * a * back**2, v - a * back, a])
    state = np.vstack([head, state])
    sigma = np.vstack([sigma[:1], sigma[:1], sigma])
    value, rate, acceleration = np.ascontiguousarray(state.T)
    return AxisEstimate(at, value, rate, acceleration, sigma)


def euler_filter(
    t: ArrayLike, angles: ArrayLike, sigma: float, jerk_psd: float, *, smooth: bool = False
) -> AxisEstimate:
    """Three Kalman filters, one for each Euler angle, as if the angles knew nothing of each other.

    The paper's scheme. Near 90 degrees of pitch yaw and roll jump by half a turn, and the filters
    follow the jump: the reason why `celestcore.GnssStarNavigator` works on quaternions.

    Parameters
    ----------
    t : array_like (n,)
        Times [s].
    angles : array_like (n, 3)
        Yaw, pitch, roll [rad], or differences of those of two sensors.
    sigma : float
        1-sigma of each angle [rad].
    jerk_psd : float
        Density of their third derivatives [rad^2/s^5].
    smooth : bool
        Whether to go back over them, too.

    Returns
    -------
    AxisEstimate
        With axes yaw, pitch, roll.

    Raises
    ------
    InputError
        Names the field and the value.

    Notes
    -----
    Zhang, Chen and Wang 2019, eqs 6-14.

    Examples
    --------
    >>> made = euler_filter(np.arange(6.0), np.zeros((6, 3)), 1e-4, 1e-16)
    >>> made.value.shape
    (6, 3)
    """
    at = times(t, "t")
    z = array(angles, "angles", (len(at), 3))
    axes = [
        axis_filter(at, np.ascontiguousarray(z[:, k]), sigma, jerk_psd, wraps=True, smooth=smooth)
        for k in range(3)
    ]
    columns = (np.stack([getattr(a, name) for a in axes], axis=1) for name in _COLUMNS)
    return AxisEstimate(at, *columns)


_COLUMNS = ("value", "rate", "acceleration", "sigma")
