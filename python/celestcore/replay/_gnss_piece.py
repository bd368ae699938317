"""A piece of a log as the two filters of a GNSS and star navigator take it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from celestcore import quaternion
from celestcore._check import FloatArray
from celestcore._tables import GyroTable
from celestcore.errors import InputError
from celestcore.gnss import GnssStarNavigator
from celestcore.gnss._attitude import AttitudeFixes, star_fixes, with_antennas
from celestcore.gnss._earth import Earth
from celestcore.gnss._orbit import Fixes, fixes_of
from celestcore.log import SensorLog
from celestcore.orbit import ForceModel
from celestcore.orbit.propagate import environment_of

Arm = tuple[FloatArray, FloatArray]
"""Times and attitudes of the last two star fixes: between them and the next the antenna turns."""
NO_ARM: Arm = (np.empty(0), np.empty((0, 4)))
BLOCK = 20 * 86400.0
"""Tables of the forces reach so much farther each time [s]."""


class Environment:
    """Tables of the forces, from the epoch or the first stop to as far as was needed.

    Their nodes stand where they stand for the whole log.
    """

    def __init__(self, force: ForceModel, epoch: str) -> None:
        self.force, self.epoch = force, epoch
        self._reach = -np.inf
        self._tables: dict[str, Any] | None = None

    def over(self, begin: float, end: float) -> dict[str, Any] | None:
        """Return tables that reach from a log's first stop to `end`."""
        if end <= self._reach:
            return self._tables
        for reach in (np.ceil(end / BLOCK) * BLOCK, end + 86400.0, end):
            try:
                span = np.array([begin, reach])
                self._tables = environment_of(self.force, self.epoch, span, None)
            except InputError:
                # the Earth's orientation is not known so far ahead: perhaps as far as is needed
                if reach == end:
                    raise
                continue
            self._reach = float(reach)
            break
        return self._tables


@dataclass(frozen=True)
class GnssPiece:
    """Fixes, the times at which the filters stop, and a gyro's samples."""

    fixes: Fixes
    stars: AttitudeFixes
    stops: FloatArray
    gyro: GyroTable | None
    velocities: bool

    def arm(self, before: Arm, end: float) -> Arm:
        """Return the last two star fixes up to a time."""
        t, q = _joined(before, self.stars)
        t, first = np.unique(t, return_index=True)
        n = int(np.searchsorted(t, end, "right"))
        some = slice(max(n - 2, 0), n)
        return t[some], q[first][some]


def piece_of(
    nav: GnssStarNavigator, log: SensorLog, arm: Arm, first: dict[str, float], *, last: bool
) -> GnssPiece | None:
    """Return a log's rows as the filters take them; None if an antenna's arm cannot be turned yet.

    `first` has the first times of the tables that turn with the Earth; new ones are put in.
    """
    stars = star_fixes(nav, log)
    known = _joined(arm, stars)
    if np.any(nav.gnss.lever_arm) and not last and len(np.unique(known[0])) < 2:
        return None
    fixes = _nothing()
    if log.gnss is not None:
        earth = _earth(nav, log, "gnss", first)
        fixes = fixes_of(nav, log.gnss, known, earth)
    if nav.antennas is not None and log.baselines is not None:
        t = np.ascontiguousarray(log.baselines.t - nav.gnss.time_offset)
        r_ie, _ = _earth(nav, log, "baselines", first).at(t)
        stars = with_antennas(nav, log, stars, r_ie)
    stops = np.unique(np.concatenate([fixes.epochs, stars.t]))
    return GnssPiece(fixes, stars, stops, log.gyro, bool(fixes.velocity.any()))


def _earth(nav: GnssStarNavigator, log: SensorLog, name: str, first: dict[str, float]) -> Earth:
    own = float(log.tables[name].t[0]) - nav.gnss.time_offset
    return Earth(str(log.epoch), first.setdefault(name, own))


def _joined(arm: Arm, stars: AttitudeFixes) -> Arm:
    own = stars.stars()
    t, q = (np.concatenate(pair) for pair in zip(arm, own, strict=True))
    return t, quaternion.continuous(q) if len(q) else q


def _nothing() -> Fixes:
    none, three = np.empty(0), np.empty((0, 3))
    rows = np.empty(0, int)
    return Fixes(none, np.empty(0, bool), three, np.empty((0, 6)), rows, three, three, none)


def only(stars: AttitudeFixes, end: float) -> AttitudeFixes:
    """Return the attitude fixes up to a time."""
    n = int(np.searchsorted(stars.t, end, "right"))
    return AttitudeFixes(
        stars.t[:n], stars.q[:n], stars.noise[:n], stars.sensor[:n], stars.row[:n], stars.names
    )


def unused_of(t: Any, used: Any, end: float, names: Any) -> dict[str, FloatArray]:
    """Return the times of unused fixes after `end` by the names of their tables."""
    bad = ~used & (t > end)
    return {str(name): t[bad & (names == name)] for name in np.unique(names[bad])}


def is_unused(t: Any, names: Any, unused: Mapping[str, FloatArray]) -> Any:
    """Tell which fixes a start has found to be wrong."""
    out = np.zeros(len(t), bool)
    for name, wrong in unused.items():
        out |= (names == name) & np.isin(t, wrong)
    return out
