"""`SensorLog`: what a spacecraft's sensors reported, one checked table per sensor."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from dataclasses import replace
from datetime import datetime
from typing import TYPE_CHECKING, Any

import numpy as np

from celestcore._check import FloatArray, warn
from celestcore._columns import parts_from_columns
from celestcore._epoch import epoch_string
from celestcore._tables import (
    KNOWN,
    BaselineTable,
    GnssTable,
    GyroTable,
    StarTable,
    Table,
    VectorTable,
    build_table,
    parts_of,
    table_kind,
)
from celestcore.errors import InputError

if TYPE_CHECKING:
    from astropy.time import Time

    from celestcore.config import Settings

__all__ = [
    "BaselineTable",
    "GnssTable",
    "GyroTable",
    "SensorLog",
    "StarTable",
    "Table",
    "VectorTable",
]

_DEGREES = 180.0 / np.pi
_TELLING = 0.25
"""How far from 57.3, relative, the ratio of gyro to star-fix rates may be to tell degrees."""


class SensorLog:
    """A log: one table per sensor, every sensor with its own times.

    Every array is copied to float64, checked, and read-only afterwards. Rows whose measurement is
    NaN or infinite are missing: they are dropped and counted in the table's ``missing``.

    Parameters
    ----------
    epoch : str, astropy Time or None
        Where all times count from; an ISO string without a scale means UTC.
    gyro : (t, rate)
        `t` (n,) s; `rate` (n, 3) rad/s, gyro frame.
    star : (t, q) or (t, q, sigma)
        `q` (n, 4) or a scipy Rotation, camera to inertial, either sign; `sigma` a number, (n,) or
        (n, 3) rad, or covariances (n, 3, 3) rad^2, camera frame.
    vector : (t, body, inertial[, sigma])
        Unit vectors (n, 3) in the sensor's and the inertial frame; short for ``vector_1``.
    gnss : (t, r) or (t, r, v)
        Earth-fixed position (n, 3) m and velocity (n, 3) m/s.
    baselines : (t, b)
        `b` (n, k, 3) m, Earth-fixed, from the master antenna to k others, two at least; NaN where
        one is missing.
    scalar_first : bool
        Whether raw quaternion arrays are (w, x, y, z).
    frames : dict, optional
        Names of the frames ``inertial``, ``body`` and ``earth``.
    title : str, optional
        A line that says what the log is.
    settings : dict or Settings, optional
        What ``log.toml`` holds: noise, mounting and so on; see `celestcore.config`.
    **tables
        ``star_NAME`` as `star`, for more cameras; ``vector_NAME`` as `vector`.

    Attributes
    ----------
    gyro : GyroTable or None
    stars : dict of str to StarTable
        Keys ``"star"``, ``"star_1"`` ...
    vectors : dict of str to VectorTable
        Keys without ``vector_``.
    gnss : GnssTable or None
    baselines : BaselineTable or None
    epoch, title : str or None
    frames, settings : dict

    Raises
    ------
    InputError
        Names the field (``gyro.t``), the row (from 0) and the value.

    Notes
    -----
    A table may also be a mapping or data frame with the columns of the file formats (``t``, ``wx``,
    ``wy``, ``wz`` ...), or a table of another log.

    Examples
    --------
    >>> log = SensorLog(gyro=([0.0, 0.1, 0.2], [[0.0, 0.0, 0.01]] * 3),
    ...                 star=([0.0, 0.2], [[1.0, 0.0, 0.0, 0.0], [-1.0, 0.0, 0.0, -0.001]]))
    >>> log
    SensorLog(0.2 s: gyro 3 rows, star 2 rows)
    >>> log.stars["star"].t
    array([0. , 0.2])
    """

    def __init__(
        self,
        *,
        epoch: str | datetime | Time | None = None,
        gyro: Any = None,
        star: Any = None,
        vector: Any = None,
        gnss: Any = None,
        baselines: Any = None,
        scalar_first: bool = True,
        frames: Mapping[str, str] | None = None,
        title: str | None = None,
        settings: Settings | Mapping[str, Any] | None = None,
        **tables: Any,
    ) -> None:
        self.settings = _checked_settings(settings, frames)
        header = self.settings.get("log", {})
        self.epoch = epoch_string(header.get("epoch") if epoch is None else epoch)
        self.title: str | None = header.get("title") if title is None else str(title)
        self.frames: dict[str, str] = self.settings.get("frames", {})
        if vector is not None and tables.setdefault("vector_1", vector) is not vector:
            raise InputError("is short for vector_1, which is given too", field="vector")
        given = {"gyro": gyro, "star": star, **tables, "gnss": gnss, "baselines": baselines}
        self._tables = {
            name: _table(name, value, scalar_first)
            for name, value in given.items()
            if value is not None or table_kind(name) is None
        }
        if not self._tables:
            raise InputError(f"the log is empty; give at least one of {KNOWN}")
        with np.errstate(all="ignore"):
            _warn_if_degrees(self.gyro, self.stars)

    @classmethod
    def _of_windows(cls, epoch: str | None, tables: Mapping[str, Any]) -> SensorLog:
        """Return a log of arrays that nobody else writes to: checked, a gyro's not copied.

        For pieces of a log one after another: whether it is in degrees was said of the first.
        """
        log = cls.__new__(cls)
        log.settings, log.frames, log.title = {}, {}, None
        log.epoch = epoch_string(epoch)
        log._tables = {name: build_table(name, parts, copy=False) for name, parts in tables.items()}
        return log

    @property
    def tables(self) -> dict[str, Table]:
        """All tables by name, as on disk: ``gyro``, ``star``, ``vector_sun`` ..."""
        return dict(self._tables)

    @property
    def gyro(self) -> GyroTable | None:
        """The gyro's table, None if there is none."""
        table = self._tables.get("gyro")
        return table if isinstance(table, GyroTable) else None

    @property
    def stars(self) -> dict[str, StarTable]:
        """The star cameras' tables by name: ``star``, ``star_1`` ..."""
        return {n: t for n, t in self._tables.items() if isinstance(t, StarTable)}

    @property
    def vectors(self) -> dict[str, VectorTable]:
        """The direction sensors' tables by name, without ``vector_``."""
        return {
            n.removeprefix("vector_"): t
            for n, t in self._tables.items()
            if isinstance(t, VectorTable)
        }

    @property
    def gnss(self) -> GnssTable | None:
        """The GNSS table, None if there is none."""
        table = self._tables.get("gnss")
        return table if isinstance(table, GnssTable) else None

    @property
    def baselines(self) -> BaselineTable | None:
        """The table of baselines between GNSS antennas, None if there is none."""
        table = self._tables.get("baselines")
        return table if isinstance(table, BaselineTable) else None

    @property
    def span(self) -> tuple[float, float]:
        """The first and the last time of any sensor [s since the epoch]."""
        ends = [(float(t.t[0]), float(t.t[-1])) for t in self._tables.values()]
        return min(e[0] for e in ends), max(e[1] for e in ends)

    @property
    def missing(self) -> int:
        """How many rows of all sensors were dropped because the measurement was missing."""
        return sum(t.missing for t in self._tables.values())

    def __len__(self) -> int:
        """Return the number of rows of all sensors together, without the missing ones."""
        return sum(len(t) for t in self._tables.values())

    def __repr__(self) -> str:
        start, end = self.span
        rows = ", ".join(
            f"{name} {len(t)} row{'s' * (len(t) != 1)}"
            + (f" ({t.missing} missing)" if t.missing else "")
            for name, t in self._tables.items()
        )
        title = f"{self.title!r}, " if self.title else ""
        since = f" from {self.epoch}" if self.epoch else ""
        return f"SensorLog({title}{end - start:.10g} s{since}: {rows})"


