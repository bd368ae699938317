"""A GNSS and star navigator's run over a log: orbit first, then the attitude about it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields
from typing import TYPE_CHECKING, Any, TypeAlias, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from celestcore import _core, quaternion
from celestcore._arguments import checked, positive
from celestcore._check import FloatArray, times, warn
from celestcore.elements import from_state
from celestcore.elements import period as orbit_period
from celestcore.errors import InputError
from celestcore.frames import orbital
from celestcore.gnss._attitude import (
    AttitudeFixes,
    AttitudeRun,
    gap_limit,
    gyro_inputs,
    star_fixes,
    with_antennas,
)
from celestcore.gnss._earth import Earth, GivenEarth, earth_of
from celestcore.gnss._orbit import Fixes, OrbitPass, OrbitRun, fixes_of
from celestcore.gnss.solution import GnssStarSolution, Innovations, LfeReport
from celestcore.log import SensorLog
from celestcore.orbit.propagate import environment_of, position, velocity

if TYPE_CHECKING:
    from celestcore.gnss.navigator import GnssStarNavigator

Sigma0: TypeAlias = "tuple[ArrayLike, ArrayLike]"
START_SIGMA = (1e3, 10.0)
"""1-sigma of a start's position [m] and velocity [m/s] if none is given."""
DEFAULTS: dict[str, Any] = {
    "r0": None,
    "v0": None,
    "sigma0": None,
    "t_output": None,
    "covariance": False,
    "earth_rotation": None,
    "environment": None,
    "portable": False,
    "progress": None,
}
REJECTED = 0.5
X = TypeVar("X")


def replaced(value: X, **changes: Any) -> X:
    """Return a copy of a description with some fields changed."""
    own = {f.name: getattr(value, f.name) for f in fields(value)}  # type: ignore[arg-type]
    return type(value)(**{**own, **changes})


def covariance_of(sigma0: Sigma0 | None) -> FloatArray:
    """Return the covariance of a start's position and velocity (6, 6)."""
    pair = START_SIGMA if sigma0 is None else sigma0
    if not isinstance(pair, Sequence | np.ndarray) or len(pair) != 2:
        raise InputError("needs (position [m], velocity [m/s])", field="sigma0", value=sigma0)
    sigma = np.concatenate([positive(part, "sigma0") for part in pair])
    return np.diag(sigma * sigma)


class Stops:
    """Times at which a run stops: all epochs and all times of the output."""

    def __init__(self, epochs: FloatArray, t_output: ArrayLike | None) -> None:
        grid = epochs if t_output is None else times(t_output, "t_output")
        outside = (grid < epochs[0]) | (grid > epochs[-1])
        if outside.any():
            row = int(np.argmax(outside))
            raise InputError(
                f"lies outside the log's span, {float(epochs[0])!r} to {float(epochs[-1])!r} s",
                field="t_output",
                row=row,
                value=float(grid[row]),
            )
        self.t = np.union1d(epochs, grid)
        self.wanted = np.isin(self.t, grid)


def within(nav: GnssStarNavigator, log: SensorLog, t: FloatArray) -> FloatArray:
    """Return those of some times that lie between a log's first and last fix, offsets taken out."""
    tables: list[tuple[Any, float]] = [(log.gnss, nav.gnss.time_offset)]
    tables += [(star, nav.star_time_offset) for star in log.stars.values()]
    if nav.antennas is not None:
        tables.append((log.baselines, nav.gnss.time_offset))
    ends = [table.t[[0, -1]] - offset for table, offset in tables if table is not None]
    first, last = min(e[0] for e in ends), max(e[1] for e in ends)
    return np.ascontiguousarray(t[(t >= first) & (t <= last)])


