"""What a celestial navigator's `run` returns."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from celestcore._check import FloatArray, IntArray
from celestcore._optional import require

__all__ = ["OrbitSolution"]

COLUMNS = ("x", "y", "z", "vx", "vy", "vz")


@dataclass(frozen=True, eq=False)
class OrbitSolution:
    """Position and velocity over a log.

    Attributes
    ----------
    t : ndarray (n,)
        Output times [s since `epoch`].
    r, v : ndarray (n, 3)
        Position [m] and velocity [m/s], GCRS.
    sigma : ndarray (n, 6)
        1-sigma of position [m] and velocity [m/s].
    covariance : ndarray (n, 6, 6) or None
        If it was asked for.
    measurement_t : ndarray (m,)
        Times of the measurements [s]. A measurement is all angles of an epoch, or one star.
    sensor : ndarray (m,) of int
        Which sensor: an index into `sensor_names`.
    row : ndarray (m,) of int
        First row in that sensor's table.
    nis, dof : ndarray (m,)
        Normalised innovation squared and its degrees of freedom.
    accepted : ndarray (m,) of bool
        Whether the measurement was used, at least in part.
    innovation, innovation_sigma : ndarray (m, 3)
        Innovation and its predicted 1-sigma [rad]; entries that a measurement does not have are
        NaN. Of an epoch: the nadir direction about two axes across it.
    stars, used : ndarray (m,) of int
        Angles of the measurement, and how many of them were used.
    ess : ndarray (m,)
        Effective number of particles at each measurement, NaN where none explained it; empty for
        other filters.
    counts : dict of str to int
        epochs, angles, rejected (angles), missing (rows without an angle), predicted_only (epochs
        of which nothing was used), recovered (measurements that no particle explained), outside
        (before the start or after the end).
    epoch : str or None
    filter : str
        Kind of the filter.
    elapsed_s : float
        Time the core took [s].
    final : dict
        State at the end: t, r, v, sigma, covariance.
    smoothed : bool
    log_likelihood : float
        Of the measurements that were used.
    sensor_names : list of str

    Examples
    --------
    >>> import celestcore as cc
    >>> star = [[0.0, 0.0, 1.0], [0.0, 1.0, 0.0]]
    >>> log = cc.CelestialLog(horizon=([0.0, 0.0], star, [1.571, 1.570]))
    >>> dynamics = cc.orbit.OrbitDynamics(cc.orbit.ForceModel.j2(), 4e-7)
    >>> nav = cc.CelestialNavigator(cc.UKF(), dynamics, cc.StarHorizon())
    >>> sol = nav.run(log, [7e6, 0, 0], [0, 0, 7.5e3])
    >>> sol.r.shape, sol.counts["angles"]
    ((1, 3), 2)
    """

    t: FloatArray
    r: FloatArray
    v: FloatArray
    sigma: FloatArray
    measurement_t: FloatArray
    sensor: IntArray
    row: IntArray
    nis: FloatArray
    dof: IntArray
    accepted: Any
    innovation: FloatArray
    innovation_sigma: FloatArray
    stars: IntArray
    used: IntArray
    counts: dict[str, int]
    filter: str
    elapsed_s: float
    final: dict[str, Any]
    covariance: FloatArray | None = None
    ess: FloatArray = field(default_factory=lambda: np.empty(0))
    epoch: str | None = None
    smoothed: bool = False
    log_likelihood: float = np.nan
    sensor_names: list[str] = field(default_factory=list)

    def __len__(self) -> int:
        return len(self.t)

    def __repr__(self) -> str:
        how = f"{self.filter}, smoothed" if self.smoothed else self.filter
        return f"OrbitSolution({len(self)} rows, {self.counts['angles']} angles, {how})"

    @property
    def state(self) -> FloatArray:
        """Position and velocity side by side (n, 6)."""
        return np.hstack([self.r, self.v])

    def columns(self) -> dict[str, FloatArray]:
        """Return the rows as named columns.

        Returns
        -------
        dict of str to ndarray
            ``t``, ``x`` ... ``vz`` and ``s_x`` ... ``s_vz``.

        Examples
        --------
        >>> import celestcore as cc
        >>> log = cc.CelestialLog(horizon=([0.0], [[0.0, 0.0, 1.0]], [1.57]))
        >>> dynamics = cc.orbit.OrbitDynamics(cc.orbit.ForceModel.j2(), 4e-7)
        >>> nav = cc.CelestialNavigator(cc.EKF(), dynamics, cc.StarHorizon())
        >>> list(nav.run(log, [7e6, 0, 0], [0, 0, 7.5e3]).columns())[:3]
        ['t', 'x', 'y']
        """
        out = {"t": self.t}
        out |= dict(zip(COLUMNS, np.ascontiguousarray(self.state.T), strict=True))
        sigma = np.ascontiguousarray(self.sigma.T)
        return out | {f"s_{name}": s for name, s in zip(COLUMNS, sigma, strict=True)}

    def to_dataframe(self) -> Any:
        """Return the rows as a pandas data frame.

        Returns
        -------
        DataFrame
            With the columns of `columns`.

        Raises
        ------
        MissingDependencyError
            If pandas is not installed.

        Examples
        --------
        >>> import celestcore as cc
        >>> log = cc.CelestialLog(horizon=([0.0], [[0.0, 0.0, 1.0]], [1.57]))
        >>> dynamics = cc.orbit.OrbitDynamics(cc.orbit.ForceModel.j2(), 4e-7)
        >>> nav = cc.CelestialNavigator(cc.EKF(), dynamics, cc.StarHorizon())
        >>> nav.run(log, [7e6, 0, 0], [0, 0, 7.5e3]).to_dataframe().shape
        (1, 13)
        """
        pandas = require("pandas", extra="pandas", what="to_dataframe")
        return pandas.DataFrame(self.columns())
