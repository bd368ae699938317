"""The orbit of a GNSS and star navigator: fixes for the core, a start, restarts, the answer."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from celestcore import quaternion
from celestcore._check import FloatArray, warn
from celestcore.errors import InputError
from celestcore.gnss._earth import Earth, GivenEarth
from celestcore.gnss._segments import FEWEST_LEFT, Begin, in_segments, listed, many_refused, stacked
from celestcore.gnss.start import orbit_start
from celestcore.orbit.propagate import propagate

if TYPE_CHECKING:
    from celestcore.gnss.navigator import GnssStarNavigator
    from celestcore.log import GnssTable

FIXES_OF_A_START = (8, 16, 32)
"""How many fixes a start looks at, and again if they do not agree."""
WIDE = (1e3, 10.0)
"""1-sigma of position [m] and velocity [m/s] about a start that was found in the fixes themselves:
so wide that they do not count twice."""
ROWS, COLUMNS = (0, 0, 0, 1, 1, 2), (0, 1, 2, 1, 2, 2)


@dataclass
class Fixes:
    """Positions and velocities in the GCRS, one row each, in order of time."""

    t: FloatArray
    velocity: Any
    value: FloatArray
    noise: FloatArray
    row: Any
    """Rows of the log's table."""
    r: FloatArray
    """Positions alone, as the start takes them, and their times."""
    v: FloatArray | None
    epochs: FloatArray

    def columns(self, used: Any) -> tuple[Any, ...]:
        """Return what the core takes of some rows."""
        parts = (self.t, self.velocity, self.value, self.noise)
        return tuple(np.ascontiguousarray(part[used]) for part in parts)


@dataclass
class OrbitPass:
    """An orbit at the stops of a run."""

    t: FloatArray
    state: FloatArray
    sigma: FloatArray
    covariance: FloatArray | None
    measured: dict[str, Any]
    final: dict[str, Any]
    restarts: list[float] = field(default_factory=list)
    outside: int = 0
    log_likelihood: float = 0.0
    elapsed_s: float = 0.0

    @property
    def r(self) -> FloatArray:
        return np.ascontiguousarray(self.state[:, :3])

    @property
    def v(self) -> FloatArray:
        return np.ascontiguousarray(self.state[:, 3:6])


def turned(noise: FloatArray, matrix: FloatArray) -> FloatArray:
    """Variances along the axes of one frame as packed covariances in another, (n, 6)."""
    full = np.einsum("nij,j,nkj->nik", matrix, noise, matrix)
    return np.ascontiguousarray(full[:, ROWS, COLUMNS])


def attitude_at(
    t: FloatArray, star: tuple[FloatArray, FloatArray]
) -> tuple[FloatArray, FloatArray]:
    """Attitude and rate of the body at some times, straight between star fixes."""
    at, first = np.unique(star[0], return_index=True)  # several star sensors may share epochs
    q = star[1][first]
    if len(at) < 2:
        raise InputError(
            "needs star fixes that tell the attitude, two at least; or give lever_arm=(0, 0, 0)",
            field="gnss.lever_arm",
        )
    k = np.clip(np.searchsorted(at, t) - 1, 0, len(at) - 2)
    turn = quaternion.log(quaternion.multiply(quaternion.conjugate(q[k]), q[k + 1]))
    dt = at[k + 1] - at[k]
    rate = turn / dt[:, None]
    # beyond the fixes the body is taken to turn on as between the nearest two
    return quaternion.multiply(q[k], quaternion.exp(rate * (t - at[k])[:, None])), rate


def fixes_of(
    nav: GnssStarNavigator, table: GnssTable, star: Any, earth: Earth | GivenEarth
) -> Fixes:
    """Return the log's GNSS table in the GCRS, of the centre of mass."""
    receiver = nav.gnss
    t = table.t - receiver.time_offset
    r_ie, turn = earth.at(t)
    r = (r_ie @ table.r[:, :, None])[:, :, 0]
    v = None
    if table.v is not None and receiver.sigma_velocity is not None:
        absolute = table.v + np.cross(turn, table.r)
        v = (r_ie @ absolute[:, :, None])[:, :, 0]
    arm = np.asarray(receiver.lever_arm, dtype=np.float64)
    if arm.any():
        q, rate = attitude_at(t, star)
        r = r - quaternion.rotate(q, np.broadcast_to(arm, r.shape))
        if v is not None:
            v = v - quaternion.rotate(q, np.cross(rate, arm))
    return merged(nav, t, r, v, r_ie)


