"""What a navigator's `run` returns: columns of arrays, indexed by time."""

from __future__ import annotations

import dataclasses
import json
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from celestcore._files import replacing
from celestcore._optional import require
from celestcore.errors import InputError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from celestcore.log import SensorLog
    from celestcore.navigator import StarGyroNavigator

Array = NDArray[np.float64]
Columns = dict[str, NDArray[Any]]

UNITS = {"t": "s", "q": "1", "w": "rad/s", "b": "rad/s", "s_a": "rad", "s_b": "rad/s"}
_QUATERNION = ("qw", "qx", "qy", "qz")
_BLOCK = 4096
_SIGMA = ("s_ax", "s_ay", "s_az", "s_bx", "s_by", "s_bz")


@dataclass(frozen=True, eq=False)
class StateAt:
    """The solution at one time, or at several: what `Solution.at` returns.

    For one time every leading axis is absent: ``q`` is (4,), ``rate`` (3,) and so on.

    Attributes
    ----------
    t : array, (...)
        Time in s since the epoch.
    q : array, (..., 4)
        Attitude ``q_ib``, body to inertial, scalar first.
    rate : array, (..., 3)
        Body rate, bias removed, rad/s, body frame.
    bias : array, (..., 3)
        Gyro bias, rad/s, body frame.
    sigma : array, (..., 6)
        One-sigma errors: attitude x, y, z (rad), bias x, y, z (rad/s), body frame.
    covariance : array, (..., 6, 6), or None
        Covariance in the order of `sigma`.

    Examples
    --------
    >>> import celestcore as cc
    >>> log = cc.sample("fermi")
    >>> sol = cc.Settings.from_log(log).navigator().run(log)
    >>> state = sol.at([100.0, 200.0])
    >>> state.q.shape, state.sigma.shape
    ((2, 4), (2, 6))
    """

    t: Array
    q: Array
    rate: Array
    bias: Array
    sigma: Array
    covariance: Array | None = None

    def as_rotation(self) -> Any:
        """Return the attitude as a `scipy.spatial.transform.Rotation` (body to inertial).

        Returns
        -------
        Rotation
            One, or a stack with the shape of `t`.

        Raises
        ------
        MissingDependencyError
            If scipy is not installed.

        Examples
        --------
        >>> import celestcore as cc
        >>> log = cc.sample("fermi")
        >>> sol = cc.Settings.from_log(log).navigator().run(log)
        >>> sol.at(100.0).as_rotation().single
        True
        """
        return _rotation(self.q)