def replay(
    nav: GnssStarNavigator, log: SensorLog, o: dict[str, Any], *, back: bool
) -> GnssStarSolution:
    """Estimate orbit and attitude over a log."""
    checked(log, "log", SensorLog)
    if o["progress"] is not None and not callable(o["progress"]):
        raise InputError("must be callable as progress(done, total)", field="progress")
    if log.epoch is None:
        raise InputError("is needed: the log must say where its times count from", field="epoch")
    if log.gnss is None:
        raise InputError("is missing: the log has no GNSS fixes", field="gnss")
    if nav.gyro is not None and log.gyro is None:
        raise InputError("is missing: the navigator has a gyro, the log has none", field="gyro")
    if nav.lfe is not None and len(log.stars) > 1:
        raise InputError(
            f"is of one star sensor, but the log has {', '.join(log.stars)}", field="lfe"
        )
    stars = star_fixes(nav, log)
    earth = earth_of(log.epoch, o["earth_rotation"])
    fixes = fixes_of(nav, log.gnss, stars.stars(), earth)
    if nav.antennas is not None and log.baselines is not None:
        t = log.baselines.t - nav.gnss.time_offset
        if isinstance(earth, GivenEarth) and not callable(earth.given):
            earth = Earth(log.epoch)  # the user's matrices are those of the fixes alone
        r_ie, _ = earth.at(np.ascontiguousarray(t))
        stars = with_antennas(nav, log, stars, r_ie)
    stops = Stops(np.unique(np.concatenate([fixes.epochs, stars.t])), o["t_output"])
    orbit = _orbit(nav, fixes, log.epoch, stops, o, back)
    # the attitude needs the orbital frame at every stop
    whole = Frames(stops.t, orbit)
    attitude = None
    if len(stars.t):
        attitude = _attitude(nav, log, stars, whole, stops, o, back)
    return _solution(nav, log, (fixes, stars), (whole.of(stops.wanted), attitude), back)


class Frames:
    """An orbit at all stops, of which the output takes some."""

    def __init__(self, t: FloatArray, orbit: OrbitPass) -> None:
        self.t, self.orbit = t, orbit
        self.q_io = orbital(orbit.r, orbit.v)

    def of(self, wanted: Any) -> OrbitPass:
        """Return the orbit at some of the stops."""
        o = self.orbit
        o.t, o.state, o.sigma = o.t[wanted], o.state[wanted], o.sigma[wanted]
        if o.covariance is not None:
            o.covariance = o.covariance[wanted]
        return o


def _orbit(
    nav: GnssStarNavigator,
    fixes: Fixes,
    epoch: str,
    stops: Stops,
    o: dict[str, Any],
    back: bool,
) -> OrbitPass:
    span = stops.t[[0, -1]]
    tables = environment_of(nav.dynamics.force, epoch, span, o["environment"])
    run = OrbitRun(nav, fixes, epoch, tables)
    begin = float(stops.t[0])
    if (o["r0"] is None) != (o["v0"] is None):
        raise InputError("goes with v0: give both or neither", field="r0")
    if o["r0"] is None:
        if o["sigma0"] is not None:
            raise InputError("goes with r0 and v0", field="sigma0", value=o["sigma0"])
        start = run.begin(-np.inf, begin)
    else:
        state = np.array([*position(o["r0"]), *velocity(o["v0"])])
        start = run.start(begin, state, covariance_of(o["sigma0"]))
    return run.run(stops.t, np.ones(len(stops.t), bool), start, o, back)


def _attitude(
    nav: GnssStarNavigator,
    log: SensorLog,
    fixes: AttitudeFixes,
    frames: Frames,
    stops: Stops,
    o: dict[str, Any],
    back: bool,
) -> dict[str, Any]:
    lfe = nav.lfe
    period = lfe.period if lfe is not None and lfe.period is not None else None
    if period is None:
        a = from_state(frames.orbit.r, frames.orbit.v).a
        period = float(orbit_period(np.mean(a)))
    run = AttitudeRun(nav, fixes, period)
    run.warn_of_arc(float(fixes.t[-1] - fixes.t[0]))
    if nav.gyro is None:
        q_io = frames.q_io
        at = np.searchsorted(stops.t, fixes.t)
        run.blur(frame_variance(frame_sigma2(frames.orbit, at)))
        out = run.run(stops.t, stops.wanted, (q_io, q_io[at]), None, o, back)
        out["q"] = quaternion.multiply(q_io[stops.wanted], out["state"][:, :4])
        out["rate"] = out["state"][:, 4:7] + frame_rate(nav, log.epoch, frames, stops, out, o)
        return out
    assert log.gyro is not None
    return _driven(run, log.gyro, stops, o, back)


