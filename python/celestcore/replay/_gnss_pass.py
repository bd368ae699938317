"""The orbit filter and the attitude filter over a piece."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from celestcore import quaternion
from celestcore._check import FloatArray
from celestcore.frames import orbital
from celestcore.gnss import GnssStarNavigator, _run
from celestcore.gnss._attitude import AttitudeRun, gyro_inputs
from celestcore.gnss._orbit import OrbitPass, OrbitRun, pass_of
from celestcore.gnss._segments import stacked
from celestcore.replay._gnss_piece import GnssPiece, is_unused, only, unused_of
from celestcore.replay._gnss_track import Advance, Track, advance

Unused = Mapping[str, FloatArray]


@dataclass(frozen=True)
class OrbitDone:
    """What came of the orbit filter."""

    orbit: OrbitPass
    n: int
    """Stops of the piece that are done."""
    track: Track
    begin: Track
    """Where it began: with what was unused then it can be gone over again."""
    unused_before: Unused
    unused: Unused
    core: dict[str, Any]


class OrbitOver:
    """The orbit filter over a piece."""

    def __init__(
        self,
        nav: GnssStarNavigator,
        piece: GnssPiece,
        epoch: str,
        tables: dict[str, Any] | None,
        *,
        last: bool,
    ) -> None:
        self.nav, self.piece, self.last = nav, piece, last
        self.options = {**_run.DEFAULTS, "environment": tables}
        self._made = (nav, piece.fixes, epoch, tables)
        self.names = np.full(len(piece.fixes.t), "gnss")

    def run(self, unused: Unused) -> OrbitRun:
        """Return the runs over the piece, but for the fixes that are not used."""
        run = OrbitRun(*self._made)
        run.used = ~is_unused(self.piece.fixes.t, self.names, unused)
        run.stops, run.options = self.piece.stops, self.options
        return run

    def start(self) -> tuple[Track, Unused] | None:
        """Return a start, and the fixes that it leaves out; None if fixes to come may change it."""
        run = self.run({})
        if not self.last and not run.decided(-np.inf):
            return None
        track = Track(*run.begin(-np.inf, float(self.piece.stops[0])))
        return track, self.unused(run, -np.inf)

    def unused(self, run: OrbitRun, end: float) -> Unused:
        """Return the fixes after a time that are not used."""
        return unused_of(self.piece.fixes.t, run.used, end, self.names)

    def over(self, begin: Track, unused: Unused, n: int, warned: list[str]) -> OrbitDone | None:
        """Go on over the first `n` stops, as far as all is decided."""
        run = self.run(unused)
        run.warned = "orbit" in warned
        stops = begin.stops(self.piece.stops)
        run.stops, run.wanted = stops, stops >= self.piece.stops[0]
        until = n + begin.goes_on
        most = self.nav.max_rejected
        made = advance(run, stops, begin, most, last=self.last, until=until)
        if run.warned and "orbit" not in warned:
            warned.append("orbit")
        done = made.done - begin.goes_on
        if done < 1 or not made.segments:
            return None
        end = float(self.piece.stops[done - 1])
        return OrbitDone(
            pass_of(stacked(made.segments), made.restarts),
            done,
            made.track,
            begin,
            unused,
            self.unused(run, end),
            self.options,
        )


@dataclass(frozen=True)
class AttitudeDone:
    """What came of the attitude filter."""

    out: dict[str, Any]
    n: int
    track: Track
    unused: Unused
    frame: FloatArray | None
    """Variance of the orbital frame at the fixes."""


class AttitudeOver:
    """The attitude filter over the first stops of a piece, those of which the orbit is known."""

    def __init__(
        self, nav: GnssStarNavigator, piece: GnssPiece, orbit: OrbitDone, period: float
    ) -> None:
        self.nav, self.piece, self.orbit = nav, piece, orbit
        self.stops = piece.stops[: orbit.n]
        self.fixes = only(piece.stars, float(self.stops[-1]))
        self.names = np.array([*self.fixes.names, ""])[self.fixes.sensor]
        self.runs = AttitudeRun(nav, self.fixes, period)

    def over(
        self,
        begin: Track | None,
        unused: Unused,
        origin: float,
        frame: float | None,
        *,
        last: bool,
    ) -> AttitudeDone | None:
        """Go on, as far as all is decided; None if that is nowhere."""
        run, known = self.runs, None
        stops = self.stops if begin is None else begin.stops(self.stops)
        q_io = gyro = None
        if self.nav.gyro is None:
            at = np.searchsorted(self.stops, self.fixes.t)
            known = _run.frame_sigma2(self.orbit.orbit, at)
            run.blur(_run.frame_variance(known, None if begin is None else frame))
            q_io = orbital(self.orbit.orbit.r, self.orbit.orbit.v)[at]
        else:
            assert self.piece.gyro is not None
            t = self.piece.gyro.t
            stops = np.union1d(stops, t[(t > stops[0]) & (t < stops[-1])])
            gyro = self._inputs(stops, origin)
        run.over(stops, np.isin(stops, self.stops), q_io, gyro, self.orbit.core)
        run.used &= ~is_unused(self.fixes.t, self.names, unused)
        if begin is None:
            if not last and not run.decided(-np.inf):
                return None
            begin = Track(*run.begin(-np.inf, float(stops[0])))
        most = self.nav.max_rejected
        made = advance(run, stops, begin, most, last=last, until=len(stops))
        return self._done(made, stops, known)

    def _inputs(self, stops: FloatArray, origin: float) -> FloatArray:
        """Return the gyro's rates; how far away its first sample is counts from `origin`."""
        gyro = self.piece.gyro
        assert gyro is not None
        if origin < stops[0] < gyro.t[0]:
            return gyro_inputs(self.nav, gyro, np.append(origin, stops))[1:]
        return gyro_inputs(self.nav, gyro, stops)

    def _done(
        self, made: Advance, stops: FloatArray, known: FloatArray | None
    ) -> AttitudeDone | None:
        n = len(self.stops)
        if made.done < len(stops):
            n = int(np.searchsorted(self.stops, stops[made.done]))
        if n < 1 or not made.segments:
            return None
        out = stacked(made.segments)
        out["restarts"] = made.restarts
        end = float(self.stops[n - 1])
        left = unused_of(self.fixes.t, self.runs.used, end, self.names)
        if known is not None:
            known = known[: np.searchsorted(self.fixes.t, end, "right")]
        return AttitudeDone(out, n, made.track, left, known)

    def turn(self, done: AttitudeDone, orbit: OrbitDone, epoch: str) -> dict[str, Any]:
        """Return the attitude filter's answer with attitudes and rates in inertial space."""
        out, stops = done.out, _run.Stops(self.stops[: done.n], None)
        if self.nav.gyro is None:
            frames = _run.Frames(stops.t, orbit.orbit)
            out["q"] = quaternion.multiply(frames.q_io, out["state"][:, :4])
            turning = _run.frame_rate(self.nav, epoch, frames, stops, out, orbit.core)
            out["rate"] = out["state"][:, 4:7] + turning
            return out
        out["q"] = out["state"][:, :4]
        at = np.searchsorted(self.runs.stops, stops.t)
        assert self.runs.gyro is not None
        out["rate"] = self.runs.gyro[at, :3] - out["state"][:, 4:7]
        return out