@dataclass(frozen=True, eq=False)
class Solution:
    """Attitude and gyro bias over a log.

    The error state, and so `sigma` and `covariance`, has the order attitude error x, y, z
    (body-frame rotation vector, rad), gyro bias x, y, z (rad/s).

    Attributes
    ----------
    t : array, (n,)
        Output times, s since `epoch`.
    q : array, (n, 4)
        Attitude ``q_ib`` (body to inertial), scalar first, without sign jumps.
    rate, bias : array, (n, 3)
        Body rate with the bias removed, and gyro bias, rad/s, body frame.
    sigma : array, (n, 6)
        One-sigma errors, rad and rad/s.
    measurement_t : array, (m,)
        Times of the measurements, s.
    sensor : array of int, (m,)
        Which sensor: an index into `sensor_names`.
    nis : array, (m,)
        Normalised innovation squared.
    dof : array of int, (m,)
        Degrees of freedom of the innovation: 3 for a star camera, 2 for a direction.
    accepted : array of bool, (m,)
        Whether the gate let the measurement through.
    innovation, innovation_sigma : array, (m, 3)
        Innovation and its predicted one-sigma error, rad; with 2 dof the third entry is NaN.
    gaps : array, (k, 2)
        Start and end of the gyro gaps, s.
    counts : dict of str to int
        samples, fixes, accepted, rejected, start (fixes that set the start), missing, outside
        (fixes before the start or after the last gyro sample) and gaps.
    covariance : array, (n, 6, 6), or None
        Full covariance, when it was asked for.
    epoch : str or None
        ISO epoch of ``t = 0``.
    title, filter : str
        What was run, and with which filter.
    elapsed_s : float
        Time the core took, s.
    final : dict
        State at the end of the log: t, q, bias, sigma, covariance; noise_scale, what the variance
        of each sensor's noise is multiplied by, if the navigator is adaptive (of a slice, too, that
        at the end of the run).
    frames : dict of str to str
        Names of the inertial and the body frame.
    smoothed : bool
        Whether every row knows the measurements after it, too.
    innovations : {"full", "nis", "none"}
        What was kept of the measurements: see `StarGyroNavigator.run`. With ``"nis"`` the
        innovations are NaN; with ``"none"`` there are no rows of measurements, m = 0.
    log_likelihood : float
        Logarithm of the probability density of the accepted measurements under the filter, each
        given those before it; what a choice of noise is judged by.
    source : (SensorLog, dict) or None
        The log and the options of the run, for `StarGyroNavigator.smooth`.

    Examples
    --------
    >>> import numpy as np
    >>> q = np.tile([1.0, 0.0, 0.0, 0.0], (3, 1))
    >>> none = np.zeros(0)
    >>> sol = Solution(t=np.arange(3.0), q=q, rate=np.zeros((3, 3)), bias=np.zeros((3, 3)),
    ...                sigma=np.ones((3, 6)), measurement_t=none, sensor=none, nis=none,
    ...                dof=none, accepted=none, innovation=np.zeros((0, 3)),
    ...                innovation_sigma=np.zeros((0, 3)), gaps=np.zeros((0, 2)), counts={})
    >>> len(sol), len(sol[0.5:])
    (3, 2)
    """

    t: Array
    q: Array
    rate: Array
    bias: Array
    sigma: Array
    measurement_t: Array
    sensor: NDArray[np.integer[Any]]
    nis: Array
    dof: NDArray[np.integer[Any]]
    accepted: NDArray[np.bool_]
    innovation: Array
    innovation_sigma: Array
    gaps: Array
    counts: dict[str, int]
    sensor_names: list[str] = field(default_factory=list)
    covariance: Array | None = None
    epoch: str | None = None
    title: str | None = None
    filter: str = ""
    elapsed_s: float = 0.0
    final: dict[str, Any] = field(default_factory=dict)
    frames: dict[str, str] = field(default_factory=dict)
    smoothed: bool = False
    log_likelihood: float = float("nan")
    innovations: str = "full"
    source: tuple[SensorLog, dict[str, Any]] | None = field(default=None, repr=False)

    def __len__(self) -> int:
        return len(self.t)

    def __repr__(self) -> str:
        span = f"{self.t[0]:g} to {self.t[-1]:g} s" if len(self) else "empty"
        name = f"{self.title!r}, " if self.title else ""
        how = ", smoothed" if self.smoothed else ""
        unknown = self.innovations == "none"
        fixes = "measurements not kept" if unknown else f"{len(self.measurement_t)} measurements"
        return (
            f"Solution({name}{self.filter or 'filter unknown'}{how}, {len(self)} rows, {span}, "
            f"{fixes})"
        )

    def __getitem__(self, when: Any) -> Any:
        """Return the state at a time (or times), or the solution between two times.

        ``sol[120.0]`` is ``sol.at(120.0)``; ``sol[60.0:120.0]`` keeps the rows and the
        measurements with 60 <= t < 120, as a `Solution`.
        """
        return self._between(when) if isinstance(when, slice) else self.at(when)

    def at(self, t: ArrayLike) -> StateAt:
        """Interpolate the solution: slerp for the attitude, straight lines for the rest.

        Parameters
        ----------
        t : float or array_like, (...)
            Times within the solution's span, s since the epoch.

        Returns
        -------
        StateAt

        Raises
        ------
        InputError
            If a time is not finite or lies outside the solution.

        Examples
        --------
        >>> import celestcore as cc
        >>> log = cc.sample("fermi")
        >>> sol = cc.Settings.from_log(log).navigator().run(log)
        >>> sol.at(100.25).q.shape
        (4,)
        """
        from celestcore import quaternion

        when = np.asarray(t, dtype=np.float64)
        low, part = self._bracket(when)
        high = np.minimum(low + 1, len(self) - 1)

        def line(column: Array) -> Array:
            w = part.reshape(part.shape + (1,) * (column.ndim - 1))
            return np.asarray((1.0 - w) * column[low] + w * column[high])

        return StateAt(
            t=when.copy(),
            q=np.asarray(quaternion.slerp(self.q[low], self.q[high], part)),
            rate=line(self.rate),
            bias=line(self.bias),
            sigma=line(self.sigma),
            covariance=None if self.covariance is None else line(self.covariance),
        )

    def as_rotation(self) -> Any:
        """Return the attitude as a `scipy.spatial.transform.Rotation` (body to inertial).

        Returns
        -------
        Rotation
            A stack of n.

        Raises
        ------
        MissingDependencyError
            If scipy is not installed.

        Examples
        --------
        >>> import celestcore as cc
        >>> log = cc.sample("fermi")
        >>> sol = cc.Settings.from_log(log).navigator().run(log)
        >>> sol.as_rotation().as_euler("ZYX").shape == (len(sol), 3)
        True
        """
        return _rotation(self.q)

    def columns(self) -> Columns:
        """Return the solution as flat columns, named as in a Parquet file.

        ``t``; ``qw qx qy qz``; ``wx wy wz`` (rate); ``bx by bz`` (bias); ``s_ax .. s_bz``
        (sigma); and, if the covariance was kept, its upper triangle ``p_11 p_12 .. p_66``.

        Returns
        -------
        dict of str to ndarray (n,)
            In SI units and radians.

        Examples
        --------
        >>> import celestcore as cc
        >>> log = cc.sample("fermi")
        >>> sol = cc.Settings.from_log(log).navigator().run(log)
        >>> list(sol.columns())[:5]
        ['t', 'qw', 'qx', 'qy', 'qz']
        """
        out: Columns = {"t": self.t}
        out.update(_split(self.q, _QUATERNION))
        out.update(_split(self.rate, ("wx", "wy", "wz")))
        out.update(_split(self.bias, ("bx", "by", "bz")))
        out.update(_split(self.sigma, _SIGMA))
        if self.covariance is not None:
            for i, j in zip(*np.triu_indices(6), strict=True):
                out[f"p_{i + 1}{j + 1}"] = np.ascontiguousarray(self.covariance[:, i, j])
        return out

    def measurement_columns(self) -> Columns:
        """Return the measurements as flat columns: t, sensor, nis, dof, accepted, ...

        Returns
        -------
        dict of str to ndarray (m,)
            Innovations in rad.

        Raises
        ------
        InputError
            If the measurements were not kept.

        Examples
        --------
        >>> import celestcore as cc
        >>> log = cc.sample("fermi")
        >>> sol = cc.Settings.from_log(log).navigator().run(log)
        >>> list(sol.measurement_columns())
        ['t', 'sensor', 'nis', 'dof', 'accepted', 'ix', 'iy', 'iz', 's_ix', 's_iy', 's_iz']
        """
        self._need("nis", "measurement_columns")
        names = np.asarray([*self.sensor_names, ""], dtype=object)
        known = np.where(self.sensor < len(self.sensor_names), self.sensor, -1).astype(int)
        out: Columns = {
            "t": self.measurement_t,
            "sensor": names[known],
            "nis": self.nis,
            "dof": self.dof,
            "accepted": self.accepted,
        }
        out.update(_split(self.innovation, ("ix", "iy", "iz")))
        out.update(_split(self.innovation_sigma, ("s_ix", "s_iy", "s_iz")))
        return out

    def to_dataframe(self, *, measurements: bool = False) -> Any:
        """Return a `pandas.DataFrame` of `columns` (or of `measurement_columns`).

        Parameters
        ----------
        measurements : bool
            Whether the measurements instead of the states.

        Returns
        -------
        DataFrame
            With `metadata` in its ``attrs``.

        Raises
        ------
        MissingDependencyError
            If pandas is not installed.

        Examples
        --------
        >>> import celestcore as cc
        >>> log = cc.sample("fermi")
        >>> sol = cc.Settings.from_log(log).navigator().run(log)
        >>> len(sol.to_dataframe()) == len(sol)
        True
        """
        pandas = require("pandas", extra="pandas", what="to_dataframe")
        columns = self.measurement_columns() if measurements else self.columns()
        frame = pandas.DataFrame({name: np.array(col) for name, col in columns.items()})
        frame.attrs.update(self.metadata())
        return frame

    def to_parquet(
        self, path: str | os.PathLike[str], *, measurements: str | os.PathLike[str] | None = None
    ) -> None:
        """Write the rows to a Parquet file, and the measurements to another if asked.

        Each file is written beside its place and then renamed: nobody sees half a file.

        Parameters
        ----------
        path : path
            The solution's rows, `columns`.
        measurements : path, optional
            The measurements, `measurement_columns`.

        Raises
        ------
        InputError
            If the directory does not exist.
        MissingDependencyError
            If pyarrow is not installed.

        Examples
        --------
        >>> import celestcore as cc
        >>> log = cc.sample("fermi")
        >>> sol = cc.Settings.from_log(log).navigator().run(log)
        >>> import tempfile
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     sol.to_parquet(f"{folder}/fermi.parquet", measurements=f"{folder}/fixes.parquet")
        """
        arrow = require("pyarrow", extra="parquet", what="writing Parquet")
        parquet = require("pyarrow.parquet", extra="parquet", what="writing Parquet")
        note = {b"celestcore": json.dumps(self.metadata()).encode()}
        todo = [(path, self.columns())]
        if measurements is not None:
            todo.append((measurements, self.measurement_columns()))
        for target, columns in todo:
            with replacing(target) as temporary:
                table = arrow.table(columns).replace_schema_metadata(note)
                parquet.write_table(table, temporary, compression="zstd")

    def metadata(self) -> dict[str, Any]:
        """Return what a reader of the bare columns must know: epoch, frames, units, version.

        Returns
        -------
        dict
            Plain values, as JSON takes them.

        Examples
        --------
        >>> import celestcore as cc
        >>> log = cc.sample("fermi")
        >>> sol = cc.Settings.from_log(log).navigator().run(log)
        >>> sol.metadata()["epoch"]
        '2015-10-13T08:00:00'
        """
        return {
            "version": package_version(),
            "title": self.title,
            "filter": self.filter,
            "epoch": self.epoch,
            "frames": {"inertial": "not given", "body": "not given", **self.frames},
            "units": UNITS,
            "quaternion": "q_ib, body to inertial, Hamilton, scalar first",
        }

    def plot(self, panels: tuple[str, ...] | None = None, *, width: float = 11.0) -> Figure:
        """Draw the solution; see `celestcore.plot.figure`.

        Parameters
        ----------
        panels : tuple of str, optional
            Which panels; by default all of `celestcore.plot.PANELS` that the solution has kept.
        width : float
            Width of the figure [inch].

        Returns
        -------
        Figure
            Of matplotlib.

        Raises
        ------
        InputError
            An unknown panel, or one of what was not kept.
        MissingDependencyError
            If matplotlib is not installed.

        Examples
        --------
        >>> import celestcore as cc
        >>> log = cc.sample("fermi")
        >>> sol = cc.Settings.from_log(log).navigator().run(log)
        >>> len(sol.plot(("sigma",)).axes) >= 1
        True
        """
        from celestcore import plot

        return plot.figure(self, plot.kept(self) if panels is None else panels, width=width)

    def report(
        self,
        path: str | os.PathLike[str],
        *,
        log: SensorLog | None = None,
        navigator: StarGyroNavigator | None = None,
    ) -> None:
        """Write a report: one HTML page with words, numbers and plots to zoom into.

        Parameters
        ----------
        path : path
            Ends in .html, or in .png for the pictures alone.
        log : SensorLog, optional
            What it came from, for the noise of its fixes; the solution's `source` if it has one.
        navigator : StarGyroNavigator, optional
            What ran; tells the noise that each sensor was said to have.

        Raises
        ------
        InputError
            If the ending is another one or the directory does not exist.
        MissingDependencyError
            If pictures (.png) were asked for and matplotlib is not installed.

        Examples
        --------
        >>> import tempfile
        >>> import celestcore as cc
        >>> log = cc.sample("fermi")
        >>> nav = cc.Settings.from_log(log).navigator()
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     nav.run(log).report(f"{folder}/fermi.html", navigator=nav)
        """
        from celestcore.report import write_report
        from celestcore.summary import summary

        if log is None and self.source is not None:
            log = self.source[0]
        gate = None if navigator is None else navigator.gate
        write_report(path, self, summary(self, log, gate=gate, navigator=navigator))

    def _need(self, least: str, what: str) -> None:
        """Raise an error if less than this was kept of the measurements."""
        if self.innovations == "none" or (least == "full" and self.innovations == "nis"):
            lost = "innovations" if self.innovations == "nis" else "measurements"
            raise InputError(
                f"{what} needs {lost}, which were not kept: run with innovations={least!r}",
                field="innovations",
                value=self.innovations,
            )

    def _bracket(self, when: Array) -> tuple[NDArray[np.intp], Array]:
        """Return the row before each time and the fraction of the way to the next row."""
        if len(self) == 0:
            raise InputError("the solution is empty: there is nothing to interpolate", field="t")
        first, last = float(self.t[0]), float(self.t[-1])
        bad = ~((when >= first) & (when <= last))
        if bad.any():
            row = int(np.flatnonzero(bad)[0])
            value = float(when.reshape(-1)[row])
            raise InputError(
                f"outside the solution, which spans {first:.10g} to {last:.10g} s",
                field="t",
                row=row,
                value=value,
            )
        low = np.clip(np.searchsorted(self.t, when, side="right") - 1, 0, max(len(self) - 2, 0))
        step = self.t[np.minimum(low + 1, len(self) - 1)] - self.t[low]
        part = (when - self.t[low]) / np.where(step > 0.0, step, 1.0)
        return low, np.asarray(part, dtype=np.float64)

    def _between(self, when: slice) -> Solution:
        """Return the rows, measurements and gaps in a half-open span of time, as copies."""
        if when.step is not None:
            raise InputError("slice a solution as sol[start:stop], without a step", field="step")
        start = -np.inf if when.start is None else float(when.start)
        stop = np.inf if when.stop is None else float(when.stop)
        rows = slice(*np.searchsorted(self.t, [start, stop], side="left"))
        fixes = slice(*np.searchsorted(self.measurement_t, [start, stop], side="left"))
        gaps = self.gaps[(self.gaps[:, 1] > start) & (self.gaps[:, 0] < stop)]
        parts: dict[str, Any] = {
            name: getattr(self, name)[rows].copy() for name in ("t", "q", "rate", "bias", "sigma")
        }
        per_fix = ("measurement_t", "sensor", "nis", "dof", "accepted", "innovation")
        parts.update(
            {name: getattr(self, name)[fixes].copy() for name in (*per_fix, "innovation_sigma")}
        )
        if self.covariance is not None:
            parts["covariance"] = self.covariance[rows].copy()
        known = None if self.innovations == "none" else parts["accepted"]
        counts = _counts(len(parts["t"]), known, len(gaps))
        final = _final(parts) if len(parts["t"]) else {}
        if final and "noise_scale" in self.final:  # known of the end of the run alone
            final["noise_scale"] = self.final["noise_scale"]
        return dataclasses.replace(
            self,
            **parts,
            gaps=gaps,
            counts=counts,
            final=final,
            log_likelihood=float("nan"),
            source=None,
        )


