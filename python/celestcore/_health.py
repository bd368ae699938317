"""How the sensors fared, window by window, and what their innovations say of their noise."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from celestcore import _core
from celestcore._fixes import Fixes
from celestcore.analysis.autocorrelation import Whiteness, whiteness
from celestcore.solution import Array

MOST_WINDOWS = 120
FIXES_A_WINDOW = 20
HIGH, LOW = 2.0, 0.5
"""Mean NIS per degree of freedom of a window beyond which it is flagged..."""
SURE = 0.999
"""...if it lies outside this chi-square interval, too."""
REJECTING, LEAST_REJECTED = 0.1, 3
"""Share of rejected fixes beyond which a window is flagged, and how many they must be."""
SILENT = 0.1
"""Share of the usual number of fixes below which a sensor counts as silent."""
BURST = 5
"""So many rejected fixes running are a burst."""
UNUSUAL = 2.0
"""Innovations predicted with so many times the usual sigma say little of the fixes' noise."""
LAGS = 20
FINE, TOO_HIGH, TOO_LOW, MANY_REJECTED, NO_FIXES, FEW = range(6)
STATES = {
    FINE: "as expected",
    TOO_HIGH: "NIS too high",
    TOO_LOW: "NIS too low",
    MANY_REJECTED: "many rejected",
    NO_FIXES: "no fixes",
    FEW: "too few to judge",
}
RULES = (
    f"A window is flagged if the mean NIS per degree of freedom is above {HIGH:g} or below {LOW:g} "
    f"(and outside the {100 * SURE:g} % chi-square interval of so many fixes), if more than "
    f"{100 * REJECTING:g} % and at least {LEAST_REJECTED} of its fixes were rejected, or if there "
    f"were fewer than {100 * SILENT:g} % of the usual fixes."
)


@dataclass(frozen=True, eq=False)
class Windows:
    """A sensor's health over windows of equal length.

    Attributes
    ----------
    edge : ndarray (k + 1,)
        Where windows begin and end [s].
    fixes, rejected : ndarray (k,) of int
    ratio : ndarray (k,)
        Mean NIS per degree of freedom of the accepted ones; NaN if there are none.
    state : ndarray (k,) of int
        One of `STATES`.
    """

    edge: Array
    fixes: NDArray[np.int64]
    rejected: NDArray[np.int64]
    ratio: Array
    state: NDArray[np.int64]

    @property
    def share(self) -> Array:
        """Share of rejected fixes, percent; NaN without fixes."""
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.asarray(100.0 * self.rejected / self.fixes)

    def segments(self) -> list[tuple[float, float, int, int, int]]:
        """Return begin, end, state, fixes and rejected of windows of equal state, joined."""
        cut = np.flatnonzero(np.diff(self.state)) + 1
        first, last = np.r_[0, cut], np.r_[cut, len(self.state)]
        return [
            (
                float(self.edge[a]),
                float(self.edge[b]),
                int(self.state[a]),
                int(self.fixes[a:b].sum()),
                int(self.rejected[a:b].sum()),
            )
            for a, b in zip(first, last, strict=True)
        ]


