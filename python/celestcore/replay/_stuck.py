"""Sensors that say the same again and again while the body turns."""

from __future__ import annotations

from typing import Any

import numpy as np

from celestcore._check import FloatArray
from celestcore.log import SensorLog
from celestcore.solution import Solution

TURNED = 10.0
"""Innovation sigmas by which the gyro must have turned since a value came first."""


def stuck(sol: Solution, log: SensorLog) -> np.ndarray[Any, np.dtype[np.bool_]]:
    """Tell of each measurement whether it repeats its sensor's value though the body has turned.

    A sensor with noise does not say the same twice; one that does so while the gyro turns hangs. A
    body at rest may well give the same quantised fix again: that counts as a fix.
    """
    out = np.zeros(len(sol.measurement_t), bool)
    gyro = log.gyro
    if gyro is None or not (~sol.accepted).any():
        return out
    steps = np.diff(gyro.t)[:, None] * gyro.rate[:-1]
    turned = np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)])
    for number, name in enumerate(sol.sensor_names):
        star = log.stars.get(name)
        own = np.flatnonzero(sol.sensor == number)
        if star is None or not len(own):
            continue
        rows = np.searchsorted(star.t, sol.measurement_t[own])
        first = _first_of_equal(star.q)[rows]
        # the integral of the rate, by components: enough to tell a turn from none
        angle = np.linalg.norm(
            _at(gyro.t, turned, star.t[rows]) - _at(gyro.t, turned, star.t[first]), axis=1
        )
        sigma = np.linalg.norm(sol.innovation_sigma[own], axis=1)
        out[own] = (first < rows) & (angle > TURNED * sigma)
    return out


def _first_of_equal(values: FloatArray) -> np.ndarray[Any, np.dtype[np.intp]]:
    """Return for each row the first one of the run of equal rows that it belongs to."""
    new = np.ones(len(values), bool)
    new[1:] = (values[1:] != values[:-1]).any(axis=1)
    starts = np.flatnonzero(new)
    out: np.ndarray[Any, np.dtype[np.intp]] = starts[np.cumsum(new) - 1]
    return out


def _at(t: FloatArray, values: FloatArray, when: FloatArray) -> FloatArray:
    return np.stack([np.interp(when, t, values[:, k]) for k in range(values.shape[1])], axis=1)
