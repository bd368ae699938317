"""What the navigator is held against: raw sensors, kinematic filters, the paper's scheme."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

import celestcore as cc
from celestcore import gnss, quaternion
from celestcore.gnss._scores import attitude_error
from celestcore.reproduce import _gnss_model as model
from celestcore.reproduce import _gnss_paper as paper
from celestcore.reproduce._gnss_series import Array, Series, of_errors

POSITION_JERK = 10.0 ** np.arange(-5.5, -1.0, 0.25)
"""Process noises that are tried in the kinematic filters of position [m^2/s^5]."""
ANGLE_JERK = 10.0 ** np.arange(-26.0, -9.0)
"""The same in the paper's filters of angle differences [rad^2/s^5]."""


class Best(NamedTuple):
    """A filter with the process noise that served it best."""

    series: Series
    psd: float


class Reference(NamedTuple):
    """Errors of one level of GPS noise, run by run."""

    gps: Series
    gps_velocity: Series
    star: dict[str, Series]
    star_lfe: dict[str, Series]
    kinematic: Best
    kinematic_smoothed: Best
    gps_pitch: Series
    literal: Best


class Slew(NamedTuple):
    """Attitude errors of the paper's Euler filters on star fixes, and of those fixes [rad]."""

    nominal: Series
    slew: Series
    star: Series


def star_error(made: Any) -> Array:
    """Return the errors of the star fixes about the body's axes (n, 3) [rad]."""
    return attitude_error(made.log.stars["star"].q, made.q_ib)


def axes_of(errors: list[Array]) -> dict[str, Series]:
    """Return the series of each axis of attitude errors."""
    return {
        name: of_errors([e[:, k] for e in errors])
        for k, name in enumerate(("roll", "pitch", "yaw"))
    }


def reference(gps: float, runs: int, seed: int, told: Any) -> Reference:
    """Return what the runs of one level come to without the navigator."""
    clean, slow = (model.scenario(model.Cell(name, gps)) for name in ("clean", "lfe"))
    made: list[Any] = []
    for k in range(runs):
        made.append(clean.trial(seed, k))
        told(1)
    tables = [m.log.gnss for m in made]
    return Reference(
        gps=of_errors([t.r - m.r_e for t, m in zip(tables, made, strict=True)]),
        gps_velocity=of_errors([t.v - m.v_e for t, m in zip(tables, made, strict=True)]),
        star=axes_of([star_error(m) for m in made]),
        star_lfe=axes_of([star_error(slow.trial(seed, k)) for k in range(runs)]),
        kinematic=_kinematic(made, gps, smooth=False),
        kinematic_smoothed=_kinematic(made, gps, smooth=True),
        **_literal(made),
    )


def _kinematic(made: list[Any], gps: float, *, smooth: bool) -> Best:
    """Return the best filter of each coordinate: position and velocity, white jerk."""

    def error(m: Any, psd: float) -> Array:
        table = m.log.gnss
        axes = [
            gnss.axis_filter(
                table.t,
                np.ascontiguousarray(table.r[:, k]),
                gps,
                psd,
                rate=np.ascontiguousarray(table.v[:, k]),
                sigma_rate=0.01 * gps,
                smooth=smooth,
            ).value
            for k in range(3)
        ]
        # the first two epochs are the parabola's of the start, which no smoother improves
        late = table.t > (paper.STEP if smooth else model.SKIP)
        found: Array = (np.stack(axes, axis=1) - m.r_e)[late]
        return found

    # most of the tries are far off, which a few runs show
    first = {psd: of_errors([error(m, psd) for m in made[:10]]).value for psd in POSITION_JERK}
    near = sorted(first, key=lambda psd: first[psd])[:3]
    found = [Best(of_errors([error(m, psd) for m in made]), float(psd)) for psd in near]
    return min(found, key=lambda best: best.series.value)


def _literal(made: list[Any]) -> dict[str, Any]:
    """Return the paper's scheme with baselines of 5 mm: GPS angles alone, and filtered.

    GPS angles by the direct method, less the star sensor's, through one filter for each angle; the
    star sensor's angles, corrected by what comes out, are the estimate.
    """
    pairs = [_angles(m) for m in made]
    truth = [_euler(cc.frames.orbital(m.r_i, m.v_i), m.q_ib) for m in made]

    def error(k: int, psd: float) -> Array:
        by_gps, by_star = pairs[k]
        t = made[k].t
        found = gnss.euler_filter(t, by_gps - by_star, model.BASELINE / 2.0, psd)
        return np.asarray((by_star + found.value - truth[k])[t > model.SKIP, 1])

    every = range(len(made))
    few = {psd: of_errors([error(k, psd) for k in every[:10]]).value for psd in ANGLE_JERK}
    psd = float(min(few, key=lambda p: few[p]))
    return {
        "gps_pitch": of_errors([p[0][:, 1] - e[:, 1] for p, e in zip(pairs, truth, strict=True)]),
        "literal": Best(of_errors([error(k, psd) for k in every]), psd),
    }


