"""How good is an orbit's prediction without fixes? The filter's belief, carried over windows."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from celestcore._check import number
from celestcore.errors import InputError
from celestcore.gnss._attitude import star_fixes
from celestcore.gnss._earth import Earth
from celestcore.gnss._orbit import Fixes, OrbitRun, fixes_of
from celestcore.orbit.propagate import environment_of

if TYPE_CHECKING:
    from celestcore.gnss.navigator import GnssStarNavigator
    from celestcore.log import SensorLog

__all__ = ["WithheldOrbit", "withheld_orbit"]

Array = NDArray[np.float64]

_CHI_95 = 2.7954834829151074
"""The length of a standard normal 3-vector is below this with probability 0.95."""
_FULL = np.array([[0, 1, 2], [1, 3, 4], [2, 4, 5]])
"""Where a packed symmetric matrix (xx, xy, xz, yy, yz, zz) has the entries of the full one."""


@dataclass(frozen=True, eq=False)
class WithheldOrbit:
    """How far an orbit predicted without fixes was off the fixes, and how far it was expected to.

    What this does not show: the fixes are the reference. An error that they keep for longer than a
    window, the same at its begin and its end, is not seen.

    Attributes
    ----------
    window : float
        Length of a window [s].
    start, end : ndarray (k,)
        The filter's last fix before a window, and the fix that the prediction is compared with [s].
    error : ndarray (k, 3)
        Fix less prediction: radial, along-track and along the orbit's normal [m].
    sigma : ndarray (k,)
        Predicted rms of the length of `error`: prediction and fix together [m].
    distance : ndarray (k,)
        Mahalanobis distance of `error`: below 2.80 with probability 0.95 if the sigmas are right.

    Examples
    --------
    >>> import celestcore as cc
    >>> trial = cc.gnss.GnssStarScenario(duration=1800.0).trial(seed=1, trial=0)
    >>> found = withheld_orbit(cc.GnssStarNavigator(), trial.log, 60.0)
    >>> found.error.shape == (len(found), 3)
    True
    """

    window: float
    start: Array
    end: Array
    error: Array
    sigma: Array
    distance: Array

    def __len__(self) -> int:
        return len(self.start)

    @property
    def size(self) -> Array:
        """Lengths of the errors [m]."""
        return np.asarray(np.linalg.norm(self.error, axis=1))

    def summary(self) -> dict[str, float]:
        """Return the main figures as plain numbers; names say the units.

        Returns
        -------
        dict of str to float

        Examples
        --------
        >>> import celestcore as cc
        >>> trial = cc.gnss.GnssStarScenario(duration=1800.0).trial(seed=1, trial=0)
        >>> withheld_orbit(cc.GnssStarNavigator(), trial.log, 60.0).summary()["window_s"]
        60.0
        """
        size = self.size
        rms = np.sqrt(np.mean(self.error**2, axis=0))
        figures = {
            "window_s": self.window,
            "windows": len(self),
            "apart": _apart(self.start, self.window),
            "error_rms_m": np.sqrt(np.mean(size**2)),
            "error_median_m": np.median(size),
            "error_95_m": np.percentile(size, 95),
            "error_max_m": size.max(),
            "radial_rms_m": rms[0],
            "along_rms_m": rms[1],
            "normal_rms_m": rms[2],
            "sigma_median_m": np.median(self.sigma),
            "ratio_rms": np.sqrt(np.mean((size / self.sigma) ** 2)),
            "inside_95": np.mean(self.distance <= _CHI_95),
            "distance_max": self.distance.max(),
        }
        return {k: int(v) if k in ("windows", "apart") else float(v) for k, v in figures.items()}


def withheld_orbit(
    navigator: GnssStarNavigator,
    log: SensorLog,
    window: float = 600.0,
    *,
    every: float | None = None,
    settle: float = 600.0,
) -> WithheldOrbit:
    """Hide all fixes for a window, predict across it, compare with the fix at its end; many times.

    The filter runs once over the whole log. From what it knew at the begin of a window, covariance
    and receiver bias included, the orbit is predicted to the last fix of the window.

    Parameters
    ----------
    navigator : GnssStarNavigator
        Used as it is.
    log : SensorLog
        With a ``gnss`` table.
    window : float
        Length of a window [s].
    every : float, optional
        Time from one window's begin to the next's [s]; the shorter of `window` and 60 s. Windows
        that overlap are not independent: ``summary()["apart"]`` says how many are apart.
    settle : float
        The first window begins this long after the first fix [s].

    Returns
    -------
    WithheldOrbit

    Raises
    ------
    InputError
        If a time is not positive, or there is no window with fixes at both ends.

    Examples
    --------
    >>> import celestcore as cc
    >>> trial = cc.gnss.GnssStarScenario(duration=1800.0).trial(seed=1, trial=0)
    >>> len(withheld_orbit(cc.GnssStarNavigator(), trial.log, 600.0, every=300.0))
    3
    """
    window = number(window, "window", above=0.0)
    every = min(window, 60.0) if every is None else number(every, "every", above=0.0)
    settle = number(settle, "settle", at_least=0.0)
    if log.gnss is None or log.epoch is None:
        raise InputError("needs GNSS fixes and an epoch", field="log")
    earth = Earth(log.epoch)
    fixes = fixes_of(navigator, log.gnss, star_fixes(navigator, log).stars(), earth)
    begin, end = _windows(fixes, window, every, settle)
    span = fixes.epochs[[0, -1]]
    tables = environment_of(navigator.dynamics.force, log.epoch, span, None)
    belief = navigator.run(log, t_output=fixes.epochs[begin], covariance=True, environment=tables)
    run = OrbitRun(navigator, fixes, log.epoch, tables)
    found = [_carried(run, belief, k, float(fixes.epochs[row])) for k, row in enumerate(end)]
    state, p = (np.stack(part) for part in zip(*found, strict=True))
    error = fixes.r[end] - state[:, :3]
    spread = p[:, :3, :3] + _noise(fixes, end)
    if state.shape[1] == 9:
        error = error - state[:, 6:]
        cross = p[:, :3, 6:]
        spread = spread + p[:, 6:, 6:] + cross + np.swapaxes(cross, -1, -2)
    weighted = np.linalg.solve(spread, error[..., None])[..., 0]
    return WithheldOrbit(
        window=window,
        start=fixes.epochs[begin],
        end=fixes.epochs[end],
        error=_along(error, state),
        sigma=np.sqrt(np.trace(spread, axis1=1, axis2=2)),
        distance=np.sqrt(np.einsum("ij,ij->i", error, weighted)),
    )


def _windows(fixes: Fixes, window: float, every: float, settle: float) -> tuple[Any, Any]:
    """Return the rows of the fixes at the begin and at the end of each window."""
    t = fixes.epochs
    edge = np.arange(t[0] + settle, t[-1] - window + 1e-6, every)
    step = float(np.median(np.diff(t))) if len(t) > 1 else window
    begin = np.searchsorted(t, edge + 1e-6) - 1
    end = np.searchsorted(t, t[np.maximum(begin, 0)] + window + 0.5 * step) - 1
    usable = (begin >= 0) & (t[end] - t[begin] > window - 0.6 * step)
    usable &= np.isfinite(fixes.r[end]).all(axis=1)
    rows = np.unique(begin[usable], return_index=True)[1]
    if len(rows) == 0:
        raise InputError(
            f"there is no window of {window:g} s with fixes at both ends after the first "
            f"{settle:g} s of fixes, which span {t[-1] - t[0]:.6g} s",
            field="window",
            value=window,
        )
    return begin[usable][rows], end[usable][rows]


def _carried(run: OrbitRun, belief: Any, k: int, t: float) -> tuple[Array, Array]:
    """Return state and covariance at time t, from the belief's row k and no fix after it."""
    state = np.concatenate([belief.r[k], belief.v[k]])
    if belief.gnss_bias is not None:
        state = np.append(state, belief.gnss_bias[k])
    stops = np.array([belief.t[k], t])
    none = run.fixes.columns(np.empty(0, dtype=int))
    start = (float(belief.t[k]), state, np.ascontiguousarray(belief.orbit_covariance[k]))
    out = run.core.run(
        (stops, np.array([False, True]), None), none, start, 1.0, False, True, False, None
    )
    n = len(state)
    return np.asarray(out["state"][-1]), np.asarray(out["covariance"]).reshape(-1, n, n)[-1]


def _noise(fixes: Fixes, rows: Any) -> Array:
    """Return the covariances of some positions (k, 3, 3) [m^2]."""
    positions = np.flatnonzero(~fixes.velocity)
    own = positions[np.argsort(fixes.row[positions])]
    return np.asarray(fixes.noise[own][rows][:, _FULL])


def _along(error: Array, state: Array) -> Array:
    """Return errors along the radial, the track and the orbit's normal."""
    r, v = state[:, :3], state[:, 3:6]
    radial = r / np.linalg.norm(r, axis=1)[:, None]
    h = np.cross(r, v)
    normal = h / np.linalg.norm(h, axis=1)[:, None]
    axes = np.stack([radial, np.cross(normal, radial), normal], axis=1)
    return np.asarray(np.einsum("kij,kj->ki", axes, error))


def _apart(start: Array, window: float) -> int:
    """Return how many of the windows can be taken without an overlap."""
    count, free = 0, -np.inf
    for t in start:
        if t >= free - 1e-3:
            count, free = count + 1, t + window
    return count