def frame_sigma2(orbit: OrbitPass, at: Any) -> FloatArray:
    """Variance of the orbital frame at some stops (n,) [rad^2]."""
    state, sigma = orbit.state[at], orbit.sigma[at]
    parts = [
        sigma[:, axes].max(axis=1) / np.linalg.norm(state[:, axes], axis=1)
        for axes in (slice(0, 3), slice(3, 6))
    ]
    return np.asarray(parts[0] ** 2 + parts[1] ** 2)


def frame_variance(known: FloatArray, before: float | None = None) -> FloatArray:
    """Variance of the orbital frame's corrections from each of some fixes to the next (n,) [rad^2].

    While the orbit is still being found its frame turns to and fro, which is no motion of the body.
    An error of the orbit that stays does not matter: it goes out of the attitude as it came in.
    `before` is the variance at the fix before the first.
    """
    earlier = np.append(np.inf if before is None else before, known)[:-1]
    variance: FloatArray = np.maximum(earlier - known, 0.0)
    if before is None:
        variance[:1] = 0.0
    return variance


def _driven(
    run: AttitudeRun, gyro: Any, stops: Stops, o: dict[str, Any], back: bool
) -> dict[str, Any]:
    """Run with a gyro: it must span the stops."""
    begin, end = float(gyro.t[0]), float(gyro.t[-1])
    slack = gap_limit(run.nav, gyro)
    if stops.t[0] < begin - slack or stops.t[-1] > end + slack:
        warn(
            f"the gyro spans {begin:.6g} to {end:.6g} s, the other sensors {stops.t[0]:.6g} to "
            f"{stops.t[-1]:.6g} s: beyond the gyro its nearest rate is held, with the uncertainty "
            "gyro.gap_rate_sigma"
        )
    inside = gyro.t[(gyro.t > stops.t[0]) & (gyro.t < stops.t[-1])]
    t = np.union1d(stops.t, inside)
    wanted = np.isin(t, stops.t[stops.wanted])
    inputs = gyro_inputs(run.nav, gyro, t)
    out = run.run(t, wanted, None, inputs, o, back)
    out["q"] = out["state"][:, :4]
    out["rate"] = inputs[wanted, :3] - out["state"][:, 4:7]
    return out


def frame_rate(
    nav: GnssStarNavigator,
    epoch: str | None,
    frames: Frames,
    stops: Stops,
    out: dict[str, Any],
    o: dict[str, Any],
) -> FloatArray:
    """Rate of the orbital frame in inertial space, in body axes.

    About -y by the motion along the orbit, ``h / r^2``, and about -z by what turns the orbit's
    plane, ``r a_h / h`` with the acceleration along the normal.
    """
    r, v = frames.orbit.r[stops.wanted], frames.orbit.v[stops.wanted]
    t = frames.orbit.t[stops.wanted]
    force = nav.dynamics.force
    tables = environment_of(force, epoch, stops.t[[0, -1]], o["environment"])
    state = np.ascontiguousarray(np.hstack([r, v]))
    a, _, _ = _core.orbit_acceleration(force._described(), tables, np.ascontiguousarray(t), state)
    h = np.cross(r, v)
    size, distance = np.linalg.norm(h, axis=1), np.linalg.norm(r, axis=1)
    across = np.einsum("ij,ij->i", a, h) / size
    rate_o = np.zeros_like(r)
    rate_o[:, 1] = -size / distance**2
    rate_o[:, 2] = -distance * across / size
    return quaternion.rotate(quaternion.conjugate(out["state"][:, :4]), rate_o)