def windows(fixes: Fixes, first: float, last: float) -> Windows:
    """Return a sensor's health from `first` to `last` [s]."""
    if fixes.whole is not None:
        return fixes.whole.windows
    count = int(np.clip(len(fixes.t) // FIXES_A_WINDOW, 1, MOST_WINDOWS))
    edge = np.linspace(first, max(last, first + 1e-9), count + 1)
    where = np.clip(np.searchsorted(edge, fixes.t, side="right") - 1, 0, count - 1)
    used = fixes.used
    n = np.bincount(where, minlength=count)
    good = np.bincount(where[used], minlength=count)
    total = np.bincount(where[used], weights=fixes.nis[used], minlength=count)
    rejected = np.bincount(where[~fixes.accepted], minlength=count)
    return judged_windows(edge, n, good, rejected, np.asarray(total, dtype=np.float64), fixes.dof)


def judged_windows(
    edge: Array,
    n: NDArray[np.int64],
    good: NDArray[np.int64],
    rejected: NDArray[np.int64],
    total: Array,
    axes: int,
) -> Windows:
    """Return windows with their states.

    Parameters
    ----------
    edge : ndarray (k + 1,)
    n, good, rejected : ndarray (k,) of int
        Measurements, used ones and rejected ones.
    total : ndarray (k,)
        Sum of NIS of the used ones.
    axes : int
        Degrees of freedom of one.
    """
    count = len(n)
    with np.errstate(invalid="ignore", divide="ignore"):
        ratio = total / (good * axes)
    state = np.full(count, FINE)
    tail = 0.5 * (1.0 - SURE)
    for k in range(count):
        dof = float(good[k] * axes)
        if dof == 0.0:
            state[k] = FEW
        elif ratio[k] > HIGH and total[k] > _core.chi2_quantile(1.0 - tail, dof):
            state[k] = TOO_HIGH
        elif ratio[k] < LOW and total[k] < _core.chi2_quantile(tail, dof):
            state[k] = TOO_LOW
    many = (rejected >= LEAST_REJECTED) & (rejected > REJECTING * n)
    state[many] = MANY_REJECTED
    usual = float(np.median(n[n > 0])) if n.any() else 0.0
    state[(n < SILENT * usual) | (n == 0)] = NO_FIXES
    return Windows(edge, n, rejected, ratio, state)


def bursts(fixes: Fixes) -> list[dict[str, Any]]:
    """Return where at least `BURST` fixes running were rejected: begin, end, fixes; longest first.

    JSON-ready; times in s.
    """
    bad = np.concatenate([[False], ~fixes.accepted, [False]]).astype(np.int8)
    begin, end = np.flatnonzero(np.diff(bad) == 1), np.flatnonzero(np.diff(bad) == -1)
    size = end - begin
    rows = np.flatnonzero(size >= BURST)
    rows = rows[np.argsort(-size[rows], kind="stable")]
    return [
        {
            "begin": float(fixes.t[begin[k]]),
            "end": float(fixes.t[end[k] - 1]),
            "fixes": int(size[k]),
        }
        for k in rows
    ]


def silences(fixes: Fixes) -> dict[str, Any] | None:
    """Return the longest time between two accepted fixes and the usual one, s; None if too few."""
    t = fixes.t[fixes.used]
    if len(t) < 3:
        return None
    step = np.diff(t)
    k = int(np.argmax(step))
    return {"begin": float(t[k]), "end": float(t[k + 1]), "usual": float(np.median(step))}


def noise(fixes: Fixes) -> dict[str, Any] | None:
    """Return what the accepted innovations say of the noise, axis by axis; JSON-ready.

    Left out are those that were predicted far worse than usual: at the start and after gaps.

    Returns
    -------
    dict or None
        In the sensor's unit: ``rms`` of the innovations and ``predicted`` by the filter;
        ``ratio`` of the two; ``mean``, and ``mean_errors``, how many of its standard errors that
        is; ``configured``, the noise the filter was told; ``seen``, the noise that explains the
        innovations, None for an axis on which the innovations are smaller than the rest of the
        prediction. None without innovations.

    Notes
    -----
    ``seen^2 = assumed^2 + rms^2 - predicted^2``: the innovation's covariance is that of the
    fix plus that of the prediction (Mehra, IEEE Trans. Automatic Control 15, 1970), and all of a
    misfit is laid to the fix. What an adaptive filter assumes is not what it was told: see
    `Fixes.assumed`.
    """
    rows = _settled(fixes)
    if fixes.innovation is None or fixes.sigma is None or not rows.any():
        return None
    sums = moments(fixes.innovation[rows], fixes.sigma[rows])
    n = int(rows.sum())
    return noise_of(sums, n, fixes.unit, fixes.axes, fixes.configured, fixes.assumed)


def moments(nu: Array, sigma: Array) -> Array:
    """Return the sums (5, axes) of innovations and their predicted sigmas that `noise_of` takes."""
    z = nu / sigma
    return np.stack([np.sum(v, axis=0) for v in (nu, nu * nu, sigma * sigma, z, z * z)])


def noise_of(
    sums: Array,
    n: int,
    unit: str,
    axes: tuple[str, ...],
    configured: Array | None,
    assumed: Array | None,
) -> dict[str, Any]:
    """Return what `noise` does, from the sums of n innovations."""
    mean, square, predicted, z, zz = sums / np.array([n, n, n, 1.0, 1.0])[:, None]
    length = np.sqrt(zz)
    seen = None
    if assumed is not None:
        variance = assumed**2 + square - predicted
        seen = np.sqrt(np.where(variance > 0.0, variance, np.nan))
    return {
        "unit": unit,
        "axes": list(axes),
        "rms": _list(np.sqrt(square)),
        "predicted": _list(np.sqrt(predicted)),
        "ratio": _list(np.sqrt(zz / n)),
        "mean": _list(mean),
        "mean_errors": _list(z / np.where(length > 0.0, length, np.inf)),
        "configured": None if configured is None else _list(configured),
        "seen": None if seen is None else _list(seen),
    }


def _settled(fixes: Fixes) -> NDArray[np.bool_]:
    """Say which accepted innovations were predicted about as well as most."""
    used = fixes.used
    if fixes.sigma is None or not used.any():
        return used
    usual = np.median(fixes.sigma[used], axis=0)
    return np.asarray(used & (fixes.sigma <= UNUSUAL * usual).all(axis=1))


def white(fixes: Fixes) -> dict[str, Any] | None:
    """Return the test of whiteness: ``p`` and ``lag_1`` by axis, ``white``; None if too few.

    About their mean: a mean that is not zero is told in `noise`.
    """
    if fixes.innovation is None or fixes.sigma is None:
        return None
    z = fixes.innovation[fixes.used] / fixes.sigma[fixes.used]
    if len(z) <= 2 * LAGS or not np.isfinite(z).all():
        return None
    z = z - z.mean(axis=0)
    if not (z != 0.0).any(axis=0).all():
        return None
    return white_of(whiteness(z, lags=LAGS))


def white_of(found: Whiteness) -> dict[str, Any]:
    """Return a test of whiteness as JSON has it."""
    return {
        "lags": len(found.lag),
        "p": _list(found.p_value),
        "lag_1": _list(found.autocorrelation[0]),
        "white": found.white,
    }


def _list(values: Array) -> list[float | None]:
    return [float(v) if np.isfinite(v) else None for v in values]
