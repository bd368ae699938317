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


def gyro_inputs(nav: GnssStarNavigator, table: GyroTable, stops: FloatArray) -> FloatArray:
    """Mean body rate and extra noise from each stop to the next, (n, 4).

    Stops between two samples share what holds between them.
    """
    gyro = nav.gyro
    assert gyro is not None
    rate, t = gyro.to_body(table.rate), table.t
    dt = np.diff(t)
    limit = gyro.max_gap if gyro.max_gap is not None else 3.0 * float(np.median(dt))
    mean = 0.5 * (rate[:-1] + rate[1:])
    chosen = {"hold": rate[:-1], "integrated": rate[1:], "average": mean}[gyro.sampling]
    gap = dt > limit
    inputs = np.zeros((len(t), 4))
    inputs[:-1, :3] = np.where(gap[:, None], mean, chosen)
    inputs[:-1, 3] = np.where(gap, gyro.gap_rate_sigma**2 * dt, 0.0)
    inputs[-1, :3] = rate[-1]
    return np.ascontiguousarray(
        inputs[np.clip(np.searchsorted(t, stops, "right") - 1, 0, len(t) - 1)]
    )


def _turns(stops: FloatArray, gyro: FloatArray, t: FloatArray) -> FloatArray:
    """Return how the body has turned from the first stop to each of some stops (n, 4)."""
    last = int(np.searchsorted(stops, t[-1]))
    steps = quaternion.exp(gyro[:last, :3] * np.diff(stops[: last + 1])[:, None])
    turned = [np.array([1.0, 0.0, 0.0, 0.0])]
    for step in steps:
        turned.append(quaternion.multiply(turned[-1], step))
    return np.array(turned)[np.searchsorted(stops, t)]


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
        fixes, nav = self.fixes, self.nav
        inside = np.flatnonzero((fixes.t >= stops[0]) & (fixes.t <= stops[-1]))
        if not len(inside):
            raise InputError("has no fix inside the span of the log", field="star")
        q = (
            fixes.q
            if frames is None
            else quaternion.multiply(quaternion.conjugate(frames[1]), fixes.q)
        )
        inside = self._good(inside, q, stops, gyro)
        start = self._start(float(stops[0]), inside, q, gyro)
        out: dict[str, Any] = self.core.run(
            (np.ascontiguousarray(stops), np.ascontiguousarray(wanted), gyro),
            (
                np.ascontiguousarray(fixes.t[inside]),
                np.ascontiguousarray(q[inside]),
                np.ascontiguousarray(self.noise[inside]),
                np.ascontiguousarray(self.weights[inside]),
            ),
            start,
            nav.gate,
            back,
            o["covariance"],
            o["portable"],
            o["progress"],
        )
        out["fix"] = inside[out["row"]]
        return out

    def _good(self, inside: Any, q: FloatArray, stops: FloatArray, gyro: FloatArray | None) -> Any:
        """Leave out those of the first fixes that the others contradict."""
        if self.nav.gate == 1.0:
            return inside
        first = inside[:FIRST]
        t, turned = self.fixes.t[first], q[first]
        if gyro is not None:
            turned = quaternion.multiply(turned, quaternion.conjugate(_turns(stops, gyro, t)))
        sigma = np.sqrt(self.noise[first][:, np.equal(ROWS, COLUMNS)].max(axis=1))
        jerk, degree = (self.nav.attitude.jerk_psd, 2) if gyro is None else (0.0, 1)
        good = agreeing(t, turned, sigma, jerk, degree)
        return np.concatenate([first[good], inside[FIRST:]])

    def _start(
        self, t: float, inside: Any, q: FloatArray, gyro: FloatArray | None
    ) -> tuple[float, FloatArray, FloatArray]:
        """Start near the first fix, with sigmas so wide that it is not counted twice."""
        first, attitude, nav = inside[0], self.nav.attitude, self.nav
        begin = self.fixes.t[first]
        if gyro is not None:
            back = quaternion.exp(-gyro[0, :3] * (begin - t))
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