def _solution(
    nav: GnssStarNavigator,
    log: SensorLog,
    given: tuple[Fixes, AttitudeFixes],
    found: tuple[OrbitPass, dict[str, Any] | None],
    back: bool,
) -> GnssStarSolution:
    fixes, stars = given
    orbit, attitude = found
    gnss = innovations(
        orbit.measured,
        fixes.t,
        np.where(fixes.velocity, "velocity", "position"),
        fixes.row,
        orbit.measured["row"],
    )
    more: dict[str, Any] = {}
    seen = nothing()
    if attitude is not None:
        names = np.array(stars.names)[stars.sensor]
        seen = innovations(attitude, stars.t, names, stars.row, attitude["fix"])
        more = attitude_columns(nav, attitude)
    if nav.gnss.bias is not None:
        more |= {"gnss_bias": orbit.state[:, 6:9], "sigma_gnss_bias": orbit.sigma[:, 6:9]}
    counts = _counts(log, gnss, seen, stars)
    warn_if_rejected(counts)
    return GnssStarSolution(
        t=orbit.t,
        r=orbit.r,
        v=orbit.v,
        sigma_r=np.ascontiguousarray(orbit.sigma[:, :3]),
        sigma_v=np.ascontiguousarray(orbit.sigma[:, 3:6]),
        gnss=gnss,
        attitude=seen,
        counts=counts,
        epoch=str(log.epoch),
        filter=nav.filter.kind,
        orbit_covariance=orbit.covariance,
        restarts=orbit.restarts,
        attitude_restarts=[] if attitude is None else attitude["restarts"],
        smoothed=back,
        elapsed_s=orbit.elapsed_s + (0.0 if attitude is None else attitude["elapsed_s"]),
        log_likelihood=orbit.log_likelihood
        + (0.0 if attitude is None else attitude["log_likelihood"]),
        **more,
    )


def attitude_columns(nav: GnssStarNavigator, out: dict[str, Any]) -> dict[str, Any]:
    """Return what the attitude filter says as columns of the solution."""
    n = int(np.sqrt(len(out["final_covariance"])))
    more: dict[str, Any] = {
        "q": quaternion.continuous(out["q"]),
        "sigma_q": np.ascontiguousarray(out["sigma"][:, :3]),
        "rate": np.ascontiguousarray(out["rate"]),
    }
    if nav.gyro is not None:
        more["bias"] = np.ascontiguousarray(out["state"][:, 4:7])
        more["sigma_bias"] = np.ascontiguousarray(out["sigma"][:, 3:6])
    if "covariance" in out:
        more["attitude_covariance"] = out["covariance"].reshape(-1, n, n)
    if nav.lfe is not None:
        size = 3 * nav.lfe.vectors
        p = out["final_covariance"].reshape(n, n)[n - size :, n - size :]
        more["lfe"] = LfeReport.of(nav.lfe.names, out["final_state"][-size:], p, nav.lfe.prior)
    return more


def innovations(
    measured: Mapping[str, Any], t: FloatArray, kind: Any, row: Any, index: Any
) -> Innovations:
    return Innovations(
        t[index],
        kind[index],
        row[index],
        measured["nis"],
        measured["accepted"],
        measured["innovation"],
        measured["innovation_sigma"],
    )


def nothing() -> Innovations:
    empty = np.empty(0)
    return Innovations(
        empty,
        empty.astype(str),
        empty.astype(int),
        empty,
        empty.astype(bool),
        *[np.empty((0, 3))] * 2,
    )


def _counts(
    log: SensorLog, gnss: Innovations, seen: Innovations, stars: AttitudeFixes
) -> dict[str, int]:
    """Return how many measurements there were of each kind, and how many were refused."""
    out: dict[str, int] = {}
    given = (gnss.kind, gnss.accepted), (seen.kind, seen.accepted)
    kinds = [*(["position", "velocity"] if len(gnss) else []), *stars.names]
    for name in kinds:
        kind, accepted = given[0] if name in ("position", "velocity") else given[1]
        own = kind == name
        if own.any():
            out[name] = int(own.sum())
            out[f"{name}_rejected"] = int((own & ~accepted).sum())
    assert log.gnss is not None
    out["unused_at_start"] = len(log.gnss) - out.get("position", 0)
    out["missing"] = log.missing
    return out


def warn_if_rejected(counts: Mapping[str, int]) -> None:
    for name, seen in counts.items():
        refused = counts.get(f"{name}_rejected", 0)
        if refused > max(20, REJECTED * seen):
            warn(
                f"{refused} of {seen} {name} measurements were outside the gate: their noise, the "
                "dynamics, a time offset or the frame is probably wrong"
            )
