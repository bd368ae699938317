"""Block N: where a sigma-point or an iterated filter does win, and where none does."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

import celestcore as cc
from celestcore import quaternion as qt
from celestcore.errors import NumericalError
from celestcore.reproduce import _textbook
from celestcore.units import ARCSEC, DEG, DEG_PER_HOUR

Array = NDArray[np.float64]
Progress = Callable[[int, int], object]

ORBIT_RATE = 1.11e-3
ANGLES = (90, 150)
"""Initial errors of N1 [deg]."""
INTERVALS = (30, 60, 120)
"""Between the fixes of N2 [s]."""
FIXES = (1, 3, 10)
"""After these fixes N2 looks at the bias."""
SETTLED_1 = 0.2 * DEG
SETTLED_3 = 0.1 * DEG
NOT_OFTEN = 0.05


def filters() -> dict[str, Any]:
    """Return the library's filters by the names of the report.

    `USQUE` is the library's unscented filter with the spread and the weights of Crassidis and
    Markley (2003).
    """
    return {
        "MEKF": cc.EKF(),
        "MEKF without reset": cc.EKF(reset=False),
        "USQUE": cc.UKF(kappa=1.0, beta=0.0),
        "UKF": cc.UKF(),
        "invariant EKF": cc.InvariantEKF(),
        "iterated MEKF": cc.IteratedEKF(),
    }


TEXTBOOK: Mapping[str, Callable[[_textbook.TwoVectors], Array]] = {
    "MEKF": lambda data: _textbook.mekf(data, reset=False),
    "MEKF with reset": lambda data: _textbook.mekf(data, reset=True),
    "invariant EKF": _textbook.invariant,
    "USQUE": _textbook.usque,
}


def run(runs: int, seed: int, progress: Progress | None = None) -> list[dict[str, Any]]:
    """Run block N.

    Parameters
    ----------
    runs : int
        Seeded runs of each case.
    seed : int
    progress : callable, optional
        ``progress(done, total)`` after each case.

    Returns
    -------
    list of dict
        One row a case and filter: ``block``, ``case``, ``form`` ("library" or "textbook"),
        ``filter``, ``runs``; N1 and N3 ``not_settled_percent``, N2 ``median_bias_deg_per_s`` (by
        fix) and ``median_nees_6`` (NEES over 6 after the third fix).
    """
    cases: list[Callable[[], list[dict[str, Any]]]] = [
        *(lambda angle=angle: _two_vectors(angle, runs, seed) for angle in ANGLES),
        *(lambda gap=gap: _slow_fixes(gap, runs, seed) for gap in INTERVALS),
        lambda: _magnetometer(runs, seed),
    ]
    out: list[dict[str, Any]] = []
    for k, case in enumerate(cases):
        out += case()
        if progress is not None:
            progress(k + 1, len(cases))
    return out


def simulate_two_vectors(angle: float, runs: int, seed: int) -> _textbook.TwoVectors:
    """Simulate N1: two random inertial directions 20 to 160 deg apart, at 1 Hz for 600 s.

    Parameters
    ----------
    angle : float
        Error of the start about a random axis [deg], exactly.
    runs, seed : int
    """
    rng = np.random.default_rng([seed, 1, round(angle)])
    steps, dt, sigma = 600, 1.0, 0.1 * DEG
    rate = np.array([ORBIT_RATE, 0.0, 0.0])
    arw, rrw = 5.0 * DEG_PER_HOUR * np.sqrt(dt), 1e-3 * ARCSEC
    known = np.stack([_apart(rng) for _ in range(runs)])
    turn = qt.exp(rate * dt * np.arange(steps + 1)[:, None])
    q = np.asarray(qt.multiply(_unit(rng.standard_normal((runs, 4))), turn[:, None]))
    seen = np.asarray(qt.rotate(qt.conjugate(q)[:, :, None], known))
    noise = sigma * rng.standard_normal(seen.shape)
    seen = _unit(seen + noise - np.sum(noise * seen, axis=-1, keepdims=True) * seen)
    error = angle * DEG * _unit(rng.standard_normal((runs, 3)))
    bias = 20.0 * DEG_PER_HOUR * _unit(rng.standard_normal((runs, 3)))
    return _textbook.TwoVectors(
        dt=dt,
        rate=rate,
        q=q,
        gyro=rate + _readings(rng, bias, steps + 1, arw, rrw, dt),
        seen=seen,
        known=known,
        start=np.asarray(qt.multiply(q[0], qt.exp(-error))),
        sigma0=(angle * DEG, 20.0 * DEG_PER_HOUR),
        arw=arw,
        rrw=rrw,
        sigma=sigma,
    )


def two_vectors_log(data: _textbook.TwoVectors, run: int) -> cc.SensorLog:
    """Return one run of N1 as a log with two direction sensors, ``a`` and ``b``."""
    t = data.dt * np.arange(len(data.q))
    tables: dict[str, Any] = {
        f"vector_{name}": (t, data.seen[:, run, k], np.tile(data.known[run, k], (len(t), 1)))
        for k, name in enumerate("ab")
    }
    return cc.SensorLog(gyro=(t, data.gyro[:, run]), **tables)


def _two_vectors(angle: int, runs: int, seed: int) -> list[dict[str, Any]]:
    data = simulate_two_vectors(angle, runs, seed)
    late = slice(len(data.q) - 120, None)
    found: dict[tuple[str, str], list[bool]] = {}
    for name, form in TEXTBOOK.items():
        error = form(data)
        lost = np.mean(~(error[late] < SETTLED_1), axis=0) > NOT_OFTEN
        found["textbook", name] = lost.tolist()
    logs = [two_vectors_log(data, k) for k in range(runs)]
    for name, kind in filters().items():
        nav = cc.StarGyroNavigator(
            kind, cc.Gyro(data.arw, data.rrw), vector=cc.VectorSensor(data.sigma)
        )
        errors = (
            _error(nav, log, data.start[k], data.sigma0, data.q[:, k]) for k, log in enumerate(logs)
        )
        found["library", name] = [
            bool(np.mean(~(error[late] < SETTLED_1)) > NOT_OFTEN) for error in errors
        ]
    return [_share("N1", f"{angle}°", key, lost) for key, lost in found.items()]


def _slow_fixes(gap: int, runs: int, seed: int) -> list[dict[str, Any]]:
    """N2: a bias of 1 deg/s, known to 1 deg/s, and 30 good fixes far apart."""
    rng = np.random.default_rng([seed, 2, gap])
    dt, sigma = 0.5, (10.0 * ARCSEC, DEG / np.sqrt(3.0))
    arw, rrw = 0.01 * DEG * np.sqrt(dt), 1.7e-6 * DEG
    every = round(gap / dt)
    t = dt * np.arange(30 * every + 1)
    swing = np.sin(2.0 * np.pi * (t[:-1, None] + 0.5 * dt) / 45.0)
    rate = DEG * np.array([1.0, 0.7, -0.5]) * swing + [0.0, -ORBIT_RATE, 0.0]
    path = qt.propagate([1.0, 0.0, 0.0, 0.0], rate, dt)
    bias = _walk(rng, DEG * _unit(rng.standard_normal((runs, 3))), len(t), rrw, dt)
    rate = np.concatenate([rate, rate[-1:]])
    gyro = rate[:, None] + bias + arw / np.sqrt(dt) * rng.standard_normal(bias.shape)
    kinds, rows = filters(), np.arange(every, len(t), every)
    errors: dict[str, list[Array]] = {name: [] for name in kinds}
    nees: dict[str, list[float]] = {name: [] for name in kinds}
    for k in range(runs):
        q = qt.multiply(_unit(rng.standard_normal(4)), path)
        fixes = qt.multiply(q[rows], qt.exp(sigma[0] * rng.standard_normal((len(rows), 3))))
        q0 = qt.multiply(q[0], qt.exp(sigma[0] * rng.standard_normal(3)))
        log = cc.SensorLog(gyro=(t, gyro[:, k]), star=(t[rows], fixes))
        for name, kind in kinds.items():
            nav = cc.StarGyroNavigator(kind, cc.Gyro(arw, rrw), cc.StarCamera(sigma[0]))
            off, square = _bias_errors(nav, log, (q0, sigma), (q, bias[:, k]), rows)
            errors[name].append(off)
            nees[name].append(square)
    return [
        {
            "block": "N2",
            "case": f"{gap} s",
            "form": "library",
            "filter": name,
            "runs": runs,
            "fixes": list(FIXES),
            "median_bias_deg_per_s": (np.median(errors[name], axis=0) / DEG).tolist(),
            "median_nees_6": float(np.median(nees[name])),
        }
        for name in kinds
    ]


def _bias_errors(
    nav: cc.StarGyroNavigator,
    log: cc.SensorLog,
    start: tuple[Array, tuple[float, float]],
    truth: tuple[Array, Array],
    rows: NDArray[np.intp],
) -> tuple[Array, float]:
    """Return the bias errors after some fixes [rad/s] and NEES/6 after the third."""
    try:
        sol = nav.run(log, q0=start[0], sigma0=start[1], covariance=True)
    except NumericalError:
        return np.full(len(FIXES), np.inf), np.inf
    assert sol.covariance is not None
    bias = truth[1] - sol.bias
    third = rows[2]
    turn = qt.log(qt.multiply(qt.conjugate(sol.q[third]), truth[0][third]))
    error = np.concatenate([turn, bias[third]])
    square = float(error @ np.linalg.solve(sol.covariance[third], error)) / 6.0
    return np.linalg.norm(bias[rows[np.array(FIXES) - 1]], axis=1), square


def simulate_magnetometer(
    runs: int, seed: int
) -> tuple[list[cc.SensorLog], Array, Array, tuple[float, float]]:
    """Simulate N3: a magnetometer alone, 350 km, 35 deg, a dipole tilted by 11 deg, 8 h.

    Parameters
    ----------
    runs, seed : int

    Returns
    -------
    logs : list of SensorLog
        The field as a direction ``field`` with the noise 50 nT over its strength.
    q : array, (run, time, 4)
        True attitudes.
    start : array, (run, 4)
        Estimated attitudes at the start.
    noise : (float, float)
        Angle [rad/sqrt(s)] and rate [rad/s/sqrt(s)] random walk.
    """
    rng = np.random.default_rng([seed, 3])
    dt, arw, rrw = 10.0, 1e-7 * np.sqrt(10.0), 3.16e-10
    t = np.asarray(dt * np.arange(2881), dtype=np.float64)
    field, rate = tilted_dipole(t)
    strength = np.linalg.norm(field, axis=1)
    turn = qt.exp(np.outer(t, [0.0, -rate, 0.0]))
    bias = _readings(
        rng, 20.0 * DEG_PER_HOUR * rng.standard_normal((runs, 3)), len(t), arw, rrw, dt
    )
    logs, truth = [], np.empty((runs, len(t), 4))
    for k in range(runs):
        truth[k] = qt.multiply(_unit(rng.standard_normal(4)), turn)
        seen = qt.rotate(qt.conjugate(truth[k]), field) + 50e-9 * rng.standard_normal(field.shape)
        gyro = bias[:, k] + [0.0, -rate, 0.0]
        vector = (t, _unit(seen), field / strength[:, None], 50e-9 / strength)
        logs.append(cc.SensorLog(gyro=(t, gyro), vector_field=vector))
    error = 50.0 * DEG * rng.standard_normal((runs, 3))
    return logs, truth, np.asarray(qt.multiply(truth[:, 0], qt.exp(-error))), (arw, rrw)


def tilted_dipole(t: Array) -> tuple[Array, float]:
    """Return the Earth's field along the orbit of N3 (n, 3) [T], inertial, and the orbital rate.

    A centred dipole of 31.2 uT at the equator, tilted by 11 deg, that turns with the Earth.
    """
    radius = 6_378_137.0 + 350e3
    rate = float(np.sqrt(3.986004418e14 / radius**3))
    along, earth = rate * t, 7.2921159e-5 * t
    c, s = np.cos(35.0 * DEG), np.sin(35.0 * DEG)
    place = np.stack([np.cos(along), np.sin(along) * c, np.sin(along) * s], axis=1)
    tilt = 11.0 * DEG
    pole = [
        np.sin(tilt) * np.cos(earth),
        np.sin(tilt) * np.sin(earth),
        np.full_like(t, np.cos(tilt)),
    ]
    moment = -np.stack(pole, axis=1)
    size = 3.12e-5 * (6_371_200.0 / radius) ** 3
    return size * (3.0 * np.sum(moment * place, axis=1)[:, None] * place - moment), rate


def _magnetometer(runs: int, seed: int) -> list[dict[str, Any]]:
    logs, truth, start, (arw, rrw) = simulate_magnetometer(runs, seed)
    late = slice(truth.shape[1] * 4 // 5, None)
    out = []
    for name, kind in filters().items():
        nav = cc.StarGyroNavigator(kind, cc.Gyro(arw, rrw))
        sigma0 = (50.0 * DEG, 20.0 * DEG_PER_HOUR)
        errors = (_error(nav, log, start[k], sigma0, truth[k]) for k, log in enumerate(logs))
        lost = [not bool(np.all(error[late] < SETTLED_3)) for error in errors]
        out.append(_share("N3", "magnetometer", ("library", name), lost))
    return out


def _error(
    nav: cc.StarGyroNavigator,
    log: cc.SensorLog,
    start: Array,
    sigma0: tuple[float, float],
    truth: Array,
) -> Array:
    """Return the angle to the truth at each sample [rad]; infinite if the filter broke down."""
    try:
        sol = nav.run(log, q0=start, sigma0=sigma0)
    except NumericalError:
        return np.full(len(truth), np.inf)
    return np.asarray(qt.angle_between(sol.q, truth))


def _share(block: str, case: str, key: tuple[str, str], lost: list[bool]) -> dict[str, Any]:
    return {
        "block": block,
        "case": case,
        "form": key[0],
        "filter": key[1],
        "runs": len(lost),
        "not_settled_percent": 100.0 * float(np.mean(lost)),
    }


def _apart(rng: np.random.Generator) -> Array:
    """Return two random directions, 20 to 160 deg apart."""
    while True:
        pair = _unit(rng.standard_normal((2, 3)))
        if abs(float(pair[0] @ pair[1])) <= np.cos(20.0 * DEG):
            return pair


def _walk(rng: np.random.Generator, start: Array, n: int, rrw: float, dt: float) -> Array:
    """Return biases (n, run, 3) that walk on from `start` (run, 3)."""
    steps = rrw * np.sqrt(dt) * rng.standard_normal((n - 1, *start.shape))
    return np.concatenate([start[None], start + np.cumsum(steps, axis=0)])


def _readings(
    rng: np.random.Generator, bias: Array, n: int, arw: float, rrw: float, dt: float
) -> Array:
    """Return bias and white noise (n, run, 3) of a gyro [rad/s]."""
    walk = _walk(rng, bias, n, rrw, dt)
    return np.asarray(walk + arw / np.sqrt(dt) * rng.standard_normal(walk.shape))


def _unit(v: Array) -> Array:
    return np.asarray(v / np.linalg.norm(v, axis=-1, keepdims=True))
