"""What theory says of each cell: bounds of filter and smoother, and how far runs scatter."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

import celestcore as cc
from celestcore import quaternion as qt
from celestcore.reproduce._model import (
    DURATION,
    GYRO_STEP,
    RATE,
    SKIP,
    STAR_STEP,
    Array,
    Cell,
    figures,
    tuned,
)


@dataclass(frozen=True)
class Theory:
    """Figures (cell, axis) [arcsec, 3 sigma], and standard errors as parts of them.

    Attributes
    ----------
    filter, smoother : array, (cell, axis)
        Steady state just after a fix.
    between, before : array, (cell, axis)
        The filter's over all gyro samples, and just before a fix.
    scatter_filter, scatter_smoother : array, (cell, axis)
        Standard error of the rms of one run, as a part of it.
    """

    filter: Array
    smoother: Array
    between: Array
    before: Array
    scatter_filter: Array
    scatter_smoother: Array


def theory(cells: list[Cell]) -> Theory:
    """Return bounds and scatter of tuned filters, from `celestcore.analysis.steady_state`."""
    rate = (0.0, -RATE, 0.0)
    settled = []
    for cell in cells:
        nav = tuned(cell, cc.EKF())
        settled.append(cc.analysis.steady_state(nav.gyro, nav.star, GYRO_STEP, STAR_STEP, rate))
    sigma = {
        name: figures(np.array([getattr(s, f"sigma_{name}")[:3] for s in settled]))
        for name in ("filter", "smoother", "between", "before")
    }
    covariance = np.array([s.filter for s in settled])
    gain = np.array([s.gain for s in settled])
    full = round((DURATION - SKIP) / STAR_STEP)
    short = round((DURATION - 2.0 * SKIP) / STAR_STEP)
    power = _correlation(covariance, gain, full)
    return Theory(
        **sigma,
        scatter_filter=figures_order(_scatter(power, full)),
        scatter_smoother=figures_order(_scatter(power, short)),
    )


def figures_order(values: Array) -> Array:
    """Return what stands about body x, y, z in the order pitch, roll, yaw."""
    return np.asarray(values[..., [1, 0, 2]])


def _correlation(covariance: Array, gain: Array, steps: int) -> Array:
    """Return the squared autocorrelation (lag, cell, 3) of errors after fixes, from lag 1.

    Errors of a settled filter go on as ``(I - K H) F``.
    """
    f = np.eye(6)
    f[:3, :3] = np.asarray(qt.to_matrix(qt.exp([0.0, RATE * STAR_STEP, 0.0])))
    f[:3, 3:] = -STAR_STEP * np.eye(3)
    h = np.hstack([np.eye(3), np.zeros((3, 3))])
    closed = (np.eye(6) - gain @ h) @ f
    at, out = covariance, np.empty((steps, len(covariance), 3))
    for k in range(steps):
        at = closed @ at
        out[k] = np.diagonal(at, axis1=1, axis2=2)[:, :3]
    return np.asarray((out / np.diagonal(covariance, axis1=1, axis2=2)[:, :3]) ** 2)


def _scatter(power: Array, steps: int) -> Array:
    """Return the standard error of the rms of a run of normal errors, as a part of it.

    The variance of a mean of squares is 2/n times the sum of the squared autocorrelation. What a
    smoother leaves of a random walk in white noise has the same autocorrelation as the filter's.
    """
    weight = 1.0 - np.arange(1, steps) / steps
    total = 1.0 + 2.0 * np.einsum("k,kca->ca", weight, power[: steps - 1])
    return np.asarray(0.5 * np.sqrt(2.0 * total / steps))
