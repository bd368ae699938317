"""How good is a prediction without fixes? The test that hides the fixes of a log window by window.

Only `StarGyroNavigator.run` is used, on copies of the log with fixes taken out.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from celestcore.errors import InputError
from celestcore.units import ARCSEC, ARCSEC_PER_S

if TYPE_CHECKING:
    from celestcore.log import SensorLog, Table
    from celestcore.navigator import StarGyroNavigator

__all__ = ["WithheldDrift", "withheld_drift"]

Array = NDArray[np.float64]

_CHI_95 = 2.7954834829151074
"""The length of a standard normal 3-vector is below this with probability 0.95."""

_ARW_STEPS = 2.0 ** np.arange(-2.5, 1.1, 0.5)
_RRW_STEPS = np.concatenate([[0.0], 2.0 ** np.arange(-4.0, 1.1, 0.5)])
"""Noises that are tried, as parts of those that would explain the whole drift alone."""

_PACKED = np.array([[0, 1, 2], [1, 3, 4], [2, 4, 5]])
"""Where a packed symmetric matrix (xx, xy, xz, yy, yz, zz) has the entries of the full one."""


@dataclass(frozen=True, eq=False)
class WithheldDrift:
    """How far predictions drifted in windows without fixes, and how far they were expected to.

    The prediction at the last fix of a window is compared with that fix. The gyro noise is
    estimated on the windows of the other folds, so no window is scored with noise it had a part in.

    What this does not show: if the "fixes" are the product of an onboard filter, as in the sample
    ``fermi``, they are a reference for the gyro's drift, not an independent measure of the absolute
    attitude, and the filter that made them may have used the same gyro.

    Attributes
    ----------
    window : float
        Length of a window, s.
    start : array, (k,)
        Where each window begins, s since the log's epoch.
    drift : array, (k,)
        Angle between prediction and fix at the window's end, with the bias estimated, rad.
    drift_without_bias : array, (k,)
        The same for plain integration of the rates from the last fix before the window, rad.
    sigma : array, (k,)
        Predicted rms of `drift`: square root of the trace of the covariance of prediction and fix.
    ratio : array, (k,)
        `drift` over `sigma`.
    distance : array, (k,)
        The stricter ratio: Mahalanobis distance of the drift vector, which knows that the predicted
        error is not the same about all axes. Below 3 with probability 0.97 if errors are Gaussian.
    fold : array of int, (k,)
        Which fold the window belongs to.
    arw, rrw : array, (k,)
        Gyro noise the window was scored with, rad/sqrt(s) and rad/s/sqrt(s).

    Examples
    --------
    >>> import celestcore as cc
    >>> log = cc.sample("fermi")
    >>> nav = cc.Settings.from_log(log).navigator()
    >>> drift = withheld_drift(nav, log, window=1800.0, folds=None)
    >>> len(drift) == len(drift.start) == len(drift.ratio)
    True
    """

    window: float
    start: Array
    drift: Array
    drift_without_bias: Array
    sigma: Array
    ratio: Array
    distance: Array
    fold: NDArray[np.intp]
    arw: Array
    rrw: Array

    def __len__(self) -> int:
        return len(self.start)

    def summary(self) -> dict[str, float]:
        """Return the main figures as plain numbers; names say the units.

        Returns
        -------
        dict of str to float

        Examples
        --------
        >>> import celestcore as cc
        >>> log = cc.sample("fermi")
        >>> nav = cc.Settings.from_log(log).navigator()
        >>> drift = withheld_drift(nav, log, window=1800.0, folds=None)
        >>> drift.summary()["window_s"]
        1800.0
        """
        low, median, high = np.percentile(self.drift, [5, 50, 95]) / ARCSEC
        plain = np.percentile(self.drift_without_bias, [5, 50, 95]) / ARCSEC
        figures = {
            "window_s": self.window,
            "windows": len(self),
            "drift_5_arcsec": low,
            "drift_median_arcsec": median,
            "drift_95_arcsec": high,
            "drift_max_arcsec": self.drift.max() / ARCSEC,
            "drift_rms_arcsec": np.sqrt(np.mean(self.drift**2)) / ARCSEC,
            "without_bias_5_arcsec": plain[0],
            "without_bias_median_arcsec": plain[1],
            "without_bias_95_arcsec": plain[2],
            "without_bias_max_arcsec": self.drift_without_bias.max() / ARCSEC,
            "without_bias_rms_arcsec": np.sqrt(np.mean(self.drift_without_bias**2)) / ARCSEC,
            "nearer_with_bias": np.mean(self.drift < self.drift_without_bias),
            "sigma_median_arcsec": np.median(self.sigma) / ARCSEC,
            "ratio_median": np.median(self.ratio),
            "ratio_max": self.ratio.max(),
            "ratio_within_3": np.mean(self.ratio <= 3.0),
            "distance_within_3": np.mean(self.distance <= 3.0),
            "arw_median_arcsec_per_sqrt_s": np.median(self.arw) / ARCSEC,
            "rrw_median_arcsec_per_s_sqrt_s": np.median(self.rrw) / ARCSEC_PER_S,
        }
        return {k: int(v) if k == "windows" else float(v) for k, v in figures.items()}


def withheld_drift(
    navigator: StarGyroNavigator,
    log: SensorLog,
    window: float = 600.0,
    *,
    folds: int | None = 4,
) -> WithheldDrift:
    """Hide all fixes in every other window, predict across, compare; then swap the windows.

    The gyro noise is chosen for each fold of consecutive windows on the other folds: of the pairs
    (arw, rrw) on a grid that put at least 95 % of those windows' drifts inside their 95 %
    ellipsoids, the one with the largest likelihood of the drifts.

    Parameters
    ----------
    navigator : StarGyroNavigator
        Its gyro noise is replaced; everything else is used as it is.
    log : SensorLog
        Needs a gyro and a star camera; with several, the first one's fixes are the reference.
    window : float
        Length of a window, s.
    folds : int or None
        In how many parts to estimate the noise; None scores with the navigator's own noise.

    Returns
    -------
    WithheldDrift

    Raises
    ------
    InputError
        If the window is not positive, or the log has too few windows for the folds.

    Examples
    --------
    >>> import celestcore as cc
    >>> log = cc.sample("fermi")
    >>> result = withheld_drift(cc.Settings.from_log(log).navigator(), log)
    >>> result.summary()["ratio_within_3"] >= 0.95
    True
    """
    if not (np.isfinite(window) and window > 0.0):
        raise InputError("must be a positive time in s", field="window", value=window)
    if folds is not None and folds < 2:
        raise InputError("must be at least 2, or None", field="folds", value=folds)
    test = _Test.of(navigator, log, float(window), 1 if folds is None else folds)
    plain = test.plain(navigator)
    if folds is None:
        fold = np.zeros(len(test), dtype=np.intp)
        gyro = navigator.gyro
        choice, tried = fold, [_Scores(gyro.arw, gyro.rrw, *test.run(navigator))]
    else:
        fold = np.arange(len(test)) * folds // len(test)
        tried = [_Scores(arw, rrw, *test.run(n)) for arw, rrw, n in _grid(navigator, plain, window)]
        best = [_best(tried, fold != k) for k in range(folds)]
        choice = np.array(best)[fold]

    picked = [tried[c] for c in choice]
    drift = np.array([np.linalg.norm(p.vectors[i]) for i, p in enumerate(picked)])
    sigma = np.array([p.sigma[i] for i, p in enumerate(picked)])
    return WithheldDrift(
        window=float(window),
        start=test.start,
        drift=drift,
        drift_without_bias=np.linalg.norm(plain, axis=1),
        sigma=sigma,
        ratio=drift / sigma,
        distance=np.array([p.distance[i] for i, p in enumerate(picked)]),
        fold=fold,
        arw=np.array([p.arw for p in picked]),
        rrw=np.array([p.rrw for p in picked]),
    )


class _Scores:
    """What one choice of noise gave: drift vectors (k, 3) and their covariances (k, 3, 3)."""

    def __init__(self, arw: float, rrw: float, vectors: Array, covariance: Array) -> None:
        self.arw, self.rrw, self.vectors = arw, rrw, vectors
        self.sigma = np.sqrt(np.trace(covariance, axis1=1, axis2=2))
        weighted = np.linalg.solve(covariance, vectors[..., None])[..., 0]
        self.distance = np.sqrt(np.einsum("ij,ij->i", vectors, weighted))
        self.likelihood = -0.5 * (self.distance**2 + np.linalg.slogdet(covariance)[1])


def _best(tried: list[_Scores], train: NDArray[np.bool_]) -> int:
    """Choose a noise on the windows `train`: the likeliest that covers them, or the best cover."""
    cover = np.array([np.mean(s.distance[train] <= _CHI_95) for s in tried])
    likelihood = np.array([np.sum(s.likelihood[train]) for s in tried])
    likelihood[cover < min(0.95, cover.max())] = -np.inf
    return int(np.argmax(likelihood))


def _grid(navigator: StarGyroNavigator, plain: Array, window: float) -> Any:
    """Yield arw, rrw and a navigator with them, about the noise that the plain drift suggests."""
    variance = np.mean(plain**2)
    arw, rrw = np.sqrt(variance / window), np.sqrt(3.0 * variance / window**3)
    for a in arw * _ARW_STEPS:
        for r in rrw * _RRW_STEPS:
            yield float(a), float(r), _with_noise(navigator, float(a), float(r))


def _with_noise(navigator: StarGyroNavigator, arw: float, rrw: float) -> StarGyroNavigator:
    return navigator._like(gyro=dataclasses.replace(navigator.gyro, arw=arw, rrw=rrw))


def _without_bias(navigator: StarGyroNavigator, sigma: float, step: float) -> StarGyroNavigator:
    """Return a navigator that trusts the gyro's bias to be zero and follows every fix."""
    arw = min(100.0 * sigma / np.sqrt(step), 9e-3)
    return _with_noise(navigator, float(arw), 0.0)


