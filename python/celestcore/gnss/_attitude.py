"""The attitude of a GNSS and star navigator: fixes for the core, a start, and the answer."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from celestcore import quaternion
from celestcore._check import FloatArray, warn
from celestcore._replay import BIAS_SIGMA
from celestcore.errors import InputError
from celestcore.gnss._attitude_start import FIRST, agreeing
from celestcore.gnss._orbit import COLUMNS, ROWS
from celestcore.gnss._segments import FEWEST_LEFT, Begin, in_segments, listed, many_refused, stacked
from celestcore.gnss.attitude import gps_attitude

if TYPE_CHECKING:
    from celestcore.gnss.navigator import GnssStarNavigator
    from celestcore.log import GyroTable, SensorLog

WIDE = 0.1
"""1-sigma of the attitude about a start that is the first fix itself [rad]: so wide that the fix
does not count twice."""


@dataclass
class AttitudeFixes:
    """Attitudes of the body in the GCRS, one row each, in order of time."""

    t: FloatArray
    q: FloatArray
    noise: FloatArray
    sensor: Any
    """0 for the first star table and so on; the last one is the antennas."""
    row: Any
    names: list[str]

    def stars(self) -> tuple[FloatArray, FloatArray]:
        """Return times and attitudes of the star fixes alone."""
        star = self.of_stars()
        return self.t[star], quaternion.continuous(self.q[star]) if star.any() else self.q[star]

    def of_stars(self) -> Any:
        """Return which rows are of star sensors, not of antennas."""
        antennas = [k for k, name in enumerate(self.names) if name == "baselines"]
        return ~np.isin(self.sensor, antennas)


def star_fixes(nav: GnssStarNavigator, log: SensorLog) -> AttitudeFixes:
    """Return the star sensors' fixes as attitudes of the body."""
    parts: list[tuple[Any, ...]] = []
    for number, (name, table) in enumerate(log.stars.items()):
        camera = nav._camera(name)
        q, noise = camera.to_body(table.q, table.sigma, table.covariance)
        t = table.t - nav.star_time_offset
        parts.append((t, q, noise, np.full(len(t), number), np.arange(len(t))))
    names = list(log.stars)
    if not parts:
        empty = (np.empty(0), np.empty((0, 4)), np.empty((0, 6)))
        return AttitudeFixes(*empty, np.empty(0, int), np.empty(0, int), names)
    return _ordered(parts, names)


def with_antennas(
    nav: GnssStarNavigator, log: SensorLog, stars: AttitudeFixes, r_ie: FloatArray
) -> AttitudeFixes:
    """Add the attitudes that the antennas' baselines tell; `r_ie` from Earth-fixed to GCRS."""
    table = log.baselines
    if nav.antennas is None or table is None:
        return stars
    found = gps_attitude(nav.antennas, table.b)
    good = np.flatnonzero(found.valid)
    if not len(good):
        warn("no epoch of the baselines tells an attitude: see celestcore.gnss.gps_attitude")
        return stars
    q = quaternion.multiply(quaternion.from_matrix(r_ie[good]), found.q[good])
    noise = np.ascontiguousarray(found.covariance[good][:, ROWS, COLUMNS])
    t = (table.t - nav.gnss.time_offset)[good]
    own = (t, q, noise, np.full(len(good), len(stars.names)), good)
    old = (stars.t, stars.q, stars.noise, stars.sensor, stars.row)
    return _ordered([old, own], [*stars.names, "baselines"])


def _ordered(parts: list[tuple[Any, ...]], names: list[str]) -> AttitudeFixes:
    columns = [np.concatenate(column) for column in zip(*parts, strict=True)]
    order = np.argsort(columns[0], kind="stable")
    t, q, noise, sensor, row = (np.ascontiguousarray(column[order]) for column in columns)
    return AttitudeFixes(t, q, noise, sensor, row, names)


def gap_limit(nav: GnssStarNavigator, table: GyroTable) -> float:
    """Return the longest step of a gyro that is no gap [s]; 0 where a lone sample has no step."""
    gyro = nav.gyro
    assert gyro is not None
    if gyro.max_gap is not None:
        return float(gyro.max_gap)
    return 3.0 * float(np.median(np.diff(table.t))) if len(table.t) > 1 else 0.0