def _counts(samples: int, accepted: NDArray[np.bool_] | None, gaps: int) -> dict[str, int]:
    """Return the counts that can be told from a part of a solution."""
    if accepted is None:
        return {"samples": samples, "gaps": gaps}
    used = int(np.count_nonzero(accepted))
    return {
        "samples": samples,
        "fixes": len(accepted),
        "accepted": used,
        "rejected": len(accepted) - used,
        "gaps": gaps,
    }


def _final(parts: Mapping[str, Any]) -> dict[str, Any]:
    """Return the state in the last row of some columns."""
    covariance = parts.get("covariance")
    out = {name: parts[name][-1].copy() for name in ("q", "bias", "sigma")}
    return {
        "t": float(parts["t"][-1]),
        **out,
        "covariance": None if covariance is None else covariance[-1].copy(),
    }


def _split(array: Array, names: tuple[str, ...]) -> Columns:
    out = np.empty((len(names), len(array)))
    for first in range(0, len(array), _BLOCK):  # a block stays in the processor's cache
        out[:, first : first + _BLOCK] = array[first : first + _BLOCK].T
    return dict(zip(names, out, strict=True))


def _rotation(q: Array) -> Any:
    transform = require("scipy.spatial.transform", extra="scipy", what="as_rotation")
    return transform.Rotation.from_quat(np.roll(q, -1, axis=-1))


def package_version() -> str:
    """Return the version of the package."""
    from celestcore import __version__

    return __version__