def _checked_settings(
    settings: Settings | Mapping[str, Any] | None, frames: Mapping[str, str] | None
) -> dict[str, Any]:
    """Return a checked copy of the settings, their frames overridden by `frames`."""
    if settings is None and frames is None:
        return {}
    from celestcore.config import Settings

    given = settings.tables if isinstance(settings, Settings) else (settings or {})
    Settings.from_dict(given)
    out = copy.deepcopy({str(name): dict(table) for name, table in given.items()})
    if frames:
        out["frames"] = {**out.get("frames", {}), **frames}
        Settings.from_dict({"frames": out["frames"]})
    return out


def _table(name: str, value: Any, scalar_first: bool) -> Table:
    if isinstance(value, Table):
        table = build_table(name, parts_of(value))
        same_rows = value.kept is not None and len(value.kept) == len(table)
        return replace(table, missing=value.missing, kept=value.kept if same_rows else None)
    if isinstance(value, Mapping) or hasattr(value, "columns"):
        return build_table(name, parts_from_columns(name, value))
    return build_table(name, value, scalar_first=scalar_first)


def _warn_if_degrees(gyro: GyroTable | None, stars: Mapping[str, StarTable]) -> None:
    """Warn if the gyro turns 57.3 times faster than the star fixes."""
    if gyro is None:
        return
    for name, star in stars.items():
        ratio = _rate_ratio(gyro, star)
        if ratio.size < 3:
            continue
        low, high = np.percentile(ratio, [25, 75]) / _DEGREES
        if low > 1.0 - _TELLING and high < 1.0 + _TELLING:
            warn(
                f"gyro.rate turns {np.median(ratio):.3g} times faster than {name}.q: it seems to "
                "be in degrees per second; multiply it by celestcore.DEG"
            )
            return


def _rate_ratio(gyro: GyroTable, star: StarTable) -> FloatArray:
    """Ratio of the gyro's rate to that of neighbouring star fixes, at up to 500 places."""
    first = np.unique(np.linspace(0, max(len(star) - 2, 0), 500).astype(np.int64))
    if len(star) < 2:
        return np.empty(0)
    a, b = star.q[first], star.q[first + 1]
    sign = np.where(np.einsum("ij,ij->i", a, b) < 0.0, -1.0, 1.0)
    half = 0.5 * np.linalg.norm(b - sign[:, None] * a, axis=1)
    dt = star.t[first + 1] - star.t[first]
    turned = 4.0 * np.arcsin(np.minimum(half, 1.0)) / dt
    middle = np.searchsorted(gyro.t, star.t[first] + 0.5 * dt)
    rate = np.linalg.norm(gyro.rate[np.minimum(middle, len(gyro) - 1)], axis=1)
    telling = (turned > 0.0) & (rate / _DEGREES * dt < 2.0)
    ratio: FloatArray = rate[telling] / turned[telling]
    return ratio