def gyro_inputs(nav: GnssStarNavigator, table: GyroTable, stops: FloatArray) -> FloatArray:
    """Mean body rate and extra noise from each stop to the next, (n, 4).

    Stops between two samples share what holds between them; beyond the first and the last sample
    theirs are held, farther than a gap may be as in a gap.
    """
    gyro = nav.gyro
    assert gyro is not None
    rate, t = gyro.to_body(table.rate), table.t
    dt, limit = np.diff(t), gap_limit(nav, table)
    mean = 0.5 * (rate[:-1] + rate[1:])
    chosen = {"hold": rate[:-1], "integrated": rate[1:], "average": mean}[gyro.sampling]
    gap = dt > limit
    inputs = np.zeros((len(t), 4))
    inputs[:-1, :3] = np.where(gap[:, None], mean, chosen)
    inputs[:-1, 3] = np.where(gap, gyro.gap_rate_sigma**2 * dt, 0.0)
    inputs[-1, :3] = rate[-1]
    out = inputs[np.clip(np.searchsorted(t, stops, "right") - 1, 0, len(t) - 1)]
    for beyond, away in ((stops < t[0], t[0] - stops[0]), (stops >= t[-1], stops[-1] - t[-1])):
        if away > limit:
            out[beyond, 3] = gyro.gap_rate_sigma**2 * away
    return np.ascontiguousarray(out)


def _turns(stops: FloatArray, gyro: FloatArray, t: FloatArray) -> FloatArray:
    """Return how the body has turned from the first of some stops to each of them (n, 4)."""
    first, last = (int(k) for k in np.searchsorted(stops, t[[0, -1]]))
    steps = quaternion.exp(gyro[first:last, :3] * np.diff(stops[first : last + 1])[:, None])
    turned = [np.array([1.0, 0.0, 0.0, 0.0])]
    for step in steps:
        turned.append(quaternion.multiply(turned[-1], step))
    return np.array(turned)[np.searchsorted(stops, t) - first]


