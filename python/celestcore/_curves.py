"""What `plot` draws, before it is drawn: angles, thinned series, the time axis."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from celestcore.solution import Array

BINS = 1000  # a line is drawn with the extremes of this many bins


@dataclass(frozen=True)
class TimeAxis:
    """Seconds to the unit on the axis: ``(t - start) / scale``."""

    start: float
    scale: float
    label: str

    def __call__(self, t: Array) -> Array:
        return np.asarray((t - self.start) / self.scale)


def euler_321(q: Array) -> Array:
    """Return yaw, pitch, roll: rotations about z, then the new y, then the new x, rad.

    For ``q_ib``, yaw is the right ascension of the body x axis and pitch its declination
    with the sign changed.

    Parameters
    ----------
    q : array, (..., 4)
        Unit quaternions, scalar first.

    Returns
    -------
    array, (..., 3)
        Yaw and roll in (-pi, pi], pitch in [-pi/2, pi/2].

    Examples
    --------
    >>> import numpy as np
    >>> np.rad2deg(euler_321(np.array([0.5**0.5, 0.0, 0.0, 0.5**0.5]))).round(6)
    array([90.,  0.,  0.])
    """
    w, x, y, z = np.moveaxis(q, -1, 0)
    yaw = np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    pitch = np.arcsin(np.clip(2.0 * (w * y - x * z), -1.0, 1.0))
    roll = np.arctan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
    return np.stack([yaw, pitch, roll], axis=-1)


def extremes(y: Array, bins: int = BINS) -> NDArray[np.intp]:
    """Return the rows that hold the lowest and highest value of each of `bins` bins.

    All rows, when there are few. The first and last row are always kept.
    """
    n = len(y)
    if n <= 2 * bins:
        return np.arange(n)
    size = -(-n // bins)  # rounded up: what is left over is less than a bin
    bins = n // size
    blocks = y[: size * bins].reshape(bins, size)
    start = np.arange(bins) * size
    tail = np.arange(size * bins, n)
    rest = tail[[int(np.argmin(y[tail])), int(np.argmax(y[tail]))]] if len(tail) else tail
    picked = [start + blocks.argmin(axis=1), start + blocks.argmax(axis=1), rest, [0, n - 1]]
    return np.unique(np.concatenate(picked))


def time_axis(t: Array, epoch: str | None) -> TimeAxis:
    """Choose unit and start of the axis for times in s since the epoch."""
    first, last = float(t[0]), float(t[-1])
    unit, scale = "s", 1.0
    for name, size, least in (
        ("min", 60.0, 300.0),
        ("h", 3600.0, 7200.0),
        ("d", 86400.0, 259200.0),
    ):
        if last - first >= least:
            unit, scale = name, size
    far = abs(first) > 3.0 * max(last - first, 1.0)
    start = first if far or epoch is None else 0.0
    origin = epoch or "the start"
    if far:
        origin = f"{epoch} + {first:.10g} s" if epoch else f"t = {first:.10g} s"
    return TimeAxis(start, scale, f"time since {origin} [{unit}]")


def wrapped(t: Array, angle: Array) -> tuple[Array, Array]:
    """Bring degrees into [-180, 180) and break the line where it jumps."""
    wrapped = (angle + 180.0) % 360.0 - 180.0
    cut = np.flatnonzero(np.abs(np.diff(wrapped)) > 120.0) + 1
    return np.insert(t, cut, np.nan), np.insert(wrapped, cut, np.nan)


def settled(low: Array, high: Array) -> tuple[float, float]:
    """Return axis limits that show the band once it has settled, with the start cut off."""
    tail = slice(len(low) // 10, None)
    bottom, top = float(np.min(low[tail])), float(np.max(high[tail]))
    margin = 0.15 * (top - bottom) or 1.0
    return bottom - margin, top + margin
