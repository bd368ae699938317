"""How a body keeps to the geodetic nadir of its own GNSS fixes, and what that says of time tags."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from celestcore import quaternion
from celestcore.errors import InputError
from celestcore.frames import orbital, orbital_geodetic
from celestcore.gnss._attitude import star_fixes
from celestcore.units import DEG

if TYPE_CHECKING:
    from celestcore.gnss.navigator import GnssStarNavigator
    from celestcore.gnss.solution import GnssStarSolution
    from celestcore.log import SensorLog

__all__ = ["NadirPointing", "nadir_pointing"]

Array = NDArray[np.float64]

STEERED = 0.05 * DEG
"""Rms angle to the geodetic frame above which a body is not taken to steer there."""
BLOCK = 600.0
"""Length of the parts whose means tell the uncertainty of the time offset [s]."""
STEADY = 1e-3
"""Spread of tag differences below which rows of two tables belong together [s]."""


@dataclass(frozen=True, eq=False)
class NadirPointing:
    """The attitude of star fixes about the orbital frame of the same log's GNSS fixes.

    Frames, Earth rotation, ellipsoid, time tags and both sensors take part, so small angles of a
    body that steers to the geodetic nadir say that the whole chain is right.

    Attributes
    ----------
    t : ndarray (n,)
        Times of the star fixes [s].
    error : ndarray (n, 3)
        Rotation vector from the orbital frame with its z axis to the geodetic nadir to the body:
        roll, pitch, yaw [rad].
    geocentric : ndarray (n, 3)
        The same from the frame with its z axis to the Earth's centre [rad].
    tag_difference : float
        Time tag of a star fix less that of the GNSS fix of the same row, NaN if rows do not belong
        together [s].
    offset, offset_sigma : float
        What the star fixes' time tags are ahead, as the attitude tells it, and 1-sigma [s]: the
        body turns with the orbit, so a late tag looks like a constant pitch. It is taken that the
        body's own mean pitch is zero. NaN for a body that does not steer to the nadir.

    Examples
    --------
    >>> import celestcore as cc
    >>> log = cc.sample("noaa20")
    >>> nav = cc.Settings.from_log(log).gnss_navigator()
    >>> found = nadir_pointing(nav, log, nav.run(log))
    >>> round(found.summary()["largest_deg"], 4)
    0.0041
    """

    t: Array
    error: Array
    geocentric: Array
    tag_difference: float
    offset: float
    offset_sigma: float

    def __len__(self) -> int:
        return len(self.t)

    def summary(self) -> dict[str, Any]:
        """Return the main figures; names say the units, lists are roll, pitch and yaw.

        Returns
        -------
        dict

        Examples
        --------
        >>> import celestcore as cc
        >>> log = cc.sample("noaa20")
        >>> nav = cc.Settings.from_log(log).gnss_navigator()
        >>> found = nadir_pointing(nav, log, nav.run(log)).summary()
        >>> round(found["geocentric_largest_deg"], 2), round(found["tag_difference_s"], 3)
        (0.17, -0.1)
        """
        error = self.error / DEG
        return {
            "fixes": len(self),
            "mean_deg": error.mean(axis=0).tolist(),
            "std_deg": error.std(axis=0).tolist(),
            "max_deg": np.abs(error).max(axis=0).tolist(),
            "largest_deg": float(np.linalg.norm(error, axis=1).max()),
            "geocentric_std_deg": (self.geocentric / DEG).std(axis=0).tolist(),
            "geocentric_largest_deg": float(np.abs(self.geocentric).max() / DEG),
            "tag_difference_s": self.tag_difference,
            "found_difference_s": self.tag_difference - self.offset,
            "offset_s": self.offset,
            "offset_sigma_s": self.offset_sigma,
        }


def nadir_pointing(
    navigator: GnssStarNavigator, log: SensorLog, solution: GnssStarSolution
) -> NadirPointing:
    """Compare the log's star fixes with the orbital frame of the solution's positions.

    Parameters
    ----------
    navigator : GnssStarNavigator
        Says how the star sensor is mounted, and its time offset.
    log : SensorLog
        With a star table; of several the first counts.
    solution : GnssStarSolution
        Of this log; rows at the times of star fixes are used.

    Returns
    -------
    NadirPointing

    Raises
    ------
    InputError
        If there is no row at the time of a star fix.

    Examples
    --------
    >>> import celestcore as cc
    >>> trial = cc.gnss.GnssStarScenario(duration=300.0).trial(seed=1, trial=0)
    >>> nav = cc.GnssStarNavigator()
    >>> len(nadir_pointing(nav, trial.log, nav.run(trial.log)))
    31
    """
    fixes = star_fixes(navigator, log)
    first = fixes.sensor == 0
    t, at, rows = np.intersect1d(fixes.t[first], solution.t, return_indices=True)
    if len(t) < 2:
        raise InputError("has no rows at the times of star fixes", field="solution")
    q = fixes.q[first][at]
    r, v = solution.r[rows], solution.v[rows]
    down, centre = orbital_geodetic(solution.epoch, t, r, v), orbital(r, v)
    error = _turn(down, q)
    offset, sigma = _offset(t, down, error)
    return NadirPointing(t, error, _turn(centre, q), _tag_difference(log), offset, sigma)


def _turn(q_io: Array, q_ib: Array) -> Array:
    """Return rotation vectors from the orbital frame to the body."""
    return quaternion.log(quaternion.multiply(quaternion.conjugate(q_io), q_ib))


def _offset(t: Array, q_io: Array, error: Array) -> tuple[float, float]:
    """Return how far the tags are ahead by least squares, and 1-sigma by means of blocks.

    A fix with the tag t that is of ``t - a`` looks turned by ``-a`` times the frame's rate.
    """
    if np.sqrt(np.mean(np.sum(error**2, axis=1))) > STEERED:
        return np.nan, np.nan
    turn = _turn(q_io[:-1], q_io[1:]) / np.diff(t)[:, None]
    rate = np.vstack([turn, turn[-1:]])
    size = np.sum(rate**2, axis=1)
    each = -np.sum(rate * error, axis=1) / size
    offset = float(np.average(each, weights=size))
    block = np.floor((t - t[0]) / BLOCK).astype(int)
    whole = [k for k in np.unique(block) if np.ptp(t[block == k]) > 0.5 * BLOCK]
    if len(whole) < 3:
        return offset, np.nan
    means = np.array([np.mean(each[block == k]) for k in whole])
    return offset, float(np.std(means, ddof=1) / np.sqrt(len(means)))


def _tag_difference(log: SensorLog) -> float:
    """Return the star table's tags less the GNSS table's, if their rows belong together."""
    star = next(iter(log.stars.values()))
    assert log.gnss is not None
    gnss = log.gnss.t
    near = np.clip(np.searchsorted(gnss, star.t), 1, len(gnss) - 1) if len(gnss) > 1 else None
    if near is None:
        return np.nan
    left = star.t - gnss[near - 1] < gnss[near] - star.t
    difference = star.t - gnss[near - left]
    middle = float(np.median(difference))
    return middle if np.percentile(np.abs(difference - middle), 90) < STEADY else np.nan
