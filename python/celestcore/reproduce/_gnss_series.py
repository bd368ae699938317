"""Errors run by run, and what they come to over all runs."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
AXES = {"roll": 0, "pitch": 1, "yaw": 2}
"""Turns about x, y and z of the body."""


class Series(NamedTuple):
    """One figure's values run by run (runs,); NaN where a filter broke down.

    `each` are rms errors, or plain values if `rms` is not set; `largest` the runs' largest errors.
    """

    each: Array
    largest: Array | None = None
    rms: bool = True

    @property
    def value(self) -> float:
        """Rms over all runs, or the mean."""
        good = self._good()
        if not len(good):
            return float("nan")
        return float(np.sqrt(np.mean(good**2)) if self.rms else np.mean(good))

    @property
    def error(self) -> float:
        """Standard error of `value`, from the scatter between runs."""
        good = self._good()
        if len(good) < 2:
            return float("nan")
        if not self.rms:
            return _standard_error(good)
        return _standard_error(good**2) / max(2.0 * self.value, 1e-300)

    @property
    def maximum(self) -> float:
        """Mean over the runs of the largest error: the paper's maximum columns."""
        if self.largest is None:
            return float("nan")
        good = self.largest[np.isfinite(self.largest)]
        return float(np.mean(good)) if len(good) else float("nan")

    @property
    def maximum_error(self) -> float:
        """Standard error of `maximum`."""
        if self.largest is None:
            return float("nan")
        good = self.largest[np.isfinite(self.largest)]
        return _standard_error(good) if len(good) > 1 else float("nan")

    def times(self, factor: float) -> Series:
        """Return it in another unit."""
        largest = None if self.largest is None else factor * self.largest
        return Series(factor * self.each, largest, self.rms)

    def _good(self) -> Array:
        return self.each[np.isfinite(self.each)]


def _standard_error(values: Array) -> float:
    return float(np.std(values, ddof=1) / np.sqrt(len(values)))


def position(scores: Any) -> Series:
    """Return the position's errors of a campaign [m]."""
    return Series(scores.rms_position, scores.max_position)


def velocity(scores: Any) -> Series:
    """Return the velocity's errors [m/s]."""
    return Series(scores.rms_velocity, scores.max_velocity)


def attitude(scores: Any, axis: str) -> Series:
    """Return the attitude's errors about one axis [rad]."""
    k = AXES[axis]
    return Series(scores.rms_attitude[:, k], scores.max_attitude[:, k])


def whole_attitude(scores: Any) -> Series:
    """Return the lengths of the attitude's errors [rad]."""
    return Series(np.sqrt(np.sum(scores.rms_attitude**2, axis=1)))


def mean(values: Array) -> Series:
    """Return a figure that is a mean over the runs, not an rms."""
    return Series(np.asarray(values, float), None, rms=False)


def of_errors(errors: list[Array]) -> Series:
    """Return the series of errors (n,) or (n, 3), one array for each run."""
    lengths = [np.abs(e) if e.ndim == 1 else np.linalg.norm(e, axis=1) for e in errors]
    return Series(
        np.array([np.sqrt(np.mean(x * x)) for x in lengths]),
        np.array([x.max() for x in lengths]),
    )