def _angles(made: Any) -> tuple[Array, Array]:
    """Return yaw, pitch, roll about the orbital frame by GPS and by the star sensor (n, 3)."""
    log = made.log
    q_io = cc.frames.orbital(made.r_i, made.v_i)
    to_orbit = np.swapaxes(quaternion.to_matrix(q_io), 1, 2) @ cc.frames.itrs_to_gcrs(
        log.epoch, made.t
    )
    measured = np.einsum("nij,nkj->nki", to_orbit, log.baselines.b)
    found = gnss.direct_attitude(measured, model.ANTENNAS[1])
    by_gps = np.stack([found.yaw, found.pitch, found.roll], axis=1)
    return by_gps, _euler(q_io, log.stars["star"].q)


def _euler(q_io: Array, q_ib: Array) -> Array:
    found = cc.frames.euler_321(quaternion.multiply(quaternion.conjugate(q_io), q_ib))
    return np.stack([found.yaw, found.pitch, found.roll], axis=1)


def euler_error(made: Any) -> Array:
    """Return the attitude errors of three filters on star fixes' Euler angles (n, 3) [rad]."""
    q_io = cc.frames.orbital(made.r_i, made.v_i)
    found = gnss.euler_filter(
        made.t, _euler(q_io, made.log.stars["star"].q), paper.STAR, model.JERK
    ).value
    q_ob = cc.frames.from_euler_321(*np.ascontiguousarray(found.T))
    return attitude_error(quaternion.multiply(q_io, q_ob), made.q_ib)


def slew(runs: int, seed: int) -> Slew:
    """Return what the Euler filters make of nominal flight and of a slew through 90 degrees."""
    both = {}
    for name in ("clean", "slew"):
        scenario = model.scenario(model.Cell(name))
        made = [scenario.trial(seed, k) for k in range(runs)]
        both[name] = [euler_error(m)[m.t > model.SKIP] for m in made]
        star = [star_error(m) for m in made]
    return Slew(of_errors(both["clean"]), of_errors(both["slew"]), of_errors(star))


def gyro_star(runs: int, seed: int) -> dict[str, Series]:
    """Return the raw star fixes of the runs with a gyro, which is left out here to save time."""
    scenario = model.without_gyro()
    return axes_of([star_error(scenario.trial(seed, k)) for k in range(runs)])


class AntennaAngles(NamedTuple):
    """Rms errors of the direct method on antenna positions of some noise [m]: angles [rad]."""

    gps: float
    yaw: float
    pitch: float
    roll: float


DRAWS = 20_000


def antenna_angles(seed: int, draws: int = DRAWS) -> list[AntennaAngles]:
    """Return what positions of single antennas say of the attitude."""
    rng = np.random.default_rng([seed, 1])
    body, out = model.ANTENNAS, []
    for gps in paper.GPS:
        noise = gps * rng.standard_normal((draws, len(body) + 1, 3))
        found = gnss.direct_attitude(body + noise[:, 1:] - noise[:, :1], body[1])
        rms = [float(np.sqrt(np.mean(a**2))) for a in (found.yaw, found.pitch, found.roll)]
        out.append(AntennaAngles(gps, *rms))
    return out


class Covariance(NamedTuple):
    """How far the covariance of least-squares attitudes is from the analytic one."""

    baselines: int
    draws: int
    difference: float
    """Norm of the difference of the covariances over that of the analytic one."""
    sigma: tuple[float, float, float]
    """1-sigma found over the analytic one, by axis."""


LAYOUT: Array = np.vstack([model.ANTENNAS, [[-1.0, -1.0, 0.5], [0.5, -1.2, -0.8]]])


def least_squares(seed: int, draws: int = DRAWS) -> list[Covariance]:
    """Return the covariances of attitudes from two, three and four baselines."""
    out = []
    for n in (2, 3, 4):
        rng = np.random.default_rng([seed, n])
        antennas = gnss.Antennas(LAYOUT[:n], model.BASELINE)
        q = rng.standard_normal((draws, 4))
        q /= np.linalg.norm(q, axis=1, keepdims=True)
        true = np.einsum("nij,kj->nki", quaternion.to_matrix(q), LAYOUT[:n])
        each = model.BASELINE / np.sqrt(2.0) * rng.standard_normal((draws, n + 1, 3))
        found = gnss.gps_attitude(antennas, true + each[:, 1:] - each[:, :1], gate=None)
        error = attitude_error(found.q, q)
        told, seen = found.covariance.mean(axis=0), error.T @ error / draws
        ratio = np.sqrt(np.diag(seen) / np.diag(told))
        difference = float(np.linalg.norm(seen - told) / np.linalg.norm(told))
        out.append(Covariance(n, draws, difference, tuple(ratio.tolist())))
    return out
