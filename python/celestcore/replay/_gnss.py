"""A GNSS and star navigator that goes over a log piece by piece: orbit first, then the attitude."""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from celestcore import quaternion
from celestcore._check import FloatArray, warn
from celestcore._epoch import epoch_string
from celestcore._tables import table_kind
from celestcore.errors import InputError
from celestcore.gnss import GnssStarNavigator, GnssStarSolution, Innovations, _run
from celestcore.gnss._attitude import AttitudeFixes, AttitudeRun, gap_limit
from celestcore.gnss._orbit import FIXES_OF_A_START
from celestcore.replay._forward import Made, Source
from celestcore.replay._gnss_pass import AttitudeDone, AttitudeOver, OrbitDone, OrbitOver
from celestcore.replay._gnss_piece import NO_ARM, Arm, Environment, GnssPiece, piece_of
from celestcore.replay._gnss_tables import counts_of, tables_of
from celestcore.replay._gnss_track import MOST_HELD, Track
from celestcore.replay._gnss_waiting import Waiting, log_of


@dataclass
class State:
    """All that what follows depends on, beside the rows that wait."""

    origin: float
    """The first stop [s]."""
    first: dict[str, float]
    """The first fix of the tables that are turned with the Earth [s]."""
    orbit: Track
    attitude: Track | None
    unused: dict[str, FloatArray] = field(default_factory=dict)
    """Times of fixes that a start has found to be wrong, by table."""
    frame: float | None = None
    """Variance of the orbital frame at the last attitude fix [rad^2]."""
    arm: Arm = NO_ARM
    q: FloatArray | None = None
    """The last row's attitude: the next one has its sign."""
    rows: int = 0
    counts: dict[str, int] = field(default_factory=dict)
    stars: tuple[float, float] = (np.inf, -np.inf)
    """The first and the last attitude fix [s]."""