class AttitudeRun:
    """Runs of the attitude filter over one log."""

    def __init__(self, nav: GnssStarNavigator, fixes: AttitudeFixes, period: float) -> None:
        self.nav, self.fixes, self.period = nav, fixes, period
        self.core = nav._attitude_core()
        self.noise = fixes.noise

    def blur(self, variance: FloatArray) -> None:
        """Add the variance of the frame that the fixes are taken to, alike about all axes (n,)."""
        self.noise = self.noise + variance[:, None] * np.equal(ROWS, COLUMNS)

    @property
    def weights(self) -> FloatArray:
        """How much each vector of the slow error adds to each fix; baselines have none of it."""
        lfe = self.nav.lfe
        if lfe is None:
            return np.zeros((len(self.fixes.t), 0))
        weights = lfe.weights(self.fixes.t, self.period)
        return np.ascontiguousarray(weights * self.fixes.of_stars()[:, None])

    def warn_of_arc(self, span: float) -> None:
        """Say where an arc is too short to tell harmonics."""
        lfe = self.nav.lfe
        if lfe is not None and lfe.harmonics and span < 0.5 * self.period:
            warn(
                f"the fixes span {span:.0f} s, less than half an orbit, {0.5 * self.period:.0f} s: "
                "harmonics of the star sensor's error cannot be told from the attitude there, and "
                "the sigmas say so"
            )

    def run(
        self,
        stops: FloatArray,
        wanted: Any,
        frames: tuple[FloatArray, FloatArray] | None,
        gyro: FloatArray | None,
        o: dict[str, Any],
        back: bool,
    ) -> dict[str, Any]:
        """Run over the stops; `frames` is the orbital frame at stops and fixes, if it is used."""
        self.over(stops, wanted, None if frames is None else frames[1], gyro, o)
        if not self.used.any():
            raise InputError("has no fix inside the span of the log", field="star")
        start = self.begin(-np.inf, float(stops[0]))
        segments, restarts = in_segments(self, stops, start, back=back)
        if restarts:
            warn(
                f"the attitude filter refused {self.nav.max_rejected} fixes running and started "
                f"again at t = {listed(restarts)} s: a turn that is faster than it is told, or a "
                "star sensor that has moved"
            )
        out = stacked(segments)
        out["restarts"] = restarts
        return out

    def over(
        self,
        stops: FloatArray,
        wanted: Any,
        frames: FloatArray | None,
        gyro: FloatArray | None,
        o: dict[str, Any],
    ) -> None:
        """Say what to run over; `frames` is the orbital frame at the fixes, if it is used."""
        self.stops, self.wanted, self.gyro, self.options = stops, wanted, gyro, o
        self.q = self.fixes.q
        if frames is not None:
            self.q = quaternion.multiply(quaternion.conjugate(frames), self.fixes.q)
        self.used = (self.fixes.t >= stops[0]) & (self.fixes.t <= stops[-1])

    def rows(self, t: float) -> Any:
        """Return the fixes that are used from time t on."""
        return np.flatnonzero(self.used & (self.fixes.t >= t))

    def times(self, rows: Any) -> FloatArray:
        """Return times of fixes."""
        return np.asarray(self.fixes.t[rows])

    def go(self, stops: slice, start: Begin, rows: Any, *, back: bool) -> dict[str, Any]:
        """Run the core over some of the stops."""
        o, gyro = self.options, self.gyro
        out: dict[str, Any] = self.core.run(
            (
                np.ascontiguousarray(self.stops[stops]),
                np.ascontiguousarray(self.wanted[stops]),
                None if gyro is None else np.ascontiguousarray(gyro[stops]),
            ),
            (
                np.ascontiguousarray(self.fixes.t[rows]),
                np.ascontiguousarray(self.q[rows]),
                np.ascontiguousarray(self.noise[rows]),
                np.ascontiguousarray(self.weights[rows]),
            ),
            start,
            self.nav.gate,
            back,
            o["covariance"],
            o["portable"],
            o["progress"],
        )
        return out

    def refused(self, out: dict[str, Any], rows: Any) -> tuple[Any, FloatArray]:
        """Return which fixes were refused, and the times of all."""
        return ~out["accepted"], np.asarray(self.fixes.t[rows[out["row"]]])

    def left(self, t: Any) -> Any:
        """Return how many fixes there are from some times on."""
        used = self.fixes.t[self.used]
        return len(used) - np.searchsorted(used, t)

    def decided(self, t: float) -> bool:
        """Tell whether a start in the fixes from time t on rests on none that is to come."""
        at = self.times(self.rows(t))
        return len(at) > FIRST and bool(at[-1] > at[FIRST - 1])

    def lost(self, out: dict[str, Any], rows: Any) -> FloatArray:
        """Return the times at which too many fixes were refused running."""
        t = many_refused(*self.refused(out, rows), self.nav.max_rejected)
        return np.asarray(t[self.left(t) >= FEWEST_LEFT])

    def again(self, lost: float, t: float) -> Begin | None:
        """Return a start at time t from the fixes from `lost` on."""
        return self.begin(lost, t)

    def begin(self, after: float, t: float) -> Begin:
        """Find a start in the fixes from `after` on, at time `t`."""
        rows = self.rows(after)
        good = self._good(rows, self.q)
        self.used[np.setdiff1d(rows[:FIRST], good[:FIRST])] = False
        return self._start(t, good, self.q)

    def _good(self, inside: Any, q: FloatArray) -> Any:
        """Leave out those of the first fixes that the others contradict."""
        if self.nav.gate == 1.0:
            return inside
        first = inside[:FIRST]
        t, turned, gyro = self.fixes.t[first], q[first], self.gyro
        if gyro is not None:
            turned = quaternion.multiply(turned, quaternion.conjugate(_turns(self.stops, gyro, t)))
        sigma = np.sqrt(self.noise[first][:, np.equal(ROWS, COLUMNS)].max(axis=1))
        jerk, degree = (self.nav.attitude.jerk_psd, 2) if gyro is None else (0.0, 1)
        good = agreeing(t, turned, sigma, jerk, degree)
        return np.concatenate([first[good], inside[FIRST:]])

    def _start(self, t: float, inside: Any, q: FloatArray) -> Begin:
        """Start near the first fix, with sigmas so wide that it is not counted twice."""
        first, attitude, nav = inside[0], self.nav.attitude, self.nav
        begin = self.fixes.t[first]
        if self.gyro is not None:
            rate = self.gyro[np.searchsorted(self.stops, t), :3]
            back = quaternion.exp(-rate * (begin - t))
            head = np.concatenate([quaternion.multiply(q[first], back), np.zeros(3)])
            sigma = np.repeat([WIDE, BIAS_SIGMA], 3)
        else:
            rate = np.zeros(3)
            later = inside[self.fixes.t[inside] > begin]
            if len(later):
                turn = quaternion.log(
                    quaternion.multiply(quaternion.conjugate(q[first]), q[later[0]])
                )
                rate = turn / (self.fixes.t[later[0]] - begin)
            head = np.concatenate(
                [
                    quaternion.multiply(q[first], quaternion.exp(-rate * (begin - t))),
                    rate,
                    np.zeros(3),
                ]
            )
            sigma = np.repeat([WIDE, attitude.rate_sigma, attitude.acceleration_sigma], 3)
        if nav.lfe is not None:
            head = np.append(head, np.zeros(3 * nav.lfe.vectors))
            sigma = np.append(sigma, np.repeat(nav.lfe.prior, 3))
        return t, np.ascontiguousarray(head), np.ascontiguousarray(np.diag(sigma * sigma))
