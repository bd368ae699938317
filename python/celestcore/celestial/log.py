"""`CelestialLog`: what a satellite measured of stars and the Earth."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from celestcore._check import FloatArray, array, unit_rows, warn
from celestcore._check import times as check_times
from celestcore._epoch import epoch_string
from celestcore.errors import InputError

__all__ = ["AngleTable", "CelestialLog"]

_HINT = "normalise it, or drop the row"


@dataclass(frozen=True, eq=False)
class AngleTable:
    """Angles to stars; rows with the same time are one epoch.

    Attributes
    ----------
    t : ndarray (n,)
        Times [s since the log's epoch], not decreasing.
    star : ndarray (n, 3)
        Unit vectors to the stars, GCRS.
    angle : ndarray (n,)
        Angles [rad].
    missing : int
        Rows that were left out because the angle is not finite.

    Examples
    --------
    >>> log = CelestialLog(horizon=([0.0, 0.0], [[1.0, 0, 0], [0, 1.0, 0]], [1.5, np.nan]))
    >>> len(log.horizon), log.horizon.missing
    (1, 1)
    """

    t: FloatArray
    star: FloatArray
    angle: FloatArray
    missing: int = 0

    def __len__(self) -> int:
        return len(self.t)

    @property
    def epochs(self) -> FloatArray:
        """Times of the epochs, each once."""
        return np.unique(self.t)


class CelestialLog:
    """Angles to stars over time, checked and read-only.

    Parameters
    ----------
    horizon : (t, star, angle), optional
        Angles between stars and the nadir: `t` (n,) s, `star` (n, 3) unit vectors in the GCRS,
        `angle` (n,) rad. Rows with the same time are one epoch.
    refraction : (t, star, angle), optional
        Refraction angles of stars seen through the atmosphere [rad].
    epoch : str, astropy Time or None
        Where the times count from.
    times : array_like (k,), optional
        Times of all epochs [s], increasing, those included at which no star was seen: a navigator
        predicts, writes a row and counts them. By default the times in the tables.

    Attributes
    ----------
    horizon, refraction : AngleTable or None
    epoch : str or None

    Raises
    ------
    InputError
        Names the field, the row and the value.

    Examples
    --------
    >>> CelestialLog(horizon=([0.0, 3.0], [[1.0, 0, 0], [0, 1.0, 0]], [1.5, 1.6]))
    CelestialLog(horizon 2 angles in 2 epochs)
    """

    def __init__(
        self,
        *,
        horizon: Any = None,
        refraction: Any = None,
        epoch: Any = None,
        times: Any = None,
    ) -> None:
        self.epoch = epoch_string(epoch)
        self._times = None if times is None else check_times(times, "times")
        self.horizon = _table(horizon, "horizon", 0.0, np.pi)
        self.refraction = _table(refraction, "refraction", -0.01, 0.1)  # noise may be larger
        if self.horizon is None and self.refraction is None:
            raise InputError("give horizon, refraction or both", field="log")

    def __repr__(self) -> str:
        parts = [
            f"{name} {len(table)} angles in {len(table.epochs)} epochs"
            for name, table in self.tables.items()
        ]
        return f"CelestialLog({', '.join(parts)})"

    @property
    def tables(self) -> dict[str, AngleTable]:
        """The tables that are there, by name."""
        both = {"horizon": self.horizon, "refraction": self.refraction}
        return {name: table for name, table in both.items() if table is not None}

    @property
    def times(self) -> FloatArray:
        """Times of all epochs (k,), each once [s]."""
        seen = [table.t for table in self.tables.values()]
        return np.unique(np.concatenate(seen if self._times is None else [*seen, self._times]))


def _table(value: Any, name: str, smallest: float, largest: float) -> AngleTable | None:
    if value is None or isinstance(value, AngleTable):
        return value
    try:
        t, star, angle = value
    except (TypeError, ValueError):
        raise InputError("needs (t, star, angle)", field=name) from None
    times = array(t, f"{name}.t", (None,))
    stars = array(star, f"{name}.star", (len(times), 3))
    angles = array(angle, f"{name}.angle", (len(times),))
    good = np.isfinite(angles)
    rows = np.flatnonzero(good)
    times, stars, angles = times[good], stars[good], angles[good]
    _check_times(times, name, rows)
    bad = ~np.isfinite(stars).all(axis=1)
    if bad.any():
        k = int(np.argmax(bad))
        raise InputError("must be finite", field=f"{name}.star", row=int(rows[k]), value=stars[k])
    unit_rows(stars, f"{name}.star", what="vector", hint=_HINT, rows=rows)
    bad = ~((angles >= smallest) & (angles <= largest))
    if bad.any():
        k = int(np.argmax(bad))
        degrees = "; angles are in radians, these look like degrees" if angles[k] > np.pi else ""
        raise InputError(
            f"must be an angle from {smallest:g} to {largest:.4g} rad{degrees}",
            field=f"{name}.angle",
            row=int(rows[k]),
            value=angles[k],
        )
    for column in (times, stars, angles):
        column.setflags(write=False)
    if not len(times):
        warn(f"{name} has no angle at all: the orbit is only predicted")
    return AngleTable(times, stars, angles, int(len(good) - len(rows)))


def _check_times(t: FloatArray, name: str, rows: Any) -> None:
    bad = ~np.isfinite(t)
    if bad.any():
        k = int(np.argmax(bad))
        raise InputError("a time must be finite", field=f"{name}.t", row=int(rows[k]), value=t[k])
    back = np.diff(t) < 0.0
    if back.any():
        k = 1 + int(np.argmax(back))
        raise InputError(
            "goes back; sort the rows by time", field=f"{name}.t", row=int(rows[k]), value=t[k]
        )