class GnssForward:
    """The two filters between two pieces."""

    def __init__(
        self, navigator: GnssStarNavigator, options: Mapping[str, Any], source: Source
    ) -> None:
        self.nav = copy.copy(navigator)
        self._given_gap = None if navigator.gyro is None else navigator.gyro.max_gap
        self.options = {**options, "max_rejected": navigator.max_rejected}
        _check(navigator, options, source)
        self.epoch = str(epoch_string(source.epoch))
        own = (navigator.attitude, navigator.star_time_offset, navigator.max_rejected)
        self.described = f"{navigator!r} {own!r}"
        self.waiting = Waiting(self.nav, source.names)
        self.push, self.skip = self.waiting.push, self.waiting.skip
        self._sure = source.names is not None
        self._environment = Environment(self.nav.dynamics.force, self.epoch)
        self._state: State | None = None
        self._warned: list[str] = []

    @property
    def reached(self) -> float:
        """Time up to which all is done [s]; -inf before the start."""
        return self.waiting.reached

    @property
    def reading_from(self) -> float:
        """Time tag before which no row of a log is needed any more [s]."""
        return self.waiting.reading_from

    @property
    def late(self) -> dict[str, int]:
        """Rows that came after their time had passed, by table."""
        return self.waiting.late

    def kept(self) -> dict[str, Any] | None:
        """Return what a checkpoint keeps; None before the start."""
        if self._state is None:
            return None
        return {
            **dataclasses.asdict(self._state),
            "reached": self.reached,
            "names": self.waiting.names,
            "gyro": self.waiting.gyro(),
            "max_gap": None if self.nav.gyro is None else self.nav.gyro.max_gap,
        }

    def restore(self, kept: dict[str, Any] | None, late: Mapping[str, int]) -> None:
        """Go on from what a checkpoint kept."""
        self.waiting.late = dict(late)
        if kept is None:
            return
        given = dict(kept)
        self.waiting.reached, self.waiting.names = given.pop("reached"), given.pop("names")
        self.waiting.put_gyro(given.pop("gyro"))
        self._fix_gap(given.pop("max_gap"))
        for name in ("orbit", "attitude"):
            given[name] = None if given[name] is None else Track(**given[name])
        for name in ("arm", "stars"):
            given[name] = tuple(given[name])
        self._state = State(**given)

    def _fix_gap(self, max_gap: float | None) -> None:
        """Take one longest step for the whole log: that of its first piece unless it is given."""
        if self.nav.gyro is not None:
            self.nav.gyro = dataclasses.replace(self.nav.gyro, max_gap=max_gap)

    def finish(self, fixes: int, rejected: int) -> None:
        """Warn of what the whole log has shown, by kinds of measurements."""
        state = self._state
        if state is None:
            raise InputError("is missing: the log has no GNSS fixes", field="gnss")
        _run.warn_if_rejected(state.counts)
        if self.nav.lfe is not None and state.attitude is not None:
            nothing = (np.empty(0), np.empty((0, 4)), np.empty((0, 6)), np.empty(0), np.empty(0))
            run = AttitudeRun(self.nav, AttitudeFixes(*nothing, []), self._period())
            run.warn_of_arc(state.stars[1] - state.stars[0])

    def _period(self) -> float:
        lfe = self.nav.lfe
        return 1.0 if lfe is None or lfe.period is None else float(lfe.period)

    def step(self, *, last: bool) -> Made | None:
        """Go on as far as what is there allows; None if there is not enough for a row."""
        known = self._state
        first = {} if known is None else dict(known.first)
        piece = self._piece(first, last=last)
        if piece is None or not len(piece.stops):
            return None
        origin = float(piece.stops[0]) if known is None else known.origin
        environment = self._environment.over(origin, float(piece.stops[-1]))
        orbits = OrbitOver(self.nav, piece, self.epoch, environment, last=last)
        if known is None:
            begin = orbits.start()
            if begin is None:
                return None
            known = State(origin, first, begin[0], None, {**begin[1]})
        orbit = orbits.over(known.orbit, known.unused, len(piece.stops), self._warned)
        if orbit is None:
            return None
        attitude = None
        oriented = self.waiting.oriented and bool(len(piece.stars.t) or not last)
        if known.attitude is not None or (self._state is None and oriented):
            ended = last and orbit.n == len(piece.stops)
            attitudes = AttitudeOver(self.nav, piece, orbit, self._period())
            done = attitudes.over(known.attitude, known.unused, origin, known.frame, last=ended)
            if done is None:
                return None
            attitude = attitudes, done
            if done.n < orbit.n:
                # the attitude has to wait: so has the orbit
                orbit = orbits.over(known.orbit, known.unused, done.n, self._warned)
                assert orbit is not None
        state = dataclasses.replace(known, first=first)
        return self._made(state, piece, orbit, attitude)

    def _piece(self, first: dict[str, float], *, last: bool) -> GnssPiece | None:
        """Return what can be gone over; None before there is enough to start."""
        end = np.inf if last else self.waiting.complete()
        tables = self.waiting.take(end)
        if self._state is None and not last:
            fixes = tables.get("gnss", ((),))[0]
            if len(fixes) <= FIXES_OF_A_START[-1] or not (self._sure or self.waiting.oriented):
                return None
        if not set(tables) - {"gyro"}:
            return None
        if self._state is None:
            _check_names(self.nav, list(tables))
        _check_slow_error(self.nav, self.waiting.names)
        log = log_of(tables, self.epoch, first=self._state is None)
        if self._state is None and log.gyro is not None and self.nav.gyro is not None:
            self._fix_gap(self._given_gap)
            self._fix_gap(gap_limit(self.nav, log.gyro))
        arm = NO_ARM if self._state is None else self._state.arm
        return piece_of(self.nav, log, arm, first, last=last)

    def _made(
        self,
        state: State,
        piece: GnssPiece,
        orbit: OrbitDone,
        oriented: tuple[AttitudeOver, AttitudeDone] | None,
    ) -> Made:
        """Take over what was done, and return the tables of it."""
        end = float(piece.stops[orbit.n - 1])
        sol = self._solution(piece, orbit, oriented, state.q)
        both = (sol.gnss, sol.attitude)
        counts = counts_of(both)
        tables = tables_of(sol, self._sensors(piece), self.options, (self.reached, state.rows))
        samples = 0
        if piece.gyro is not None:
            t = piece.gyro.t
            samples = int(np.count_nonzero((t > self.reached) & (t <= end)))
        if np.any(self.nav.gnss.lever_arm):
            state.arm = piece.arm(state.arm, end)
        if oriented is not None:
            self._take_attitude(state, piece, oriented[1], end)
            assert sol.q is not None
            state.q = sol.q[-1]
        state.unused = {**orbit.unused, **({} if oriented is None else oriented[1].unused)}
        state.orbit = orbit.track
        state.rows += orbit.n
        state.counts = {
            name: state.counts.get(name, 0) + counts.get(name, 0)
            for name in {**state.counts, **counts}
        }
        self._state = state
        self._warn_of_waiting(state)
        self.waiting.drop(end)
        return Made(
            tables,
            samples=samples,
            fixes=sum(len(m) for m in both),
            rejected=sum(int((~m.accepted).sum()) for m in both),
            log_likelihood=sol.log_likelihood,
            restarts=sorted([*sol.restarts, *sol.attitude_restarts]),
        )

    def _warn_of_waiting(self, state: State) -> None:
        """Say once that what was written may differ from a run over the whole log."""
        tracks = [track for track in (state.orbit, state.attitude) if track is not None]
        waited = self.waiting.waited or any(track.unsure for track in tracks)
        if waited and "waited" not in self._warned:
            self._warned.append("waited")
            warn(
                f"a sensor fell silent for more than {MOST_HELD:.0f} s just when its next fixes "
                f"would have told what the last ones are worth (t = {self.reached:.6g} s): the "
                "replay went on; a run over the whole log may start again there, or turn the lever "
                "arm otherwise"
            )

    def _take_attitude(
        self, state: State, piece: GnssPiece, done: AttitudeDone, end: float
    ) -> None:
        state.attitude = done.track
        if done.frame is not None and len(done.frame):
            state.frame = float(done.frame[-1])
        t = piece.stars.t[piece.stars.t <= end]
        if len(t):
            state.stars = min(state.stars[0], float(t[0])), float(t[-1])

    def _sensors(self, piece: GnssPiece) -> list[str]:
        """Return what fares well or not, whether or not it is in this piece."""
        own = ["position", *(["velocity"] if piece.velocities else [])]
        return own + [n for n in self.waiting.names if table_kind(n) in ("star", "baselines")]

    def _solution(
        self,
        piece: GnssPiece,
        orbit: OrbitDone,
        oriented: tuple[AttitudeOver, AttitudeDone] | None,
        q: FloatArray | None,
    ) -> GnssStarSolution:
        found = orbit.orbit
        kind = np.where(piece.fixes.velocity, "velocity", "position")
        index = found.measured["row"]
        gnss = _run.innovations(found.measured, piece.fixes.t, kind, piece.fixes.row, index)
        seen: Innovations = _run.nothing()
        more: dict[str, Any] = {}
        likelihood, restarts = found.log_likelihood, []
        if oriented is not None:
            attitudes, done = oriented
            out = attitudes.turn(done, orbit, self.epoch)
            fixes = attitudes.fixes
            seen = _run.innovations(out, fixes.t, attitudes.names, fixes.row, out["fix"])
            more = _run.attitude_columns(self.nav, out)
            if q is not None:
                more["q"] = quaternion.continuous(np.vstack([q, out["q"]]))[1:]
            likelihood += out["log_likelihood"]
            restarts = out["restarts"]
        if self.nav.gnss.bias is not None:
            more |= {"gnss_bias": found.state[:, 6:9], "sigma_gnss_bias": found.sigma[:, 6:9]}
        return GnssStarSolution(
            t=found.t,
            r=found.r,
            v=found.v,
            sigma_r=np.ascontiguousarray(found.sigma[:, :3]),
            sigma_v=np.ascontiguousarray(found.sigma[:, 3:6]),
            gnss=gnss,
            attitude=seen,
            counts={},
            epoch=self.epoch,
            filter=self.nav.filter.kind,
            restarts=found.restarts,
            attitude_restarts=restarts,
            log_likelihood=likelihood,
            **more,
        )