@dataclass(frozen=True, eq=False)
class _Test:
    """The log with the fixes of either half of the windows taken out, and the windows' last fixes.

    `start` and `end` (k,) s are a window's begin and last fix, `phase` (k,) says which log hides
    it, `q` (k, 4) and `noise` (k, 3, 3) rad^2 are that fix, body to inertial and in the body frame.
    """

    logs: tuple[SensorLog, SensorLog]
    start: Array
    end: Array
    phase: NDArray[np.intp]
    q: Array
    noise: Array
    step: float

    def __len__(self) -> int:
        return len(self.start)

    @classmethod
    def of(cls, navigator: StarGyroNavigator, log: SensorLog, window: float, folds: int) -> _Test:
        """Cut `log` into windows; the first one is never hidden."""
        if log.gyro is None or not log.stars:
            raise InputError("needs a gyro and a star camera with fixes", field="log")
        name, star = next(iter(log.stars.items()))
        q, packed = navigator._camera(name).to_body(star.q, star.sigma, star.covariance)
        origin = max(float(log.gyro.t[0]), float(star.t[0]))
        count = int((min(float(log.gyro.t[-1]), float(star.t[-1])) - origin) // window)
        index = np.arange(1, count)
        edge = origin + window * np.arange(count + 1)
        row = np.searchsorted(star.t, edge, side="left") - 1
        last, before = row[2:], row[1:-1]
        usable = (star.t[last] - star.t[before] > 0.5 * window) & (before >= row[:-2])
        if usable.sum() < 2 * folds:
            raise InputError(
                f"the log has {usable.sum()} windows of {window:g} s with fixes around them, but "
                f"{2 * folds} are needed; take shorter windows or fewer folds",
                field="window",
                value=window,
            )
        return cls(
            logs=(_hide(log, origin, window, count, 0), _hide(log, origin, window, count, 1)),
            start=np.asarray(edge[1:-1][usable], dtype=np.float64),
            end=star.t[last][usable],
            phase=(index % 2)[usable],
            q=q[last][usable],
            noise=packed[last][usable][:, _PACKED],
            step=float(np.median(np.diff(star.t))),
        )

    def run(self, navigator: StarGyroNavigator, **start: Any) -> tuple[Array, Array]:
        """Return the drift vectors (k, 3) rad at the windows' ends and their covariances."""
        from celestcore import quaternion

        vectors, covariance = np.empty((len(self), 3)), np.empty((len(self), 3, 3))
        for phase, log in enumerate(self.logs):
            hidden = self.phase == phase
            there = navigator.run(log, covariance=True, **start).at(self.end[hidden])
            turn = quaternion.multiply(quaternion.conjugate(there.q), self.q[hidden])
            vectors[hidden] = quaternion.log(turn)
            assert there.covariance is not None
            covariance[hidden] = there.covariance[:, :3, :3] + self.noise[hidden]
        return vectors, covariance

    def plain(self, navigator: StarGyroNavigator) -> Array:
        """Return the drift vectors (k, 3) rad of plain integration from the last fix."""
        sigma = float(np.sqrt(np.trace(self.noise, axis1=1, axis2=2).max()))
        follower = _without_bias(navigator, sigma, self.step)
        return self.run(follower, bias0=(0.0, 0.0, 0.0), sigma0=(1e-3, 1e-12))[0]


def _hide(log: SensorLog, origin: float, window: float, count: int, phase: int) -> SensorLog:
    """Return a copy of `log` without the fixes of every other window."""
    from celestcore.log import SensorLog

    def kept(name: str, table: Table) -> Table:
        if not name.startswith(("star", "vector")):
            return table
        index = np.floor((table.t - origin) / window)
        rows = (index % 2 != phase) | (index < 1) | (index >= count)
        columns = {
            f.name: getattr(table, f.name)[rows]
            for f in dataclasses.fields(table)
            if isinstance(getattr(table, f.name), np.ndarray)
        }
        return dataclasses.replace(table, **columns)

    tables: dict[str, Any] = {name: kept(name, table) for name, table in log.tables.items()}
    return SensorLog(
        epoch=log.epoch, title=log.title, frames=log.frames, settings=log.settings, **tables
    )