def merged(
    nav: GnssStarNavigator, t: FloatArray, r: FloatArray, v: FloatArray | None, r_ie: FloatArray
) -> Fixes:
    """Positions and velocities as rows in order of time."""
    receiver, n = nav.gnss, len(t)
    variance = np.square(np.asarray(receiver.sigma, dtype=np.float64))
    parts = [(t, np.zeros(n, bool), r, turned(variance, r_ie), np.arange(n))]
    if v is not None:
        known = np.flatnonzero(np.isfinite(v).all(axis=1))
        variance = np.square(np.asarray(receiver.sigma_velocity, dtype=np.float64))
        noise = turned(variance, r_ie[known])
        parts.append((t[known], np.ones(len(known), bool), v[known], noise, known))
    columns = [np.concatenate(column) for column in zip(*parts, strict=True)]
    order = np.lexsort((columns[1], columns[0]))
    at, velocity, value, noise, row = (np.ascontiguousarray(c[order]) for c in columns)
    return Fixes(at, velocity, value, noise, row, r, v, t)


class OrbitRun:
    """Runs of the orbit filter over one log."""

    def __init__(
        self, nav: GnssStarNavigator, fixes: Fixes, epoch: str, tables: dict[str, Any] | None
    ) -> None:
        self.nav, self.fixes, self.epoch, self.tables = nav, fixes, epoch, tables
        self.core = nav._orbit_core(tables)
        self.used = np.ones(len(fixes.t), bool)
        self.warned = False

    def begin(self, after: float, t: float) -> tuple[float, FloatArray, FloatArray]:
        """Find a start in the fixes from `after` on, and carry it to time `t`."""
        first = int(np.searchsorted(self.fixes.epochs, after))
        for looked_at in FIXES_OF_A_START:
            try:
                return self._begin(slice(first, first + looked_at), t)
            except InputError:
                # where the first few do not agree, more of them may
                if looked_at == FIXES_OF_A_START[-1] or first + looked_at >= len(self.fixes.epochs):
                    raise
        raise AssertionError  # the loop returns or raises

    def _begin(self, some: slice, t: float) -> tuple[float, FloatArray, FloatArray]:
        receiver, v = self.nav.gnss, self.fixes.v
        velocity_sigma = receiver.sigma_velocity
        try:
            found = orbit_start(
                self.fixes.epochs[some],
                self.fixes.r[some],
                None if v is None else v[some],
                sigma=float(np.max(np.asarray(receiver.sigma))),
                sigma_velocity=None if velocity_sigma is None else float(np.max(velocity_sigma)),
                fixes=some.stop - some.start,
            )
        except InputError as error:
            raise InputError(error.message, field="gnss", value=error.value) from None
        bad = np.flatnonzero(~found.good) + some.start
        if len(bad):
            self.used &= ~np.isin(self.fixes.row, bad)
        state = np.concatenate([found.r, found.v])
        if t != found.t:
            moved = propagate(
                self.nav.dynamics.force,
                self.epoch,
                found.r,
                found.v,
                [found.t, t],
                method="rk4",
                environment=self.tables,
            )
            state = np.concatenate([moved.r[-1], moved.v[-1]])
        return self.start(t, state, np.repeat(np.square(WIDE), 3) * np.eye(6))

    def start(
        self, t: float, state: FloatArray, covariance: FloatArray
    ) -> tuple[float, FloatArray, FloatArray]:
        """Return a start as the core takes it: with the receiver's bias, if it is estimated."""
        bias = self.nav.gnss.bias
        if bias is None:
            return t, np.ascontiguousarray(state), np.ascontiguousarray(covariance)
        full = np.zeros((9, 9))
        full[:6, :6] = covariance
        full[6:, 6:] = bias.sigma**2 * np.eye(3)
        return t, np.append(state, np.zeros(3)), full

    def run(
        self, stops: FloatArray, wanted: Any, start: Begin, o: dict[str, Any], back: bool
    ) -> OrbitPass:
        """Run over the stops; where every fix is refused many times running, start again."""
        self.stops, self.wanted, self.options = stops, wanted, o
        given = o["r0"] is not None
        segments, restarts = in_segments(self, stops, start, back=back, given=given)
        if restarts:
            warn(
                f"the orbit filter refused {self.nav.max_rejected} fixes running and started again "
                f"at t = {listed(restarts)} s: a manoeuvre, a jump of the receiver, a wrong r0 "
                "or v0, or dynamics that are too confident"
            )
        return pass_of(stacked(segments), restarts)

    def rows(self, t: float) -> Any:
        """Return the fixes that are used from time t on."""
        return np.flatnonzero(self.used & (self.fixes.t >= t))

    def times(self, rows: Any) -> FloatArray:
        """Return times of fixes."""
        return np.asarray(self.fixes.t[rows])

    def again(self, lost: float, t: float) -> Begin | None:
        """Find a start in the fixes from time `lost` on; None if no orbit fits them."""
        try:
            return self.begin(lost, t)
        except InputError as error:
            if not self.warned:
                warn(
                    f"the orbit filter refuses fixes from t = {lost:.6g} s on, and no orbit fits "
                    f"them to start again from ({error}); until one does it is mostly predicted"
                )
            self.warned = True
            return None

    def go(self, stops: slice, start: Begin, rows: Any, *, back: bool) -> dict[str, Any]:
        """Run the core over some of the stops."""
        o = self.options
        out: dict[str, Any] = self.core.run(
            (
                np.ascontiguousarray(self.stops[stops]),
                np.ascontiguousarray(self.wanted[stops]),
                None,
            ),
            self.fixes.columns(rows),
            start,
            self.nav.gate,
            back,
            o["covariance"],
            o["portable"],
            o["progress"],
        )
        return out

    def refused(self, out: dict[str, Any], rows: Any) -> tuple[Any, FloatArray]:
        """Return which positions were refused, and the times of all."""
        index = rows[out["row"]]
        positions = ~self.fixes.velocity[index]
        return ~out["accepted"][positions], np.asarray(self.fixes.t[index][positions])

    def left(self, t: Any) -> Any:
        """Return how many fixes there are from some times on."""
        return len(self.fixes.epochs) - np.searchsorted(self.fixes.epochs, t)

    def decided(self, t: float) -> bool:
        """Tell whether a start in the fixes from time t on rests on none that is to come."""
        return bool(self.left(t) > FIXES_OF_A_START[-1])

    def lost(self, out: dict[str, Any], rows: Any) -> FloatArray:
        """Return the times at which too many positions were refused running."""
        t = many_refused(*self.refused(out, rows), self.nav.max_rejected)
        # where fewer fixes than a start takes are left there is nothing to start again from
        return np.asarray(t[self.left(t) >= FEWEST_LEFT])


def pass_of(out: dict[str, Any], restarts: list[float]) -> OrbitPass:
    measured = {
        "row": out["fix"],
        **{name: out[name] for name in ("nis", "accepted", "innovation", "innovation_sigma")},
    }
    size = int(np.sqrt(len(out["final_covariance"])))
    covariance = out.get("covariance")
    return OrbitPass(
        t=out["t"],
        state=out["state"],
        sigma=out["sigma"],
        covariance=None if covariance is None else covariance.reshape(-1, size, size),
        measured=measured,
        final={
            "t": out["final_t"],
            "state": out["final_state"],
            "covariance": out["final_covariance"].reshape(size, size),
        },
        restarts=restarts,
        outside=out["outside"],
        log_likelihood=out["log_likelihood"],
        elapsed_s=out["elapsed_s"],
    )
