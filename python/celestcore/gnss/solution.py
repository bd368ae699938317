"""What a GNSS and star navigator's `run` returns."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from celestcore._check import FloatArray, IntArray
from celestcore._files import replacing
from celestcore._optional import require
from celestcore.errors import InputError
from celestcore.frames import Euler321, euler_321, orbital
from celestcore.quaternion import conjugate, multiply
from celestcore.solution import package_version

if TYPE_CHECKING:
    from celestcore.gnss.navigator import GnssStarNavigator
    from celestcore.log import SensorLog

__all__ = ["GnssStarSolution", "Innovations", "LfeReport"]

OBSERVABLE = 0.5
UNOBSERVABLE = 0.9
"""Sigma after over sigma before below and above which a combination counts as seen, or as not."""


@dataclass(frozen=True, eq=False)
class Innovations:
    """What a filter made of its measurements, one row each.

    Attributes
    ----------
    t : ndarray (m,)
        Times [s since the epoch].
    kind : ndarray (m,) of str
        ``position`` and ``velocity``, or the table's name.
    row : ndarray (m,) of int
        Row of the table.
    nis : ndarray (m,)
        Normalised innovation squared; 3 degrees of freedom.
    accepted : ndarray (m,) of bool
    innovation, sigma : ndarray (m, 3)
        Measured less predicted, and its 1-sigma: [m] or [m/s] along the inertial axes, [rad] about
        the body's.

    Examples
    --------
    >>> Innovations(*[np.zeros(0)] * 5, *[np.zeros((0, 3))] * 2)
    Innovations(0 rows, 0 accepted)
    """

    t: FloatArray
    kind: Any
    row: IntArray
    nis: FloatArray
    accepted: Any
    innovation: FloatArray
    sigma: FloatArray

    def __len__(self) -> int:
        return len(self.t)

    def __repr__(self) -> str:
        return f"Innovations({len(self)} rows, {int(np.sum(self.accepted))} accepted)"


@dataclass(frozen=True, eq=False)
class LfeReport:
    """The star sensor's slow error at the end of a run, and how much of it was seen.

    Attributes
    ----------
    names : list of str
        What each vector is: ``cos 1``, ``sin 1`` ...
    value, sigma, prior : ndarray (vectors, 3)
        Estimate and 1-sigma after and before the run, body axes [rad].
    ratio : ndarray (vectors, 3)
        `sigma` over `prior`: 1 where nothing was learnt.
    eigenvalues : ndarray (3 vectors,)
        Posterior 1-sigma over the prior's along the directions of `eigenvectors`, ascending.
    eigenvectors : ndarray (3 vectors, 3 vectors)
        Columns: combinations of the coefficients, each in units of its prior sigma, vector by
        vector.

    Examples
    --------
    >>> report = LfeReport.of(["cos 1"], np.zeros(3), np.diag([1.0, 1.0, 0.01]), np.ones(1))
    >>> report.eigenvalues, report.unobservable
    (array([0.1, 1. , 1. ]), 2)
    """

    names: list[str]
    value: FloatArray
    sigma: FloatArray
    prior: FloatArray
    ratio: FloatArray
    eigenvalues: FloatArray
    eigenvectors: FloatArray

    @classmethod
    def of(
        cls, names: list[str], value: FloatArray, covariance: FloatArray, prior: FloatArray
    ) -> LfeReport:
        """Return the report of coefficients with a covariance.

        Parameters
        ----------
        names : list of str
            Of the vectors.
        value : ndarray (3 vectors,)
            Estimates [rad].
        covariance : ndarray (3 vectors, 3 vectors)
            Of the estimates [rad^2].
        prior : ndarray (vectors,)
            1-sigma of each vector's components before [rad].

        Returns
        -------
        LfeReport

        Examples
        --------
        >>> LfeReport.of(["cos 1"], np.zeros(3), np.eye(3), np.ones(1)).ratio
        array([[1., 1., 1.]])
        """
        each = np.repeat(prior, 3)
        values, vectors = np.linalg.eigh(covariance / np.outer(each, each))
        sigma = np.sqrt(np.diag(covariance))
        rows = (len(names), 3)
        return cls(
            names,
            value.reshape(rows),
            sigma.reshape(rows),
            each.reshape(rows),
            (sigma / each).reshape(rows),
            np.sqrt(np.maximum(values, 0.0)),
            vectors,
        )

    def part(self, *names: str) -> FloatArray:
        """Return 1-sigma ratios of the combinations of some vectors alone, ascending.

        Parameters
        ----------
        *names : str
            Of the vectors, for example ``"cos 1", "sin 1"``.

        Returns
        -------
        ndarray (3 len(names),)

        Examples
        --------
        >>> report = LfeReport.of(["cos 1", "sin 1"], np.zeros(6), np.eye(6), np.ones(2))
        >>> report.part("cos 1")
        array([1., 1., 1.])
        """
        index = [3 * self.names.index(name) + axis for name in names for axis in range(3)]
        scaled = (self.eigenvectors * self.eigenvalues**2) @ self.eigenvectors.T
        values = np.linalg.eigvalsh(scaled[np.ix_(index, index)])
        return np.asarray(np.sqrt(np.maximum(values, 0.0)))

    @property
    def unobservable(self) -> int:
        """How many combinations kept 90 % or more of their prior 1-sigma."""
        return int(np.count_nonzero(self.eigenvalues >= UNOBSERVABLE))

    @property
    def observable(self) -> int:
        """How many combinations lost half of their prior 1-sigma or more."""
        return int(np.count_nonzero(self.eigenvalues <= OBSERVABLE))

    def __str__(self) -> str:
        arcsec = 180.0 * 3600.0 / np.pi
        lines = ["star sensor's slow error, body x, y, z [arcsec], sigma over prior in brackets"]
        for name, value, sigma, ratio in zip(
            self.names, self.value * arcsec, self.sigma * arcsec, self.ratio, strict=True
        ):
            each = "  ".join(
                f"{v:7.2f} +- {s:5.2f} ({r:4.2f})"
                for v, s, r in zip(value, sigma, ratio, strict=True)
            )
            lines.append(f"  {name:<13} {each}")
        lines.append(
            f"  of {len(self.eigenvalues)} combinations {self.observable} were seen (sigma at most "
            f"half the prior's) and {self.unobservable} were not (0.9 or more: unobservable)"
        )
        return "\n".join(lines)


@dataclass(frozen=True, eq=False)
class GnssStarSolution:
    """Position, velocity and attitude over a log.

    Attributes
    ----------
    t : ndarray (n,)
        Output times [s since `epoch`].
    r, v : ndarray (n, 3)
        Position [m] and velocity [m/s] of the centre of mass, GCRS.
    sigma_r, sigma_v : ndarray (n, 3)
        Their 1-sigma.
    gnss_bias, sigma_gnss_bias : ndarray (n, 3) or None
        Slow error of the receiver, GCRS axes [m], if it is estimated.
    q : ndarray (n, 4) or None
        Attitude ``q_ib``, body to GCRS, scalar first; None without attitude fixes.
    sigma_q : ndarray (n, 3) or None
        1-sigma of its error, body axes [rad].
    rate : ndarray (n, 3) or None
        Rate of the body in inertial space, body axes [rad/s].
    bias, sigma_bias : ndarray (n, 3) or None
        Bias of the gyro and its 1-sigma [rad/s], where there is a gyro.
    orbit_covariance : ndarray (n, 6, 6) or (n, 9, 9), or None
        Of position, velocity and the receiver's bias, if it was asked for.
    attitude_covariance : ndarray (n, N, N) or None
        Of attitude error, then rate and acceleration or the gyro's bias, then the slow error.
    lfe : LfeReport or None
        The star sensor's slow error.
    gnss, attitude : Innovations
        What the two filters made of their measurements; a smoother's are its forward pass's.
    counts : dict of str to int
        positions, velocities, star and baseline fixes, rejected ones of each, missing rows.
    restarts : list of float
        Times at which the orbit filter lost the fixes and started again [s].
    attitude_restarts : list of float
        The same of the attitude filter.
    epoch, filter : str
    smoothed : bool
    elapsed_s : float
        Time the core took [s].
    log_likelihood : float
        Of the measurements that were used, both filters.

    Examples
    --------
    >>> import celestcore as cc
    >>> trial = cc.gnss.GnssStarScenario(duration=300.0).trial(seed=1, trial=0)
    >>> sol = cc.GnssStarNavigator().run(trial.log)
    >>> sol.r.shape, sol.q.shape
    ((31, 3), (31, 4))
    """

    t: FloatArray
    r: FloatArray
    v: FloatArray
    sigma_r: FloatArray
    sigma_v: FloatArray
    gnss: Innovations
    attitude: Innovations
    counts: dict[str, int]
    epoch: str
    filter: str
    gnss_bias: FloatArray | None = None
    sigma_gnss_bias: FloatArray | None = None
    q: FloatArray | None = None
    sigma_q: FloatArray | None = None
    rate: FloatArray | None = None
    bias: FloatArray | None = None
    sigma_bias: FloatArray | None = None
    orbit_covariance: FloatArray | None = None
    attitude_covariance: FloatArray | None = None
    lfe: LfeReport | None = None
    restarts: list[float] = field(default_factory=list)
    attitude_restarts: list[float] = field(default_factory=list)
    smoothed: bool = False
    elapsed_s: float = 0.0
    log_likelihood: float = np.nan

    def __len__(self) -> int:
        return len(self.t)

    def __repr__(self) -> str:
        how = f"{self.filter}, smoothed" if self.smoothed else self.filter
        what = "orbit" if self.q is None else "orbit and attitude"
        return f"GnssStarSolution({len(self)} rows of {what}, {how})"

    @property
    def q_io(self) -> FloatArray:
        """Orbital frame to GCRS (n, 4): z to the Earth's centre, y against the orbit's normal."""
        return orbital(self.r, self.v)

    @property
    def q_ob(self) -> FloatArray:
        """Body to orbital frame (n, 4)."""
        return multiply(conjugate(self.q_io), self._attitude())

    def euler(self) -> Euler321:
        """Yaw, pitch and roll (3-2-1) of the body about the orbital frame [rad].

        Returns
        -------
        Euler321

        Raises
        ------
        InputError
            If there is no attitude.

        Examples
        --------
        >>> import celestcore as cc
        >>> trial = cc.gnss.GnssStarScenario(duration=300.0).trial(seed=1, trial=0)
        >>> bool(abs(cc.GnssStarNavigator().run(trial.log).euler().pitch[-1]) < 1e-3)
        True
        """
        return euler_321(self.q_ob)

    def _attitude(self) -> FloatArray:
        if self.q is None:
            raise InputError("is not known: the log has no attitude fixes", field="q")
        return self.q

    def columns(self) -> dict[str, FloatArray]:
        """Return the rows as named columns.

        Returns
        -------
        dict of str to ndarray
            ``t``, ``x`` ... ``vz`` and their ``s_...``; with an attitude ``qw`` ... ``qz``, ``wx``
            ... ``wz`` and ``s_ax`` ... ``s_az``; and biases where they are estimated.

        Examples
        --------
        >>> import celestcore as cc
        >>> trial = cc.gnss.GnssStarScenario(duration=300.0).trial(seed=1, trial=0)
        >>> list(cc.GnssStarNavigator().run(trial.log).columns())[:4]
        ['t', 'x', 'y', 'z']
        """
        axes = ("x", "y", "z")
        out = {"t": self.t}
        parts: list[tuple[FloatArray | None, list[str]]] = [
            (self.r, list(axes)),
            (self.v, [f"v{a}" for a in axes]),
            (self.sigma_r, [f"s_{a}" for a in axes]),
            (self.sigma_v, [f"s_v{a}" for a in axes]),
            (self.gnss_bias, [f"gnss_b{a}" for a in axes]),
            (self.sigma_gnss_bias, [f"s_gnss_b{a}" for a in axes]),
            (self.q, ["qw", "qx", "qy", "qz"]),
            (self.rate, [f"w{a}" for a in axes]),
            (self.sigma_q, [f"s_a{a}" for a in axes]),
            (self.bias, [f"b{a}" for a in axes]),
            (self.sigma_bias, [f"s_b{a}" for a in axes]),
        ]
        for array, names in parts:
            if array is not None:
                out |= dict(zip(names, np.ascontiguousarray(array.T), strict=True))
        return out

    def report(
        self,
        path: str | Path,
        *,
        title: str | None = None,
        log: SensorLog | None = None,
        navigator: GnssStarNavigator | None = None,
    ) -> None:
        """Write a report: one HTML page with words, numbers and plots to zoom into.

        Parameters
        ----------
        path : path
            Ends in .html.
        title : str, optional
            What the log is called.
        log, navigator : SensorLog, GnssStarNavigator, optional
            What ran over what: tell the noise that each sensor was said to have.

        Raises
        ------
        InputError
            If the ending is another one or the directory does not exist.

        Examples
        --------
        >>> import tempfile
        >>> import celestcore as cc
        >>> trial = cc.gnss.GnssStarScenario(duration=300.0).trial(seed=1, trial=0)
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     cc.GnssStarNavigator().run(trial.log).report(f"{folder}/orbit.html")
        """
        from celestcore._orbit_report import orbit_summary, write_orbit_report

        write_orbit_report(path, self, orbit_summary(self, title, log=log, navigator=navigator))

    def to_dataframe(self) -> Any:
        """Return the rows as a pandas data frame with the columns of `columns`.

        Raises
        ------
        MissingDependencyError
            If pandas is not installed.

        Examples
        --------
        >>> import celestcore as cc
        >>> trial = cc.gnss.GnssStarScenario(duration=300.0).trial(seed=1, trial=0)
        >>> cc.GnssStarNavigator().run(trial.log).to_dataframe().shape[0]
        31
        """
        pandas = require("pandas", extra="pandas", what="to_dataframe")
        return pandas.DataFrame(self.columns())

    def metadata(self) -> dict[str, Any]:
        """Return what a reader of the bare columns must know: epoch, frames, units, version.

        Returns
        -------
        dict
            Plain values, as JSON takes them.

        Examples
        --------
        >>> import celestcore as cc
        >>> trial = cc.gnss.GnssStarScenario(duration=300.0).trial(seed=1, trial=0)
        >>> cc.GnssStarNavigator().run(trial.log).metadata()["inertial"]
        'GCRS'
        """
        return {
            "version": package_version(),
            "filter": self.filter,
            "smoothed": self.smoothed,
            "epoch": self.epoch,
            "inertial": "GCRS",
            "units": "s, m, m/s, rad, rad/s",
            "quaternion": "q_ib, body to inertial, Hamilton, scalar first",
        }

    def to_parquet(self, path: str | Path) -> None:
        """Write the rows to a Parquet file: the columns of `columns`, whole or not at all.

        Parameters
        ----------
        path : path
            Of the file.

        Raises
        ------
        InputError
            If the directory does not exist.
        MissingDependencyError
            If pyarrow is not installed.

        Examples
        --------
        >>> import celestcore as cc
        >>> from tempfile import TemporaryDirectory
        >>> trial = cc.gnss.GnssStarScenario(duration=300.0).trial(seed=1, trial=0)
        >>> with TemporaryDirectory() as folder:
        ...     cc.GnssStarNavigator().run(trial.log).to_parquet(f"{folder}/orbit.parquet")
        """
        arrow = require("pyarrow", extra="parquet", what="writing Parquet")
        parquet = require("pyarrow.parquet", extra="parquet", what="writing Parquet")
        note = {b"celestcore": json.dumps(self.metadata()).encode()}
        with replacing(path) as temporary:
            table = arrow.table(self.columns()).replace_schema_metadata(note)
            parquet.write_table(table, temporary, compression="zstd")

    def plot(self, panels: tuple[str, ...] | None = None, *, width: float = 11.0) -> Any:
        """Draw innovations, NIS and sigmas over time.

        Parameters
        ----------
        panels : tuple of str, optional
            Some of ``innovation position``, ``nis position``, ``innovation star`` ..., ``sigma``;
            all there is something for.
        width : float
            Width of the figure [inch].

        Returns
        -------
        matplotlib.figure.Figure

        Raises
        ------
        InputError
            If a panel is unknown.
        MissingDependencyError
            If matplotlib is not installed.

        Examples
        --------
        >>> import celestcore as cc
        >>> trial = cc.gnss.GnssStarScenario(duration=300.0).trial(seed=1, trial=0)
        >>> figure = cc.GnssStarNavigator().run(trial.log).plot(("nis position", "sigma"))
        >>> len(figure.axes) > 1
        True
        """
        from celestcore._gnss_plots import Drawn, figure

        return figure(Drawn(self), panels, width=width)

    def to_oem(self, path: str | Path, **names: Any) -> None:
        """Write the orbit as a CCSDS Orbit Ephemeris Message, GCRF.

        Parameters
        ----------
        path : path
            Of the file; KVN.
        **names
            Those of `celestcore.ccsds.write_oem`, such as ``object_name``.

        Raises
        ------
        MissingDependencyError
            Without the library that writes it.

        Examples
        --------
        >>> GnssStarSolution.to_oem  # doctest: +ELLIPSIS
        <function ...
        """
        from celestcore.ccsds import write_oem

        p = self.orbit_covariance
        covariance = None if p is None else np.ascontiguousarray(p[:, :6, :6])
        write_oem(path, self.epoch, self.t, self.r, self.v, covariance=covariance, **names)

    def to_aem(self, path: str | Path, **names: Any) -> None:
        """Write the attitude as a CCSDS Attitude Ephemeris Message, quaternions from GCRF to body.

        Parameters
        ----------
        path : path
            Of the file; KVN.
        **names
            Those of `celestcore.ccsds.write_aem`, such as ``object_name``.

        Raises
        ------
        InputError
            If there is no attitude.
        MissingDependencyError
            Without the library that writes it.

        Examples
        --------
        >>> GnssStarSolution.to_aem  # doctest: +ELLIPSIS
        <function ...
        """
        from celestcore.ccsds import write_aem

        write_aem(path, self.epoch, self.t, self._attitude(), **names)
