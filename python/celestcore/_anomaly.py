"""True and mean anomalies of any conic; `celestcore.elements` hands them on."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from celestcore._check import BoolArray, FloatArray, array
from celestcore.errors import InputError

TWO_PI = 2.0 * np.pi


def refuse(bad: BoolArray, message: str, field: str, value: FloatArray) -> None:
    """Raise an `InputError` that names the first bad row, if there is one."""
    if np.any(bad):
        k = int(np.argmax(bad))
        row = k if np.ndim(bad) else None
        raise InputError(message, field=field, row=row, value=np.asarray(value).reshape(-1)[k])


def broadcast(**values: Any) -> dict[str, FloatArray]:
    arrays = {name: array(value, name) for name, value in values.items()}
    try:
        shaped = np.broadcast_arrays(*arrays.values())
    except ValueError:
        shapes = " and ".join(str(a.shape) for a in arrays.values())
        raise InputError(f"shapes {shapes} do not broadcast", field="elements") from None
    for name, value in zip(arrays, shaped, strict=True):
        flat = value.reshape(-1)
        finite = np.isfinite(flat) | ((name == "a") & np.isinf(flat))
        refuse(~finite, "must be finite", name, flat)
    return dict(zip(arrays, shaped, strict=True))


def _above_sine(x: FloatArray, sign: Any) -> FloatArray:
    """Return ``x - sin x`` (sign -1) or ``sinh x - x`` (sign 1) without cancellation near 0."""
    square = sign * x * x
    series = np.ones_like(x)
    for k in range(21, 3, -2):
        series = 1.0 + series * square / (k * (k - 1.0))
    with np.errstate(over="ignore"):
        plain = np.where(np.less(sign, 0.0), x - np.sin(x), np.sinh(x) - x)
    return np.where(np.abs(x) < 1.0, series * x**3 / 6.0, plain)


def true_to_mean(nu: ArrayLike, e: ArrayLike) -> FloatArray:
    """Mean anomaly of a true anomaly, for any conic.

    Parameters
    ----------
    nu, e : array_like (...)
        True anomaly [rad] and eccentricity.

    Returns
    -------
    ndarray (...)
        Ellipse: ``E - e sin E``, on the same revolution as `nu`; hyperbola: ``e sinh F - F``;
        parabola: ``D + D^3 / 3`` with ``D = tan(nu / 2)`` (Barker).

    Raises
    ------
    InputError
        If an eccentricity is negative or an anomaly lies beyond the asymptote.

    Examples
    --------
    >>> float(true_to_mean(np.pi / 2, 0.5).round(6))
    0.614185
    """
    f = broadcast(nu=nu, e=e)
    true, ecc = f["nu"], f["e"]
    refuse((ecc < 0.0).reshape(-1), "must not be negative", "e", ecc)
    beyond = (ecc >= 1.0) & ~(1.0 + ecc * np.cos(true) > 0.0)
    refuse(beyond.reshape(-1), "lies beyond the asymptote", "nu", true)
    turns = np.round(true / TWO_PI)
    half = np.tan(0.5 * (true - TWO_PI * turns))
    ratio = np.sqrt(np.abs(1.0 - ecc) / (1.0 + ecc))
    eccentric = 2.0 * np.arctan(ratio * half)
    ellipse = (1.0 - ecc) * eccentric + ecc * _above_sine(eccentric, -1.0) + TWO_PI * turns
    with np.errstate(all="ignore"):
        hyperbolic = 2.0 * np.arctanh(ratio * half)
        hyperbola = (ecc - 1.0) * hyperbolic + ecc * _above_sine(hyperbolic, 1.0)
        parabola = half + half**3 / 3.0
    return np.where(ecc < 1.0, ellipse, np.where(ecc > 1.0, hyperbola, parabola))


def mean_to_true(mean: ArrayLike, e: ArrayLike) -> FloatArray:
    """Solve Kepler's equation: the true anomaly of a mean anomaly, for any conic.

    Newton's method, kept between bounds that close in on the root, so that it converges for every
    eccentricity.

    Parameters
    ----------
    mean, e : array_like (...)
        Mean anomaly [rad], as `true_to_mean` returns it, and eccentricity.

    Returns
    -------
    ndarray (...)
        True anomaly [rad], on the same revolution as `mean`.

    Raises
    ------
    InputError
        If an eccentricity is negative.

    Examples
    --------
    >>> float(mean_to_true(true_to_mean(2.0, 0.3), 0.3).round(12))
    2.0
    """
    f = broadcast(mean=mean, e=e)
    m, ecc = f["mean"], f["e"]
    refuse((ecc < 0.0).reshape(-1), "must not be negative", "e", ecc)
    ellipse = ecc < 1.0
    turns = np.where(ellipse, np.round(m / TWO_PI), 0.0)
    m = m - TWO_PI * turns
    root = _kepler(np.abs(m), ecc)
    ratio = np.sqrt((1.0 + ecc) / np.where(ecc == 1.0, 1.0, np.abs(1.0 - ecc)))
    with np.errstate(all="ignore"):
        half = np.where(ellipse, ratio * np.tan(0.5 * root), ratio * np.tanh(0.5 * root))
        barker = 2.0 * np.sinh(np.arcsinh(1.5 * np.abs(m)) / 3.0)
    half = np.where(ecc == 1.0, barker, half)
    return np.asarray(np.copysign(2.0 * np.arctan(half), m) + TWO_PI * turns)


def _kepler(m: FloatArray, e: FloatArray) -> FloatArray:
    """Solve ``E - e sin E = m`` or ``e sinh F - F = m`` for m >= 0 (parabolas are left alone)."""
    ellipse = e < 1.0
    low = np.where(ellipse, m, 0.0)
    # the ellipse's root lies in [m, m + e]; the hyperbola's below asinh of (m + F) / e
    high = np.where(ellipse, np.minimum(m + e, np.pi), np.arcsinh(m / np.maximum(e, 1.0)) + 1.0)
    for _ in range(60):
        short = ~ellipse & (e * np.sinh(np.minimum(high, 700.0)) - high < m)
        if not short.any():
            break
        high = np.where(short, 2.0 * high, high)
    x = np.where(m == 0.0, 0.0, 0.5 * (low + high))
    for _ in range(80):
        with np.errstate(all="ignore"):
            cosine = np.where(ellipse, np.cos(x), np.cosh(x))
            value = np.abs(1.0 - e) * x + e * _above_sine(x, np.where(ellipse, -1.0, 1.0)) - m
            slope = np.where(ellipse, 1.0 - e * cosine, e * cosine - 1.0)
            step = value / slope
        low, high = np.where(value <= 0.0, x, low), np.where(value >= 0.0, x, high)
        newton = x - step
        inside = (newton >= low) & (newton <= high)
        new = np.where(inside, newton, 0.5 * (low + high))
        done = np.abs(new - x) <= 4e-16 * np.abs(new)
        x = new
        if (done | (e == 1.0)).all():
            break
    return np.asarray(x)