def _check(nav: GnssStarNavigator, options: Mapping[str, Any], source: Source) -> None:
    """Refuse what cannot be split to the results of a run over the whole log."""
    if source.epoch is None:
        raise InputError("is needed: the log must say where its times count from", field="epoch")
    if options["smooth"]:
        raise InputError(
            "goes over the log back as well, which a GnssStarNavigator does on whole logs alone: "
            "leave it out, or call nav.smooth(log) on a log in memory",
            field="smooth",
            value=True,
        )
    if options["sigma0"] is not None:
        raise InputError("is of a StarGyroNavigator: leave it out", field="sigma0")
    if options["max_rejected"] != "default":
        raise InputError(
            "is the navigator's own here: leave it out, give GnssStarNavigator(max_rejected=...)",
            field="max_rejected",
            value=options["max_rejected"],
        )
    lfe = nav.lfe
    if lfe is not None and lfe.harmonics and lfe.period is None:
        raise InputError(
            "is by default the mean over the whole log, which is not known in parts: give "
            "LowFrequencyError(period=...), for a log in memory that of its orbit in s",
            field="lfe.period",
        )
    names = source.names
    if names is None:
        return
    _check_names(nav, names)


def _check_names(nav: GnssStarNavigator, names: Sequence[str]) -> None:
    """Refuse tables that a run over the whole log refuses."""
    if "gnss" not in names:
        raise InputError("is missing: the log has no GNSS fixes", field="gnss")
    if nav.gyro is not None and "gyro" not in names:
        raise InputError("is missing: the navigator has a gyro, the log has none", field="gyro")
    stars = [name for name in names if table_kind(name) == "star"]
    _check_slow_error(nav, stars)
    if np.any(nav.gnss.lever_arm) and not stars:
        raise InputError(
            "needs star fixes that tell the attitude, two at least; or give lever_arm=(0, 0, 0)",
            field="gnss.lever_arm",
        )


def _check_slow_error(nav: GnssStarNavigator, names: Sequence[str]) -> None:
    stars = [name for name in names if table_kind(name) == "star"]
    if nav.lfe is not None and len(stars) > 1:
        raise InputError(f"is of one star sensor, but the log has {', '.join(stars)}", field="lfe")
